"""`postproc compare`: from two programs to the files of a comparison."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Sequence
from pathlib import Path

from msgspec import Struct
from msgspec.structs import replace

from postproc import correction, forces, provenance
from postproc.cell import Cell
from postproc.comparison import compare
from postproc.dialects import registry
from postproc.errors import InputError, PostprocError
from postproc.files import FileEntry, foreign, refuse, with_record, write_whole
from postproc.forces import ForceSource
from postproc.frames import M_PER_MM
from postproc.jobs.conversion import read_program
from postproc.jobs.marking import marked, origin_of, with_options
from postproc.jobs.output_plan import protect
from postproc.jobs.programs import Job
from postproc.jobs.settings import EXCEEDED, GOOD, Settings, as_stated, load_setup
from postproc.program import Document, Program
from postproc.report import to_json
from postproc.report.comparison import (
    ComparisonSummary,
    MadeFrom,
    comparison_page,
    comparison_summary,
    pairs_csv,
)
from postproc.robot import RobotModel
from postproc.version import VERSION

_FEW, _SHARE = 4, 0.1
"""So many lines, or this share of them, may have been changed since; else it was not written by these options."""


class CompareRequest(Struct, frozen=True, kw_only=True):
    """Which programs are compared, and where the comparison is written.

    :param nominal: the program as it should be cut: G-code, or a robot program.
    :param corrected: the robot program that is compared with it.
    :param cell: cell file.
    :param forces: CSV file of cutting forces, by lines of the nominal program, or process.toml they are computed from.
    :param output: folder to write into; None = a folder `corrected` beside the nominal program.
    :param keep_unresolved: read motions of KRL that only the running robot knows, and tell that they are not compared.
    :param overwrite: replace files that postproc did not write.
    """

    nominal: Path
    corrected: Path
    cell: Path
    forces: Path | None = None
    output: Path | None = None
    keep_unresolved: bool = False
    overwrite: bool = False

    @property
    def settings(self) -> Settings:
        """How both programs are read."""
        return Settings(self.cell, keep_unresolved=self.keep_unresolved)

    def reads(self) -> list[Path]:
        """Return the files that are read."""
        programs = (self.nominal, self.corrected)
        beside = [path for each in programs for path in registry.of_file(each).companions(each)]
        return [*programs, *beside, self.cell, *([] if self.forces is None else [self.forces])]


class ComparisonFiles(Struct, frozen=True):
    """A comparison as it was written.

    :param code: exit code: 0 good, 3 a tolerance is exceeded or the corrected program was changed.
    :param summary: content of `part.compare.report.json`.
    :param written: its files.
    """

    code: int
    summary: ComparisonSummary
    written: tuple[Path, ...]


def compare_programs(request: CompareRequest) -> ComparisonFiles:
    """Compare two programs and write what differs, whole or not at all.

    :raises PostprocError: an input is unusable, or an output must not be written.
    """
    cell, robot = load_setup(request.settings)
    nominal = read_program(request.nominal, robot, cell)
    corrected = read_program(request.corrected, robot, cell)
    if not corrected.keeps_text:
        raise InputError(
            "the second program is compared as the robot drives it, and this one is G-code",
            file=str(request.corrected),
            advice="Give the nominal program first and the robot program second.",
        )
    for path, program in ((request.nominal, nominal), (request.corrected, corrected)):
        _refuse_part(path, program)
    _refuse_corrected(request.nominal, nominal)
    folder = request.output or request.nominal.parent / "corrected"
    stem = f"{request.corrected.stem}.compare"
    names = pairs, page, record = f"{stem}.pairs.csv", f"{stem}.report.html", f"{stem}.report.json"
    protect(request.reads(), folder, names)
    if not request.overwrite:
        refuse(foreign(folder, names, record))
    source = _source(request, cell)
    found = compare(nominal, corrected, robot, cell, source)
    made = _made_from(request, cell, robot, nominal, corrected)
    content = comparison_summary(found, made, cell.tolerance, cell.output.max_correction_mm * M_PER_MM)
    contents: dict[str, bytes | Iterable[bytes]] = {
        pairs: pairs_csv(found),
        page: comparison_page(found, content),
    }

    def rendered(entries: list[FileEntry]) -> bytes:
        content["files"] = entries
        return to_json(content)

    written = write_whole(folder, with_record(contents, record, rendered))
    return ComparisonFiles(EXCEEDED if content["verdict"]["state"] == "failed" else GOOD, content, tuple(written))


def _source(request: CompareRequest, cell: Cell) -> ForceSource | None:
    """Return the forces of the nominal program: from a file, or computed from a process.toml."""
    if request.forces is None or request.forces.suffix.lower() != ".toml":
        return None if request.forces is None else forces.read(request.forces)
    from postproc.jobs import process_forces  # what a cutter does is imported with it

    return process_forces.read(request.forces, cell)


def _refuse_part(path: Path, program: Program) -> None:
    """Raise for a file that is but a part of a divided program: where the robot stands before it is said elsewhere."""
    whole = _said_by(program).part_of
    if whole:
        raise InputError(
            f"this file is a part of {whole}, which calls it", file=str(path), advice=f"Name {whole} instead."
        )


def _refuse_corrected(path: Path, program: Program) -> None:
    """Raise for a nominal program that postproc corrected, or that calls one: its targets are commands already."""
    writer = registry.by_name(program.dialect).writer
    if writer is None:
        return
    for file, said in (
        (str(path), writer.origin(program.documents)),
        *((document.name, writer.origin([document])) for document in program.documents[1:]),
    ):
        if said.mode == "corrected":
            raise InputError(
                f"this program, which is to be the nominal one, was corrected by postproc {said.version}: its targets "
                "are commands, and not those of the part",
                file=file,
                line=said.line,
                advice="Give the program that it was made from as NOMINAL, and this one as CORRECTED.",
            )


def _said_by(program: Program) -> provenance.Provenance:
    writer = registry.by_name(program.dialect).writer
    return provenance.Provenance("none") if writer is None else writer.origin(program.documents)


def _made_from(
    request: CompareRequest, cell: Cell, robot: RobotModel, nominal: Program, corrected: Program
) -> MadeFrom:
    """Return what is known of where the second program comes from."""
    said = _said_by(corrected)
    if not said.sums:
        return MadeFrom(said, {})
    here = origin_of(nominal.documents, request.cell, cell, request.forces, "corrected")
    sums = {"program": "source", "cell": "cell", "robot model": "model", "force file": "forces"}
    agrees = {name: said.sums.get(key) == getattr(here, key) for name, key in sums.items()}
    if said.state != "changed" or said.version != VERSION or not all(agrees.values()):
        return MadeFrom(said, agrees, () if said.state == "intact" else None)
    try:
        settings = with_options(request.settings, said.options)
    except ValueError:  # written by who knows what
        return MadeFrom(said, agrees)
    found = []
    for name in dict.fromkeys([corrected.name, request.nominal.stem]):  # the file may have been renamed since
        try:
            again = _written_again(request, settings, cell, robot, said.mode, name)
        except PostprocError:
            continue
        if len(again) == len(corrected.documents):
            found.append(_changed(again, corrected.documents, said.line))
    few = max(_FEW, _SHARE * sum(len(document.text.splitlines()) for document in corrected.documents))
    edited, missing = min(found, key=lambda each: len(each[0]) + each[1], default=((), 0))
    if not found or len(edited) + missing > few:
        return MadeFrom(said, agrees)
    return MadeFrom(said, agrees, edited, missing)


def _changed(
    written: Sequence[Document], documents: Sequence[Document], line: int
) -> tuple[tuple[tuple[str, int], ...], int]:
    """Return the lines, with their files, that are not as they were written, and how many are not there any more.

    :param line: of the main file that says where the program comes from, and what its text was: it is not looked at.
    """
    edited: list[tuple[str, int]] = []
    missing = 0
    by_name = {document.name: document for document in written}
    for at_same_place, new in zip(written, documents, strict=True):
        old = by_name.get(new.name, at_same_place)  # a program that was renamed has other names
        lines, fewer = _edited(old.text, new.text)
        edited += [(new.name, number) for number in lines if new is not documents[0] or number != line]
        missing += fewer
    return tuple(edited), missing


def _written_again(
    request: CompareRequest, settings: Settings, cell: Cell, robot: RobotModel, mode: str, name: str
) -> tuple[Document, ...]:
    """Return the files that `convert` writes from the same inputs with some settings, as a program of that name."""
    settings = replace(settings, mode="nominal" if mode == "nominal" else "convert")
    cell = as_stated(cell, settings)
    read_as, to = (registry.of_file(path).name for path in (request.nominal, request.corrected))
    job = Job(request.nominal, read_as, request.corrected.parent, request.forces, name, to)
    source = _source(request, cell)
    program = read_program(request.nominal, robot, cell, name=None if job.keeps_text else name)
    linearize = settings.linearize_arcs
    result = correction.process(program, robot, cell, source, settings.mode, linearize_arcs=linearize, to=job.to)
    if job.keeps_text and request.nominal.stem != name:
        result = replace(result, documents=job.writer.renamed(result.documents, name))
    return marked(result, job, settings, cell).documents


def _edited(written: str, text: str) -> tuple[list[int], int]:
    """Return the lines of a text that are not as they were written, and how many lines it has no more."""
    old, new = written.splitlines(), text.splitlines()
    same = 0
    while same < min(len(old), len(new)) and old[same] == new[same]:
        same += 1
    behind = 0
    while behind < min(len(old), len(new)) - same and old[-1 - behind] == new[-1 - behind]:
        behind += 1
    lines: list[int] = []
    missing = 0
    matcher = difflib.SequenceMatcher(
        None, old[same : len(old) - behind], new[same : len(new) - behind], autojunk=False
    )
    for what, first, last, begin, end in matcher.get_opcodes():
        if what != "equal":
            lines += range(same + begin + 1, same + end + 1)
            missing += max(0, (last - first) - (end - begin))
    return lines, missing
