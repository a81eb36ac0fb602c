"""`postproc compare`: from two programs to the files of a comparison."""

from __future__ import annotations

import csv
import math
from collections.abc import Iterable
from pathlib import Path

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from postproc import provenance
from postproc.cell import Cell
from postproc.comparison import compare
from postproc.dialects import registry
from postproc.dialects.dialect import Dialect
from postproc.errors import InputError, argument
from postproc.files import add_record, find_foreign_files, json_bytes, recorded_files, refuse, write_whole
from postproc.forces.sources import extensions
from postproc.frames import M_PER_MM
from postproc.jobs import inputs
from postproc.jobs.conversion import force_source, origin_of
from postproc.jobs.output_plan import protect
from postproc.jobs.programs import EXCEEDED, GOOD, PROCESS, Settings, apply_settings, load_setup
from postproc.jobs.started_program import read_program, read_with_start
from postproc.program import Bools, Program
from postproc.report.comparison import (
    ComparisonSummary,
    ProgramOrigin,
    comparison_page,
    comparison_summary,
    pairs_csv,
)


class CompareRequest(Struct, frozen=True, kw_only=True):
    """Two programs to compare, and where to write the comparison.

    :param nominal: the program as it should be cut: G-code, or a robot program.
    :param corrected: the robot program that is compared with it.
    :param cell: cell file.
    :param forces: CSV file of cutting forces, by lines of the nominal program, or process.toml to compute them from.
    :param output: folder to write into; None = a folder `corrected` next to the nominal program.
    :param dialect: name of the format of the programs whose extension is not known; if both extensions are known, of
        the nominal program. None: the extensions decide.
    :param keep_unresolved: read KRL with motions that are known at run time only, and list them as not compared.
    :param overwrite: replace files that postproc did not write.
    """

    nominal: Path
    corrected: Path
    cell: Path
    forces: Path | None = None
    output: Path | None = None
    dialect: str | None = None
    keep_unresolved: bool = False
    overwrite: bool = False

    @property
    def settings(self) -> Settings:
        """Settings for reading both programs."""
        return Settings(self.cell, keep_unresolved=self.keep_unresolved)

    def dialects(self) -> tuple[Dialect, Dialect]:
        """Return the dialects of the nominal and of the corrected program.

        :raises ProgramError: an extension is not known, and `dialect` is None.
        """
        is_nominal_known = registry.has_known_extension(self.nominal)
        is_corrected_known = registry.has_known_extension(self.corrected)
        # `dialect` is that of the file whose extension is not known; if both are known, of the nominal program
        is_of_nominal = is_corrected_known or not is_nominal_known
        return (
            registry.dialect_of_file(self.nominal, self.dialect if is_of_nominal else None),
            registry.dialect_of_file(self.corrected, None if is_corrected_known else self.dialect),
        )

    def input_files(self) -> list[Path]:
        """Return the input files."""
        programs = (self.nominal, self.corrected)
        pairs = zip(programs, self.dialects(), strict=True)
        companions = [path for program, dialect in pairs for path in dialect.companions(program)]
        return [*programs, *companions, self.cell, *([] if self.forces is None else [self.forces])]


class ComparisonFiles(Struct, frozen=True):
    """A comparison and its files.

    :param code: exit code: 0 good, 3 a tolerance is exceeded or the corrected program was changed.
    :param summary: content of `part.compare.report.json`, but for its list of files.
    :param written_files: its files; the last one is `part.compare.report.json`.
    """

    code: int
    summary: ComparisonSummary
    written_files: tuple[Path, ...]


def compare_programs(request: CompareRequest) -> ComparisonFiles:
    """Compare two programs and write the results: all of them or none.

    :raises PostprocError: an input is unusable, or an output must not be written.
    """
    cell, robot = load_setup(request.settings)
    nominal_dialect, second_dialect = request.dialects()
    nominal, cell = read_with_start(request.nominal, robot, cell, nominal_dialect.name)
    second_program = read_program(request.corrected, robot, cell, second_dialect.name)
    if not second_program.keeps_text:
        raise InputError(
            "the second program must be a robot program, and this one is G-code",
            file=str(request.corrected),
            advice="Give the nominal program first and the robot program second.",
        )
    for path, program in ((request.nominal, nominal), (request.corrected, second_program)):
        _refuse_part(path, program)
    _refuse_corrected_program(request.nominal, nominal)
    cell = _use_stated_tolerance(cell, request, second_program)
    folder = request.output or request.nominal.parent / "corrected"
    stem = f"{request.corrected.stem}.compare"
    pairs, page, record = f"{stem}.pairs.csv", f"{stem}.report.html", f"{stem}.report.json"
    names = (pairs, page, record)
    protect(request.input_files(), folder, names)
    if not request.overwrite:
        refuse(find_foreign_files(folder, names, record))
    source = force_source(request.forces, cell)
    file_origin = _origin_of_second(request, cell, nominal, second_program)
    if file_origin.lacks_force_file:
        _require_stated_forces(request, file_origin.stated_origin)
    ends = _stated_ends(request.corrected) if file_origin.is_made_from_inputs else None
    comparison = compare(
        nominal, second_program, robot, cell, source, same_origin=file_origin.is_made_from_inputs, ends=ends
    )
    content = comparison_summary(comparison, file_origin, cell.tolerance, cell.output.max_correction_mm * M_PER_MM)
    contents: dict[str, bytes | Iterable[bytes]] = {
        pairs: pairs_csv(comparison),
        page: comparison_page(comparison, content),
    }
    contents_with_record = add_record(contents, record, lambda entries: json_bytes(replace(content, files=entries)))
    paths = write_whole(folder, contents_with_record)
    return ComparisonFiles(EXCEEDED if content.verdict.state == "failed" else GOOD, content, tuple(paths))


def _use_stated_tolerance(cell: Cell, request: CompareRequest, second_program: Program) -> Cell:
    """Return the cell with the tolerance that the second program states, because it was written to that tolerance.

    A program that states none leaves the cell as it is.

    :raises InputError: the stated tolerance is no length above zero.
    """
    origin = _origin(second_program)
    text = origin.options.get("tolerance_mm")
    if text is None:
        return cell
    try:
        tolerance = float(text)
        if not 0.0 < tolerance < math.inf:
            raise ValueError  # noqa: TRY301 - like a text that is no number
    except ValueError:
        problem, advice = f"its line of origin states tolerance_mm={text}", "Convert the program again."
        raise InputError(problem, file=str(request.corrected), line=origin.line, advice=advice) from None
    return apply_settings(cell, replace(request.settings, tolerance_mm=tolerance))


def _require_stated_forces(request: CompareRequest, origin: provenance.Provenance) -> None:
    """Refuse a comparison without forces if the force file of the second program is next to one of the programs.

    Without forces, a target cannot be distinguished from an inserted target next to it, and offsets would be wrong.

    :param origin: origin that the second program states.
    :raises InputError: a file with the checksum of the stated forces is in the folder of one of the programs.
    """
    endings = {*extensions(), PROCESS}
    for folder in dict.fromkeys((request.nominal.parent, request.corrected.parent)):
        for file in sorted(path for path in folder.iterdir() if path.suffix.lower() in endings and path.is_file()):
            if inputs.sum_of(inputs.force_inputs(file)) == origin.sums["forces"]:
                problem = f"it was corrected for the forces in {file}, which are not given"
                advice = f"Give --forces {argument(file)}."
                raise InputError(problem, file=str(request.corrected), line=origin.line, advice=advice)


def _stated_ends(path: Path) -> Bools | None:
    """Return which Cartesian targets (n,) of a written program end a motion of the program that it was made from.

    Its list of targets, `PROGRAM.targets.csv`, states the position t of each on its motion, 1 at the end. It is only
    used if the report of the conversion lists program and list with the checksums that they have now. None: there is no
    such list.
    """
    table, record = (path.with_name(f"{path.stem}{suffix}") for suffix in (".targets.csv", ".report.json"))
    names = path.name, table.name
    if (
        not {*names} <= recorded_files(record).keys()
        or not table.exists()
        or find_foreign_files(path.parent, names, record.name)
    ):
        return None
    with table.open(encoding="utf-8", newline="") as file:
        return np.array([float(row["t"]) == 1.0 for row in csv.DictReader(file)], dtype=bool)


def _refuse_part(path: Path, program: Program) -> None:
    """Refuse a file that is only a part of a divided program, or one of its modules.

    A large program is divided into parts, which its main file calls, or into modules, which are loaded one by one. Both
    state it in their line of origin, a comment.

    :raises InputError: the file is such a part or module.
    """
    origin = _origin(program)
    if "module" in origin.options:
        raise InputError(
            f"this is module {origin.options['module']} of {origin.options.get('modules')}, not a whole program",
            file=str(path),
            line=origin.line,
            advice="Convert with divide_into_modules = false in [output] of the cell, into another folder, and compare "
            "that program: it has the same motions. `predict` takes a module.",
        )
    main_file = origin.part_of
    if main_file:
        raise InputError(
            f"this file is a part of {main_file}, which calls it", file=str(path), advice=f"Name {main_file} instead."
        )


def _refuse_corrected_program(path: Path, program: Program) -> None:
    """Refuse a nominal program that postproc corrected, or that calls a corrected program.

    :raises InputError: it is such a program: its targets are corrected poses.
    """
    writer = registry.dialect_of_name(program.dialect).writer
    if writer is None:
        return
    for file, origin in (
        (str(path), writer.origin(program.documents)),
        *((document.name, writer.origin([document])) for document in program.documents[1:]),
    ):
        if origin.mode == "corrected":
            raise InputError(
                f"the nominal program was corrected by postproc {origin.version}: its targets are corrected poses",
                file=file,
                line=origin.line,
                advice="Give the program that it was made from as NOMINAL, and this one as CORRECTED.",
            )


def _origin(program: Program) -> provenance.Provenance:
    """Return what a program states of its origin in a comment line: version, mode, checksums of its inputs.

    The state is "none" for a format that postproc does not write.
    """
    writer = registry.dialect_of_name(program.dialect).writer
    return provenance.Provenance("none") if writer is None else writer.origin(program.documents)


def _origin_of_second(request: CompareRequest, cell: Cell, nominal: Program, second_program: Program) -> ProgramOrigin:
    """Return the origin that the second program states, and which of its inputs agree with the inputs of the request.

    Forces that are not given are not compared. A program that states no checksums has no inputs to compare. If the
    nominal program was itself written by postproc, the checksums that both state for program and forces are compared.
    """
    origin, nominal_origin = _origin(second_program), _origin(nominal)
    if not origin.sums:
        return ProgramOrigin(origin, {})
    request_origin = origin_of(nominal.documents, request.cell, cell, request.forces, "corrected")
    key_of_input = {"program": "source", "cell": "cell", "robot model": "model", "force file": "forces"}
    input_agreement = {name: origin.sums.get(key) == getattr(request_origin, key) for name, key in key_of_input.items()}
    if nominal_origin.state == "intact" and nominal_origin.mode == "nominal":  # both were written from one program
        input_agreement |= {
            name: nominal_origin.sums.get(key_of_input[name]) == origin.sums.get(key_of_input[name])
            for name in ("program", "force file")
        }
    lacks_force_file = request.forces is None and not input_agreement["force file"]
    if lacks_force_file:
        del input_agreement["force file"]
    is_made_from_inputs = origin.state == "intact" and all(input_agreement.values())
    return ProgramOrigin(
        origin, input_agreement, is_made_from_inputs=is_made_from_inputs, lacks_force_file=lacks_force_file
    )
