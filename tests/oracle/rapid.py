"""A controller that executes RAPID, token by token, written from ABB's manuals and sharing no code with the package.

It knows what CAM systems write: modules with data, procedures and functions, their parameters by value and by reference
(INOUT, VAR, PERS: the routine works on the data of the call), LOCAL names, FOR, WHILE, IF, TEST, GOTO, RETURN, moves by
numbers and by names, Offs, RelTool. Poses are matrices in the world, in mm; what a comment says of the force holds
until the next one. Inputs are answered by the caller.

Source: ABB, Technical reference manual, RAPID kernel (3HAC16585) and RAPID instructions (3HAC16581).
"""

from __future__ import annotations

import contextlib
import copy
import math
import re
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from scipy.spatial.transform import Rotation

TOKEN = re.compile(
    r'\s+|(?P<comment>!.*)|(?P<word>[A-Za-z]\w*)|(?P<number>\d+(\.\d*)?([eE][-+]?\d+)?)|(?P<text>"[^"]*")'
    r"|(?P<sign>:=|<=|>=|<>|[-+*/=<>\[\](){},;:\\.])"
)
FIELDS = {
    "trans": 0,
    "rot": 1,
    "robconf": 2,
    "extax": 3,
    "x": 0,
    "y": 1,
    "z": 2,
    "tframe": 1,
    "uframe": 3,
    "oframe": 4,
    "v_tcp": 0,
}
SPEEDS = {f"v{n}": [float(n), 500.0, 5000.0, 1000.0] for n in (5, 10, 20, 50, 100, 200, 500, 1000)}
ZONES = {f"z{n}": [False, 0.3 if n == 0 else float(n)] for n in (0, 1, 5, 10, 20, 50)} | {"fine": [True, 0.0]}
ORIGIN = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0]]


def matrix(pose):
    """A `pose` of RAPID as a matrix [mm]."""
    out = np.eye(4)
    out[:3, :3] = Rotation.from_quat(np.roll(pose[1], -1)).as_matrix()
    out[:3, 3] = pose[0]
    return out


WAITING = ("waittime", "waitdi", "waituntil", "stop")


@dataclass
class Motion:
    """One executed move: poses in the world."""

    name: str
    line: int
    pose: np.ndarray | None
    joints: list[float] | None
    via: np.ndarray | None
    speed: float
    zone: float
    tool: np.ndarray
    base: np.ndarray
    force: str
    conf: list[float] = field(default_factory=list)
    waits: bool = False  # the program waits at its end


class _Return(Exception):
    """RETURN; the first argument is the value of a function."""


class _Jump(Exception):
    """GOTO; the first argument is the label."""


class _Exit(Exception):
    """EXIT."""


class UndefinedError(AssertionError):
    """The controller would stop: an index outside of an array, a division by zero, a loop without end."""


MOST_STATEMENTS = 4000
DEFAULTS = {"num": 0.0, "bool": False, "string": ""}
"""Values of data without initial value."""


class Place:
    """Where a value is: a list, and the index in it. Data are lists of one value."""

    def __init__(self, holder: list, index: int = 0) -> None:
        self.holder, self.index = holder, index

    @property
    def value(self):
        return self.holder[self.index]

    @value.setter
    def value(self, value) -> None:
        self.holder[self.index] = copy.deepcopy(value)

    def inner(self, index: int) -> Place:
        """The place of an element or component, counted from 0."""
        if not isinstance(self.value, list) or not 0 <= index < len(self.value):
            raise UndefinedError("there is no such element")
        return Place(self.value, index)


def data_of(value) -> Place:
    """New data with a value."""
    return Place([copy.deepcopy(value)])


@dataclass
class Parameter:
    """A parameter: `changes` if the routine works on the data of the call."""

    name: str
    changes: bool
    optional: bool


@dataclass
class Routine:
    """A routine: the token where its body begins, and the module that it is in."""

    start: int
    parameters: list[Parameter]
    module: str


class Controller:
    """Executes the routine `main` of the modules of a text.

    :param inputs: answers of the digital inputs that the program asks for, in order; 0 if it is empty.
    """

    def __init__(self, text: str, inputs: Callable[[], bool] | None = None) -> None:
        self.tokens: list[tuple[str, str, int]] = []
        line, at = 1, 0
        if text.startswith("%%%"):  # the head of a file of an old controller
            at = text.index("%%%", 3) + 3
            line += text[:at].count("\n")
        while at < len(text):
            match = TOKEN.match(text, at)
            assert match, text[at : at + 30]
            if match.lastgroup:
                kind = next(k for k in ("comment", "word", "number", "text", "sign") if match[k] is not None)
                self.tokens.append((kind, match[0], line))
            line += match[0].count("\n")
            at = match.end()
        self.inputs = inputs or (lambda: False)
        self.routines: dict[tuple[str, str], Routine] = {}
        self.motions: list[Motion] = []
        self.main_returned = False
        self.force, self.at, self.count = "", 0, 0
        system = {**SPEEDS, **ZONES, "tool0": [True, ORIGIN], "wobj0": [0, 0, 0, ORIGIN, ORIGIN]}
        self.data: dict[tuple[str, str], Place] = {("", name): data_of(value) for name, value in system.items()}
        self.module = ""
        self.scopes: list[dict[str, Place | None]] = []
        while self.peek():
            self.read_module()

    # --- tokens

    def peek(self) -> str:
        at = self.at
        while at < len(self.tokens) and self.tokens[at][0] == "comment":
            at += 1
        return self.tokens[at][1].lower() if at < len(self.tokens) else ""

    def next(self) -> str:
        while self.tokens[self.at][0] == "comment":
            self.remark(self.tokens[self.at][1])
            self.at += 1
        self.at += 1
        return self.tokens[self.at - 1][1]

    def remark(self, comment: str) -> None:
        words = comment[1:].split()
        if words[:1] == ["FORCE"] and self.scopes:
            self.force = "" if words[1:] == ["OFF"] else " ".join(words[1:])

    def take(self, word: str) -> None:
        assert self.next().lower() == word, (word, self.tokens[self.at - 1])

    def accept(self, word: str) -> bool:
        if self.peek() == word:
            self.next()
            return True
        return False

    # --- data

    def read_module(self) -> None:
        while self.peek() not in ("module", ""):
            self.next()
        if not self.peek():
            return
        self.next()
        self.module = self.next().lower()
        is_local = False
        while self.peek() != "endmodule":
            word = self.peek()
            owner = self.module if is_local else ""
            if word in ("local", "task"):
                self.next()
                is_local = word == "local"
                continue
            if word in ("const", "var", "pers"):
                name, value = self.declared()
                self.data[owner, name] = data_of(value)
            elif word in ("proc", "func"):
                self.next()
                if word == "func":
                    self.next()
                name = self.next().lower()
                parameters = self.parameters()
                self.routines[owner, name] = Routine(self.at, parameters, self.module)
                while self.peek() != f"end{word}":
                    self.next()
                self.next()
            else:
                raise AssertionError(word)
            is_local = False
        self.next()

    def parameters(self) -> list[Parameter]:
        parameters: list[Parameter] = []
        self.take("(")
        while not self.accept(")"):
            self.accept(",")
            optional = self.accept("\\")
            changes = self.peek() in ("inout", "var", "pers")
            if changes:
                self.next()
            self.next()  # its type
            parameters.append(Parameter(self.next().lower(), changes, optional))
            if self.accept("{"):
                while not self.accept("}"):
                    self.next()
        return parameters

    def declared(self) -> tuple[str, object]:
        self.next()
        type_, name, sizes = self.next().lower(), self.next().lower(), []
        if self.accept("{"):
            sizes.append(int(self.expression()))
            while self.accept(","):
                sizes.append(int(self.expression()))
            self.take("}")
        value = self.expression() if self.accept(":=") else DEFAULTS.get(type_)
        if value is None or (sizes and not isinstance(value, list)):
            for size in reversed(sizes):
                value = [copy.deepcopy(value) for _ in range(size)]
        self.take(";")
        return name, value

    def named(self, name: str) -> Place:
        """The data of a name: of the routine, LOCAL data of its module, data of all modules."""
        if self.scopes and name in self.scopes[-1]:
            place = self.scopes[-1][name]
            if place is None:
                raise UndefinedError(f"{name} is not given")
            return place
        return self.data[self.module, name] if (self.module, name) in self.data else self.data["", name]

    def routine(self, name: str) -> Routine | None:
        return self.routines.get((self.module, name), self.routines.get(("", name)))

    # --- expressions

    def expression(self, level: int = 0):
        signs = (("or", "xor"), ("and",), ("=", "<>", "<", ">", "<=", ">="), ("+", "-"), ("*", "/", "div", "mod"))
        if level == len(signs):
            return self.factor()
        if level in (0, 2) and self.accept("not"):
            value = not self.expression(level + 1)
        else:
            value = self.expression(level + 1)
        while self.peek() in signs[level]:
            sign, right = self.next().lower(), self.expression(level + 1)
            value = self.combined(sign, value, right)
        return value

    @staticmethod
    def combined(sign: str, left, right):
        if sign in ("/", "div", "mod") and right == 0.0:
            raise UndefinedError("division by zero")
        return {
            "=": lambda a, b: a == b, "<>": lambda a, b: a != b, "<": lambda a, b: a < b, ">": lambda a, b: a > b,
            "<=": lambda a, b: a <= b, ">=": lambda a, b: a >= b, "+": lambda a, b: a + b, "-": lambda a, b: a - b,
            "*": lambda a, b: a * b, "/": lambda a, b: a / b, "div": lambda a, b: float(math.trunc(a / b)),
            "mod": math.fmod, "or": lambda a, b: a or b, "and": lambda a, b: a and b, "xor": lambda a, b: a != b,
        }[sign](left, right)  # fmt: skip

    def factor(self):
        word = self.next()
        if word == "-":
            return -self.factor()
        if word == "(":
            value = self.expression()
            self.take(")")
            return value
        if word == "[":
            items = [self.expression()]
            while self.accept(","):
                items.append(self.expression())
            self.take("]")
            return items
        if word[0].isdigit():
            return float(word)
        if word[0] == '"':
            return word[1:-1]
        word = word.lower()
        if word in ("true", "false"):
            return word == "true"
        if self.peek() == "(":
            routine = self.routine(word)
            if routine is not None:
                self.next()
                return self.call(routine, *self.arguments(routine, ")"))
            return self.function(word)
        return self.rest_of_place(self.named(word)).value

    def rest_of_place(self, place: Place) -> Place:
        """The place behind indices and components."""
        while self.peek() in ("{", "."):
            if self.accept("{"):
                place = place.inner(self.index())
                while self.accept(","):
                    place = place.inner(self.index())
                self.take("}")
            else:
                self.next()
                place = place.inner(FIELDS[self.next().lower()])
        return place

    def index(self) -> int:
        value = self.expression()
        if value != round(value):
            raise UndefinedError("an index is no whole number")
        return int(value) - 1

    def function(self, name: str):
        self.take("(")
        if name == "present":
            place = self.scopes[-1][self.next().lower()]
            self.take(")")
            return place is not None
        if name == "dinput":
            self.next()
            self.take(")")
            return 1.0 if self.inputs() else 0.0
        values = [self.expression()]
        turns = {"rx": 0.0, "ry": 0.0, "rz": 0.0}
        while not self.accept(")"):
            if self.accept("\\"):
                word = self.next().lower()
                self.take(":=")
                turns[word] = self.expression()
            else:
                self.take(",")
                values.append(self.expression())
        if name == "abs":
            return abs(values[0])
        if name in ("sin", "cos"):
            return getattr(math, name)(math.radians(values[0]))
        point, *step = values
        if point is None:
            raise UndefinedError("a target has no value")
        if name == "offs":
            return [[a + b for a, b in zip(point[0], step, strict=True)], *copy.deepcopy(point[1:])]
        assert name == "reltool", name
        moved = matrix(point[:2])
        place = (moved @ [*step, 1.0])[:3]
        turned = Rotation.from_matrix(moved[:3, :3]) * Rotation.from_euler("XYZ", list(turns.values()), degrees=True)
        return [place.tolist(), np.roll(turned.as_quat(), 1).tolist(), *copy.deepcopy(point[2:])]

    # --- execution

    def run(self, name: str = "main") -> list[Motion]:
        """The moves of a routine."""
        with contextlib.suppress(_Exit):
            self.call(next(routine for (_, other), routine in self.routines.items() if other == name), {})
        return self.motions

    def arguments(self, routine: Routine, end: str) -> tuple[dict[str, Place | None]]:
        """The data of the parameters of a call."""
        given: dict[str, Place | None] = {parameter.name: None for parameter in routine.parameters}
        required = iter([parameter for parameter in routine.parameters if not parameter.optional])
        while not self.accept(end):
            self.accept(",")
            if self.accept("\\"):
                name = self.next().lower()
                parameter = next(parameter for parameter in routine.parameters if parameter.name == name)
                if not self.accept(":="):
                    given[name] = data_of(True)  # a switch
                    continue
            else:
                parameter = next(required)
            given[parameter.name] = self.argument(parameter)
        return (given,)

    def argument(self, parameter: Parameter) -> Place | None:
        begin, word = self.at, self.next().lower()
        if self.scopes and self.scopes[-1].get(word, ...) is None and self.peek() in (",", ")", ";", "\\"):
            return None  # an optional parameter passed on that is not given
        if parameter.changes:
            return self.rest_of_place(self.named(word))
        self.at = begin
        return data_of(self.expression())

    def call(self, routine: Routine, given: dict[str, Place | None]):
        back, module = self.at, self.module
        if len(self.scopes) > 40:
            raise UndefinedError("calls are nested too deeply")
        self.at, self.module = routine.start, routine.module
        self.scopes.append(dict(given))
        value = None
        while True:
            try:
                self.block(("endproc", "endfunc", "error"))
            except _Return as end:
                value = end.args[0]
                self.main_returned = len(self.scopes) == 1
            except _Jump as jump:
                self.at = self.label(routine, jump.args[0])
                continue
            break
        self.scopes.pop()
        self.at, self.module = back, module
        return value

    def label(self, routine: Routine, name: str) -> int:
        at = routine.start
        while not (self.tokens[at][1].lower() == name and self.tokens[at + 1][1] == ":"):
            at += 1
        return at + 2

    def skip(self, ends: tuple[str, ...]) -> None:
        """Go to one of the words that ends a block, over blocks inside; comments are not heeded."""
        depth = 0
        while True:
            kind, word, _ = self.tokens[self.at]
            word = word.lower()
            if kind == "word" and depth == 0 and word in ends:
                return
            if kind == "word" and word in ("for", "while", "if", "test"):
                depth += 1
            if kind == "word" and word in ("endfor", "endwhile", "endif", "endtest"):
                depth -= 1
            self.at += 1

    def block(self, ends: tuple[str, ...]) -> None:
        while True:
            while self.tokens[self.at][0] == "comment":
                self.remark(self.tokens[self.at][1])
                self.at += 1
            if self.peek() in ends:
                return
            self.count += 1
            if self.count > MOST_STATEMENTS:
                raise UndefinedError("the program does not end")
            self.statement()

    def statement(self) -> None:
        word = self.peek()
        if word in ("const", "var", "pers"):
            name, value = self.declared()
            self.scopes[-1][name] = data_of(value)
        elif word == "for":
            self.loop()
        elif word == "while":
            self.repeat()
        elif word == "if":
            self.branch()
        elif word == "test":
            self.test()
        elif word.startswith("move"):
            self.move()
        elif word == "return":
            self.next()
            raise _Return(None if self.peek() == ";" else self.expression())
        elif word == "goto":
            self.next()
            raise _Jump(self.next().lower())
        elif word == "exit":
            raise _Exit
        else:
            self.simple()

    def repeat(self) -> None:
        self.next()
        begin = self.at
        while True:
            self.at = begin
            condition = self.expression()
            self.take("do")
            if not condition:
                break
            self.block(("endwhile",))
        self.skip(("endwhile",))
        self.next()

    def branch(self) -> None:
        ends = ("elseif", "else", "endif")
        self.next()
        while True:
            condition = self.expression()
            self.take("then")
            if condition:
                self.block(ends)
                self.skip(("endif",))
                break
            self.skip(ends)
            word = self.next().lower()
            if word == "else":
                self.block(("endif",))
            if word != "elseif":
                if word == "else":
                    break
                return
        self.next()

    def test(self) -> None:
        ends = ("case", "default", "endtest")
        self.next()
        subject = self.expression()
        while True:
            word = self.next().lower()
            if word == "endtest":
                return
            is_taken = word == "default"
            if word == "case":
                values = [self.expression()]
                while self.accept(","):
                    values.append(self.expression())
                is_taken = subject in values
            self.take(":")
            if is_taken:
                self.block(ends)
                self.skip(("endtest",))
            else:
                self.skip(ends)

    def loop(self) -> None:
        self.next()
        name = self.next().lower()
        self.take("from")
        value = self.expression()
        self.take("to")
        last = self.expression()
        step = self.expression() if self.accept("step") else (1.0 if last >= value else -1.0)
        self.take("do")
        begin = self.at
        outer = self.scopes[-1].get(name, ...)
        while (last - value) * step >= 0.0:
            self.at = begin
            self.scopes[-1][name] = data_of(value)
            self.block(("endfor",))
            value += step
        if outer is ...:
            self.scopes[-1].pop(name, None)
        else:
            self.scopes[-1][name] = outer
        self.skip(("endfor",))
        self.next()

    def simple(self) -> None:
        name = self.next().lower()
        if self.accept(":"):
            return  # a label
        if self.peek() in (":=", "{", "."):
            place = self.rest_of_place(self.named(name))
            self.take(":=")
            place.value = self.expression()
            self.take(";")
            return
        routine = self.routine(name)
        if routine is not None:
            self.call(routine, *self.arguments(routine, ";"))
            return
        if name in ("incr", "decr", "clear", "add"):
            place = self.rest_of_place(self.named(self.next().lower()))
            step = {"incr": 1.0, "decr": -1.0, "clear": -place.value, "add": 0.0}[name]
            if self.accept(","):
                step = self.expression()
            self.take(";")
            place.value += step
            return
        if name in WAITING and self.motions:
            self.motions[-1].waits = True
        while self.next() != ";":
            pass

    def move(self) -> None:
        while self.tokens[self.at][0] == "comment":
            self.next()
        line = self.tokens[self.at][2]
        name = self.next().lower()
        values, options = [], {}
        while not self.accept(";"):
            self.accept(",")
            if self.accept("\\"):
                word = self.next().lower()
                options[word] = self.expression() if self.accept(":=") else True
            else:
                values.append(copy.deepcopy(self.expression()))
        if any(value is None for value in values):
            raise UndefinedError("a target has no value")
        force = self.force
        following = self.tokens[self.at] if self.at < len(self.tokens) else ("", "", 0)
        if following[0] == "comment" and following[2] == line and following[1][1:].split()[:1] == ["FORCE"]:
            self.remark(following[1])  # in the line of the move: it holds for it
            force = self.force
        *points, speed, zone, tool = values
        frames = options.get("wobj", [0, 0, 0, ORIGIN, ORIGIN])
        base = matrix(frames[3]) @ matrix(frames[4])
        held = np.float32
        moved = Motion(
            name,
            line,
            None if name == "moveabsj" else base @ matrix(points[-1][:2]),
            points[-1][0] if name == "moveabsj" else None,
            (base @ matrix(points[0][:2]))[:3, 3] if name == "movec" else None,
            float(held(options.get("v", speed[0]))),
            0.0 if zone[0] else float(held(options.get("z", zone[1]))),
            matrix(tool[1]),
            base,
            force,
            points[-1][2] if name != "moveabsj" else [],
        )
        self.motions.append(moved)


def wrench(motion: Motion) -> np.ndarray:
    """The force of a motion in the world (6,) [N, N·m]."""
    given = {n.upper(): float(v) for n, v in re.findall(r"([FM][XYZ])=([-+.\deE]+)", motion.force)}
    own = np.array([given.get(n, 0.0) for n in ("FX", "FY", "FZ", "MX", "MY", "MZ")])
    axes = motion.base[:3, :3]
    if "FRAME=TOOL" in motion.force:
        assert motion.pose is not None
        axes = motion.pose[:3, :3]
    return np.concatenate([axes @ own[:3], axes @ own[3:]])
