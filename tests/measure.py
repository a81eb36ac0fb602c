"""Size and language of the project: `python -m tests.measure [FOLDER]`.

Prints for each package its lines, files, modules with exactly one client, share of import lines, regular expressions
and idioms; and for each page of documentation its words, words a sentence, longest paragraph and idioms. An idiom is an
expression of `IDIOMS` in a name, docstring, comment or message: they have plainer words.
"""

from __future__ import annotations

import ast
import re
import sys
from collections import Counter, defaultdict
from dataclasses import dataclass
from pathlib import Path

IDIOMS = re.compile(
    r"\b(is told|are told|be told|told|tells?|stands?|standing|beside|what is|give[sn]? way|giving way|gave way|felt"
    r"|so many|comes? along|came along|spared|houses?|floors?|lies off|a stranger|nobody)\b",
    re.IGNORECASE,
)
_REGEX = re.compile(r"\bre\.(compile|match|fullmatch|search|sub|finditer|findall|split)\(")


@dataclass
class Module:
    """A module: its package, lines, lines of imports, the modules it imports, regular expressions, idioms."""

    package: str
    lines: int
    imports: int
    targets: set[str]
    regexes: int
    idioms: int


def modules_of(folder: Path) -> dict[str, Module]:
    """The modules of a package, by dotted name."""
    names = {_dotted(folder, path): path for path in sorted(folder.rglob("*.py"))}
    out = {}
    for name, path in names.items():
        text = path.read_text(encoding="utf-8")
        nodes = [node for node in ast.walk(ast.parse(text)) if isinstance(node, ast.Import | ast.ImportFrom)]
        targets = {target for node in nodes for target in _targets(node, names)} - {name}
        lines = sum((node.end_lineno or node.lineno) - node.lineno + 1 for node in nodes)
        count = len(text.splitlines())
        out[name] = Module(
            _package(name), count, lines, targets, len(_REGEX.findall(text)), len(IDIOMS.findall(_spaced(text)))
        )
    return out


def single_clients(modules: dict[str, Module]) -> set[str]:
    """The modules, packages' own files apart, that exactly one other module imports."""
    clients: Counter[str] = Counter(target for module in modules.values() for target in module.targets)
    packages = {name.rpartition(".")[0] for name in modules}
    return {name for name in modules if clients[name] == 1 and name not in packages}


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


def _dotted(folder: Path, path: Path) -> str:
    return ".".join(path.relative_to(folder.parent).with_suffix("").parts).removesuffix(".__init__")


def _package(name: str) -> str:
    parts = name.split(".")
    depth = 3 if parts[1:2] == ["dialects"] else 2
    return ".".join(parts[1:depth]) or parts[0]


def _targets(node: ast.Import | ast.ImportFrom, names: dict[str, Path]) -> set[str]:
    if isinstance(node, ast.Import):
        return {alias.name for alias in node.names if alias.name in names}
    inner = {f"{node.module}.{alias.name}" for alias in node.names}
    own = {str(node.module)} if any(name not in names for name in inner) else set()
    return {name for name in inner | own if name in names}


def _spaced(text: str) -> str:
    """The text with underscores as blanks, so that names count too."""
    return text.replace("_", " ")


def main(folder: Path) -> None:
    """Print both tables."""
    modules = modules_of(folder / "postproc")
    single = single_clients(modules)
    packages: defaultdict[str, list[tuple[str, Module]]] = defaultdict(list)
    for name, module in modules.items():
        packages[module.package].append((name, module))
        packages["all"].append((name, module))
    print(f"{'package':<24}{'lines':>8}{'files':>7}{'one client':>12}{'imports':>9}{'regex':>7}{'idioms':>8}")
    for package, found in sorted(packages.items(), key=lambda item: -sum(module.lines for _, module in item[1])):
        lines = sum(module.lines for _, module in found)
        imports = sum(module.imports for _, module in found)
        print(
            f"{package:<24}{lines:>8}{len(found):>7}{sum(name in single for name, _ in found):>12}"
            f"{imports / max(1, lines):>9.1%}{sum(module.regexes for _, module in found):>7}"
            f"{sum(module.idioms for _, module in found):>8}"
        )
    print(f"\n{'page':<40}{'words':>7}{'a sentence':>12}{'paragraph':>11}{'idioms':>8}")
    for page in [*sorted(folder.glob("*.md")), *sorted(folder.glob("docs/**/*.md"))]:
        if page.name != "CHANGELOG.md":
            words, mean, longest, idioms = prose(page.read_text(encoding="utf-8"))
            print(f"{page.relative_to(folder).as_posix():<40}{words:>7}{mean:>12.1f}{longest:>11}{idioms:>8}")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if sys.argv[1:] else Path(__file__).resolve().parent.parent)
