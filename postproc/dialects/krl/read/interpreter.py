"""Statements in execution order: the values that they set, and the values that become unknown.

If it is not certain whether or how often code runs (branches, loops, parts of expressions), everything that it may
write becomes unknown. Variables that interrupts, triggers and cyclic statements write may change at any time from
their declaration on.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable

from postproc.dialects.krl.language import tree
from postproc.dialects.krl.language.expressions import calls
from postproc.dialects.krl.language.names import OPENING, WITHOUT_MOTION
from postproc.dialects.krl.language.parser import statement
from postproc.dialects.krl.language.source import Place
from postproc.dialects.krl.language.structures import LOOPS
from postproc.dialects.krl.language.values import Call, OpaqueText, Reference, UnreadableText, Value, Word, walk
from postproc.dialects.krl.read.calls import IN_ORDER, Calls
from postproc.dialects.krl.read.data_lists import declare_variables
from postproc.dialects.krl.read.explanations import names_without_value, why_not_decided, why_unknown
from postproc.dialects.krl.read.known import (
    NO_VALUE,
    UnknownValue,
    VariableValue,
    stored_originals,
    unknown_order_error,
)
from postproc.dialects.krl.read.run import SETTING_ADVICE, Run
from postproc.dialects.krl.read.state import MOTION_SETTINGS, STORED_VARIABLES, State
from postproc.dialects.krl.read.variables import Variables, convert_to_type

_CLOSING = {closing: opening for opening, closing in OPENING.items()} | {"UNTIL": "REPEAT"}
_ASYNCHRONOUS_MOTIONS = frozenset({"ASYPTP", "ASYCONT", "ASYSTOP", "ASYCANCEL"})
"""Calls that move external axes, or stop them, while the program continues."""
_SUPERPOSED_MOTIONS = frozenset({"$TECH", "$TECH_C", "$SPL_TECH", "$SPL_TECH_C"})
"""Function generators, which swing the tool about its path (KUKA, System Variables)."""
_SPLINE_TRIGGER_WORDS = frozenset({"CONST_VEL", "STOP"})
"""Statements whose distances count from the start or the end of the spline motion that follows, as in a TRIGGER."""
_SIMPLE_STATEMENTS = (tree.Assignment, tree.CallStatement)
_MOTION_STATEMENTS = (tree.Motion, tree.Spline, tree.EndSpline)
_CONDITION_WORDS = frozenset({"FOR", "IF", "WHILE", "UNTIL", "SWITCH"})
JUMP_ADVICE = (
    "Write LOOP with EXIT, FOR, WHILE or IF around the motions instead, or the motions in order; --keep-unresolved "
    "cannot leave it as it is."
)
_JUMP_PROBLEM = "it is not known before the program runs whether GOTO is run, and with it what runs next"
LOOP_ADVICE = (
    "Motions in loops and branches are corrected where the statements that run, and how often, are known before the "
    "program runs: write them out in order, or leave them as they are by --keep-unresolved."
)


def undecided_jump_message(variables: Variables, control: Place | None) -> tuple[str, str]:
    """Return the problem and the advice for a GOTO that may run or not.

    :param control: head of the control structure whose condition is not known; None if it is to be left out.
    """
    if control is None:
        return _JUMP_PROBLEM, JUMP_ADVICE
    stmt = statement(control.source, control.line)
    reason = why_not_decided(variables, control.source, stmt.values)
    names = names_without_value(variables, control.source, stmt.values)
    value_advice = f" Or say in [krl.values] of the cell what {', '.join(names)} will be." if names else ""
    return (
        f"{_JUMP_PROBLEM}: the condition of {stmt.word} ({control}) is not known{reason}",
        f"{JUMP_ADVICE}{value_advice}",
    )


class Interpreter:
    """Runs the statements of a program, and of the routines that it calls.

    :param run: the program as far as it has run.
    :param take_motion: takes a motion of the program, or a line that begins or ends a spline block.
    :param run_routine: runs the routine that was called last.
    :param inline_call: follows the call of a routine with motions as part of the trace; returns False if the call is
        not part of the trace.
    """

    def __init__(
        self,
        run: Run,
        take_motion: Callable[[Place, tree.Statement], None],
        run_routine: Callable[[], None],
        inline_call: Callable[[Place, Call], bool],
    ) -> None:
        """Keep the functions that take motions and calls."""
        self.run, self._take_motion, self._inline_call = run, take_motion, inline_call
        self.calls = Calls(run, run_routine)

    def follow_statement(self, place: Place, stmt: tree.Statement) -> None:
        """Run one statement.

        Motions of routines outside of the trace are not taken, but functions that they call are followed.

        :param place: file and line of the statement.
        :raises ProgramError: the statement is not understood, or its effect on motion is not modelled.
        """
        self.run.statement_place = place
        if isinstance(stmt, _MOTION_STATEMENTS):
            if self.run.is_traced:
                self._take_motion(place, stmt)
            else:
                self.follow_functions(place, stmt.values)
            return
        # most statements are simple, and surely do not control execution
        is_simple = isinstance(stmt, _SIMPLE_STATEMENTS) and stmt.word not in _ASYNCHRONOUS_MOTIONS
        is_control = not is_simple and self._follow_control(place, stmt)
        if not is_control:
            self._follow_other(place, stmt)

    def _follow_control(self, place: Place, stmt: tree.Statement) -> bool:
        """Follow a statement that controls execution: a line of a control structure, GOTO, RETURN, or CONST_VEL.

        The head of a control structure is added to `Level.open_structures`, and its end removes it. Calls that move
        external axes are refused here too.

        :param place: file and line of the statement.
        :returns: False for any other statement; nothing is followed then.
        :raises ProgramError: the statement closes a structure that is not open, is a GOTO that may run or not, or
            moves external axes.
        """
        level, word = self.run.level, stmt.word
        if word in OPENING or word == "REPEAT":  # not in `OPENING`, because it ends with UNTIL
            level.open_structures.append((word, place.line))
        elif word in _CLOSING:
            if not level.open_structures or level.open_structures[-1][0] != _CLOSING[word]:
                raise place.error(
                    f"{word} without {_CLOSING[word]}", advice="Check that the control structure is complete."
                )
            level.open_structures.pop()
        elif isinstance(stmt, tree.Goto):
            # the innermost open structure with a condition
            lines = [line for word, line in level.open_structures if word in _CONDITION_WORDS]
            control = Place(place.source, lines[-1]) if lines else None
            raise place.error(*undecided_jump_message(self.run.variables, control))
        elif isinstance(stmt, tree.Return):
            self._follow_return(place, stmt)
        elif isinstance(stmt, tree.SplineTiming):
            self._follow_spline_timing(place, stmt)
        elif word in _ASYNCHRONOUS_MOTIONS:
            raise place.error(f"{word} moves external axes", "Only fixed external axes are supported.")
        else:
            return False
        if word in _CONDITION_WORDS:
            self._follow_control_head(place, stmt)
        return True

    def _follow_spline_timing(self, place: Place, stmt: tree.SplineTiming) -> None:
        """Follow a statement on the speed or the stop of spline motions, such as CONST_VEL; its text stays unchanged.

        :param place: file and line of the statement.
        :raises ProgramError: the statement is not understood, or is outside of a spline block.
        """
        if not stmt.is_complete:
            raise place.error("the statement is not understood", "Check its spelling.")
        self.follow_functions(place, stmt.values)
        if not self.run.is_traced:
            return
        if stmt.word != "STOP" and not self.run.settings.state.spline_block:
            raise place.error(f"{stmt.word} outside of a spline block", "Write it between SPLINE and ENDSPLINE.")
        if stmt.word in _SPLINE_TRIGGER_WORDS:
            self.run.triggers.append(self.run.row)

    def _follow_return(self, place: Place, stmt: tree.Return) -> None:
        """Follow RETURN: the routine ends, with its value if it is a function.

        A RETURN that may not run is passed over in the main routine: what follows is corrected for the case that it
        runs. In a called routine it is refused: it would not be known what the routine does.

        :param place: file and line of the RETURN.
        :raises UnknownOrderError: the RETURN may not run, and is in a called routine.
        """
        level = self.run.level
        if not self.run.is_certain:
            is_in_called_routine = not level.is_traced or len(self.run.stack) > 1
            if is_in_called_routine:
                raise unknown_order_error(place, "it is not known whether it returns here")
            return
        if stmt.value is not None:
            level.result = convert_to_type(self.calls.evaluate_with_calls(place, stmt.value), level.routine.result_type)
        level.return_line = level.return_line or place.line

    def _follow_control_head(self, place: Place, stmt: tree.Statement) -> None:
        """Follow the functions in the head of a control structure (`stmt`); the counter of a FOR becomes unknown.

        :param place: file and line of the head.
        """
        self.follow_functions(place, stmt.values)
        if isinstance(stmt, tree.For) and stmt.name:
            self.run.variables.forget(self.run.stored_name(stmt.name), str(place))

    def follow_functions(self, place: Place, values: Iterable[Value]) -> None:
        """Follow the functions in some expressions of a statement, as calls that may not run.

        :param place: file and line of the statement.
        """
        for call in calls(values):
            self.calls.follow_call(place, call, is_certain=False)

    def _follow_other(self, place: Place, stmt: tree.Statement) -> None:
        """Follow a statement that neither moves nor controls execution, such as an assignment, a declaration or a call.

        :param place: file and line of the statement.
        :raises ProgramError: the statement is not understood, or its effect on motion is not modelled.
        """
        if stmt.word == "BAS":
            self._follow_bas(place, stmt)
        elif isinstance(stmt, tree.Assignment):
            self.assign(place, stmt.target, stmt.value)
        elif isinstance(stmt, tree.CallStatement):
            self.follow_functions(place, stmt.call.arguments)
            if not self._inline_call(place, stmt.call):
                self.calls.follow_call(place, stmt.call, is_certain=self.run.is_certain)
        elif isinstance(stmt, tree.Event):
            if isinstance(stmt, tree.Trigger) and self.run.is_traced:
                self.run.triggers.append(self.run.row)
            self._note_event(place, stmt)
        elif isinstance(stmt, (tree.CyclicInput, tree.Import)):
            self._note_cyclic_changes(place, stmt)
        elif isinstance(stmt, tree.Declaration):
            row = self.run.row if self.run.is_traced and self.run.has_rows else 0  # 0: not in the trace
            names = declare_variables(self.run.variables, place.source, stmt, row)
            if self.run.is_traced:
                self.run.note_followed_names(*(declarator.name_start for declarator in names))
        elif stmt.word == "EXIT":
            self._check_exit(place)
        elif isinstance(stmt, tree.IdleDeclaration):
            return
        elif stmt.word in WITHOUT_MOTION:
            self.follow_functions(place, stmt.values)
        elif isinstance(stmt, tree.FaultyStatement):
            raise stmt.error
        elif not isinstance(stmt, tree.Label):
            raise place.error("the statement is not understood", "Check its spelling.")

    def _note_cyclic_changes(self, place: Place, stmt: tree.CyclicInput | tree.Import) -> None:
        """Note that the variable of an ANIN, DIGIN, SIGNAL or IMPORT may change at any time from now on.

        :param place: file and line of the statement.
        :raises ProgramError: the variable is a setting of motions.
        """
        if stmt.name in MOTION_SETTINGS:
            raise place.error(f"{stmt.word} changes {stmt.name} at any time", SETTING_ADVICE)
        self.run.note_cyclic_change(place, self.run.stored_name(stmt.name))
        if isinstance(stmt, tree.Import):
            for name in stored_originals(stmt):
                self.run.note_cyclic_change(place, name)

    def _check_exit(self, place: Place) -> None:
        """Refuse an EXIT of a loop whose rounds are followed one by one, if it is not known whether the EXIT runs.

        :param place: file and line of the EXIT.
        :raises UnknownOrderError: the EXIT is in a control structure of the loop whose condition is not known.
        """
        level = self.run.level
        # open structures are those whose condition is not known; if a loop is among them, the EXIT leaves that loop
        if level.loop_depth and not any(word in LOOPS for word, _ in level.open_structures):
            word, line = level.open_structures[-1]
            reason = why_not_decided(self.run.variables, place.source, statement(place.source, line).values)
            problem = "it is not known before the program runs whether the loop is left here: "
            raise unknown_order_error(
                place,
                f"{problem}the condition of {word} ({Place(place.source, line)}) is not known{reason}",
                LOOP_ADVICE,
            )

    def _follow_bas(self, place: Place, stmt: tree.Statement) -> None:
        """Follow a call of KUKA's BAS, which sets speeds, frames and modes by its command.

        :param place: file and line of the call.
        :raises ProgramError: the call is not understood.
        """
        if isinstance(stmt, tree.FaultyStatement):
            raise stmt.error
        if not isinstance(stmt, tree.CallStatement) or not stmt.call.arguments:
            raise place.error("BAS is not understood", "Write BAS(#COMMAND,value).")
        self._change_state(place, self.run.settings.state_after_bas(place, stmt.call))

    def _change_state(self, place: Place, state: State) -> None:
        """Put the state after a statement into force; if the statement may not run, the changed fields become unknown.

        :param place: file and line of the statement.
        """
        if self.run.is_certain:
            self.run.settings.change_state(self.run.row, state)
        else:
            word, open_line = self.run.level.open_structures[-1]
            problem = f"what motions depend on is changed inside {word} ({Place(place.source, open_line)})"
            self.run.settings.may_become(self.run.row, state, place.error(problem, SETTING_ADVICE))

    def assign(self, place: Place, target: Reference, expression: Value) -> None:
        """Follow an assignment.

        Variables of the controller become unknown, since it may change them itself; but for `STORED_VARIABLES`.

        :param place: file and line of the assignment.
        :param target: the variable, array element or component that it sets; `expression` gives the value.
        :raises ProgramError: the effect on motion is not modelled.
        """
        self.follow_functions(place, [target])
        name = target.name
        if name in MOTION_SETTINGS:
            self._assign_setting(place, target, expression)
            return
        # name of the variable or array element; a call in the expression may change the index of the element
        key_before_calls = self.run.variables.key_of(target)
        # only in the file of the program are the numbers of a copied point corrected where they are written
        is_copied = target.field is None and self.run.is_traced and place.source is self.run.routine.source
        value = self.calls.evaluate_with_calls(place, expression, is_copied=is_copied)
        is_off = isinstance(value, Word) and value.text == "#OFF"
        if name in _SUPERPOSED_MOTIONS and target.field == "MODE" and not is_off:
            raise place.error(
                f"{name} superposes a motion on the path", "Only programs that leave it #OFF are understood."
            )
        if name.startswith("$") and name not in STORED_VARIABLES:
            self.run.variables.forget(name, str(place))
            return
        if target.field is None and self.run.is_traced:
            self.run.note_followed_names(target.start)
        key, stored_name = self.run.variables.key_of(target), self.run.stored_name(name)
        is_whole_array = target.indices == ()  # ``P[]``
        if key != key_before_calls:
            self.run.variables.forget(stored_name, self._unknown_element_reason(place, target, expression))
        elif not self.run.is_certain or key is None or is_whole_array:  # None: the index is not known
            self.run.variables.forget(stored_name, str(place))
        elif name == "$H_POS" and target.field is None and value == NO_VALUE:
            pass  # a position that is in no file: the home position of the cell stays
        else:
            self._store(place, target, key, expression, value)

    def _store(self, place: Place, target: Reference, key: str, expression: Value, value: VariableValue) -> None:
        """Give a variable, or a member of it, the value of an assignment.

        An unknown value keeps the place and the reason that it has, since they lead to the cause. Where it lacks them,
        it gets those of this assignment. A copied variable needs no reason: its place says enough.

        :param place: file and line of the assignment.
        :param target: the variable as the statement names it.
        :param key: stored name of the variable or array element, see `Variables`.
        :param value: value of the expression.
        """
        is_whole_variable = target.field is None
        if isinstance(value, UnknownValue):
            has_cause = value.change_place and (value.reason or is_whole_variable)
            if not has_cause:
                value = UnknownValue(str(place), why_unknown(self.run.variables, place.source, expression))
        if target.field is None:
            self.run.note_copy(
                expression, value, target.name
            )  # the numbers of a copied point are corrected at its text
            self.run.variables.set(key, value, place)
        else:
            self.run.variables.set_field(key, target.field, value, place)

    def _unknown_element_reason(self, place: Place, target: Reference, expression: Value) -> str:
        """Return why it is not known which array element an assignment writes, as text for a message.

        A call in the assigned expression changes the index, and KUKA does not say whether the index or the value is
        evaluated first.

        :param place: file and line of the assignment.
        :param target: the array element as the statement names it.
        """
        indices = {value.name for value in walk(target.indices or ()) if isinstance(value, Reference)}
        places = {
            write_place
            for call in calls([expression])
            for index in indices
            if (write_place := self.calls.write_place(call, self.run.stored_name(index))) is not None
        }
        change_places = ", ".join(sorted(map(str, places))) or "an argument"
        element = place.source.text[target.start : target.stop]
        return f"{place}: which element {element} is, is not known, because the call changes its index: {change_places}"

    def _assign_setting(self, place: Place, target: Reference, expression: Value) -> None:
        """Follow an assignment to a setting of motions, such as `$BASE`.

        :param place: file and line of the assignment.
        :param target: the setting, or a component of it; `expression` gives the value.
        :raises ProgramError: the value cannot be read, or its effect on motion is not modelled.
        """
        # the expression, which messages quote; in place of a function that has been run, its value
        value: Value | VariableValue = expression
        if isinstance(expression, UnreadableText):
            raise expression.error
        if isinstance(expression, OpaqueText) and expression.excess_start >= 0:
            raise place.error(
                f"{place.source.text[expression.excess_start : expression.stop].strip()!r} is not understood",
                advice="Check its spelling.",
            )
        if isinstance(expression, Call) or calls([expression]):
            result = self.calls.evaluate_with_calls(place, expression)
            if isinstance(expression, Call) and not isinstance(result, UnknownValue):
                value = result
        self._change_state(
            place, self.run.settings.state_after_assignment(self.run.settings.state, place, target, value)
        )

    def _note_event(self, place: Place, event: tree.Event) -> None:
        """Note what the action of an INTERRUPT or a TRIGGER may change from now on.

        :param place: file and line of the statement.
        :raises ProgramError: the action moves the robot, or may change settings of motions at any time.
        """
        scope = self.run.variables.scope
        effects = self.run.analysis.effects_of_action(
            self.run.level.module, self.run.level.routine, place, event, scope
        )
        if effects.motion is not None:
            raise place.error(f"{event.word} moves the robot ({effects.motion})", IN_ORDER)
        self.calls.note_lasting_effects(place, event.word, effects, f"{event.word} in {place}")
        # RESUME of a local interrupt returns to the routine that declares it
        if event.is_global or place.source is self.run.routine.source:
            self.run.resume_place = self.run.resume_place or effects.resume
