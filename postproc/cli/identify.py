"""`postproc identify`: compensator geometry, compliances, geometry of the robot, from measurements."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from postproc.cli import options
from postproc.cli.options import Choice

if TYPE_CHECKING:
    from postproc.identification import IdentifiedFolder
    from postproc.jobs.identification_files import Work

_FILE = click.Path(path_type=Path)


@click.group()
def identify() -> None:
    """Identify the robot from measurements.

    The results go into a model folder that `convert` takes.

    \b
    Examples:
      postproc identify compensator markers.csv -o compensator.toml
      postproc identify elastostatics measurements.csv --experiment experiment.toml \\
          --compensator compensator.toml -o my_robot
    """  # noqa: D301 - click: keep these lines as they are


@identify.command()
@click.argument("markers", type=_FILE)
@click.option("-o", "--output", type=_FILE, required=True, help="TOML file to write.")
@options.overwrite
@click.option("--json", "as_json", is_flag=True, help="Print the result as JSON.")
def compensator(markers: Path, output: Path, overwrite: bool, as_json: bool) -> None:
    """Geometry of the gravity compensator: L, a_x, a_y.

    MARKERS is a CSV file with columns q2,marker,repeat,X,Y,Z: deg, mm, in any frame of the tracker. Marker P1 is on
    link 2 where the spring is attached; P01, P02, … are on the spring, best spread evenly around its swivel axis P0.
    Prints the paper's condition on their places (Σ R cos β = Σ R sin β = 0), the bias that they leave, and the
    intervals that evenly spread markers would give. `postproc plan compensator` proposes angles and places.
    Eq. (6) and (7) of the paper.

    \b
    Example:
      postproc identify compensator markers.csv -o compensator.toml
    """  # noqa: D301 - click: keep these lines as they are
    import json

    from postproc.identification.compensator_geometry import as_data, text_lines
    from postproc.jobs.identification_files import identify_compensator

    result = identify_compensator(markers, output, overwrite=overwrite)
    if as_json:
        click.echo(json.dumps(as_data(result, markers.name), indent=2, ensure_ascii=False))
        return
    for line in text_lines(result):
        click.echo(line)
    for warning in result.warnings:
        click.echo(f"warning: {warning}", err=True)
    click.echo(f"written: {output}")


@identify.command()
@click.argument("measurements", type=_FILE)
@click.option("--experiment", type=_FILE, required=True, help="TOML file: robot, sigma_mm, load point, points.")
@click.option("--compensator", type=_FILE, help="Geometry from `identify compensator`.")
@click.option(
    "--method",
    type=Choice(["enhanced", "serial"]),
    default="enhanced",
    show_default=True,
    help="enhanced: partial poses, compensator; serial: the strict serial chain of Dumas et al. 2011.",
)
@click.option(
    "--structure",
    type=Choice(["auto", "joints"]),
    default="auto",
    show_default=True,
    help="auto: look for springs of links and stiffening gears where joint springs do not explain the readings.",
)
@click.option("--geometry", is_flag=True, help="Calibrate the geometry too, from the readings without load.")
@click.option("-o", "--output", type=_FILE, required=True, metavar="MODEL_DIR", help="Model folder to write.")
@options.overwrite
@click.option("--json", "as_json", is_flag=True, help="Print identification.json.")
@click.pass_context
def elastostatics(ctx: click.Context, /, as_json: bool, **request: Any) -> None:
    """Compliances of joints, compensator, links and gears.

    All have 95 % intervals. MEASUREMENTS is a CSV file of the positions of reference points on the tool, without load
    (load 0) and loaded, in several configurations; the frame of the measuring device is free. Writes a model folder for
    `robot = …` of a cell, with identification.json and report.html in it. What the readings do not determine keeps the
    robot's prior value and is reported together with what to measure instead. Eq. (8) to (10) of the paper.

    Exit codes: 0 the model may be used, perhaps with a reservation; 1 the readings cannot be used; 3 the model is
    written, but may not be used: too few configurations were measured to estimate a bound, or the springs have no
    equilibrium under loads that were measured.

    \b
    Example:
      postproc identify elastostatics measurements.csv --experiment experiment.toml \\
          --compensator compensator.toml -o my_robot
    """  # noqa: D301 - click: keep these lines as they are
    from postproc.jobs.identification_files import ElastostaticsRequest, identify_elastostatics

    files_request = ElastostaticsRequest(**request)
    folder = identify_elastostatics(files_request, _print_step)
    _print_result(folder, files_request.output, as_json)
    if folder.data.verdict is not None and folder.data.verdict.refused:
        ctx.exit(3)


@identify.command()
@click.argument("measurements", type=_FILE)
@click.option("--experiment", type=_FILE, required=True, help="TOML file: robot, sigma_mm, load point, points.")
@click.option("--model", type=_FILE, help="Model folder whose springs predict the sag; default: the robot shipped.")
@click.option("-o", "--output", type=_FILE, required=True, metavar="MODEL_DIR", help="Model folder to write.")
@options.overwrite
@click.option("--json", "as_json", is_flag=True, help="Print identification.json.")
def geometry(output: Path, as_json: bool, **request: Any) -> None:
    """Geometry from readings without load.

    That is offsets, lengths and tilts, with sag under own weight. MEASUREMENTS is the CSV file of `identify
    elastostatics`; loaded readings in it are not used. The model folder written carries the calibrated geometry, and
    `convert` then corrects for it too. Cross-validation on
    configurations left out decides whether sag is separated from geometry, and whether the geometry is changed at all.

    \b
    Example:
      postproc identify geometry measurements.csv --experiment experiment.toml --model my_robot -o my_calibrated_robot
    """  # noqa: D301 - click: keep these lines as they are
    from postproc.jobs.identification_files import identify_geometry

    _print_result(identify_geometry(output=output, **request), output, as_json)


@identify.command()
@click.argument("model", type=_FILE, metavar="MODEL_DIR")
@click.argument("measurements", type=_FILE)
@click.option("--experiment", type=_FILE, help="TOML file of tracker readings: robot, sigma_mm, points.")
@click.option("--cell", type=_FILE, help="Cell file of a job: its share that the readings cover is stated.")
@options.several_programs("Programs of the job: files, folders, patterns.")
@click.option("--forces", type=_FILE, help="Cutting forces of the job: a file, or a folder with NAME.csv … for each.")
@click.option("--process", type=_FILE, help="Material, tools and stock, from which the forces are computed.")
@click.pass_context
def validate(
    ctx: click.Context,
    model: Path,
    measurements: Path,
    experiment: Path | None,
    cell: Path | None,
    programs: tuple[str, ...],
    other_programs: tuple[str, ...],
    forces: Path | None,
    process: Path | None,
) -> None:
    """Validate a model with readings that it was not fitted to.

    Checks its 95 % bound. MEASUREMENTS is a CSV file like that of `identify elastostatics`, of the same
    robot in other configurations or under other loads; states that the model was identified from are left out.
    MODEL_DIR may be the name of a shipped robot. Prints, for each level of loads, the measured displacements, the
    prediction errors, the noise in these, their 95 % bound, the factor (> if noise hides the error), the share of
    displacements whose error is inside the bound, and the limits of that share for all displacements, with 95 %
    confidence. The model does not hold if less than the promised 95 % are inside even at the upper limit; it holds if
    90 % are inside and the lower limit is above 50 %; else more configurations are needed.

    Gears with lost motion or breakpoints deflect otherwise where a torque changes its sign or leaves the measured
    range. So the torques of the loads are printed by joint and sign. With --cell and --program it is stated what
    share of the cutting path lies inside them, and the model holds for that share only. A torque is inside if five
    configurations or more have its sign on that joint and one of them at least its size, and if the torque on the most
    loaded joint is no less than under the smallest loads.

    MEASUREMENTS may also be the probing.csv of a test part, filled in. Then give --cell, --process and --program of the
    part, without --experiment: the model is checked as by `identify part --compare`.

    Exit codes: 0 the model holds, and for a job at least 95 % of it is covered; 1 the readings cannot be used; 3 the
    model does not hold, or this cannot be decided, or it states no bound.

    \b
    Examples:
      postproc identify validate my_robot validation.csv --experiment experiment.toml
      postproc identify validate my_robot validation.csv --experiment experiment.toml \\
          --cell cell.toml --program part.nc --process part.process.toml
      postproc identify validate my_robot probing.csv --cell cell.toml --process testpart.process.toml \\
          --program testpart.nc
    """  # noqa: D301 - click: keep these lines as they are
    from postproc.testpart.probing import is_probing_table

    programs += other_programs  # --program a.nc b.nc
    if is_probing_table(measurements):
        if experiment or forces or cell is None or process is None or not programs:
            raise click.UsageError("A probed part needs --cell, --process and --program, and nothing else.")
        holds = _holds_for_part(model, measurements, cell, process, tuple(map(Path, programs)))
    elif experiment is None:
        raise click.UsageError("Tracker readings need --experiment.")
    else:
        holds = _holds_for_readings(model, measurements, experiment, _work_of(cell, programs, forces, process))
    if not holds:
        ctx.exit(3)


def _work_of(cell: Path | None, programs: tuple[str, ...], forces: Path | None, process: Path | None) -> Work | None:
    """Return the job that the options of `validate` state; None if they state none.

    :raises click.UsageError: options that exclude each other, or that are missing.
    """
    from postproc.jobs.identification_files import Work

    if (cell is None) != (not programs):
        raise click.UsageError("Give --cell and --program together.")
    if forces is not None and process is not None:
        raise click.UsageError("--forces and --process exclude each other.")
    if (forces is not None or process is not None) and cell is None:
        raise click.UsageError("--forces and --process need --cell and --program.")
    if process is not None and process.suffix.lower() != ".toml":
        raise click.BadParameter(f"{process} is no .toml file.", param_hint="--process")
    return None if cell is None else Work(cell=cell, programs=programs, forces=process or forces)


def _holds_for_readings(model: Path, measurements: Path, experiment: Path, work: Work | None) -> bool:
    """Print the validation of a model with tracker readings; return whether the model holds.

    :param work: the job whose cover by the readings is printed too; None: no job.
    """
    from postproc.jobs.identification_files import validate_model

    result, text = validate_model(model, measurements, experiment, work)
    click.echo(text)
    for warning in result.warnings:
        click.echo(f"warning: {warning}", err=True)
    return result.holds


def _holds_for_part(model: Path, readings: Path, cell: Path, process: Path, programs: tuple[Path, ...]) -> bool:
    """Print the validation of a model with a probed part; return whether the model holds.

    :param programs: programs by which the part was cut.
    """
    from postproc.jobs.testpart_files import PartRequest, compare_part
    from postproc.report.testpart import agreement_lines

    data, agreement = compare_part(
        PartRequest(probed=readings, cell=cell, process=process, programs=programs), str(model)
    )
    for text in agreement_lines(data, agreement):
        click.echo(text)
    for warning in agreement.warnings:
        click.echo(f"warning: {warning}", err=True)
    return agreement.holds


@identify.command()
@click.argument("folder", type=_FILE)
@click.pass_context
def check(ctx: click.Context, folder: Path) -> None:
    """Check a folder of measurements to publish.

    Prints what it has and lacks. FOLDER holds experiment.toml and measurements.csv of `identify elastostatics`,
    dataset.toml with licence and source, LICENSE, SHA256SUMS, and the robot if it is not a shipped one. The reference
    describes the format. What is required comes first.

    Exit codes: 0 the folder can be published; 1 it cannot be read; 3 something required is missing or wrong.

    \b
    Example:
      postproc identify check my_measurements
    """  # noqa: D301 - click: keep these lines as they are
    from postproc.identification.dataset import check as findings_of

    findings = findings_of(folder)
    for finding in sorted(findings, key=lambda finding: (finding.is_present, not finding.required)):
        mark = "has  " if finding.is_present else "lacks"
        click.echo(f"{mark} {finding.text}{'' if finding.is_present or not finding.required else ' (required)'}")
    if any(finding.required and not finding.is_present for finding in findings):
        ctx.exit(3)


@identify.command()
@click.argument("probed", type=_FILE)
@click.option("--cell", type=_FILE, required=True, help="Cell in which the part was cut; its robot is the prior.")
@click.option("--process", type=_FILE, required=True, help="Process of the part: testpart.process.toml.")
@options.several_programs("What was cut: testpart.nc, and the programs of further placements.", is_required=True)
@click.option("--tool", type=int, help="Number of its tool; default: the only one.")
@options.probe_sigma
@click.option("--compare", is_flag=True, help="Check the model of the cell only; write nothing.")
@click.option("-o", "--output", type=_FILE, metavar="MODEL_DIR", help="Model folder to write.")
@options.overwrite
@click.option("--json", "as_json", is_flag=True, help="Print identification.json.")
@click.pass_context
def part(
    ctx: click.Context,
    /,
    compare: bool,
    output: Path | None,
    overwrite: bool,
    as_json: bool,
    programs: tuple[str, ...],
    other_programs: tuple[str, ...],
    **request: Any,
) -> None:
    """Compliances, and the scale of forces, from a probed part.

    PROBED is the probing.csv of `postproc testpart`, filled in: deviations along the normal, positive where material is
    left; rows without a deviation are left out. Its touch-off points on the uncut top (T01.top …, at least three) say
    how high the program ran over the block: the forces are those of the depths that were cut, and beyond half the
    flattest cut the part is refused. The part was cut uncorrected. The prior is the model of the cell with
    its covariance or sigma_percent, and the forces of the process with their sigma. Writes a model folder with
    covariance, material.toml with the forces as found (for `[material] file`), and a page of measured against predicted
    deviations. What the part does not determine keeps its prior and is named.

    --compare checks the model of the cell by the part, every month for example: it states whether the deviations agree
    with the model, and which parameters have changed.

    Exit codes: 0 the model may be used, or holds; 1 the readings cannot be used; 3 refused, does not hold, or nothing
    is decided, since features look exchanged, points contradict the others, or the touch-off was too far off.

    \b
    Examples:
      postproc identify part probing.csv --cell cell.toml --process testpart.process.toml \\
          --program testpart.nc -o my_robot
      postproc identify part probing.csv --cell my_cell.toml --process testpart.process.toml \\
          --program testpart.nc --compare
    """  # noqa: D301 - click: keep these lines as they are
    from postproc.jobs.testpart_files import PartRequest, identify_part
    from postproc.report.testpart import agreement_lines, part_lines

    if compare == (output is not None):
        raise click.UsageError("Give -o MODEL_DIR, or --compare.")
    programs += other_programs  # --program a.nc b.nc
    folder = identify_part(PartRequest(programs=tuple(map(Path, programs)), **request), output, overwrite=overwrite)
    agreement = folder.data.agreement
    if as_json:
        click.echo(folder.data.as_json().decode())
    else:
        lines = part_lines(folder.data) if agreement is None else agreement_lines(folder.data, agreement)
        for text in lines:
            click.echo(text)
        for warning in folder.data.warnings if agreement is None else agreement.warnings:
            click.echo(f"warning: {warning}", err=True)
        if folder.written_files:
            click.echo(f"written: {output}")
    if folder.data.verdict.refused if agreement is None else not agreement.holds:
        ctx.exit(3)


def _print_result(folder: IdentifiedFolder, output: Path, as_json: bool) -> None:
    """Print the result, its warnings and the output folder; with `as_json` only the result as JSON."""
    if as_json:
        click.echo(folder.data.as_json().decode())
        return
    click.echo(folder.text)
    for warning in folder.data.warnings:
        click.echo(f"warning: {warning}", err=True)
    click.echo(f"written: {output}")


def _print_step(message: str) -> None:
    """Print a step of the work on stderr: as a line for the window, as text on a terminal, else not at all."""
    import sys

    from postproc import progress

    if progress.as_lines():
        progress.write_step(message)
    elif sys.stderr.isatty():
        click.echo(f"{message} …", err=True)


@identify.command()
@click.argument("measured", type=_FILE, required=False)
@click.option("--process", type=_FILE, required=True, help="process.toml with the tool of the cuts.")
@click.option("--tool", metavar="KEY", help="Number or name of that tool in [tools]; default: the only one.")
@click.option("--propose", is_flag=True, help="Write test cuts (G-code) and the CSV file to fill in, nothing else.")
@click.option("-o", "--output", type=_FILE, required=True, help="TOML file to write; with --propose the program.")
@options.overwrite
def forces(
    measured: Path | None, process: Path, tool: str | None, propose: bool, output: Path, overwrite: bool
) -> None:
    """Cutting coefficients from measured forces or spindle power.

    MEASURED is a CSV file with columns mode,ap_mm,ae_mm,rpm,feed_mm_per_min,Fx,Fy,Fz and optionally sigma_N,power_W.
    mode is slot, up or down; forces act on the tool in FEED axes; empty cells are not used. Writes a [material] with
    95 % intervals and covariance, which process.toml takes by `file = "material.toml"`, and a page of measured and
    fitted forces. What the readings cannot separate is refused: five feeds in a slot determine all six.

    \b
    Examples:
      postproc identify forces --propose --process process.toml -o testcuts.nc
      postproc identify forces testcuts.csv --process process.toml -o material.toml
    """  # noqa: D301 - click: keep these lines as they are
    from postproc.jobs.process_forces import identify_forces, propose_cuts
    from postproc.report.material import as_text

    has_readings = measured is not None
    if propose == has_readings:  # both, or neither
        raise click.UsageError("Give MEASURED, or --propose.")
    if measured is None:
        paths = propose_cuts(process, output, tool, overwrite=overwrite)
    else:
        material, paths = identify_forces(measured, process, output, tool, overwrite=overwrite)
        click.echo(as_text(material))
        for warning in material.warnings:
            click.echo(f"warning: {warning}", err=True)
    click.echo(f"written: {', '.join(path.name for path in paths)}")
