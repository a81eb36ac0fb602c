"""The procedures of a module that are its program: one, or several that are each a run of their own.

A main procedure that asks a person or an input which procedure runs cannot be followed. The procedures that it calls
can: each of them begins at the start of the program, with the data as they are declared and without settings. Data
that one of them changes are not known in the others.
"""

from __future__ import annotations

from collections.abc import Sequence, Set
from pathlib import PurePath

from msgspec.structs import replace

from postproc.dialects.rapid.effects import called_names
from postproc.dialects.rapid.execution import ExecutedProgram, Execution, RapidError, RunBegin, setting_after
from postproc.dialects.rapid.instructions import SETTINGS
from postproc.dialects.rapid.moves import Move, Setting, Target
from postproc.dialects.rapid.syntax import Instruction, Module, Routine, all_statements
from postproc.dialects.rapid.values import Scope
from postproc.errors import ProgramError, first_of
from postproc.program import PTP

_MOST_NAMES = 5
"""Largest number of names in one message; further names are counted."""
_KEY = "[rapid] procedures"
"""Key of the cell that names the procedures."""


def program_procedures(
    modules: Sequence[Module], file_name: str, program_name: str, procedure_names: Sequence[str]
) -> list[Routine]:
    """Return the procedures that are the program, in the order in which they are followed.

    They are those that the cell names, as far as the modules have them. Without such procedures the result is one: the
    procedure named like the file, named like the program, or named main, in this order; otherwise the only one without
    parameters that no other calls.

    :param procedure_names: names that the cell states.
    :raises ProgramError: there is no procedure, it is not clear which is the program, or a named one has parameters.
    """
    routines = {routine.name: routine for module in modules for routine in module.routines if routine.kind == "PROC"}
    named_routines = [routines[name] for name in dict.fromkeys(map(str.upper, procedure_names)) if name in routines]
    for routine in named_routines:
        if routine.parameters:
            raise ProgramError(
                f"PROC {routine.name} has parameters, so that it is no run of its own",
                file=file_name,
                advice=f"Name a procedure that calls it in {_KEY} of the cell.",
            )
    if named_routines:
        return named_routines
    for candidate in (PurePath(file_name).stem.upper(), program_name.upper(), "MAIN"):
        if candidate in routines:
            return [routines[candidate]]
    called_names = {
        statement.name.removeprefix("%")
        for routine in routines.values()
        for statement in all_statements(routine.body)
        if isinstance(statement, Instruction)
    }
    uncalled_routines = [
        routine for routine in routines.values() if routine.name not in called_names and not routine.parameters
    ]
    if len(uncalled_routines) == 1:
        return uncalled_routines
    if not routines:
        raise ProgramError("there is no PROC", file=file_name, advice="Check that this is the program.")
    names = first_of([routine.name for routine in (uncalled_routines or routines.values())], _MOST_NAMES)
    raise ProgramError(
        f"there is no PROC main, and it is not clear which of these is the program: {names}",
        file=file_name,
        advice=f"Name the file like the procedure, name the procedures in {_KEY} of the cell, or add a PROC main that "
        "calls what is to run.",
    )


def follow(executions: Sequence[Execution], start_numbers: Sequence[float]) -> ExecutedProgram:
    """Run executions one after another, each from the start of the program, and return one result for all.

    Each further run begins with a motion to the start of the program, which is in no text.

    :param executions: executions of the procedures of one program, which have not run.
    :param start_numbers: the start as the 12 numbers of a jointtarget.
    :raises RapidError: a procedure cannot be followed, or is no run of its own beside the others.
    """
    results = [execution.run() for execution in executions]
    if len(results) == 1:
        return results[0]
    program = ExecutedProgram()
    for execution, result in zip(executions, results, strict=True):
        if not result.errors:
            _check_run(execution, result, {execution.entry.name for execution in executions})
        if program.moves and result.moves:  # not the first run
            program.begins.append(RunBegin(execution.entry.start, len(program.moves), len(program.notes)))
            program.moves.append(_move_to_start(execution.entry, result.moves[0], start_numbers))
        move_count = len(program.moves)  # the moves of this run are counted behind those of the runs before
        program.moves += result.moves
        program.notes += [(comment, index + move_count) for comment, index in result.notes]
        program.waits += [(start, count + move_count) for start, count in result.waits]
        for loop_start, rounds in result.rounds.items():
            program.rounds.setdefault(loop_start, []).extend(rounds)
        for name, calls in result.calls.items():
            program.calls.setdefault(name, []).extend(calls)
        for name, (start, count) in result.unknown_calls.items():
            first_start, count_before = program.unknown_calls.get(name, (start, 0))
            program.unknown_calls[name] = first_start, count_before + count
        program.errors += result.errors
        program.followed_names |= result.followed_names
        program.cell_data |= result.cell_data
    return program


def setting_elsewhere(routine: Routine, followed_names: Set[str]) -> Instruction | None:
    """Return the first instruction by which a caller of followed procedures changes settings of moves; None without it.

    Settings of a new program count as no change.

    :param routine: a routine that is not followed.
    :param followed_names: names of the followed routines.
    """
    if not called_names(routine.body) & followed_names:
        return None
    settings = (
        item for item in all_statements(routine.body) if isinstance(item, Instruction) and item.name in SETTINGS
    )
    return next((item for item in settings if setting_after(item, Setting(), Scope({})) != Setting()), None)


def _move_to_start(entry: Routine, first_move: Move, start_numbers: Sequence[float]) -> Move:
    """Return the motion with which the run of a procedure begins: to the start of the program, in the frames of a move.

    :param first_move: first move of the procedure.
    :param start_numbers: the start as the 12 numbers of a jointtarget.
    """
    return replace(
        first_move,
        statement=Instruction(entry.start, entry.start, "MOVEABSJ", ()),
        kind=PTP,
        target=Target([*start_numbers], first_move.target.expression),
        via=None,
        has_joint_target=True,
        zone=0.0,
    )


def _check_run(execution: Execution, result: ExecutedProgram, entry_names: set[str]) -> None:
    """Check that a procedure is a run of its own, whatever runs before and after it.

    :param execution: its execution; `result`: what it returned.
    :param entry_names: names of all procedures that are runs of their own.
    :raises RapidError: it does not move, calls another one of them, never ends, or changes settings for the others.
    """
    entry = execution.entry
    if not result.moves:
        problem = f"PROC {entry.name} has no motions, and {_KEY} of the cell names it"
        raise RapidError(problem, entry.start, "Remove it from there.")
    for name in result.calls:
        if name in entry_names:
            problem = f"PROC {entry.name} calls {name}, and {_KEY} of the cell names both: its moves would run twice"
            raise RapidError(problem, result.calls[name][0].start, "Name one of them.")
    if result.endless_loop is not None:
        problem = f"this loop never ends, so that no other procedure runs after PROC {entry.name}"
        advice = f"Put its body into a procedure of its own, and name this one in {_KEY}."
        raise RapidError(problem, result.endless_loop.start, advice)
    if execution.setting != Setting():
        problem = (
            f"PROC {entry.name} leaves ConfJ, SingArea, CirPathMode or VelSet changed, so that the other procedures of "
            f"{_KEY} would move differently after it"
        )
        raise RapidError(problem, entry.start, "Set them back at its end.")
