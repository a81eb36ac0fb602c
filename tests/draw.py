"""Functions drawn at random, each printed alone, for a reader who does not know the code.

``python -m tests.draw SEED COUNT [FOLDER …] --key FILE`` draws functions of at least five lines from the package and,
as many together, from other folders, such as code that is known to be good. They are mixed and numbered; the key says
where each is from. A reader who knows neither package nor key then judges both by one measure.
"""

from __future__ import annotations

import argparse
import ast
import random
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from tests.places import ROOT

_LEAST_LINES = 5
"""Shorter functions say little about the code."""


class _Function(NamedTuple):
    """A function: its file, first line, and source text."""

    file: Path
    line: int
    text: str


def functions(folder: Path) -> Iterator[_Function]:
    """Yield the functions and methods of a folder that have `_LEAST_LINES` or more, decorators not counted."""
    for file in sorted(folder.rglob("*.py")):
        source = file.read_text(encoding="utf-8")
        lines = source.splitlines()
        for node in ast.walk(ast.parse(source)):
            if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
                end = node.end_lineno or node.lineno
                if end - node.lineno + 1 >= _LEAST_LINES:
                    first = min([node.lineno, *(decorator.lineno for decorator in node.decorator_list)])
                    yield _Function(file, first, "\n".join(lines[first - 1 : end]))


def draw(seed: int, count: int, other_folders: list[Path]) -> list[_Function]:
    """Return `count` functions in random order; half of them, evenly, from the other folders if there are any."""
    generator = random.Random(seed)
    other_count = count // 2 if other_folders else 0
    drawn = generator.sample(list(functions(ROOT / "postproc")), count - other_count)
    for index, folder in enumerate(other_folders):
        share = (other_count + index) // len(other_folders)  # the shares of all folders add up to their number
        drawn += generator.sample(list(functions(folder)), share)
    generator.shuffle(drawn)
    return drawn


def main() -> None:
    """Print the functions, and write the key."""
    parser = argparse.ArgumentParser(prog="python -m tests.draw", description=__doc__)
    parser.add_argument("seed", type=int)
    parser.add_argument("count", type=int, help="number of functions, those of other folders included")
    parser.add_argument("folder", type=Path, nargs="*", help="other code, for comparison")
    parser.add_argument("--key", type=Path, required=True, help="file for the places of the functions")
    options = parser.parse_args()
    drawn = draw(options.seed, options.count, options.folder)
    for number, function in enumerate(drawn):
        print(f"\n##### F{number:02d}\n{function.text}")
    key = "".join(f"F{number:02d} {function.file}:{function.line}\n" for number, function in enumerate(drawn))
    options.key.write_text(key, encoding="utf-8")


if __name__ == "__main__":
    main()
