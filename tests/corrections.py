"""Programs from text, read and corrected in a cell: the sample cell with its KR 270, unless a test names another."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from postproc import correction
from postproc.cell import Cell
from postproc.correction import Result
from postproc.dialects import registry
from postproc.dialects.text import decode
from postproc.program import Program
from postproc.robot import RobotModel
from tests.kr270 import CELL, ROBOT


def read_files(files: Mapping[str, str | bytes], cell: Cell = CELL, robot: RobotModel = ROBOT) -> Program:
    """Read a program.

    :param files: text by file name. The first is the main file: its name is that of the program, its ending says the
        dialect.
    """
    documents = [decode(name, text.encode() if isinstance(text, str) else text) for name, text in files.items()]
    main = Path(documents[0].name)
    return correction.read(documents, robot, cell, main.stem, registry.dialect_of_file(main).name)


def read_back(result: Result, cell: Cell = CELL, robot: RobotModel = ROBOT) -> Program:
    """Read what was written."""
    main = Path(result.documents[0].name)
    return correction.read(result.documents, robot, cell, main.stem, registry.dialect_of_file(main).name)


def krl_files(source: str, data: str | None = None) -> dict[str, str]:
    """Return the files of a KRL program: part.src, and part.dat if there is one."""
    return {"part.src": source} | ({} if data is None else {"part.dat": data})


def process_files(
    files: Mapping[str, str | bytes], cell: Cell = CELL, robot: RobotModel = ROBOT, **options: object
) -> Result:
    """Read a program and correct it, see `read_files` and `correction.process`."""
    return correction.process(read_files(files, cell, robot), robot, cell, **options)


def correct_files(
    files: Mapping[str, str | bytes], cell: Cell = CELL, robot: RobotModel = ROBOT, **options: object
) -> Result:
    """Read a program and correct it, see `process_files`; fail if an issue stops it."""
    result = process_files(files, cell, robot, **options)
    assert not result.failed, result.issues
    return result
