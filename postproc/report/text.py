"""Summaries for a terminal: of one program, and a table for many."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from msgspec.structs import astuple

from postproc.report.answers import Verdict, chance_in_words
from postproc.report.feed import duration_text, feed_sentences
from postproc.report.formatting import PLAIN, ROUNDING_MM, Display, State, estimate_text, two_digit_text
from postproc.report.summary import IssueEntry, Summary, improvement
from postproc.report.verdict import clearance_text, nothing_to_correct, uncorrected_sentence

_VERDICT_WORDS: dict[State, str] = {"failed": "failed", "warning": "to be looked at", "ok": "good"}
"""Word of the table of programs for each state of a verdict."""
_NO_FORCES = "no forces"
_MOST_REASONS = 8
"""Largest number of reasons of a verdict in the terminal; the page has all."""
_MEASURES = ("max", "RMS", "mean", "95 %")
"""Labels of `summary.Distances`."""


def program_text(content: Summary, display: Display = PLAIN) -> str:
    """Return the summary of one program on one screen: the verdict, the table of deviations, and other facts.

    The table is Table 3 of the paper.

    :param display: output whose style the text has; plain by default.
    """
    verdict = content.verdict
    lines = [
        f"{content.program}  on {content.robot}: {uncorrected_sentence(content) or target_count_text(content)}",
        display.verdict(verdict.headline, verdict.state),
        *(f"  {answer}" for answer in verdict.answers),
    ]
    lines += [f"  - {reason}" for reason in verdict.reasons[:_MOST_REASONS]]
    if len(verdict.reasons) > _MOST_REASONS:
        lines.append(f"  - {_further_reasons_text(len(verdict.reasons))}: see the report")
    no_correction = nothing_to_correct(content)
    lines += [
        "",
        _deviation_table(content, display) if no_correction is None else f"  {no_correction}",
        "",
        *_fact_lines(content),
        *_feed_lines(content, display),
        *(issue_line(issue, content.program) for issue in content.issues if issue.level == "info"),
    ]
    return "\n".join(lines)


def _deviation_table(content: Summary, display: Display) -> str:
    """Return the table of deviations [mm].

    Mode "predict": the predicted deviations. Other modes: deviations before and after correction, and the improvement.
    """
    u95 = _largest_u95(content)
    if content.mode == "predict":
        rows = [
            (label, estimate_text(value, u95)) for label, value in zip(_MEASURES, astuple(content.before), strict=True)
        ]
        return display.table(("deviation [mm]", "predicted"), rows, (1,), "  ")
    # astuple: largest, RMS, mean and 95th percentile, as _MEASURES
    measures = zip(_MEASURES, astuple(content.before), astuple(content.after), strict=True)
    table_rows = [
        (label, estimate_text(before, u95), estimate_text(after, u95), factor_text(before, after))
        for label, before, after in measures
    ]
    return display.table(("deviation [mm]", "before", "after", "improvement"), table_rows, range(1, 4), "  ")


def target_count_text(content: Summary) -> str:
    """Return the number of targets in words, and how many of them were inserted between the targets of the program."""
    inserted_count = content.inserted_targets
    noun = "places looked at" if content.mode == "predict" and inserted_count else "targets"
    origin = "between its targets" if content.mode == "predict" else "inserted"
    return f"{content.targets} {noun}" + (f", {inserted_count} of them {origin}" if inserted_count else "")


def _fact_lines(content: Summary) -> list[str]:
    """Return indented lines with facts that the verdict does not contain: path, origin, margins, clearance."""
    facts = [] if content.verdict.state == "ok" else _path_facts(content)
    if content.mode == "convert" and content.compensated_percent is not None:
        facts.append(f"compensated {percent_text(content.compensated_percent)}")
    if content.mode == "predict" and content.between_max_mm is not None:
        facts.append(f"anywhere on the path at most {estimate_text(content.between_max_mm, _largest_u95(content))} mm")
    is_path_missed = content.tolerance_held is False  # None: only the rounding of corners exceeds it
    if content.mode == "predict" and is_path_missed:
        facts.append(f"tolerance {content.tolerance_mm:g} mm EXCEEDED")
    origin = content.provenance
    if origin.state == "intact":  # postproc wrote this program, and nobody has changed it since
        is_compensated = origin.mode == "corrected" and nothing_to_correct(content) is None
        correction_note = ": its targets compensate the deviation predicted here" if is_compensated else ""
        facts.append(f"written by postproc {origin.version} ({origin.mode}), unchanged since{correction_note}")
    limits = content.limits
    facts.append(
        f"smallest joint margin {number_text(limits.min_joint_margin_deg, 1)}°, "
        f"smallest singular value {number_text(limits.min_singular_value, 3)}"
    )
    facts += [] if content.collision is None else [clearance_text(content), *content.collision.remarks]
    return [f"  {fact}" for fact in facts]


def _feed_lines(content: Summary, display: Display) -> list[str]:
    """Return lines on lowered feeds and, for several operations, a table of cutting times.

    Empty if feeds are not chosen by a tolerance.
    """
    feed = content.feed
    if feed is None:
        return []
    lines = [f"  {sentence}" for sentence in feed_sentences(feed)]
    if len(feed.operations) > 1 and feed.lowered_moves:
        rows = [
            (
                operation.name,
                duration_text(operation.time_before_s),
                duration_text(operation.time_after_s),
                str(operation.lowered_moves),
            )
            for operation in feed.operations
        ]
        lines.append(display.table(("cutting time", "before", "after", "moves slowed"), rows, range(1, 4), "  "))
    return lines


def _path_facts(content: Summary) -> list[str]:
    """Return facts on the path: the largest correction, the path error between targets, and how corners are rounded."""
    facts = []
    if content.mode == "convert" and content.max_correction_mm is not None:
        facts.append(f"largest correction {two_digit_text(content.max_correction_mm)} mm")
    if content.mode != "predict" and content.between_max_mm is not None:
        # tolerance_held is None if only approximation exceeds the tolerance
        judgement = {None: ", held but for approximation", True: ", held", False: ", EXCEEDED"}[content.tolerance_held]
        tolerance_text = "" if content.tolerance_mm is None else f" (tolerance {content.tolerance_mm:g} mm{judgement})"
        facts.append(f"between targets at most {two_digit_text(content.between_max_mm)} mm{tolerance_text}")
    blending = content.blending
    if blending.source_line is not None:
        programmed_mm = blending.programmed_max_mm
        details = f"line {blending.source_line}" + (
            f"; the program itself by {two_digit_text(programmed_mm)} mm" if programmed_mm else ""
        )
        facts.append(f"{blending.by} rounds corners by up to {two_digit_text(blending.max_mm)} mm ({details})")
    return facts


def issue_line(issue: IssueEntry, program: str) -> str:
    """Return one line about an issue, with the line of the program where it occurs first.

    :param program: file name of the program.
    """
    place = program if issue.source_line is None else f"{program}:{issue.source_line}"
    count = f" ({issue.count} times)" if issue.count > 1 else ""
    return f"{issue.level}: {place}: {issue.message}{count}"


class ProgramRow(NamedTuple):
    """A program in the table of many programs.

    :param name: of the program.
    :param content: its summary; None: the program was not written.
    :param outcome: result in one word.
    :param is_skipped: True if nothing had to be written for it: programs that call it are written with it.
    """

    name: str
    content: Summary | None
    outcome: str
    is_skipped: bool = False


def programs_table(rows: Sequence[ProgramRow], display: Display = PLAIN) -> str:
    """Return a table of many programs with expected errors (95 %); below, the first reason of each verdict not "ok".

    :param display: output whose style the table has; plain by default.
    """
    head = ("program", "targets", "uncorrected [mm]", "corrected [mm]", "better", "tolerance", "verdict", "result")
    cells: list[tuple[str, ...]] = []
    for name, content, outcome, _ in rows:
        if content is None:
            cells.append((name, *("-",) * 6, outcome))
            continue
        tolerance = "-" if content.part.tolerance_mm is None else f"{content.part.tolerance_mm:g}"
        cells.append(
            (name, str(content.targets), *_error_texts(content.verdict), tolerance, _verdict_word(content), outcome)
        )
    summaries = [row.content for row in rows if row.content is not None]
    if len(rows) > 1 and summaries:
        cells.append(_totals_row(summaries, len(rows), sum(row.is_skipped for row in rows)))
    return "\n".join([display.table(head, cells, right=range(1, 6)), *_reason_lines(rows)])


def _totals_row(summaries: Sequence[Summary], count: int, skipped_count: int) -> tuple[str, ...]:
    """Return the last row of the table of programs: number of targets, largest errors, and the count of each verdict.

    :param summaries: summaries of the programs that were written, at least one.
    :param count: number of all programs, including those that were not written.
    :param skipped_count: number of programs for which nothing had to be written.
    """
    answers = [better for content in summaries if (better := content.verdict.better) is not None]
    uncorrected = _largest_length_text([answer.uncorrected_mm for answer in answers])
    corrected_text = _largest_length_text([answer.corrected_mm for answer in answers])
    words = [_verdict_word(content) for content in summaries]
    missing_count = count - len(summaries) - skipped_count
    counts = [f"{missing_count} not written"] if missing_count else []
    counts += [f"{skipped_count} with callers"] if skipped_count else []
    counts += [f"{words.count(word)} {word}" for word in (*_VERDICT_WORDS.values(), _NO_FORCES) if word in words]
    targets = str(sum(content.targets for content in summaries))
    return (f"all {count}, at most", targets, uncorrected, corrected_text, "", "", "", ", ".join(counts))


class _ErrorTexts(NamedTuple):
    """Expected errors of a program as texts; "-" if unknown.

    :param uncorrected: expected error without correction [mm].
    :param corrected: expected error with correction [mm].
    :param chance: chance that the correction makes the part better.
    """

    uncorrected: str
    corrected: str
    chance: str


def _error_texts(verdict: Verdict) -> _ErrorTexts:
    """Return the expected errors of a program and the chance that the correction makes the part better, as texts."""
    # the answer to the question whether the part gets better
    better = verdict.better
    if better is None:
        return _ErrorTexts("-", "-", "-")
    chance = "-" if better.chance is None else chance_in_words(better.chance)
    uncorrected_text, corrected_text = (
        _largest_length_text([error]) for error in (better.uncorrected_mm, better.corrected_mm)
    )
    return _ErrorTexts(uncorrected_text, corrected_text, chance)


def _largest_length_text(lengths_mm: Sequence[float | None]) -> str:
    """Return the largest of lengths [mm] as text; None is an unknown length, "-" is returned if all are unknown."""
    lengths = [length for length in lengths_mm if length is not None]
    return two_digit_text(max(lengths)) if lengths else "-"


def _largest_u95(content: Summary) -> float | None:
    """Return the largest bound (95 %) at a target [mm]; None if the model states no uncertainty."""
    return None if content.u95 is None else content.u95.max_mm


def _verdict_word(content: Summary) -> str:
    """Return the verdict of a program as the word of the table; "no forces" for a warning if no force is known."""
    state = content.verdict.state
    return _NO_FORCES if state == "warning" and content.max_force_N == 0.0 else _VERDICT_WORDS[state]


def _reason_lines(rows: Sequence[ProgramRow]) -> list[str]:
    """Return a line for each distinct reason of verdicts that are not "ok", with the programs that it concerns.

    Only the first reason of each verdict counts. At most `_MOST_REASONS` have a line; a last line counts the others.
    """
    programs: dict[str, list[str]] = {}
    for name, content, *_ in rows:
        if content is not None and content.verdict.state != "ok":
            programs.setdefault(content.verdict.reasons[0], []).append(name)
    lines = []
    for reason, names in [*programs.items()][:_MOST_REASONS]:
        program_names = names[0] if len(names) == 1 else f"{names[0]} and {len(names) - 1} more"
        lines.append(f"  - {program_names}: {reason}")
    if len(programs) > _MOST_REASONS:
        lines.append(f"  - {_further_reasons_text(len(programs))}: see the overview")
    return lines


def _further_reasons_text(count: int) -> str:
    """Return in words how many of `count` reasons are not listed, as only `_MOST_REASONS` are."""
    further_count = count - _MOST_REASONS
    return f"{further_count} more reason{'s' if further_count > 1 else ''}"


def number_text(value: float | None, places: int) -> str:
    """Return a number with `places` decimals as text; "-" for None."""
    return "-" if value is None else f"{value:.{places}f}"


def factor_text(before_mm: float, after_mm: float) -> str:
    """Return the improvement factor, before divided by after, as text.

    "-" if the deviation before is below the rounding of written numbers; "to rounding" if only that after is.

    >>> factor_text(5.6, 0.5), factor_text(5.6, 0.0016), factor_text(0.5, 0.00005), factor_text(0.00005, 0.00005)
    ('11.2', '3500', 'to rounding', '-')
    """
    if before_mm < ROUNDING_MM:
        return "-"
    ratio = improvement(before_mm, after_mm)
    return "to rounding" if ratio is None else f"{ratio:.1f}" if ratio < 1000.0 else f"{ratio:.0f}"


def percent_text(value: float | None) -> str:
    """Return a percentage as text, never rounded up to 100.

    >>> percent_text(91.2), percent_text(99.9996), percent_text(None)
    ('91.2 %', '99.99 %', '-')
    """
    if value is None:
        return "-"
    return f"{value:.1f} %" if value < 99.9 else f"{int(value * 100.0) / 100.0:.2f} %"
