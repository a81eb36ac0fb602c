"""Run the command `postproc` from the Python of another program.

Needs only the standard library of Python 3.8. The command of `postproc` is read from `command.json` next to this file
(`postproc install-post` writes it), else from the environment variable POSTPROC; else it is searched on the PATH.
"""

from __future__ import annotations

import json
import os
import re
import shlex
import shutil
import subprocess
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

_COMMAND_FILE = Path(__file__).with_name("command.json")
_REMEDY = (
    "Run 'postproc install-post HOST' again with the postproc that is to be used, or name its command in the "
    "environment variable POSTPROC, e.g. C:\\\\tools\\\\postproc\\\\Scripts\\\\postproc.exe or 'wsl postproc'."
)


class HostError(Exception):
    """Conversion failed; the message is for the user of the host."""


class Block(NamedTuple):
    """One line of the program that postproc reads, and where it is from in the host, the CAM program.

    :param text: the line, without its end.
    :param place: name of its origin in the host, e.g. ``operation Pocket, command 12``.
    """

    text: str
    place: str


class Converted(NamedTuple):
    """Result of a conversion.

    :param files: written files: the program first, its moves and additional input files last.
    :param summary: content of its `report.json`.
    :param warnings: warnings for the user, one line each, with the host's names of places.
    :param state: of the verdict: "ok", "warning" or "failed".
    :param verdict: its headline, the three answers, and the reasons of a state that is not "ok"; one line each.
    """

    files: list[Path]
    summary: dict[str, Any]
    warnings: list[str]
    state: str
    verdict: list[str]


def command() -> tuple[list[str], bool]:
    """Return the command that runs postproc, and True if it runs in the Windows Subsystem for Linux.

    :raises HostError: it is not found; the message says where it was searched.
    """
    if _COMMAND_FILE.is_file():
        words = [str(word) for word in json.loads(_COMMAND_FILE.read_text(encoding="utf-8"))["command"]]
    elif os.environ.get("POSTPROC"):
        words = shlex.split(os.environ["POSTPROC"], posix=os.name != "nt")
    else:
        words = ["postproc"]
    program = shutil.which(words[0])
    if program is None:
        place = f"{words[0]} of {_COMMAND_FILE}" if _COMMAND_FILE.is_file() else f"'{words[0]}'"
        raise HostError(f"postproc is not found: {place} is no program that can be run here. {_REMEDY}")
    return [program, *words[1:]], Path(words[0]).stem.lower() == "wsl"


def convert(
    blocks: Sequence[Block],
    folder: Path,
    name: str,
    extension: str,
    options: Sequence[tuple[str, str]],
    inputs: Mapping[str, bytes] | None = None,
) -> Converted:
    """Convert a program with postproc.

    On success its text is left in ``NAME.moves.txt`` in the folder: line numbers in reports refer to that file.

    :param blocks: the program.
    :param folder: to write the results into; made if it is missing.
    :param name: of the written program.
    :param extension: by which postproc knows the format of the blocks.
    :param options: of `postproc convert` and their values; an empty value for a flag. Files are given by path, or
        by name if they are among `inputs`.
    :param inputs: contents of additional input files by name; they are written to the folder too.
    :raises HostError: nothing was written, or the program may not be driven; the message gives the errors with the
        host's names of places.
    """
    text = "\n".join([block.text for block in blocks] + [""]).encode("utf-8")
    inputs = inputs or {}
    with tempfile.TemporaryDirectory(prefix="postproc") as scratch:
        program = Path(scratch) / f"{name}.{extension}"
        entry = _converted_entry(program, text, folder, options, inputs)
    issues = [(issue["level"], _issue_text(issue, program, blocks)) for issue in entry["issues"]]
    if not entry["written"]:
        faults = [_with_host_places(entry["error"], program, blocks)] if entry["error"] else []
        raise HostError("\n".join(faults + [text for level, text in issues if level == "error"]))
    verdict = entry["verdict"]
    paths = [_from_linux(path) for path in entry["written"]]
    if verdict["drive"]["state"] == "failed":  # the robot must not run this program: leave nothing that could be loaded
        for path in paths:
            path.unlink()
        faults = [verdict["headline"], *verdict["drive"]["reasons"]]
        raise HostError("\n".join(_with_host_places(fault, program, blocks) for fault in faults))
    warnings = [text for level, text in issues if level == "warning"]
    reasons = verdict["reasons"] if verdict["state"] != "ok" else []
    lines = [verdict["headline"], *verdict["answers"], *reasons]
    moves = folder / f"{name}.moves.txt"
    moves.write_bytes(text)
    for input_name, content in inputs.items():
        (folder / input_name).write_bytes(content)
    kept_inputs = [moves, *(folder / input_name for input_name in inputs)]
    lines = [_with_host_places(line, program, blocks) for line in lines]
    return Converted([*paths, *kept_inputs], entry, warnings, verdict["state"], lines)


def _converted_entry(
    program: Path, text: bytes, folder: Path, options: Sequence[tuple[str, str]], inputs: Mapping[str, bytes]
) -> dict[str, Any]:
    """Write a program and its additional input files, convert it, and return its entry in the summary of postproc.

    :param program: path at which the program is written; additional input files are written next to it.
    :param folder: of the results, see `convert`; `options` and `inputs` likewise.
    :raises HostError: a file or the folder cannot be written, or postproc cannot be run.
    """
    try:
        program.write_bytes(text)
        for input_name, content in inputs.items():
            program.with_name(input_name).write_bytes(content)
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as cause:
        raise HostError(f"{folder}: cannot be written to: {cause.strerror}. Choose another folder.") from cause
    words = [str(program), "-o", str(folder)]
    for option, value in options:
        path_or_value = str(program.with_name(value)) if value in inputs else value
        words += [option, path_or_value] if value else [option]
    entry: dict[str, Any] = _summary_of_run(["convert", *words, "--json"])["programs"][0]
    return entry


def _summary_of_run(words: Sequence[str]) -> dict[str, Any]:
    """Run postproc and return the JSON that it prints.

    :raises HostError: it cannot be run, or prints something else.
    """
    prefix, is_in_linux = command()
    if is_in_linux:
        words = [_to_linux(prefix, word) for word in words]
    try:
        process = subprocess.run(
            [*prefix, *words],
            stdin=subprocess.DEVNULL,
            capture_output=True,
            env=_environment(),
            cwd=tempfile.gettempdir(),
            creationflags=getattr(subprocess, "CREATE_NO_WINDOW", 0),
            check=False,
        )
    except OSError as cause:
        raise HostError(f"{prefix[0]} cannot be run: {cause}. {_REMEDY}") from cause
    try:
        content: dict[str, Any] = json.loads(process.stdout.decode("utf-8"))
    except ValueError:
        message = process.stderr.decode("utf-8", "replace").strip() or f"it ended with code {process.returncode}"
        hint = f" {_REMEDY}" if "No module named" in message else ""
        raise HostError(f"{re.sub('^Error: ', '', message)}{hint}") from None
    return content


def _environment() -> dict[str, str]:
    """Return the environment for postproc: without the variables that configure the Python of the host.

    An AppImage, which sets APPDIR, makes the libraries of the host be found first: its LD_LIBRARY_PATH is left out.
    """
    host_names = {"LD_LIBRARY_PATH"} if "APPDIR" in os.environ else set()
    variables = {
        name: value
        for name, value in os.environ.items()
        if name not in host_names and (not name.startswith("PYTHON") or name == "PYTHONUTF8")
    }
    variables["PYTHONIOENCODING"] = "utf-8"
    return variables


def _to_linux(prefix: Sequence[str], word: str) -> str:
    r"""Return a path as WSL knows it: ``C:\parts\a.nc`` is ``/mnt/c/parts/a.nc``; other words as they are.

    :param prefix: command that runs postproc, which begins with `wsl`.
    :raises HostError: WSL does not reach the path.
    """
    if not re.match(r"[A-Za-z]:[\\/]", word):
        return word
    words = [*prefix[:1], "wslpath", "-a", "-u", word.replace("\\", "/")]
    process = subprocess.run(words, capture_output=True, check=False)
    if process.returncode:
        raise HostError(f"{word}: WSL does not reach this path: {process.stderr.decode('utf-8', 'replace').strip()}")
    return process.stdout.decode("utf-8").strip()


def _from_linux(path: str) -> Path:
    """Return a path of WSL as Windows knows it: ``/mnt/c/parts/a.src`` is ``C:/parts/a.src``; others as they are."""
    match = re.match("/mnt/([a-z])/(.*)", path) if os.name == "nt" else None
    return Path(f"{match[1].upper()}:/{match[2]}" if match else path)


def _issue_text(issue: dict[str, Any], program: Path, blocks: Sequence[Block]) -> str:
    """Return an issue as text, with the host's name of its place."""
    line: int | None = issue.get("source_line")  # from 1; 0 or None: the issue is about no single line
    place = f"{blocks[line - 1].place}: " if line and line <= len(blocks) else ""
    return f"{place}{_with_host_places(issue['message'], program, blocks)}"


def _with_host_places(text: str, program: Path, blocks: Sequence[Block]) -> str:
    """Return a text with program lines, such as ``part.nc:12:``, replaced by the host's names of their places."""

    def place(match: re.Match[str]) -> str:
        """Return the host's name of the place of a line; the text as it is if there is no such line."""
        line = int(match[1])
        return f"{blocks[line - 1].place}:" if 1 <= line <= len(blocks) else match[0]

    host_text = re.sub(rf"\S*\b{re.escape(program.name)}:(\d+):", place, text)
    return re.sub(rf"\S*\b{re.escape(program.name)}", program.stem, host_text)
