"""Size and language of the project: `python -m tests.measure [PART …] [--folder FOLDER]`, e.g. `dialects.krl`.

Prints for each package, and for each sub-package of the parts given, its lines, files, modules with exactly one
client, share of import lines, regular expressions (all, and those outside of modules that split text into tokens) and
idioms; and for each page of documentation, and the newest section of CHANGELOG.md, its words, words a sentence, longest
paragraph and idioms. An idiom is an expression of `IDIOMS` in a name, docstring, comment or message.
"""

from __future__ import annotations

import argparse
import ast
import re
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

IDIOMS = re.compile(
    r"\b(is told|are told|be told|told|tells?|stands?|standing|beside|what is|give[sn]? way|giving way|gave way|felt"
    r"|so many|comes? along|came along|spared|houses?|lies off|a stranger|nobody)\b",
    re.IGNORECASE,
)
TOKENS = {"tokens", "bulk", "plain_lines", "plain_settings", "scan", "words"}
"""Modules that split text into tokens, or search whole files in bulk: regular expressions belong there."""
_REGEX = re.compile(r"\bre\.(compile|match|fullmatch|search|sub|finditer|findall|split)\(")


@dataclass
class Module:
    """A module: its lines, lines of imports, the modules it uses, regular expressions, idioms.

    A door has no function and no class: the file of a package that re-exports names.
    """

    lines: int
    imports: int
    targets: set[str]
    regexes: int
    idioms: int
    door: bool


def modules_of(folder: Path) -> dict[str, Module]:
    """The modules of a package, by dotted name."""
    names = {_dotted(folder, path): path for path in sorted(folder.rglob("*.py"))}
    out = {}
    exported = _exported(names)
    for name, path in names.items():
        text = path.read_text(encoding="utf-8")
        tree = ast.parse(text)
        nodes = [node for node in ast.walk(tree) if isinstance(node, ast.Import | ast.ImportFrom)]
        targets = {target for node in nodes for target in _targets(node, names)} - {name}
        targets |= _by_package(tree, nodes, exported) - {name}
        lines = sum((node.end_lineno or node.lineno) - node.lineno + 1 for node in nodes)
        count = len(text.splitlines())
        regexes, idioms = len(_REGEX.findall(text)), len(IDIOMS.findall(_spaced(text)))
        door = not any(isinstance(node, ast.FunctionDef | ast.ClassDef) for node in tree.body)
        out[name] = Module(count, lines, targets, regexes, idioms, door)
    return out


def single_clients(modules: dict[str, Module]) -> set[str]:
    """The modules, packages' own files apart, that exactly one other module uses.

    A package that only re-exports the names of a module is no client of it: those are that import the names from the
    package. It counts where there are none, since such a module is loaded by name.
    """
    packages = {name.rpartition(".")[0] for name in modules}
    users = {name: {user for user in modules if name in modules[user].targets} for name in modules}
    doors = {
        name: {user for user in users[name] if name.startswith(f"{user}.") and modules[user].door} for name in users
    }
    return {name for name in users if len(users[name] - doors[name] or users[name]) == 1 and name not in packages}


def prose(text: str) -> tuple[int, float, int, int]:
    """Words, words a sentence, words of the longest paragraph and idioms of a page of Markdown, its code left out."""
    text = re.sub(r"```.*?```", "", text, flags=re.DOTALL)
    paragraphs: list[str] = [""]
    for line in text.splitlines():
        if re.match(r"\s*([-*]|\d+\.)\s", line) or not line.strip() or line.startswith(("|", "#", "!", "    ")):
            paragraphs.append("")
        if line.strip() and not line.startswith(("|", "#", "!", "    ")):
            paragraphs[-1] += f" {line.strip()}"
    plain = [re.sub(r"`[^`]*`", "code", paragraph) for paragraph in paragraphs]
    counts = [len(re.findall(r"\w[\w'’.-]*", paragraph)) for paragraph in plain]
    sentences = [
        part for paragraph in plain for part in re.split(r"(?<=[.!?])\s+", paragraph) if re.search(r"\w", part)
    ]
    return sum(counts), sum(counts) / max(1, len(sentences)), max(counts), len(IDIOMS.findall(text))


def newest(changelog: str) -> str:
    """The section of a changelog for its newest version."""
    return re.split(r"^## ", changelog, flags=re.MULTILINE)[1]


def _dotted(folder: Path, path: Path) -> str:
    return ".".join(path.relative_to(folder.parent).with_suffix("").parts).removesuffix(".__init__")


def _packages(name: str, parts: Sequence[str]) -> set[str]:
    """The packages that a module is counted in, below the top one."""
    levels = name.split(".")[1:]
    within = {".".join(levels[:depth]) for depth in range(1, len(levels) + 1)}
    wanted = {levels[0]} if levels else set()
    for part in (*parts, "dialects"):
        depth = part.count(".") + 2
        if part in within and len(levels) >= depth:
            wanted.add(".".join(levels[:depth]))
    return wanted | {"all"}


def _targets(node: ast.Import | ast.ImportFrom, names: dict[str, Path]) -> set[str]:
    if isinstance(node, ast.Import):
        return {alias.name for alias in node.names if alias.name in names}
    inner = {f"{node.module}.{alias.name}" for alias in node.names}
    own = {str(node.module)} if any(name not in names for name in inner) else set()
    return {name for name in inner | own if name in names}


def _exported(names: dict[str, Path]) -> dict[str, dict[str, str]]:
    """The names that packages re-export: for each package, the module that each name comes from."""
    out: dict[str, dict[str, str]] = {}
    for package, path in names.items():
        if path.name == "__init__.py":
            found = [
                node for node in ast.parse(path.read_text(encoding="utf-8")).body if isinstance(node, ast.ImportFrom)
            ]
            out[package] = {
                alias.asname or alias.name: str(node.module)
                for node in found
                for alias in node.names
                if node.module in names and f"{node.module}.{alias.name}" not in names
            }
    return out


def _by_package(tree: ast.Module, nodes: Sequence[ast.AST], exported: dict[str, dict[str, str]]) -> set[str]:
    """The modules of which a module uses names that a package re-exports."""
    used = set()
    packages = {}
    for node in nodes:
        if isinstance(node, ast.ImportFrom):
            used |= {(str(node.module), alias.name) for alias in node.names}
            packages |= {alias.asname or alias.name: f"{node.module}.{alias.name}" for alias in node.names}
        elif isinstance(node, ast.Import):
            packages |= {alias.asname: alias.name for alias in node.names if alias.asname}
    for part in ast.walk(tree):
        if isinstance(part, ast.Attribute) and isinstance(part.value, ast.Name) and part.value.id in packages:
            used.add((packages[part.value.id], part.attr))
    found = set()
    for package, name in used:
        while name in exported.get(package, {}):
            package = exported[package][name]
            found.add(package)
    return found


def _spaced(text: str) -> str:
    """The text with underscores as blanks, so that names count too."""
    return text.replace("_", " ")


def main(folder: Path, parts: Sequence[str]) -> None:
    """Print both tables."""
    modules = modules_of(folder / "postproc")
    single = single_clients(modules)
    packages: defaultdict[str, list[str]] = defaultdict(list)
    for name in modules:
        for package in _packages(name, parts):
            packages[package].append(name)
    titles = f"{'lines':>8}{'files':>7}{'one client':>12}{'imports':>9}{'regex':>7}{'outside':>9}{'idioms':>8}"
    print(f"{'package':<24}{titles}")
    for package, names in sorted(packages.items(), key=lambda item: -sum(modules[name].lines for name in item[1])):
        found = [modules[name] for name in names]
        lines = sum(module.lines for module in found)
        outside = sum(modules[name].regexes for name in names if name.rpartition(".")[2] not in TOKENS)
        print(
            f"{package:<24}{lines:>8}{len(found):>7}{sum(name in single for name in names):>12}"
            f"{sum(module.imports for module in found) / max(1, lines):>9.1%}"
            f"{sum(module.regexes for module in found):>7}{outside:>9}{sum(module.idioms for module in found):>8}"
        )
    print(f"\n{'page':<40}{'words':>7}{'a sentence':>12}{'paragraph':>11}{'idioms':>8}")
    for page in [*sorted(folder.glob("*.md")), *sorted(folder.glob("docs/**/*.md"))]:
        if page.name != "commands.md":  # the text of --help counts with the package
            text = page.read_text(encoding="utf-8")
            words, mean, longest, idioms = prose(newest(text) if page.name == "CHANGELOG.md" else text)
            print(f"{page.relative_to(folder).as_posix():<40}{words:>7}{mean:>12.1f}{longest:>11}{idioms:>8}")


if __name__ == "__main__":
    options = argparse.ArgumentParser(description="Size and language of the project.")
    options.add_argument("parts", nargs="*", help="packages whose sub-packages are listed too")
    options.add_argument("--folder", type=Path, default=Path(__file__).resolve().parent.parent)
    given = options.parse_args()
    main(given.folder, given.parts)
