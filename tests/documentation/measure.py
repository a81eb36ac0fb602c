"""How large the package and its parts are, and what else tells of their form.

    python -m tests.documentation.measure [PART …]        e.g. dialects.krl forces

Printed for each part (the package, its sub-packages, and those of the parts given): lines and files; modules that
exactly one other module imports; the share of lines that are imports; regular expressions, and those outside of the
modules that read text (`tokens`, `bulk`, `plain_lines`, `plain_settings`, `words`); and words that plain English has
others for.
"""

from __future__ import annotations

import argparse
import ast
import re
from collections import Counter, defaultdict
from pathlib import Path

ROOT = Path(__file__).parents[2] / "postproc"
TOKENS = frozenset({"tokens", "bulk", "plain_lines", "plain_settings", "words"})
WORDS = (
    "told", "stands", "stand", "beside", "what is", "where is", "meeting", "house", "floor", "gives way", "give way",
    "given way", "softness", "carriage", "asked", "asks", "come along", "comes along", "so many", "lives", "held",
)  # fmt: skip
_EXPRESSION = re.compile(r"\bre\.(?:compile|match|search|fullmatch|findall|finditer|sub|split)\(")


def modules() -> dict[str, Path]:
    """Return the modules of the package by their dotted names below it."""
    found = {}
    for path in sorted(ROOT.rglob("*.py")):
        parts = path.relative_to(ROOT).with_suffix("").parts
        found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return found


def imports(path: Path) -> tuple[set[str], int]:
    """Return the names of the package that a module imports, and how many of its lines are imports."""
    names, lines = set(), 0
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import | ast.ImportFrom):
            lines += (node.end_lineno or node.lineno) - node.lineno + 1
        if isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[0] == "postproc":
            base = (node.module or "").removeprefix("postproc").lstrip(".")
            names |= {base} | {f"{base}.{one.name}".lstrip(".") for one in node.names}
    return names, lines


def clients(found: dict[str, Path]) -> dict[str, set[str]]:
    """Return which modules import each module; a package that hands it on does not count as one."""
    users: dict[str, set[str]] = defaultdict(set)
    for name, path in found.items():
        for used in imports(path)[0] & found.keys():
            if not (path.name == "__init__.py" and used.startswith(f"{name}.")):
                users[used].add(name)
    return users


def row(part: str, found: dict[str, Path], users: dict[str, set[str]]) -> str:
    """Return the line of a part."""
    own = {name: path for name, path in found.items() if not part or name == part or name.startswith(f"{part}.")}
    texts = {name: path.read_text(encoding="utf-8") for name, path in own.items()}
    lines = sum(text.count("\n") for text in texts.values())
    imported = sum(imports(path)[1] for path in own.values())
    single = sum(len(users[name]) == 1 for name, path in own.items() if path.name != "__init__.py")
    expressions = {name: len(_EXPRESSION.findall(text)) for name, text in texts.items()}
    outside = sum(count for name, count in expressions.items() if name.rpartition(".")[2] not in TOKENS)
    words = sum(sum(len(re.findall(rf"\b{word}\b", text)) for word in WORDS) for text in texts.values())
    share = f"{100 * imported / max(lines, 1):.0f} %"
    total = sum(expressions.values())
    return f"{part or 'postproc':<32}{lines:>7}{len(own):>7}{single:>12}{share:>9}{total:>8}{outside:>9}{words:>8}"


def main() -> None:
    """Print the table, and the words that are found most."""
    options = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    options.add_argument("parts", nargs="*")
    given = options.parse_args().parts
    found = modules()
    users = clients(found)
    packages = {name for name, path in found.items() if path.name == "__init__.py" and name}
    inside = [p for part in given for p in sorted(packages | {part}) if p == part or p.rpartition(".")[0] == part]
    print(f"{'part':<32}{'lines':>7}{'files':>7}{'one client':>12}{'imports':>9}{'regex':>8}{'outside':>9}{'words':>8}")
    for part in dict.fromkeys(["", *([] if given else sorted(p for p in packages if "." not in p)), *inside]):
        print(row(part, found, users))
    shown = given[0] if given else ""
    texts = [path.read_text(encoding="utf-8") for name, path in found.items() if name.startswith(shown)]
    count = Counter({word: sum(len(re.findall(rf"\b{word}\b", text)) for text in texts) for word in WORDS})
    print(f"words in {shown or 'postproc'}:", ", ".join(f"{word} {n}" for word, n in count.most_common() if n))


if __name__ == "__main__":
    main()
