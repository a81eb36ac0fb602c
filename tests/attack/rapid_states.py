"""Random RAPID whose moves depend on what ran before: a controller of its own says where the tool goes.

    python -m tests.attack.rapid_states --minutes 10 [--seed 0] [--keep-going]

Modules have procedures and functions with parameters by value and by reference, names that hide each other, LOCAL data,
arrays, loops, conditions, jumps, digital inputs. The package must refuse a program, or make the motions that the
controller makes whatever the inputs say. Without forces the module comes back byte for byte; with forces, the loaded
tool must be on the path of the module as it was (`rapid.compare`).
"""

from __future__ import annotations

import random
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from itertools import count

from postproc.dialects.rapid.dialect import RAPID
from postproc.dialects.text import decode
from postproc.errors import PostprocError
from postproc.program import Program
from tests.attack.driver import Wrong, parser, try_seeds
from tests.attack.rapid import check_correction, check_motions, setup
from tests.oracle.rapid import Controller, Motion, UndefinedError

MOST_INPUTS = 3
"""Inputs that a run may ask for; programs that ask more often are not tried."""
DECLARATIONS = """PERS tooldata tMill:=[TRUE,[[0,0,350],[1,0,0,0]],[5,[0,0,100],[1,0,0,0],0,0,0]];
PERS tooldata tDrill:=[TRUE,[[3,0,320],[1,0,0,0]],[5,[0,0,100],[1,0,0,0],0,0,0]];
PERS wobjdata wPart:=[FALSE,TRUE,"",[[1500,-200,700],[1,0,0,0]],[[5,-3,2],[1,0,0,0]]];
VAR wobjdata wSide:=[FALSE,TRUE,"",[[1480,-180,690],[1,0,0,0]],[[0,0,0],[1,0,0,0]]];
VAR speeddata vCut:=[25.5,500,5000,1000];"""
TYPES = ("num", "num", "num", "robtarget", "bool")


@dataclass
class Signature:
    """A routine: parameters are (name, type, mode, optional); `result` is the type of a function; `moves` if it, or a
    routine that it calls, moves the robot.
    """

    name: str
    result: str
    moves: bool
    parameters: list[tuple[str, str, str, bool]] = field(default_factory=list)


class StateGenerator:
    """Writes modules whose data change while they run."""

    def __init__(self, seed: int) -> None:
        self.random = random.Random(seed)
        self.has_inputs = self.maybe(0.4)
        self.has_jumps = self.maybe(0.5)
        self.has_forces = self.maybe(0.6)
        self.has_changing_functions = self.maybe(0.5)
        self.routines = [self.signature(k) for k in range(self.random.randint(1, 5))]
        self.names: dict[str, list[str]] = {}
        """Names of data that may be written, by type."""
        self.constants: dict[str, list[str]] = {}
        self.rank = -1
        """Routines call those behind themselves only."""
        self.result = ""
        self.can_move = True
        self.labels = 0
        self.loops = 0

    # --- choices

    def maybe(self, share: float) -> bool:
        return self.random.random() < share

    def pick(self, *choices):
        return self.random.choice(choices)

    # --- data

    def signature(self, number: int) -> Signature:
        result = self.pick("", "", "num", "robtarget")
        parameters = []
        for k in range(self.random.randint(0, 3)):
            type_ = self.pick(*TYPES)
            mode = self.pick("", "INOUT", "VAR", "PERS", "INOUT")
            name = self.pick(
                f"x{k}", f"x{k}", {"num": f"n{k + 1}", "robtarget": f"p{k + 1}", "bool": f"b{k + 1}"}[type_]
            )
            parameters.append((name, type_, mode, self.maybe(0.15)))
        moves = not result and self.maybe(0.5)
        return Signature(f"{'f' if result else 'r'}{number}", result, moves, parameters)

    def literal(self, type_: str) -> str:
        if type_ == "num":
            return str(self.random.randint(-4, 9)) if self.maybe(0.8) else f"{self.random.uniform(-9, 9):.2f}"
        if type_ == "bool":
            return self.pick("TRUE", "FALSE")
        x, y, z = self.random.randint(-90, 90), self.random.randint(-90, 90), self.random.randint(0, 80)
        turn = self.pick("[0,1,0,0]", "[0,1,0,0]", "[0,0.99904822,0.04361939,0]")
        return f"[[{x},{y},{z}],{turn},[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]]"

    def variable(self, type_: str) -> str:
        """Data that may be written, perhaps an element of an array."""
        names = [*self.names.get(type_, []), *self.names.get(type_, [])[-2:]]
        if type_ in ("num", "robtarget") and self.maybe(0.15):
            return f"{'a' if type_ == 'num' else 'q'}{{{self.index()}}}"
        return self.random.choice(names)

    def reference(self, type_: str) -> str:
        """Data that a routine may change, often an element of an array."""
        if type_ != "bool" and self.maybe(0.3):
            return f"{'a' if type_ == 'num' else 'q'}{{{self.index()}}}"
        return self.variable(type_)

    def index(self) -> str:
        return str(self.random.randint(1, 3)) if self.maybe(0.97) else self.pick(*self.names["num"])

    def value(self, type_: str, depth: int = 0) -> str:
        if type_ == "bool":
            return self.condition(depth)
        if type_ == "robtarget":
            return self.point(depth)
        chance = self.random.random()
        if depth > 1 or chance < 0.3:
            return self.literal("num")
        if chance < 0.6:
            return self.variable("num") if self.maybe(0.8) else self.pick("c1", "c2")
        if chance < 0.68:
            return f"{self.variable('robtarget')}.trans.{self.pick('x', 'y', 'z')}"
        if chance < 0.76:
            return self.function_call("num") or self.literal("num")
        if chance < 0.8:
            return f"Abs({self.value('num', depth + 1)})"
        operands = [self.value("num", depth + 1) for _ in range(2)]
        left, right = (f"({operand})" if operand.startswith("-") else operand for operand in operands)
        return f"({left}{self.pick('+', '-', '*', '+', '-')}{right})"

    def point(self, depth: int = 0) -> str:
        chance = self.random.random()
        if chance < 0.15:
            return self.literal("robtarget")
        if chance < 0.55:
            return self.variable("robtarget") if self.maybe(0.7) else self.pick("k1", "k2")
        if depth > 1:
            return self.pick("k1", "k2")
        if chance < 0.65:
            return self.function_call("robtarget") or "k1"
        step = ",".join(self.value("num", depth + 1) for _ in range(3))
        return f"{self.pick('Offs', 'RelTool')}({self.point(depth + 1)},{step})"

    def condition(self, depth: int = 0) -> str:
        chance = self.random.random()
        if self.has_inputs and chance < 0.25:
            return "DInput(di1)=1"
        if chance < 0.5:
            return self.pick("", "NOT ") + self.variable("bool")
        sign = self.pick("<", ">", "=", "<>", "<=", ">=")
        return f"{self.value('num', depth + 1)}{sign}{self.value('num', depth + 1)}"

    # --- calls

    def arguments(self, routine: Signature) -> str:
        required, options = [], []
        for name, type_, mode, optional in routine.parameters:
            if optional and self.maybe(0.5):
                continue
            text = self.reference(type_) if mode else self.value(type_, 1)
            if optional:
                options.append(f"\\{name}:={text}")
            else:
                required.append(text)
        return ",".join(required) + "".join(options)

    def function_call(self, type_: str) -> str:
        functions = [one for one in self.routines[self.rank + 1 :] if one.result == type_]
        if not functions:
            return ""
        routine = self.random.choice(functions)
        return f"{routine.name}({self.arguments(routine)})"

    # --- statements

    def tail(self) -> str:
        speed = self.pick("v100", "vCut", r"v100\V:=33.5")
        zone, tool = self.pick("fine", "z1", "z5"), self.pick("tMill", "tMill", "tDrill")
        return f",{speed},{zone},{tool}\\WObj:={self.pick('wPart', 'wPart', 'wSide')};"

    def move(self) -> str:
        return f"{self.pick('MoveL', 'MoveL', 'MoveL', 'MoveJ')} {self.point()}{self.tail()}"

    def assignment(self) -> str:
        chance = self.random.random()
        if chance < 0.06:
            return f"wSide.oframe.trans.{self.pick('x', 'y', 'z')}:={self.value('num')};"
        if chance < 0.1:
            return f"vCut.v_tcp:={self.random.randint(20, 40)};"
        type_ = self.pick("num", "num", "num", "robtarget", "robtarget", "bool")
        if type_ == "num" and self.maybe(0.3):
            word = self.pick("Incr", "Decr", "Clear", "Add")
            return f"{word} {self.variable('num')}" + (f",{self.value('num', 1)};" if word == "Add" else ";")
        if type_ == "robtarget" and self.maybe(0.5):
            return f"{self.variable('robtarget')}.trans.{self.pick('x', 'y', 'z')}:={self.value('num')};"
        return f"{self.variable(type_)}:={self.value(type_)};"

    def call(self) -> str:
        procedures = [one for one in self.routines[self.rank + 1 :] if not one.result]
        if not self.can_move and self.maybe(0.9):
            procedures = [one for one in procedures if not one.moves]
        if not procedures:
            return self.assignment()
        routine = self.random.choice(procedures)
        return f"{routine.name} {self.arguments(routine)};".replace(" ;", ";").replace(" \\", "\\")

    def statements(self, depth: int, most: int = 4) -> list[str]:
        lines: list[str] = []
        for _ in range(self.random.randint(1, most)):
            lines += self.statement(depth)
        return lines

    def statement(self, depth: int) -> list[str]:
        chance = self.random.random()
        can_move = self.can_move
        if chance < 0.25 and can_move:
            return [self.move()]
        if chance < 0.5 or depth > 2:
            return [self.assignment()]
        if chance < 0.68:
            return [self.call()]
        if chance < 0.8:
            return self.branches(depth)
        if chance < 0.9:
            return self.loop(depth)
        if self.has_jumps and depth == 0 and chance < 0.96:
            self.labels += 1
            body = self.statements(1, 2)
            return [f"IF {self.condition()} THEN", f"GOTO l{self.labels};", "ENDIF", *body, f"l{self.labels}:"]
        if self.has_jumps and depth and chance < (0.98 if self.can_move else 0.995):
            return [f"RETURN {self.value(self.result)};" if self.result else "RETURN;"]
        if self.has_forces and can_move:
            return [f"! FORCE FX={self.random.randint(-300, 300)} FZ={self.random.randint(50, 300)}"]
        return [self.assignment()]

    def branches(self, depth: int) -> list[str]:
        if self.maybe(0.25):
            lines = [f"TEST {self.value('num', 1)}"]
            for values in ("1,2", "3", "-1"):
                lines += [f"CASE {values}:", *self.statements(depth + 1, 2)]
            return [*lines, *(["DEFAULT:", *self.statements(depth + 1, 1)] if self.maybe(0.5) else []), "ENDTEST"]
        lines = [f"IF {self.condition()} THEN", *self.statements(depth + 1, 2)]
        if self.maybe(0.3):
            lines += [f"ELSEIF {self.condition()} THEN", *self.statements(depth + 1, 2)]
        if self.maybe(0.4):
            lines += ["ELSE", *self.statements(depth + 1, 2)]
        return [*lines, "ENDIF"]

    def loop(self, depth: int) -> list[str]:
        if self.maybe(0.3):
            self.loops += 1
            name = f"w{self.loops}"
            body = self.statements(depth + 1, 2)
            return [f"{name}:=0;", f"WHILE {name}<{self.random.randint(1, 3)} DO", *body, f"Incr {name};", "ENDWHILE"]
        name = self.pick("i", "j", *self.names["num"][-1:], "n1")
        name = name if name.isalnum() else "i"
        saved = {type_: list(names) for type_, names in self.names.items()}
        self.names["num"] = [one for one in self.names["num"] if one != name] or ["n4"]
        body = self.statements(depth + 1, 2)
        if self.can_move and self.maybe(0.5):
            body.append(f"MoveL Offs({self.variable('robtarget')},{name},0,2*{name}){self.tail()}")
        self.names = saved
        bounds = self.pick("1 TO 3", "3 TO 1", "1 TO 2", "0 TO 4 STEP 2", f"1 TO {self.value('num', 2)}")
        return [f"FOR {name} FROM {bounds} DO", *body, "ENDFOR"]

    # --- routines

    def routine(self, number: int) -> list[str]:
        """The text of a routine; −1 is main."""
        signature = self.routines[number] if number >= 0 else Signature("main", "", moves=True)
        self.rank, self.result, self.can_move = number, signature.result, signature.moves
        saved = {type_: list(names) for type_, names in self.names.items()}
        lines: list[str] = []
        for name, type_, _, optional in signature.parameters:
            if not optional:
                self.names[type_].append(name)
            else:  # it may only be asked for
                self.names[type_] = [one for one in self.names[type_] if one != name] or [f"{self.letter(type_)}4"]
        parameter_names = {name for name, *_ in signature.parameters}
        for _ in range(self.random.randint(0, 2)):
            type_ = self.pick(*TYPES)
            name = self.pick("s1", f"{self.letter(type_)}{self.random.randint(1, 2)}")
            name = name if name != "s1" else f"s{self.letter(type_)}"
            if name not in parameter_names:
                parameter_names.add(name)
                self.names[type_].append(name)
                lines.append(f"{self.pick('VAR', 'VAR')} {type_} {name}:={self.literal(type_)};")
        counters = len(lines)
        for name, type_, _, optional in signature.parameters:
            if optional and type_ == "num":
                lines += [f"IF Present({name}) THEN", f"{self.variable('num')}:={name};", "ENDIF"]
        first_loop = self.loops
        if signature.result and not self.has_changing_functions:
            lines += self.move_free_locals()
        elif number < 0:
            lines += [
                "ConfL\\Off;",
                "MoveAbsJ [[0,10,20,0,60,0],[9E9,9E9,9E9,9E9,9E9,9E9]],v500,fine,tMill\\WObj:=wPart;",
            ]
            if self.has_forces:
                lines.append("! FORCE FX=120 FZ=200")
            lines += [*self.statements(0, 6), self.call(), self.move(), self.call(), self.move()]
        else:
            lines += self.statements(0, 4)
        if signature.result:
            lines.append(f"RETURN {self.value(signature.result, 1)};")
        lines[counters:counters] = [f"VAR num w{k}:=0;" for k in range(first_loop + 1, self.loops + 1)]
        self.names = saved
        head = ",".join(
            f"{self.option(optional)}{mode}{' ' if mode else ''}{type_} {name}"
            for name, type_, mode, optional in signature.parameters
        ).replace(",\\", "\\")
        word = f"FUNC {signature.result}" if signature.result else "PROC"
        local = "LOCAL " if number >= 0 and self.maybe(0.2) and not self.divided else ""
        return [f"{local}{word} {signature.name}({head})", *lines, f"END{word.partition(' ')[0]}"]

    @staticmethod
    def option(optional: bool) -> str:
        return "\\" if optional else ""

    @staticmethod
    def letter(type_: str) -> str:
        return {"num": "n", "robtarget": "p", "bool": "b"}[type_]

    def move_free_locals(self) -> list[str]:
        """A function that changes nothing but its own data."""
        return ["VAR num sn0:=0;", f"sn0:={self.value('num', 2)};"]

    def text(self) -> str:
        """The text of the modules."""
        data = DECLARATIONS.splitlines()
        self.divided = self.maybe(0.3)
        for type_ in ("num", "robtarget", "bool"):
            letter = self.letter(type_)
            self.names[type_] = [f"{letter}{k}" for k in range(1, 5)]
            for name in self.names[type_]:
                kind = self.pick("VAR", "VAR", "PERS", "LOCAL VAR" if not self.divided else "VAR")
                data.append(f"{kind} {type_} {name}:={self.literal(type_)};")
        data += [f"CONST num c1:={self.literal('num')};", "CONST num c2:=c1+1;"]
        data += [f"CONST robtarget k{k}:={self.literal('robtarget')};" for k in (1, 2)]
        data.append(f"VAR num a{{3}}:=[{','.join(self.literal('num') for _ in range(3))}];")
        data.append(f"PERS robtarget q{{3}}:=[{','.join(self.literal('robtarget') for _ in range(3))}];")
        data.append("VAR num z1a;")
        bodies = [self.routine(number) for number in range(len(self.routines) - 1, -2, -1)]
        if not self.divided:
            return "\n".join(["MODULE first", *data, *(line for body in bodies for line in body), "ENDMODULE", ""])
        half = len(bodies) // 2
        second = [line for body in bodies[:half] for line in body]
        first = [line for body in bodies[half:] for line in body]
        return "\n".join(["MODULE first", *data, *first, "ENDMODULE", "MODULE second", *second, "ENDMODULE", ""])


# --- runs


def runs(text: str) -> list[tuple[list[Motion], bool]]:
    """Return the motions for all answers of the inputs, and whether the main routine ended by RETURN.

    :raises UndefinedError: the controller stops in one of them, or asks too often.
    """
    waiting: list[list[bool]] = [[]]
    results: list[tuple[list[Motion], bool]] = []
    while waiting:
        decided = waiting.pop()
        asked = count()

        def answer(decided: list[bool] = decided, asked: count[int] = asked) -> bool:
            number = next(asked)
            if number >= MOST_INPUTS:
                raise UndefinedError("too many inputs")
            if number == len(decided):
                waiting.append([*decided, True])
                decided.append(False)
            return decided[number]

        controller = Controller(text, answer)
        results.append((controller.run(), controller.main_returned))
    return results


def program_of(text: str) -> Program:
    """Return the program that the package reads."""
    cell, _, place, _ = setup()
    return RAPID.read([decode("random.mod", text.encode())], cell, place.forward, "random")


def attack(seed: int, *, correct: bool = False, read: Callable[[str], Program] = program_of) -> str:
    """Try the modules of a seed; return what became of them.

    :raises Wrong: the package makes other motions than the controller.
    """
    text = StateGenerator(seed).text()
    try:
        results = runs(text)
    except UndefinedError as cause:
        return f"invalid: {cause}"
    try:
        program = read(text)
    except PostprocError as cause:
        return f"refused: {getattr(cause, 'problem', cause)}"
    try:
        for wanted, main_returned in results:
            check_motions(program, wanted, ends_early=main_returned)
        if correct and len(results) == 1 and not results[0][1]:
            return check_correction(text, program)
    except Wrong as cause:
        raise Wrong(f"seed {seed}: {cause}\n{text}") from None
    return "read, with inputs" if len(results) > 1 else "read"


def main() -> int:
    """Try modules, and count what came of them."""
    arguments = parser(__doc__)
    arguments.add_argument("--correct", action="store_true", help="correct and load each module too")
    options = arguments.parse_args()
    return try_seeds(options, partial(attack, correct=options.correct))


if __name__ == "__main__":
    raise SystemExit(main())
