"""How two programs differ: numbers and verdict (`part.compare.report.json`), pairs as CSV, text for a terminal."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import numpy as np
from msgspec import Struct
from msgspec.structs import asdict, astuple, replace
from numpy.typing import NDArray

from postproc.chunks import chunks
from postproc.comparison import Comparison, Difference, place_of
from postproc.correction import statistics
from postproc.decimals import Number, rows_of_csv
from postproc.errors import Level
from postproc.files import FileEntry
from postproc.frames import DEG_PER_RAD, MM_PER_M, Array, norm, xyzabc_from_pose
from postproc.program import Ints, Program
from postproc.provenance import Provenance
from postproc.provenance import State as Origin
from postproc.report.answers import LIMITS_AND_COLLISIONS, UNJUDGED, Drive, Tolerance, Verdict, verdict_of
from postproc.report.formatting import PLAIN, ROUNDING_MM, Display, State, above_limit_text, millimetre_text, stated_mm
from postproc.report.path import operation_starts
from postproc.report.summary import Distances


class Names(Struct, frozen=True):
    """Display names of the files of a program.

    :param main_file: name of the main file.
    :param prefix: text before file names: empty, or folders with a trailing slash.
    :param has_several_files: True if the motions of the program are in several files.
    """

    main_file: str
    prefix: str
    has_several_files: bool

    def location_text(self, file_and_line: tuple[str, int]) -> str:
        """Return file and line as text, such as `folder/part.src:12`."""
        return f"{self.prefix}{file_and_line[0]}:{file_and_line[1]}"

    def line_text(self, file_and_line: tuple[str, int]) -> str:
        """Return a line number for tables, preceded by its file if the program has several files."""
        return self.location_text(file_and_line) if self.has_several_files else str(file_and_line[1])


def names_of(comparison: Comparison) -> tuple[Names, Names]:
    """Return the display names of the files of both programs, with folders if a file name is in both."""
    programs = comparison.nominal, comparison.corrected
    files = [{document.name.lower() for document in program.documents} for program in programs]
    prefixes = (
        _distinct_ends(*(program.documents[0].folder for program in programs)) if files[0] & files[1] else ("", "")
    )
    nominal, corrected_names = (
        Names(prefix + program.documents[0].name, prefix, _has_several_files(program, rows))
        for program, prefix, rows in zip(programs, prefixes, comparison.pair.T, strict=True)
    )
    return nominal, corrected_names


def _has_several_files(program: Program, rows: Ints) -> bool:
    """Return whether motions are in more than one file; False without motions.

    :param rows: (n,) rows of the motions of the program.
    """
    places = program.places(rows)
    return bool(len(places.file)) and bool((places.file != places.file[0]).any())


def _distinct_ends(nominal_folder: str, second_folder: str) -> tuple[str, str]:
    """Return the shortest ends of two paths that tell these folders apart, with a trailing slash.

    Empty if they are the same folder.

    For example "new/" and "old/" of /jobs/new and /jobs/old.
    """
    folders = [Path(folder).resolve().parts for folder in (nominal_folder, second_folder)]
    if folders[0] == folders[1]:
        return "", ""
    # smallest number of last parts of the paths that differ; as the folders differ, there is one
    count = next(n for n in range(1, max(map(len, folders)) + 1) if folders[0][-n:] != folders[1][-n:])
    # the root of a drive is a part with slashes of its own
    first, second = ("/".join(part.strip("/\\") for part in folder[-count:]) + "/" for folder in folders)
    return first, second


_MOST_LARGEST_PAIRS = 20
"""Number of pairs with the largest offsets in the JSON file."""
_DIFFERENCE_KINDS = (
    "speed", "kind", "approximation", "base", "tool", "external-axis", "posture", "axis-target", "orientation", "force",
    "rapid", "twice", "back", "orientation-type", "statement", "not-compared",
)  # fmt: skip


class ProgramOrigin(Struct, frozen=True):
    """The origin of the second program, and whether it was made from the inputs of this comparison.

    :param stated_origin: the origin that its text states.
    :param input_agreement: name of each input (program, cell, robot model, force file) → whether the second program was
        made from it. Empty if its text states no origin; without force file if it was made with one that is not given
        now.
    :param is_made_from_inputs: its text is as postproc wrote it, and it was made from these inputs.
    :param lacks_force_file: it was made with a force file that is not given now.
    """

    stated_origin: Provenance
    input_agreement: Mapping[str, bool]
    is_made_from_inputs: bool = False
    lacks_force_file: bool = False


class Rotations(Struct, frozen=True):
    """Angles between the orientations of pairs, along the cutting path."""

    max_deg: float
    rms_deg: float


class Lines(Struct, frozen=True):
    """Files and lines of a pair."""

    nominal_file: str
    nominal_line: int
    corrected_file: str
    corrected_line: int


class PairEntry(Lines, frozen=True):
    """A pair."""

    mm: float
    deg: float


class WorstPair(Struct, frozen=True):
    """Files and lines of the pair with the largest value; None without such a pair."""

    nominal_file: str | None
    nominal_line: int | None
    corrected_file: str | None
    corrected_line: int | None


_NO_LINES = {"nominal_file": None, "nominal_line": None, "corrected_file": None, "corrected_line": None}


class CutDistances(WorstPair, frozen=True):
    """Distances of the loaded tip from nominal along the cutting path, for each program; worst pair of the second."""

    nominal: Distances
    corrected: Distances


class DistancesBetweenPairs(Struct, frozen=True):
    """Largest distances of the loaded tip from the nominal path between pairs, for each program.

    Motions with a force count: no rapid moves, and no PTP.
    """

    nominal_max_mm: float
    corrected_max_mm: float
    corrected_file: str
    corrected_line: int


class PathGap(Struct, frozen=True):
    """Largest distance of the two paths between consecutive pairs, and its place; 0 and None without segments."""

    max_mm: float
    nominal_file: str | None
    nominal_line: int | None
    corrected_file: str | None
    corrected_line: int | None


class OperationEntry(Struct, frozen=True):
    """An operation of the nominal program."""

    name: str
    tool: int
    nominal_file: str
    nominal_line: int
    pairs: int
    offset: Distances
    cut: CutDistances | None


class DifferenceEntry(Struct, frozen=True):
    """A difference other than offsets, or a part that could not be compared, and its first place."""

    level: Level
    kind: str
    message: str
    source_file: str | None
    source_line: int | None
    corrected_file: str | None
    corrected_line: int | None
    count: int


class OriginEntry(Struct, frozen=True):
    """The origin of the second program; None where it is unknown.

    `made_from_these`: name of each input of this comparison → whether the second program was made from it.
    """

    state: Origin
    mode: str | None
    version: str | None
    made_from_these: dict[str, bool]


class ComparisonSummary(Struct, frozen=True, omit_defaults=True, kw_only=True):
    """Content of `part.compare.report.json`. Statistics are along the cutting path, at targets of both programs.

    A pair is a target of the nominal program and its partner in the corrected one. `cut` and `between` are deviations
    of the loaded tool, at pairs and between them: None if no forces are known.
    """

    nominal: str
    corrected: str
    robot: str
    pairs: int
    inserted: int
    splines: int
    only_nominal: int
    passed: int
    passed_within_mm: float | None
    only_corrected: int
    offset: Distances
    rotation: Rotations
    between_targets: PathGap
    largest: list[PairEntry]
    differences: dict[str, int]
    cut: CutDistances | None
    between: DistancesBetweenPairs | None
    tolerance_mm: float
    operations: list[OperationEntry]
    provenance: OriginEntry
    issues: list[DifferenceEntry]
    verdict: Verdict
    files: list[FileEntry] | None = None


def comparison_summary(
    comparison: Comparison, file_origin: ProgramOrigin, tolerance: float, limit: float
) -> ComparisonSummary:
    """Return the content of `part.compare.report.json`.

    :param file_origin: origin of the second program.
    :param tolerance: largest permitted distance of the tip from the nominal path [m].
    :param limit: largest permitted correction [m].
    """
    content = _unjudged_summary(comparison, file_origin, tolerance)
    errors, doubts = [*_failures(content, limit * MM_PER_M, file_origin)], [*_doubts(content, file_origin)]
    state: State = "failed" if errors else "warning" if doubts else "ok"
    drive = Drive(state, [*errors, *doubts], [LIMITS_AND_COLLISIONS])
    passed_checks = _passed_checks(content, file_origin)
    verdict = verdict_of("convert", drive, None, _tolerance_answer(content), passed_checks, words=WORDS)
    return replace(content, verdict=verdict)


def _passed_checks(content: ComparisonSummary, file_origin: ProgramOrigin) -> list[str]:
    """Return sentences on the checks that passed, and on the differences of level "info"."""
    sentences = ["every target has its partner" + (", or the path passes it" if content.passed else "")]
    if content.provenance.state == "intact":
        sentences.append("the text is as postproc wrote it")
    are_forces_known = content.cut is not None
    if are_forces_known:
        sentences.append(
            f"the corrected program stays within {content.tolerance_mm:g} mm at its targets under the forces given"
        )
    elif file_origin.lacks_force_file:
        sentences.append(
            "both come from the same program, cell and robot model; the forces of the correction are in a file: give "
            "it with --forces to check what remains"
        )
    return sentences + [_issue_text(issue) for issue in content.issues if issue.level == "info"]


def _unjudged_summary(comparison: Comparison, file_origin: ProgramOrigin, tolerance: float) -> ComparisonSummary:
    """Return the content of the report with a placeholder as verdict; parameters as of `comparison_summary`."""
    rotation = statistics(comparison.rotation, comparison.cut_length)
    count_of_kind = Counter[str]()
    for difference in comparison.differences:
        count_of_kind[difference.kind] += difference.count
    names = names_of(comparison)
    nominal, second_names = names
    return ComparisonSummary(
        nominal=nominal.main_file,
        corrected=second_names.main_file,
        robot=comparison.robot,
        pairs=len(comparison.pair),
        inserted=len(comparison.inserted_rows),
        splines=int(np.count_nonzero(comparison.spline)),
        only_nominal=len(comparison.only_nominal),
        passed=len(comparison.passed_rows),
        passed_within_mm=_largest_passing_distance(comparison),
        only_corrected=len(comparison.additional_rows),
        offset=_distances(comparison.distance, comparison.cut_length),
        rotation=Rotations(max_deg=rotation.largest * DEG_PER_RAD, rms_deg=rotation.rms * DEG_PER_RAD),
        between_targets=_largest_gap(comparison, names),
        largest=_largest_pairs(comparison, names),
        differences={kind.replace("-", "_"): count_of_kind[kind] for kind in _DIFFERENCE_KINDS},
        cut=_cut_distances(comparison, names, slice(0, len(comparison.pair))),
        between=_deviation_between_targets(comparison, second_names),
        tolerance_mm=stated_mm(tolerance),
        operations=[*_operation_entries(comparison, names)],
        provenance=OriginEntry(
            state=file_origin.stated_origin.state,
            mode=file_origin.stated_origin.mode or None,
            version=file_origin.stated_origin.version or None,
            made_from_these=dict(file_origin.input_agreement),
        ),
        issues=[_difference_entry(difference, nominal, second_names) for difference in comparison.differences],
        verdict=UNJUDGED,
    )


def _largest_passing_distance(comparison: Comparison) -> float | None:
    """Return the largest distance of the second path from nominal targets that it leaves out [mm]; None if unknown."""
    distances = comparison.passing_distance[np.isfinite(comparison.passing_distance)]
    return float(distances.max()) * MM_PER_M if len(distances) else None


def _difference_entry(difference: Difference, nominal: Names, second_names: Names) -> DifferenceEntry:
    """Return a difference as an entry of the summary.

    :param nominal: display names of the files of the nominal program, `second_names` of the second one.
    """
    return DifferenceEntry(
        level=difference.level,
        kind=difference.kind,
        message=difference.message,
        source_file=None if difference.nominal is None else nominal.prefix + difference.nominal[0],
        source_line=None if difference.nominal is None else difference.nominal[1],
        corrected_file=None if difference.corrected is None else second_names.prefix + difference.corrected[0],
        corrected_line=None if difference.corrected is None else difference.corrected[1],
        count=difference.count,
    )


def place_text(entry: DifferenceEntry) -> str:
    """Return file and line of the first place of a difference in each program, joined by "and"; empty if unknown."""
    places = (
        (entry.source_file, entry.source_line),
        (entry.corrected_file, entry.corrected_line),
    )
    return " and ".join(f"{file}:{line}" for file, line in places if file is not None)


def _failures(content: ComparisonSummary, limit_mm: float, file_origin: ProgramOrigin) -> Iterator[str]:
    """Yield reasons why the corrected program must not be run.

    :param limit_mm: largest permitted correction.
    """
    if content.provenance.state == "changed":
        yield f"{content.corrected} was changed since postproc wrote it: convert the program again"
    are_forces_known = content.cut is not None
    # without the forces of its correction, targets cannot be told from inserted ones: then offsets mean nothing
    are_offsets_judged = are_forces_known or not file_origin.is_made_from_inputs
    if are_offsets_judged and not content.offset.max_mm <= limit_mm:  # not ≤: an unknown offset (NaN) fails too
        offset = above_limit_text(content.offset.max_mm, limit_mm)
        place = _pair_text(content.largest[0])
        yield f"{place}: this target is {offset} mm off: more than max_correction_mm = {limit_mm:g}"
    if not content.pairs:
        yield "no target of one program belongs to one of the other"
    yield from (_issue_text(issue) for issue in content.issues if issue.level == "error")


def _tolerance_answer(content: ComparisonSummary) -> Tolerance | None:
    """Return the answer that the second program does not hold the tolerance of the path; None if nothing shows that.

    It is never "held": collisions and limits are left to a prediction of the second program.
    """
    cut, between_targets = content.cut, content.between  # deviations under force; None: no forces are known
    tolerance, reasons = content.tolerance_mm, list[str]()
    # not ≤: an unknown distance (NaN) fails too
    if cut is not None and not cut.corrected.max_mm <= tolerance:
        reasons.append(
            f"{_pair_text(cut)}: the corrected program leaves {above_limit_text(cut.corrected.max_mm, tolerance)} mm "
            f"at this target under the forces given (tolerance {tolerance:g} mm)"
        )
    if between_targets is not None and not between_targets.corrected_max_mm <= tolerance:
        reasons.append(
            f"{between_targets.corrected_file}:{between_targets.corrected_line}: between targets it leaves "
            f"{above_limit_text(between_targets.corrected_max_mm, tolerance)} mm to the nominal path under the forces "
            f"given (tolerance {tolerance:g} mm)"
        )
    if not reasons:
        return None
    return Tolerance(
        state="failed",
        of="path",
        mm=tolerance,
        held=False,
        beyond_percent=None,
        would_help=[],
        reasons=reasons,
    )


def _pair_text(pair: Lines | WorstPair) -> str:
    """Return files and lines of a pair in both programs."""
    return f"{pair.nominal_file}:{pair.nominal_line} and {pair.corrected_file}:{pair.corrected_line}"


def _doubts(content: ComparisonSummary, file_origin: ProgramOrigin) -> Iterator[str]:
    """Yield reasons to check the corrected program before it is run."""
    # name of each input (program, cell, robot model, force file) → whether the corrected program was made from it
    input_agreement = content.provenance.made_from_these
    changed_inputs = [name for name, is_same in input_agreement.items() if not is_same]
    if changed_inputs:
        yield f"{content.corrected} was made with {' and '.join(f'another {name}' for name in changed_inputs)}"
    are_forces_known = content.cut is not None
    if content.provenance.mode == "nominal" and are_forces_known:
        yield f"{content.corrected} is nominal: it was written without correction"
    # a correction explains distances of a program that was made from these inputs, and another $BASE those of any
    are_distances_explained = file_origin.is_made_from_inputs or content.differences["base"] > 0
    if not are_forces_known and not are_distances_explained:
        yield from _unexplained_distances(content)
    yield from (_issue_text(issue) for issue in content.issues if issue.level == "warning")


def _unexplained_distances(content: ComparisonSummary) -> Iterator[str]:
    """Yield a doubt about the largest distance of the programs beyond the tolerance: no forces explain it.

    Of a distance at a target and one between targets, only the first is named.
    """
    gap = content.between_targets
    reason = "and no forces are known that explain it: give --forces"
    if content.offset.max_mm > content.tolerance_mm:
        yield f"{_pair_text(content.largest[0])}: this target is {content.offset.max_mm:.4f} mm off, {reason}"
    elif gap.max_mm > content.tolerance_mm:
        place = f"{gap.nominal_file}:{gap.nominal_line} and {gap.corrected_file}:{gap.corrected_line}"
        yield f"{place}: on the way to this target the programs are {gap.max_mm:.4f} mm apart, {reason}"


def _issue_text(issue: DifferenceEntry) -> str:
    """Return a difference as text, with its first place and its count."""
    count = f" ({issue.count} times)" if issue.count > 1 else ""
    place = place_text(issue)
    return f"{place}{': ' if place else ''}{issue.message.rstrip('.')}{count}"


def _distances(values: Array, cut_length: Array) -> Distances:
    """Return the statistics of distances along the cutting path [mm].

    :param values: (n,) the distances [m].
    :param cut_length: (n,) length of path with which each distance counts [m]; 0 of rapid motions.
    """
    measures = statistics(values, cut_length)
    return Distances(
        max_mm=measures.largest * MM_PER_M,
        rms_mm=measures.rms * MM_PER_M,
        mean_mm=measures.mean * MM_PER_M,
        p95_mm=measures.p95 * MM_PER_M,
    )


def _cut_distances(comparison: Comparison, names: Sequence[Names], rows: slice) -> CutDistances | None:
    """Return the deviations of both programs under force at cutting targets [mm], and the worst pair of the second one.

    None without forces. The lines of the worst pair are None if all pairs are rapid.

    :param names: display names of the files of both programs.
    :param rows: pairs that count.
    """
    if comparison.cuts is None:
        return None
    rapid, cut_length = comparison.rapid[rows], comparison.cut_length[rows]
    nominal_distance, corrected_distance = (
        norm(comparison.cuts.nominal[rows]),
        norm(comparison.cuts.corrected_deviation[rows]),
    )
    lines = _NO_LINES
    if not rapid.all():
        worst = rows.start + int(np.argmax(np.where(rapid, -1.0, corrected_distance)))
        lines = asdict(_lines_of_pair(comparison, names, worst))
    return CutDistances(
        **lines, nominal=_distances(nominal_distance, cut_length), corrected=_distances(corrected_distance, cut_length)
    )


def _largest_gap(comparison: Comparison, names: Sequence[Names]) -> PathGap:
    """Return the largest distance of the paths between targets [mm], and its pair.

    0 and no pair if no distance is known.

    :param names: display names of the files of both programs.
    """
    # rapid motions, and paths from or to a PTP (NaN), do not count
    size = np.where(comparison.rapid | np.isnan(comparison.path_distance), -1.0, comparison.path_distance)
    worst = int(np.argmax(size)) if len(size) else -1
    if worst < 0 or size[worst] < 0.0:
        return PathGap(max_mm=0.0, **_NO_LINES)
    return PathGap(max_mm=float(size[worst]) * MM_PER_M, **asdict(_lines_of_pair(comparison, names, worst)))


def _deviation_between_targets(comparison: Comparison, second_names: Names) -> DistancesBetweenPairs | None:
    """Return the largest deviations between targets of cutting moves [mm]; None without forces or cutting moves."""
    cuts = comparison.cuts  # `row`: motion of the second program at each place between pairs
    motions = comparison.corrected.motions
    if cuts is None or not len(cuts.row):
        return None
    is_cutting = ~motions.rapid[cuts.row]
    worst = int(np.argmax(np.where(is_cutting, cuts.corrected_distance, -1.0)))
    if not is_cutting[worst]:
        return None
    file, line = comparison.corrected.places(cuts.row[worst : worst + 1]).of(0)
    return DistancesBetweenPairs(
        nominal_max_mm=float(cuts.nominal_distance[is_cutting].max()) * MM_PER_M,
        corrected_max_mm=float(cuts.corrected_distance[worst]) * MM_PER_M,
        corrected_file=second_names.prefix + file,
        corrected_line=line,
    )


def _largest_pairs(comparison: Comparison, names: Sequence[Names]) -> list[PairEntry]:
    """Return the cutting pairs with the largest offsets, the largest first, at most `_MOST_LARGEST_PAIRS`."""
    size = np.where(comparison.rapid, -1.0, comparison.distance)  # negative: not cutting
    order = np.argsort(-size, kind="stable")[:_MOST_LARGEST_PAIRS]
    return [
        PairEntry(
            **asdict(_lines_of_pair(comparison, names, row)),
            mm=float(comparison.distance[row]) * MM_PER_M,
            deg=float(comparison.rotation[row]) * DEG_PER_RAD,
        )
        for row in order[size[order] >= 0.0].tolist()
    ]


def _lines_of_pair(comparison: Comparison, names: Sequence[Names], pair: int) -> Lines:
    """Return file and line of both targets of a pair, as keys of the report.

    :param names: display names of the files of both programs.
    :param pair: index of the pair.
    """
    nominal_row, corrected_row = comparison.pair[pair]
    nominal_file, nominal_line = place_of(comparison.nominal, nominal_row)
    corrected_file, corrected_line = place_of(comparison.corrected, corrected_row)
    return Lines(
        nominal_file=names[0].prefix + nominal_file,
        nominal_line=nominal_line,
        corrected_file=names[1].prefix + corrected_file,
        corrected_line=corrected_line,
    )


def _operation_entries(comparison: Comparison, names: Sequence[Names]) -> Iterator[OperationEntry]:
    """Yield an entry for each operation of the nominal program that has cutting targets, in order.

    :param names: display names of the files of both programs.
    """
    starts = operation_starts(comparison.nominal, comparison.pair[:, 0])  # first pair → name and tool
    for first, end in pairwise([*sorted(starts), len(comparison.pair)]):
        rows = slice(first, end)
        cutting_count = int(np.count_nonzero(~comparison.rapid[rows]))
        if not cutting_count:
            continue
        name, tool = starts[first]
        # argmin: the first pair that is not rapid
        lines = _lines_of_pair(comparison, names, first + int(np.argmin(comparison.rapid[rows])))
        yield OperationEntry(
            name=name,
            tool=tool,
            nominal_file=lines.nominal_file,
            nominal_line=lines.nominal_line,
            pairs=cutting_count,
            offset=_distances(comparison.distance[rows], comparison.cut_length[rows]),
            cut=_cut_distances(comparison, names, rows),
        )


_XYZABC = ("X", "Y", "Z", "A", "B", "C")
_NUMBER_COLUMNS = (
    *(f"{name}_nominal" for name in _XYZABC),
    *(f"{name}_corrected" for name in _XYZABC),
    "offset_mm", "rotation_deg", "speed_nominal_mm_per_s", "speed_corrected_mm_per_s",
    "cut_nominal_mm", "cut_corrected_mm", "between_mm", "cut_length_mm",
)  # fmt: skip
_DECIMALS = (6,) * 13 + (6, 3, 3, 6, 6, 6, 6)
"""Decimals of each of `_NUMBER_COLUMNS`."""
PAIR_COLUMNS = ("state", "nominal_file", "nominal_line", "corrected_file", "corrected_line", "rapid", *_NUMBER_COLUMNS)
"""Columns of the CSV file of pairs, in order."""
_STATES = ("pair", "inserted", "only_nominal", "only_corrected", "passed")


def pairs_csv(comparison: Comparison) -> Iterator[bytes]:
    """Yield the CSV of pairs in pieces of some thousand rows, in the order of the second program.

    A target that only the nominal program has follows the partner of the target before it.
    A number that is unknown or does not apply to a target is an empty cell. Poses of pairs are in the nominal `$BASE`,
    poses of other targets in the `$BASE` of their own motion.
    """
    yield (",".join(PAIR_COLUMNS) + "\n").encode()
    targets = _table_targets(comparison)
    nominal_row, corrected_row = targets.nominal[targets.order], targets.corrected[targets.order]
    numbers = _numbers_of_targets(comparison, targets)[targets.order]
    is_nominal_rapid, is_corrected_rapid = comparison.nominal.motions.rapid, comparison.corrected.motions.rapid
    # a pair is rapid if its nominal motion is
    rapid = np.where(nominal_row >= 0, is_nominal_rapid[nominal_row], is_corrected_rapid[corrected_row]).astype(float)
    state_names = _word_column(_STATES, targets.state[targets.order])
    nominal_file, nominal_line = _place_columns(comparison.nominal, nominal_row)
    corrected_file, corrected_line = _place_columns(comparison.corrected, corrected_row)
    for part in chunks(len(targets.order)):
        columns: list[Number | NDArray[np.uint8]] = [
            state_names[part],
            nominal_file[part],
            Number.of(nominal_line[part], 0),
            corrected_file[part],
            Number.of(corrected_line[part], 0),
            Number.of(rapid[part], 0),
            *(Number.of(numbers[part, column], decimals) for column, decimals in enumerate(_DECIMALS)),
        ]
        yield rows_of_csv(columns)


class _TableTargets(NamedTuple):
    """The n targets of the CSV file: first the pairs, in the order of `Comparison.pair`, then all others.

    :param state: (n,) index in `_STATES`.
    :param nominal: (n,) motion of the nominal program; −1 for targets of the second program alone.
    :param corrected: (n,) motion of the second program; −1 for targets of the nominal program alone.
    :param order: (n,) indices of the targets in the order of the rows of the file.
    """

    state: Ints
    nominal: Ints
    corrected: Ints
    order: Ints


def _table_targets(comparison: Comparison) -> _TableTargets:
    """Return all targets of both programs, and their order in the CSV file: that of the second program.

    A nominal target without a partner follows the partner of the last paired target before it.
    """
    paired_nominal_row, paired_corrected_row = comparison.pair.T
    states = [
        _targets_of_state("pair", paired_nominal_row, paired_corrected_row),
        _targets_of_state("inserted", None, comparison.inserted_rows),
        _targets_of_state("only_nominal", comparison.only_nominal, None),
        _targets_of_state("passed", comparison.passed_rows, None),
        _targets_of_state("only_corrected", None, comparison.additional_rows),
    ]
    state, nominal_row, corrected_row = np.concatenate(states, axis=1)
    has_no_partner = corrected_row < 0
    sort_row = corrected_row.copy()
    preceding_pair_count = np.searchsorted(paired_nominal_row, nominal_row[has_no_partner])
    sort_row[has_no_partner] = np.append(-1, paired_corrected_row)[preceding_pair_count]  # −1: no pair before it
    return _TableTargets(state, nominal_row, corrected_row, order=np.lexsort((has_no_partner, sort_row)))


def _targets_of_state(state: str, nominal: Ints | None, corrected: Ints | None) -> Ints:
    """Return targets of one state (3, n): index of the state, nominal motion and motion of the second program.

    :param nominal: (n,) motions of the nominal program; None: −1 for all targets.
    :param corrected: (n,) motions of the second program; None: −1 for all targets.
    """
    count = len(nominal if nominal is not None else corrected if corrected is not None else ())
    rows = [np.full(count, -1) if motions is None else motions for motions in (nominal, corrected)]
    return np.stack([np.full(count, _STATES.index(state)), *rows])


def _numbers_of_targets(comparison: Comparison, targets: _TableTargets) -> Array:
    """Return the columns `_NUMBER_COLUMNS` (n, k) of targets, not yet in the order of the file; NaN without a value.

    Pairs come first, in the order of `Comparison.pair`, then targets without a partner.
    """
    pair_count, nominal_row, corrected_row = len(comparison.pair), targets.nominal, targets.corrected
    nominal_motions, corrected_motions = comparison.nominal.motions, comparison.corrected.motions
    nominal_pose, corrected_pose = (np.full((len(targets.state), 6), np.nan) for _ in range(2))
    nominal_pose[nominal_row >= 0] = xyzabc_from_pose(nominal_motions.target[nominal_row[nominal_row >= 0]])
    corrected_pose[:pair_count] = xyzabc_from_pose(comparison.pose)
    unpaired = pair_count + np.flatnonzero(corrected_row[pair_count:] >= 0)
    corrected_pose[unpaired] = xyzabc_from_pose(corrected_motions.target[corrected_row[unpaired]])

    def pair_column(values: Array | None) -> Array:
        """Return a column (n,) with the values of the pairs, NaN for other targets; None: NaN for all targets."""
        column = np.full(len(targets.state), np.nan)
        if values is not None:
            column[:pair_count] = values
        return column

    cuts = comparison.cuts
    return np.column_stack(
        [
            nominal_pose,
            corrected_pose,
            pair_column(comparison.distance * MM_PER_M),
            pair_column(comparison.rotation * DEG_PER_RAD),
            np.where(nominal_row >= 0, comparison.nominal_feed[nominal_row], np.nan) * MM_PER_M,
            np.where(corrected_row >= 0, corrected_motions.feed[corrected_row], np.nan) * MM_PER_M,
            pair_column(None if cuts is None else norm(cuts.nominal) * MM_PER_M),
            pair_column(None if cuts is None else norm(cuts.corrected_deviation) * MM_PER_M),
            pair_column(comparison.path_distance * MM_PER_M),
            pair_column(comparison.cut_length * MM_PER_M),
        ]
    )


def _place_columns(program: Program, rows: Ints) -> tuple[NDArray[np.uint8], Array]:
    """Return the columns of file names (n, width) and of lines (n,) of motions (n,).

    :param rows: (n,) motions; −1: no motion, whose file name is empty and whose line is NaN.
    """
    is_motion = rows >= 0
    places = program.places(rows[is_motion])
    line, file_index = np.full(len(rows), np.nan), np.full(len(rows), len(places.files))  # the last name is empty
    line[is_motion], file_index[is_motion] = places.line, places.file
    return _word_column([*places.files, ""], file_index), line


def _word_column(words: Sequence[str], index: Ints) -> NDArray[np.uint8]:
    """Return a column of texts (n, width) as bytes in UTF-8, padded with zeros, quoted where CSV requires it.

    :param words: distinct texts of the column.
    :param index: (n,) index in `words` of the text of each row.
    """
    csv_words = ['"' + word.replace('"', '""') + '"' if set(word) & set(',"\r\n') else word for word in words]
    return np.char.encode(csv_words, "utf-8").view(np.uint8).reshape(len(csv_words), -1)[index]


WORDS: dict[State, str] = {
    "ok": "They belong together.",
    "warning": "Look at the differences.",
    "failed": "Do not run the corrected one.",
}
"""Sentence for each state of the verdict."""
_MEASURES = ("max", "RMS", "mean", "95 %")
"""Labels of the fields of `Distances`, in order."""
_PAIRS_IN_TEXT = 5
"""Largest number of pairs in the text for a terminal."""


def comparison_text(content: ComparisonSummary, display: Display = PLAIN) -> str:
    """Return the summary of a comparison as text for a terminal, at most one screen.

    :param display: output whose style the text has; plain by default.
    """
    verdict = content.verdict
    lines = [
        f"{content.corrected} against {content.nominal}  on {content.robot}: {count_text(content)}",
        display.verdict(verdict.headline, verdict.state),
        *(f"  {answer}" for answer in verdict.answers),
        *(f"  - {reason}" for reason in verdict.reasons),
        "",
        _distance_table(content, display),
        "",
        *(f"  {line}" for line in _detail_lines(content)),
    ]
    return "\n".join(lines)


def _distance_table(content: ComparisonSummary, display: Display) -> str:
    """Return the table of offsets, and of the deviations of both programs if forces are known [mm], as text."""
    cut, between_targets = content.cut, content.between
    head = ["along the cuts [mm]", "offset"] + (["nominal cuts", "corrected cuts"] if cut is not None else [])
    distances = [content.offset] + ([cut.nominal, cut.corrected] if cut is not None else [])
    # a row for each measure, a column for each of the distances
    measures = zip(_MEASURES, *map(astuple, distances), strict=True)
    rows = [(label, *map(millimetre_text, values)) for label, *values in measures]
    if between_targets is not None:
        nominal_mm, corrected_mm = between_targets.nominal_max_mm, between_targets.corrected_max_mm
        rows.append(("max between", "-", millimetre_text(nominal_mm), millimetre_text(corrected_mm)))
    return display.table(head, rows, range(1, len(head)), "  ")


def _detail_lines(content: ComparisonSummary) -> Iterator[str]:
    """Yield lines on the orientation, the path between targets, the largest offsets, and the origin of the program."""
    yield f"orientation: {content.rotation.max_deg:.4f}° at most"
    path_gap = content.between_targets
    if path_gap.nominal_line is not None:
        yield (
            f"on the way between targets: {millimetre_text(path_gap.max_mm)} mm at most, before "
            f"{path_gap.nominal_file}:{path_gap.nominal_line} and {path_gap.corrected_file}:{path_gap.corrected_line}"
        )
    if content.passed:
        yield passed_sentence(content)
    if content.splines:
        yield spline_sentence(content)
    for pair in content.largest[:_PAIRS_IN_TEXT]:
        if pair.mm > 0.0:
            yield f"{millimetre_text(pair.mm)} mm between {_pair_text(pair)}"
    origin = content.provenance
    if origin.state == "none":
        yield f"{content.corrected} does not say that postproc wrote it"
    elif origin.version is not None:
        state = "unchanged since" if origin.state == "intact" else "changed since"
        yield f"{content.corrected} was written by postproc {origin.version} ({origin.mode}), {state}"


def spline_sentence(content: ComparisonSummary) -> str:
    """Return a sentence on splines, of which the targets are compared but not the path between them."""
    count = content.splines
    return f"of splines ({count} SPL) the targets are compared, the way between them is not"


def passed_sentence(content: ComparisonSummary) -> str:
    """Return a sentence on nominal targets that the second program leaves out, but whose path passes them."""
    count, distance = content.passed, content.passed_within_mm
    count_text, pronoun = ("1 target", "it") if count == 1 else (f"{count} targets", "them")
    verb = "is" if count == 1 else "are"
    passes = f"its path passes {pronoun}" + ("" if distance is None else f" within {max(distance, ROUNDING_MM):.4f} mm")
    return f"{count_text} of the nominal program {verb} not in the corrected one; {passes}"


def count_text(content: ComparisonSummary) -> str:
    """Return the numbers of paired and unpaired targets in words; missing and added ones only if there are any."""
    text = f"{content.pairs} pairs, {content.inserted} inserted"
    text += f", {content.only_nominal} missing" if content.only_nominal else ""
    return text + (f", {content.only_corrected} added" if content.only_corrected else "")
