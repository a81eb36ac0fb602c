"""Calls: a called routine is followed too, statement by statement, if this can be done exactly.

The execution trace: the lines of the program in the order in which they are executed, as rows. Called routines with
motions or force comments are part of it. A place is a line of a file.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

from msgspec import Struct
from msgspec.structs import replace

from postproc.dialects.krl.language.expressions import calls
from postproc.dialects.krl.language.names import PURE, STANDARD
from postproc.dialects.krl.language.routines import Callee, Module, Routine
from postproc.dialects.krl.language.source import Place
from postproc.dialects.krl.language.values import Aggregate, Call, OpaqueText, Reference, Value, writable_variable
from postproc.dialects.krl.read.effects import Effects
from postproc.dialects.krl.read.explanations import why_unknown
from postproc.dialects.krl.read.known import NO_VALUE, Scope, UnknownValue, VariableValue, unknown_order_error
from postproc.dialects.krl.read.run import SETTING_ADVICE, Level, Run, UntracedCall
from postproc.dialects.krl.read.state import FIELD_OF_SETTING, MOTION_SETTINGS, STORED_VARIABLES, fields_of
from postproc.dialects.krl.read.variables import INT_OR_REAL, convert_to_type
from postproc.errors import Issue, ProgramError

_MAX_CALL_DEPTH = 20
"""Largest number of calls within each other that are followed; a deeper call is not run exactly."""
IN_ORDER = "Motions of interrupts cannot be corrected; write them out in order."
_COMPLETE_ADVICE = "Begin behind the call with a LIN or PTP whose target has all components."
_JOINTS_ADVICE = "Begin behind the call with a PTP to joint angles, all of A1 … A6."
_INLINE_ADVICE = "Put the motions of the subprogram in place of its call."


class Calls:
    """Follows calls, and expressions with calls in them.

    :param run: the program as far as it has run.
    :param run_routine: runs the routine that was called.
    :ivar entered_calls: calls of routines in the execution trace that have not ended, the innermost last.
    """

    def __init__(self, run: Run, run_routine: Callable[[], None]) -> None:
        """Begin without a call; the variables of the run evaluate functions by following their calls here."""
        self.run, self._run_routine = run, run_routine
        run.variables.functions = _PureFunctions(self)
        self.entered_calls: list[_BoundCall] = []

    def evaluate_with_calls(self, place: Place, expression: Value, *, is_copied: bool = False) -> VariableValue:
        """Return the value of an expression, and run the functions in it.

        A function that is the whole expression runs whenever the statement does. Functions inside a larger expression,
        or in arguments, may not run.

        :param place: the statement that contains the expression.
        :param is_copied: True if the expression is assigned to a variable or a parameter. A point that it names then
            keeps its place in the text, where its numbers are corrected, see `Run.note_copy`.
        :returns: an `UnknownValue` if the value is not known before run time; `NO_VALUE` for a variable of the program
            without a value.
        :raises ProgramError: a function moves the robot where this cannot be corrected, or the text cannot be read.
        """
        if isinstance(expression, Call):
            for inner in calls(expression.arguments):
                self.follow_call(place, inner, is_certain=False)
            if expression.name in PURE:
                return self.run.variables.evaluate(expression)
            return self.follow_call(place, expression, is_certain=self.run.is_certain)
        for inner in calls([expression]):
            self.follow_call(place, inner, is_certain=False)
        value = self.run.variables.evaluate(expression)
        if isinstance(value, Aggregate):
            return self._with_text_place(expression, value, is_copied=is_copied)
        is_program_variable = isinstance(expression, Reference) and expression.name[0] != "$"
        if value == NO_VALUE and not is_program_variable:
            return UnknownValue(str(place), why_unknown(self.run.variables, place.source, expression))
        return value

    def _with_text_place(self, expression: Value, value: Aggregate, *, is_copied: bool) -> Aggregate:
        """Return the value of an expression with the place of the text in which its numbers may be corrected.

        An aggregate in a traced routine: its own text, in the present row. A copied point: the text of that point. Any
        other text belongs to another variable, so that the value counts as computed.

        :param value: value of the expression.
        :param is_copied: see `evaluate_with_calls`.
        """
        if isinstance(expression, Aggregate) and self.run.is_traced:
            return value if value.is_computed else self.run.with_row(value)
        if is_copied and isinstance(expression, Reference) and expression.field is None:
            return value
        return replace(value, is_computed=True)

    def follow_call(self, place: Place, call: Call, *, is_certain: bool) -> VariableValue:
        """Follow a call, and return the value of the function, if it is one.

        A routine that cannot be run exactly is not run: all that it may write becomes unknown. A routine of the
        execution trace is entered by `enter_routine` instead, where it surely runs.

        :param is_certain: True if the call runs exactly once. If False, only a routine without side effects is run.
        :returns: an `UnknownValue` if the value is not known before run time, or the routine gives none.
        :raises ProgramError: the routine moves the robot where this cannot be corrected, or has lasting effects that
            cannot be followed (`note_lasting_effects`).
        """
        callee = self.run.library.find_callee(call.name, self.run.level.module)
        unknown = UnknownValue(str(place), f"what {call.spelling(place.source)}() gives is not known")
        self._note_break_off(place, call)
        if callee is None:
            self._follow_absent_routine(place, call)
            if call.name in PURE or call.name in STANDARD:
                return unknown
            return UnknownValue(str(place), f"{call.spelling(place.source)}() is in no file of the program")
        effects = self.run.analysis.effects_of(*callee)
        self.note_lasting_effects(place, call.name, effects)
        self._check_motion(place, call, *callee, effects)
        if callee.module is self.run.library.program:
            self.run.called_routines.add(callee.routine)
        if effects.waits:
            self.run.waiting_calls.append(self.run.row)
        if _has_no_effects(effects):  # may be run even if it is not certain that the program runs it
            result = None if self._obstacle(place, call, *callee, effects) else self._run_exactly(place, call, *callee)
            if effects.turn_speed_place is not None and (result is None or not is_certain):  # may have set them
                self.run.settings.forget_turn_speeds(self.run.row)
            return unknown if result is None else result
        if is_certain and not self._obstacle(place, call, *callee, effects):
            result = self._run_exactly(place, call, *callee)
            if result is not None:
                return result
        # the routine is not run, or an error ended it: variables that it may change become unknown
        if effects.interrupt_motion is not None:
            problem = f"{call.name} is called, and declares a GLOBAL interrupt that moves the robot"
            raise place.error(f"{problem} ({effects.interrupt_motion})", IN_ORDER)
        self._forget_arguments(place, call, callee.routine)
        self._forget_written_variables(place, call.name, effects)
        return unknown

    def _note_break_off(self, place: Place, call: Call) -> None:
        """Add a call to `Run.interruptible_calls` if RESUME of an interrupt may break it off, and the motion before it.

        The robot may then be anywhere on that motion. Functions of the controller are not broken off. Calls in routines
        that are not traced do not count.
        """
        if not self.run.may_be_broken_off or not self.run.is_traced or call.name in PURE or call.name in STANDARD:
            return
        problem = f"RESUME of an interrupt may break off {call.name} and the motion before it"
        reason = place.error(f"{problem}: where the next motion begins is not known", _COMPLETE_ADVICE)
        self.run.interruptible_calls.append((self.run.row, reason))

    def write_place(self, call: Call, name: str) -> Place | None:
        """Return the line at which a called routine may write a variable.

        :param name: stored name of the variable.
        :returns: None if the routine does not write the variable, or is in no file.
        """
        callee = self.run.library.find_callee(call.name, self.run.level.module)
        return None if callee is None else self.run.analysis.effects_of(*callee).writes.get(name)

    def _follow_absent_routine(self, place: Place, call: Call) -> None:
        """Follow a call of a routine that is in no file: its arguments become unknown, and the call is noted.

        Functions of the controller are not noted; those that change nothing (`PURE`) leave their arguments unchanged.
        """
        if call.name in PURE:
            return
        if call.name not in STANDARD:
            self.run.absent_calls.append((call.spelling(place.source), self.run.reported_line))
        self._forget_arguments(place, call, None)

    def note_lasting_effects(
        self, place: Place, subject: str, effects: Effects, later_subject: str | None = None
    ) -> None:
        """Note effects that last: routines in no file, variables that may change at any time from now on, and RESUME.

        :param subject: the routine or statement that has these effects, as errors on this line name it.
        :param later_subject: the routine or statement as errors on later lines name it; None: `subject`.
        :raises ProgramError: frames or speeds may change at any time, or a variable that a caller gave as an argument.
        """
        if not (effects.lasting_write or effects.absent_calls or effects.resume or effects.volatile_writes):
            return
        if effects.lasting_write is not None:
            problem = f"{subject} has a parameter that changes at any time from then on ({effects.lasting_write})"
            raise place.error(problem, "Change a variable of a .dat there, or make the parameter :IN.")
        self.run.absent_calls += [(name, self.run.reported_line) for name in effects.absent_calls.values()]
        self.run.may_be_broken_off |= effects.resume is not None
        settings = sorted(MOTION_SETTINGS.intersection(effects.volatile_writes))
        if settings:
            problem = f"{subject} changes what motions depend on at any time: {', '.join(settings)}"
            change_place = str(effects.volatile_writes[settings[0]])
            raise place.error(problem if change_place == str(place) else f"{problem} ({change_place})", SETTING_ADVICE)
        self.run.note_possible_changes(effects.volatile_writes, later_subject or subject)

    def _forget_arguments(self, place: Place, call: Call, routine: Routine | None) -> None:
        """Mark as unknown the arguments that a call may write: variables of the program, and settings of motions.

        :param routine: the called routine; None if it is in no file.
        """
        for _, reference in self._writable_arguments(place, call, routine):
            if reference.name in FIELD_OF_SETTING:  # a setting of motions, such as $BASE
                problem = f"{reference.name} is given to {call.name}, which may change it"
                self.run.settings.make_uncertain(
                    self.run.row, fields_of(reference.name), place.error(problem, SETTING_ADVICE)
                )
            else:
                self.run.variables.forget(self.run.stored_name(reference.name), str(place))

    def _writable_arguments(self, place: Place, call: Call, routine: Routine | None) -> list[tuple[int, Reference]]:
        """Return the arguments that a routine may write: the index, from 0, and the variable of each.

        An argument for a parameter with ``:IN`` cannot be written. Every other variable can, also an argument behind
        the last parameter.

        :param routine: the called routine; None if it is in no file: its parameters are not known.
        """
        parameters = () if routine is None else routine.parameters
        return [
            (index, reference)
            for index, argument in enumerate(call.arguments)
            if (reference := writable_variable(argument)) is not None
            and not (index < len(parameters) and parameters[index].by_value)
        ]

    def _forget_written_variables(self, place: Place, name: str, effects: Effects) -> None:
        """Mark as unknown all variables and settings that a routine may write, since it is not run here.

        Settings are unknown from the present row of the execution trace on.

        :param place: the call.
        :param name: name of the routine, for messages.
        """
        trace_row = self.run.row
        for variable, write_place in effects.writes.items():
            if variable in MOTION_SETTINGS:
                problem = f"{name} may change {variable} ({write_place})"
                # variables without a field of the `State`, such as $ROBROOT: frames depend on them
                fields = fields_of(variable) if variable in FIELD_OF_SETTING else ["base", "tool"]
                self.run.settings.make_uncertain(trace_row, fields, place.error(problem, SETTING_ADVICE))
            else:
                self.run.variables.forget(variable, str(write_place))
        # not among `writes`: no motion is refused for an unknown speed of turning (`$VEL.ORI1`, `$VEL.ORI2`)
        if effects.turn_speed_place is not None:
            self.run.settings.forget_turn_speeds(trace_row)

    def _check_motion(self, place: Place, call: Call, module: Module, routine: Routine, effects: Effects) -> None:
        """Check the call of a routine that is not in the trace, if it contains motions or force comments.

        Force comment: the acting force is not known after the call. Motions in the program itself, or a call that may
        not run: the call is refused; under `--keep-unresolved` it is left uncorrected. Motions in another file: the
        call is added to `untraced_calls`, the robot position after it is not known, and a warning says so. If the first
        motion depends on the robot position, the call is added to `position_dependent_calls`.

        :param routine: the called routine; `effects` are its effects.
        :raises ProgramError: the call is refused, or the routine calls the program again.
        """
        run = self.run
        if effects.force_comment is not None and run.is_traced:
            run.unknown_force_reasons[run.row] = (
                f"{call.name} is called, which holds a force comment ({effects.force_comment})"
            )
        motion_place = effects.motion
        if motion_place is None or not run.is_traced:
            return
        problem = f"{call.name} is called, which moves the robot ({motion_place})"
        run.unfollowed_routines |= run.analysis.reachable_routines(module, routine)
        if run.routine in run.unfollowed_routines:  # the main routine itself
            raise place.error(f"{problem} and calls this program again", _INLINE_ADVICE)
        dependent_place = run.analysis.first_dependent_place(module, routine)
        if dependent_place is not None:
            run.position_dependent_calls.add(run.row)
        is_in_program = motion_place.source is run.routine.source
        if run.keeps_unresolved and (is_in_program or run.level.open_structures):
            run.unresolved_motions.append((run.row, place.error(problem)))
            return
        if is_in_program:
            raise place.error(problem, _INLINE_ADVICE)
        if run.level.open_structures:
            raise place.error(f"{problem} inside {run.level.open_structures[-1][0]}", _JOINTS_ADVICE)
        default_cause = place.error(f"{problem}, in a way that cannot be followed", _INLINE_ADVICE)
        cause = run.obstacles.get(routine, default_cause)
        reason = place.error(f"{problem}: where the next motion begins is not known", _JOINTS_ADVICE)
        name = call.spelling(place.source)
        run.untraced_calls.append(
            UntracedCall(row=run.row, reason=reason, name=name, module=module, routine=routine, cause=cause)
        )
        self._warn_of_untraced_call(name, call.name, cause, motion_place, dependent_place)

    def _warn_of_untraced_call(
        self, spelling: str, name: str, cause: ProgramError, motion_place: Place, dependent_place: Place | None
    ) -> None:
        """Warn that the motions of a called routine are not corrected.

        :param spelling: name of the routine as the program spells it; `name` is the name in upper case.
        :param cause: why the call is not followed.
        :param motion_place: one of the motions of the routine.
        :param dependent_place: the first of these motions that depends on the robot position; None: none does.
        """
        cause_text = f"{cause.file}, line {cause.line}: {cause.problem}"
        message = (
            f"{spelling}() moves the robot ({motion_place}): its motions are not corrected here, because of "
            f"{cause_text}."
        )
        if dependent_place is not None:
            message += (
                f" They begin from the robot position ({dependent_place}): the correction of the motion before moves "
                "them too."
            )
        self.run.issues.append(Issue("warning", "motions-elsewhere", message, self.run.reported_line, subject=name))

    def traced_callee(self, call: Call) -> Callee | None:
        """Return the called routine if it belongs in the execution trace: it moves the robot or has a force comment.

        :returns: None if it does not belong there, is in no file, or cannot be followed (`Run.obstacles`).
        """
        callee = self.run.library.find_callee(call.name, self.run.level.module)
        if callee is None or callee.routine in self.run.obstacles:
            return None
        effects = self.run.analysis.effects_of(*callee)
        return callee if effects.motion is not None or effects.force_comment is not None else None

    def enter_routine(self, place: Place, call: Call, module: Module, routine: Routine) -> None:
        """Make a called routine of the execution trace the running routine, until `leave_routine`.

        :raises UnknownOrderError: the call cannot be followed exactly.
        :raises ProgramError: see `note_lasting_effects`.
        """
        effects = self.run.analysis.effects_of(module, routine)
        self.note_lasting_effects(place, call.name, effects)
        if module is self.run.library.program:
            self.run.called_routines.add(routine)
        if obstacle := self._obstacle(place, call, module, routine, effects):
            problem = f"{call.name} is called, which moves the robot, in a way that cannot be followed: {obstacle}"
            raise unknown_order_error(place, problem, _INLINE_ADVICE, routine)
        self.entered_calls.append(self._bound_call(place, call, module, routine, is_traced=True))
        self._begin_routine(self.entered_calls[-1], is_traced=True)

    def leave_routine(self) -> None:
        """End the routine that was entered last, and return to its caller."""
        self._end_routine(self.entered_calls.pop())

    def _run_exactly(self, place: Place, call: Call, module: Module, routine: Routine) -> VariableValue | None:
        """Run a called routine that is not in the trace, and return its value.

        :returns: an `UnknownValue` if the routine gives no value; None if an error ended it. After None variables may
            have values that the routine has given them.
        """
        bound = self._bound_call(place, call, module, routine)
        level = self._begin_routine(bound, is_traced=False)
        try:
            self._run_routine()
        except ProgramError:
            self._leave_routine(bound)
            return None
        finally:
            self.run.statement_place = place  # the statement with the call
        self._end_routine(bound)
        return level.result if level.result != NO_VALUE else UnknownValue(str(place))

    def _obstacle(self, place: Place, call: Call, module: Module, routine: Routine, effects: Effects) -> str:
        """Return why a call cannot be run exactly, as text for a message; empty if it can.

        An argument that the routine may write needs one name in the routine, that of its parameter: a variable with two
        names would have two values while the routine runs.

        :param place: file and line of the call.
        :param module: the module of the called routine.
        :param effects: what the routine writes, and whether it jumps.
        """
        if routine in self.run.stack:  # it is running already
            return "it calls itself"
        if self.run.may_be_broken_off:
            return "RESUME of an interrupt may break it off"
        if effects.jump is not None:
            return f"it jumps ({effects.jump})"
        if len(self.run.stack) > _MAX_CALL_DEPTH:
            return f"more than {_MAX_CALL_DEPTH} calls are within each other"
        if len(call.arguments) > len(routine.parameters):
            return f"it takes {len(routine.parameters)} arguments, {len(call.arguments)} are given"
        roots: set[str] = set()  # stored names of the arguments; of an element, that of its array
        for index, reference in self._writable_arguments(place, call, routine):
            name, root = place.source.text[reference.start : reference.stop], self.run.stored_name(reference.name)
            is_whole_array = reference.indices == ()  # ``P[]``
            if is_whole_array and not self._is_matching_array(routine, index, reference, root):
                return f"{name} is a whole array, and its parameter is not one of that type"
            if root in roots or root in effects.writes or root in MOTION_SETTINGS:
                return f"{name} has two names in it, one as its parameter"
            roots.add(root)
        # variables of the arguments that the routine also names itself
        if roots and (aliases := self.run.analysis.variable_names(module, routine) & roots):
            return f"{min(aliases)} has two names in it, one as its parameter"
        return ""

    def _is_matching_array(self, routine: Routine, index: int, reference: Reference, root: str) -> bool:
        """Return whether an argument is a whole array for an array parameter of the same type.

        :param index: index of the argument and of its parameter.
        :param reference: the argument, an array without an index.
        :param root: stored name of this array.
        """
        parameter = routine.parameters[index]
        array_type = self.run.variables.types.get(root)
        return parameter.is_array and reference.field is None and array_type == routine.types.get(parameter.name, "")

    def _bound_call(
        self, place: Place, call: Call, module: Module, routine: Routine, *, is_traced: bool = False
    ) -> _BoundCall:
        """Return a call with the scope and the argument values of its routine; functions in the arguments are run.

        :param place: file and line of the call.
        :param module: the module of the called routine.
        :param is_traced: True if the routine is in the execution trace.
        """
        variables, parameters = self.run.variables, routine.parameters
        writable_arguments = self._writable_arguments(place, call, routine)
        # a whole array (no index in the brackets) is not copied: the routine works on the array of the caller
        arrays = {
            parameters[index].name: self.run.stored_name(reference.name)
            for index, reference in writable_arguments
            if reference.indices == ()
        }
        self.run.call_count += 1
        scope = self.run.scopes.scope_of_call(module, routine, self.run.call_count, arrays)
        references = [
            # the key is found before functions in the arguments run: they may change an index
            _Argument(index, reference, variables.key_of(reference))
            for index, reference in writable_arguments
            if reference.indices != () and index < len(parameters)
        ]
        argument_values = self._argument_values(place, call, routine, is_traced=is_traced)
        # parameters whose variables in the caller may change at any time
        volatile_names = {
            scope.stored_name(parameters[argument.number].name): variables.volatile_values[root]
            for argument in references
            if (root := self.run.stored_name(argument.reference.name)) in variables.volatile_values
        }
        types = {argument.number: variables.type_of(argument.reference) for argument in references}
        return _BoundCall(
            place=place,
            module=module,
            routine=routine,
            scope=scope,
            references=references,
            argument_values=argument_values,
            argument_types=types,
            volatile_names=volatile_names,
            caller=self.run.level,
            caller_scope=variables.scope,
        )

    def _argument_values(
        self, place: Place, call: Call, routine: Routine, *, is_traced: bool
    ) -> dict[int, VariableValue]:
        """Return the values of all arguments of a call, index → value; functions in the arguments are run.

        Arguments that are left out, and whole arrays, have `NO_VALUE`.

        :param is_traced: True if the routine is in the execution trace.
        """
        values: dict[int, VariableValue] = {}
        for index, argument in enumerate(call.arguments):
            text = place.source.text[argument.start : argument.stop]
            is_left_out = isinstance(argument, OpaqueText) and not text.strip()
            if is_left_out or (isinstance(argument, Reference) and argument.indices == ()):
                values[index] = NO_VALUE
                continue
            values[index] = self.evaluate_with_calls(place, argument, is_copied=is_traced)
            if is_traced:
                self.run.note_copy(argument, values[index], routine.parameters[index].name)
        return values

    def _begin_routine(self, bound: _BoundCall, *, is_traced: bool) -> Level:
        """Make the routine of a call the running routine, set its parameters, and return its `Level`.

        :param is_traced: True if the routine is in the execution trace.
        """
        for index, parameter in enumerate(bound.routine.parameters):
            if parameter.name in bound.scope.array_names:
                continue  # an array of the caller
            stored_name = bound.scope.stored_name(parameter.name)
            declared_type = bound.routine.types.get(parameter.name, "")
            # a parameter with :IN has no argument type: its value is separate from the argument
            argument_type = bound.argument_types.get(index, declared_type)
            may_be_rounded = declared_type == "REAL" and argument_type in ("INT", INT_OR_REAL)
            may_be_rounded |= declared_type == "INT" and argument_type != "INT"
            parameter_type = INT_OR_REAL if may_be_rounded else declared_type  # see `_BoundCall.argument_types`
            if parameter_type:
                self.run.variables.types[stored_name] = parameter_type
            argument_value = bound.argument_values.get(index, NO_VALUE)
            value = convert_to_type(argument_value, parameter_type) if parameter_type else argument_value
            # the same object if it is equal: `_end_routine` compares by identity to see whether the routine has set it
            self.run.variables.put(stored_name, argument_value if value == argument_value else value)
        self.run.variables.volatile_values |= bound.volatile_names
        self.run.level = Level(bound.module, bound.routine, bound.scope, is_traced=is_traced)
        self.run.stack.append(bound.routine)
        self.run.variables.scope = bound.scope
        return self.run.level

    def _leave_routine(self, bound: _BoundCall) -> None:
        """Make the caller the running routine again; its arguments keep the values that they had before the call.

        Parameters that may change at any time, as their arguments do, no longer count among such variables.
        """
        self.run.stack.pop()
        self.run.level, self.run.variables.scope = bound.caller, bound.caller_scope
        for name in bound.volatile_names:
            self.run.variables.volatile_values.pop(name, None)

    def _end_routine(self, bound: _BoundCall) -> None:
        """End a called routine: its caller runs again, and its arguments get the final values of the parameters.

        An argument whose parameter has not been set stays as it is. An element whose index is not known, and a system
        variable that does not keep a written value, become unknown.
        """
        self._leave_routine(bound)
        place, variables = bound.place, self.run.variables
        for index, reference, key in bound.references:
            value = variables.value(bound.scope.stored_name(bound.routine.parameters[index].name))
            # the same object as `_begin_routine` has stored: the parameter has not been set
            if value is bound.argument_values[index] or value is None:
                continue
            is_controller_variable = reference.name[0] == "$" and reference.name not in STORED_VARIABLES
            if key is None or is_controller_variable:  # None: the index of the element is not known
                variables.forget(self.run.stored_name(reference.name), str(place))
            elif reference.field is not None:
                variables.set_field(key, reference.field, value, place)
            else:
                variables.set(key, value, place)


def _has_no_effects(effects: Effects) -> bool:
    """Return whether a routine only gives a value: it writes no variable outside, moves nothing and does not jump.

    Such a routine may be run to get its value even where it is not certain that the program runs it. Turn speeds
    (`Effects.turn_speed_place`) do not count: it may set them.
    """
    changes = effects.writes or effects.volatile_writes or effects.absent_calls
    moves = effects.motion or effects.interrupt_motion or effects.force_comment or effects.resume
    return not (changes or moves or effects.parameter_write or effects.lasting_write or effects.jump)


class _PureFunctions(Struct, frozen=True, eq=False):
    """The functions of a program that change nothing, see `variables.Functions`.

    :param calls: follows the calls of these functions.
    """

    calls: Calls

    def is_pure(self, call: Call) -> bool:
        """Return whether a called function gives a value and changes nothing; calls in its arguments do not count."""
        run = self.calls.run
        if call.name in PURE:
            return True
        callee = run.library.find_callee(call.name, run.level.module)
        return (
            callee is not None
            and bool(callee.routine.result_type)
            and _has_no_effects(run.analysis.effects_of(*callee))
        )

    def value(self, call: Call) -> VariableValue:
        """Return the value of a call of a pure function; `NO_VALUE` before the first statement of the program runs."""
        place = self.calls.run.statement_place
        return NO_VALUE if place is None else self.calls.follow_call(place, call, is_certain=False)


class _Argument(NamedTuple):
    """An argument that a routine may write.

    :ivar number: its index among the arguments, from 0.
    :ivar reference: the argument.
    :ivar key: the variable that it named when the call began; None if that is not known.
    """

    number: int
    reference: Reference
    key: str | None


class _BoundCall(Struct, frozen=True, eq=False):
    """A call with its arguments.

    :param place: the statement that contains the call.
    :param scope: scope of the names in the called routine, for this call alone.
    :param references: arguments that the routine may write.
    :param argument_values: index → value, of all arguments.
    :param argument_types: index → type, of `references`. A REAL parameter whose argument is an INT, or an INT parameter
        whose argument is a REAL, gets the type `INT_OR_REAL`: no source says whether the routine then reads the number
        that it assigned or the number that the variable of the caller keeps of it.
    :param volatile_names: stored names of parameters whose arguments may change at any time, and what changes them.
    :param caller: the calling routine; `caller_scope` is the scope of its names.
    """

    place: Place
    module: Module
    routine: Routine
    scope: Scope
    references: list[_Argument]
    argument_values: dict[int, VariableValue]
    argument_types: dict[int, str]
    volatile_names: dict[str, UnknownValue]
    caller: Level
    caller_scope: Scope
