"""A controller that executes KRL, statement by statement. It shares no code with the package.

What a real controller leaves to chance is drawn from a random generator: inputs, when interrupts and submit programs
run, when triggers switch, what analogue inputs read, what programs do that are in no file. A program whose motions do
not depend on chance gives the same motions for every seed. Given `Choices`, nothing is left to chance: inputs are what
they say, interrupts never come, and all that a program can do is tried by taking them one after the other.
"""

from __future__ import annotations

import operator
import re
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import lru_cache

import numpy as np

from tests.oracle.arm import abc, rot

TOKEN = re.compile(
    r"""\s*(?:(?P<number>(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)|(?P<literal>'[BbHh][ \t]*[0-9A-Fa-f]+')
    |(?P<string>"[^"]*")|(?P<enum>\#\w+)|(?P<name>[A-Za-z_$][\w$]*)|(?P<sign>==|<>|<=|>=|[-+*/:(){}\[\].,=<>]))""",
    re.VERBOSE,
)
OPENING = {
    "IF": "ENDIF",
    "FOR": "ENDFOR",
    "WHILE": "ENDWHILE",
    "LOOP": "ENDLOOP",
    "REPEAT": "UNTIL",
    "SWITCH": "ENDSWITCH",
}
TYPES = {"INT", "REAL", "BOOL", "CHAR", "FRAME", "POS", "E6POS", "AXIS", "E6AXIS", "FDAT", "LDAT"}
MOTIONS = {"LIN", "PTP", "CIRC", "LIN_REL", "PTP_REL", "SLIN", "SPTP", "SCIRC", "SLIN_REL", "SPTP_REL", "SPL"}
KINDS = {"SLIN": "LIN", "SPTP": "PTP", "SCIRC": "CIRC"}
FORCE = re.compile(r"\s*;\s*FORCE\s+(OFF|[FM][XYZ]\s*=.*)$", re.IGNORECASE)
ROUTINE = re.compile(r"(GLOBAL\s+)?DEF(?:FCT\s+(\w+))?\s+(\w+)\s*\(([^)]*)\)", re.IGNORECASE)
LABEL = re.compile(r"([A-Za-z_]\w*)\s*:$")
CARTESIAN = "XYZABC"
_INPUTS = {"$IN", "$OUT", "$ANIN", "$FLAG"}
_BITS = ("B_OR", "B_EXOR", "B_AND")
_NO_VARIABLES = {"TRUE", "FALSE", "NOT", "$BASE", "$TOOL", "$NULLFRAME", "$WORLD", "$ROBROOT", "$VEL", "$APO", *_INPUTS}
_BEHIND = {(), (",",), (")",), ("}",), ("]",)}
"""What follows a value that is a number alone."""
MOST_STEPS = 3000
COMPARISONS = {
    "==": operator.eq,
    "<>": operator.ne,
    "<": operator.lt,
    ">": operator.gt,
    "<=": operator.le,
    ">=": operator.ge,
}
FUNCTIONS = {
    "ABS": abs,
    "SQRT": lambda x: float(np.sqrt(abs(x))),
    "SIN": lambda x: float(np.sin(np.radians(x))),
    "COS": lambda x: float(np.cos(np.radians(x))),
    "TAN": lambda x: float(np.tan(np.radians(x))),
    "ACOS": lambda x: float(np.degrees(np.arccos(x))) if abs(x) <= 1 else invalid("ACOS"),
    "ATAN2": lambda y, x: float(np.degrees(np.arctan2(y, x))),
    "SVEL_CP": lambda speed, *_: {"CP": speed},
    "SORI_TYP": lambda data: word(data, "ORI_TYP", "#VAR"),
    "SCIRC_TYPE": lambda data: word(data, "CIRC_TYP", "#BASE"),
    "SIPO_MODE": lambda data: word(data, "IPO_FRAME", "#BASE"),
    **dict.fromkeys(
        ("SLOAD", "SACC_CP", "SJERK", "USE_CM_PRO_VALUES", "SVEL_JOINT", "SACC_JOINT", "SGEAR_JERK"), lambda *_: 0.0
    ),
    "SAPO": lambda data: approximation(data),
    "SAPO_PTP": lambda data: {"CPTP": data.get("APO_DIST", 0.0)},
    "SCIRC_M": lambda data: data.get("CB", {}),
    "INV_POS": lambda frame: components(np.linalg.inv(pose(frame))),
}


def word(data, field, usual):
    """Return a mode, or what a structure has for it."""
    return data.get(field, usual) if isinstance(data, dict) else data


def approximation(data):
    """Return what SAPO sets: the distance of a structure, if it has one."""
    distance = word(data, "APO_DIST", None)
    return {} if distance is None else {"CDIS": distance}


class Unsaid:
    """What no source says: two controllers that do it in different ways.

    :ivar side: which of the two, 0 or 1.
    :ivar asked: True if it mattered.
    """

    side, asked = 0, False

    @classmethod
    def choose(cls, first, second):
        """Return what the present controller does."""
        cls.asked = True
        return second if cls.side else first


class Invalid(Exception):
    """The program stops: a value is missing, an index is none, there are too many statements."""


class PositionUnknown(Invalid):
    """A motion depends on where the robot is behind a motion of the other kind: this executor has no kinematics."""


def invalid(problem):
    """Stop the program."""
    raise Invalid(problem)


class _Return(Exception):
    pass


class _Exit(Exception):
    pass


class _Stop(Exception):
    """The end of what is followed of a program that never ends."""


class _Goto(Exception):
    pass


class _Resume(Exception):
    """RESUME: the calls behind that in which the interrupt was declared end (KSS 8, RESUME)."""


class Choices:
    """What inputs are, one after the other: those of `decided`, then FALSE.

    :ivar decided: what they were.
    :param most: so many may be TRUE; where more are, all further ones are FALSE.
    """

    def __init__(self, decided=(), most=6):
        self.given, self.decided, self.most = list(decided), [], most

    def __call__(self):
        number = len(self.decided)
        value = self.given[number] if number < len(self.given) else False
        value = value and sum(self.decided) < self.most
        self.decided.append(value)
        return value

    def following(self):
        """What is to be tried next; None when all was."""
        decided = list(self.decided)
        while decided and (decided[-1] or sum(decided) >= self.most):
            decided.pop()
        return Choices([*decided[:-1], True], self.most) if decided else None


def copied(value):
    """Return a copy of a structure, or the value that is none."""
    return {name: copied(item) for name, item in value.items()} if isinstance(value, dict) else value


@dataclass
class Variable:
    kind: str = ""
    value: object = None
    members: dict = field(default_factory=dict)


@dataclass
class Place:
    """A variable or a part of one: what an assignment writes and a parameter by reference stands for."""

    variable: Variable
    path: list = field(default_factory=list)

    def get(self):
        value = self.variable.value
        for step in self.path:
            if not isinstance(value, dict) or step not in value:
                raise Invalid(f"no value: {step}")
            value = value[step]
        if value is None:
            raise Invalid("no value")
        return value

    def set(self, new):
        new = copied(new)
        members = self.variable.members
        if not self.path:
            if isinstance(new, dict) and members:
                new = {name: fitting(members.get(name, ""), item) for name, item in new.items()}
            self.variable.value = fitting(self.variable.kind, new)
            return
        if not isinstance(self.variable.value, dict):
            self.variable.value = {}
        value = self.variable.value
        for step in self.path[:-1]:
            value = value.setdefault(step, {})
        last = self.path[-1]
        names = [step for step in self.path if isinstance(step, str)]
        if isinstance(last, int | tuple):
            kind = self.variable.kind
        else:
            for name in names[:-1]:
                members = members.get(name, {}) if isinstance(members, dict) else {}
            own = isinstance(members, dict) and members
            kind = members.get(last, "") if own else "REAL" if last in CARTESIAN else ""
        value[last] = fitting(kind, new)


def whole(value):
    """A number that an expression gives; what becomes of an INT beyond 32 bits is in no source."""
    if isinstance(value, int) and not isinstance(value, bool) and not -(2**31) <= value < 2**31:
        return too_large(value)
    return value


def too_large(value):
    """An INT beyond 32 bits: the program stops, or the INT wraps."""
    if Unsaid.choose(True, False):
        raise Invalid("an INT is too large")
    return (int(value) + 2**31) % 2**32 - 2**31


def quotient(value, other):
    """The quotient of two INTs: the decimal places of a negative one are cut off, or it is rounded down."""
    exact = value % other == 0 or (value >= 0 and other > 0)
    return value // other if exact else Unsaid.choose(int(value / other), value // other)


def compared(sign, value, other):
    """Whether two values compare so; REALs that are close may be equal or not for a controller with fewer digits."""
    holds = COMPARISONS[sign](value, other)
    if isinstance(value, float) or isinstance(other, float):
        exact = value == other and float(np.float32(value)) == value
        if not exact and abs(value - other) <= 1e-6 * max(abs(value), abs(other)):
            return Unsaid.choose(holds, not holds)
    return holds


def fitting(kind, value):
    """What a variable of a type makes of a value."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return value
    if kind == "INT" and not abs(value) < 2**31:
        return too_large(value)
    if kind == "INT" and abs(value % 1 - 0.5) < 1e-6:
        return Unsaid.choose(int(np.floor(value + 0.5)), int(np.ceil(value - 0.5)))
    if kind == "INT":
        return int(np.floor(value + 0.5))
    return float(value) if kind == "REAL" else value


@dataclass
class Routine:
    module: Module
    name: str
    parameters: list
    body: list
    public: bool
    result: str = ""


@dataclass
class Module:
    name: str
    variables: dict = field(default_factory=dict)
    routines: dict = field(default_factory=dict)


@dataclass
class Motion:
    file: str
    line: int
    kind: str
    numbers: list | None
    via: list | None
    joints: list | None
    base: np.ndarray
    tool: np.ndarray
    speed: float
    cdis: float | None
    force: str
    callers: tuple
    mode: str
    synchronised: int = 0
    begins_uncorrected: bool = False
    waits: bool = False


@lru_cache(100_000)
def tokens(text):
    """Kinds and tokens of a line, upper case; and the index of the first geometric operator."""
    kinds, found, position = [], [], 0
    text = text.rstrip()
    while position < len(text):
        match = TOKEN.match(text, position)
        if not match:
            raise Invalid(f"not understood: {text[position:]}")
        kinds.append(match.lastgroup)
        found.append(match[match.lastgroup].upper())
        position = match.end()
    return tuple(kinds), tuple(found), found.index(":") if ":" in found else len(found)


class Reader:
    """Tokens of one line."""

    def __init__(self, text):
        (self.kinds, self.tokens, self.chain), self.at = tokens(text), 0
        self.count = len(self.tokens)

    def number(self):
        """Take a number that is a whole value, with its sign; None if the next tokens are none."""
        at = self.at
        negative = self.tokens[at : at + 1] == ("-",)
        at += negative
        if at >= self.count or self.kinds[at] != "number" or self.tokens[at + 1 : at + 2] not in _BEHIND:
            return None
        self.at, token = at + 1, self.tokens[at]
        value = int(token) if token.isdigit() else float(token)
        return -value if negative else value

    def peek(self, ahead=0):
        index = self.at + ahead
        return self.tokens[index] if index < self.count else ""

    def kind(self, ahead=0):
        index = self.at + ahead
        return self.kinds[index] if index < self.count else ""

    def take(self, *expected):
        token = self.peek()
        if expected and token not in expected:
            raise Invalid(f"{expected} is expected, {token!r} found")
        self.at += 1
        return token


def code(line):
    inside = False
    for offset, char in enumerate(line):
        inside ^= char == '"'
        if char == ";" and not inside:
            return line[:offset].strip()
    return line.strip()


@lru_cache(1000)
def declarations(text):
    """Return the statements of a data list."""
    lines = map(code, re.split(r"\r\n|\n", text))
    others = ("DEFDAT", "ENDDAT", "&", "EXT ", "EXTFCT ", "EXTP ", "SIGNAL ", "CHANNEL ")
    return [line for line in lines if line and not line.upper().startswith(others)]


@lru_cache(1000)
def routines(file, text):
    """Return name, parameters, statements, whether it is GLOBAL, and type of each routine of a file.

    Control structures hold their statements; nothing of them changes while they run.
    """
    parsed, body, stack, opened = [], None, [], []
    for number, raw in enumerate(re.split(r"\r\n|\n", text), 1):
        line = code(raw)
        word = line.split("(")[0].split(" ")[0].upper() if line else ""
        if body is not None and (found := FORCE.match(raw)):
            word, line = "FORCE", found[1].strip()
        elif found := LABEL.match(line):
            word, line = "LABEL", found[1].upper()
        head = ROUTINE.match(line)
        if head:
            parameters = []
            for part in filter(None, map(str.strip, head[4].split(","))):
                name, _, way = part.partition(":")
                parameters.append((name.replace("[]", "").strip().upper(), way.strip().upper() == "IN"))
            body = []
            parsed.append((head[3].upper(), parameters, body, bool(head[1]), (head[2] or "").upper()))
            stack, opened = [body], []
        elif word in ("END", "ENDFCT"):
            body = None
        elif not line or line[0] == "&" or body is None:
            continue
        elif word in OPENING:
            block = [word, file, number, line, [[]], []]
            stack[-1].append(block)
            stack.append(block[4][0])
            opened.append(word)
        elif word in ("ELSE", "CASE", "DEFAULT"):
            if opened[-1:] != (["IF"] if word == "ELSE" else ["SWITCH"]):
                raise Invalid(f"{word} without what it belongs to")
            stack.pop()
            block = stack[-1][-1]
            block[4].append([(line, number)])
            stack.append(block[4][-1])
        elif word in OPENING.values():
            if not opened or OPENING[opened.pop()] != word:
                raise Invalid(f"{word} without what it closes")
            stack.pop()
            stack[-1][-1][5] = line, number
        else:
            stack[-1].append((word, file, number, line))
    return parsed


class Controller:
    """Files, variables, and one run.

    :param files: name → text.
    :param rng: chance.
    :param base, tool: 4×4, in force where BAS(#INITMOV,0) leaves them; `system`: name → value of the controller's data.
    :param choices: what inputs are, where nothing is left to chance.
    :param given: values of inputs and of variables that are in no file, and of parameters of the program.
    :param side: how it does what no source says.
    :param initmov: frames behind BAS(#INITMOV,0): those of the cell, BASE(0) and TOOL_DATA[1] ("bas"), or one of both.
    :ivar rounds: motions of two rounds of a LOOP without EXIT.
    """

    def __init__(self, files, rng, base, tool, system, choices=None, given=None, side=0, initmov="cell"):
        self.initmov = initmov
        self.given, self.rounds = given or {}, ([], [])
        Unsaid.side, Unsaid.asked = side, False
        self.rng, self.cell, self.choices, self.force = rng, (base, tool), choices, ""
        self.base, self.tool, self.speed, self.cdis = base, tool, 2.0, 3.0
        self.modes, self.flags = {"$ORI_TYPE": "#VAR", "$CIRC_TYPE": "#BASE", "$IPO_MODE": "#BASE"}, {}
        self.shared = {name: Variable("", copied(value)) for name, value in system.items()}
        self.shared |= {name: Variable("", value) for name, value in self.given.items() if name[0] != "$"}
        self.modules, self.motions, self.submit, self.structures = {}, [], [], {}
        self.numbers = self.joints = None
        self.synchronised = 0
        self.outside = base, tool, 0.0
        self.stood = base, tool
        self.conditions = {}
        self.handlers, self.active, self.pending, self.cyclic = {}, set(), [], []
        self.busy, self.steps = False, 0
        self.here, self.callers, self.imports = ("", 0), [], []
        self.frames = []
        for name, text in files.items():
            for line in declarations(text) if name.upper().endswith(".DAT") else ():
                if re.match(r"(?i)(?:DECL\s+)?(?:GLOBAL\s+)?STRUC\s", line):
                    self.declare({}, line)
        for name, text in files.items():
            stem, _, ending = name.upper().rpartition(".")
            module = self.modules.setdefault(stem, Module(stem))
            if ending == "DAT":
                self.data(module, text)
            else:
                self.source(module, name, text)
                if ending == "SUB":
                    self.submit += module.routines.values()
        for variables, line in self.imports:
            self.imported(variables, line)

    # --- files ---------------------------------------------------------------------------------------------------

    def data(self, module, text):
        for line in declarations(text):
            if line.upper().startswith("IMPORT"):
                self.imports.append((module.variables, line))
            else:
                self.declare(module.variables, line, module)

    def declare(self, variables, line, module=None):
        reader = Reader(line)
        public = False
        while reader.peek() in ("DECL", "GLOBAL", "CONST"):
            public |= reader.take() == "GLOBAL"
        if reader.peek() == "STRUC":
            self.structure_type(reader)
            return
        kind = ""
        if reader.kind(1) == "name":
            kind = reader.take()
        while True:
            name, index = reader.take(), None
            if reader.peek() == "[":
                reader.take()
                index = None if reader.peek() == "]" else self.indices(reader)
                reader.take("]")
            table = self.shared if public else variables
            variable = table.get(name) or (variables.get(name) or self.shared.get(name) if not kind else None)
            if variable is None or (kind and not public and name not in variables):
                variable = table[name] = Variable(kind, None, self.structures.get(kind, {}))
            if isinstance(variable, Variable) and kind and not variable.kind:
                variable.kind, variable.value = kind, fitting(kind, variable.value)
            if isinstance(variable, Place) and kind in ("INT", "REAL"):
                self.convert_argument(variable, kind)
            if reader.peek() == "=":
                reader.take()
                Place(variable, [] if index is None else [index]).set(self.expression(reader))
            if reader.peek() != ",":
                return
            reader.take()

    def structure_type(self, reader):
        """STRUC name type member, member, type member …"""
        reader.take("STRUC")
        members, kind = self.structures.setdefault(reader.take(), {}), ""
        while reader.kind():
            first = reader.take()
            if reader.kind() == "name":
                kind, first = first, reader.take()
            members[first] = self.structures.get(kind, kind)
            if reader.kind():
                reader.take(",")

    def convert_argument(self, place, kind):
        """What happens to a variable of another type that is given by reference is not documented."""
        value = place.get()
        other = isinstance(value, int | float) and not isinstance(value, bool) and fitting(kind, value) != value
        if other and self.rng is not None and self.rng.random() < 0.5:
            place.set(fitting(kind, value))

    def source(self, module, file, text):
        for name, *parts in routines(file, text):
            module.routines[name] = Routine(module, name, *parts)

    # --- running -------------------------------------------------------------------------------------------------

    def run(self, name):
        """Run a program to its end; its motions are in `motions`."""
        routine = self.modules[name].routines[name]
        self.frames.append((routine, {name: Variable("", self.given.get(name)) for name, _ in routine.parameters}))
        try:
            with suppress(_Return, _Stop):
                self.block(routine.body)
        except _Resume:
            raise Invalid("RESUME in the routine that declares the interrupt") from None
        except _Goto as jump:
            raise Invalid(f"GOTO to {jump.args[0]}, which is no label: no controller takes the program") from None
        return self.motions

    def block(self, body):
        labels = {one[3]: at for at, one in enumerate(body) if one[0] == "LABEL"}
        at = 0
        while at < len(body):
            statement = body[at]
            at += 1
            try:
                if statement[0] in OPENING:
                    self.structure(statement)
                elif isinstance(statement[0], str) and len(statement) == 4:
                    self.statement(*statement)
            except _Goto as jump:
                if jump.args[0] not in labels:
                    raise
                at = labels[jump.args[0]]
            self.chance()

    def chance(self):
        """Let happen what may happen between two statements."""
        self.steps += 1
        if self.steps > MOST_STEPS:
            raise Invalid("too long")
        if self.busy or self.choices is not None:
            return
        self.busy = True
        for name, low, high in self.cyclic:
            name.set(
                float(self.rng.uniform(low, high)) if name.variable.kind != "INT" else int(self.rng.integers(1, 4))
            )
        for number in sorted(self.active & self.handlers.keys()):
            public, *handler = self.handlers[number]
            self.evaluate_condition(number, handler[0])
            declared = public or any(handler[0] is frame for frame in self.frames)  # KSS 8, INTERRUPT DECL: GLOBAL
            if declared and self.rng.random() < 0.2:
                try:
                    self.action(*handler)
                except _Resume:
                    self.busy, self.numbers = False, self.somewhere()
                    raise _Resume(handler[0]) from None
        for routine in self.submit:
            if self.rng.random() < 0.2:
                self.call(routine, [])
        for action in list(self.pending):
            if self.rng.random() < 0.4:
                self.pending.remove(action)
                count = len(self.motions)
                self.action(*action)
                if len(self.motions) > count:
                    raise Invalid("a TRIGGER moves the robot")
        self.busy = False

    def somewhere(self):
        """Return where a motion stops that BRAKE breaks off."""
        return self.numbers and (np.array(self.numbers) + self.rng.uniform(-5, 5, 6)).tolist()

    def evaluate_condition(self, number, frame):
        """Evaluate what an interrupt asks for: a function in it may do something."""
        condition = self.conditions[number]
        if re.search(r"[A-Za-z]\w*\s*\(", condition):
            self.frames.append(frame)
            with suppress(Invalid):
                self.expression(Reader(condition))
            self.frames.pop()

    def action(self, frame, callers, file, number, line):
        """Run what a TRIGGER or an INTERRUPT does: it belongs to the calls in which it was declared."""
        self.frames.append(frame)
        present = self.callers, self.here
        self.callers = callers
        word = re.match(r"[\w$]+", line)[0].upper()
        try:
            self.statement(word, file, number, line)
        finally:
            self.frames.pop()
            self.callers, self.here = present

    def structure(self, block):
        word, file, number, line, parts, closing = block
        self.here = file, number
        reader = Reader(line)
        reader.take(word)
        if word == "IF":
            chosen = 0 if self.expression(reader) else 1
            if chosen < len(parts):
                self.block(parts[chosen])
        elif word == "FOR":
            place = self.place(reader)
            reader.take("=")
            first = self.sum(reader)
            reader.take("TO")
            last = self.sum(reader)
            step = 1
            if reader.peek() == "STEP":
                reader.take()
                step = self.sum(reader)
            if step == 0 or any(not isinstance(bound, int) for bound in (first, last, step)):
                raise Invalid("bounds of FOR")
            place.set(first)
            with suppress(_Exit):
                while (place.get() - last) * step <= 0:
                    self.block(parts[0])
                    self.chance()
                    place.set(place.get() + step)
        elif word == "WHILE":
            text = line
            while True:
                self.here = file, number
                reader = Reader(text)
                reader.take("WHILE")
                if not self.expression(reader):
                    return
                try:
                    self.block(parts[0])
                except _Exit:
                    return
                self.chance()
        elif word == "LOOP" and not leaves(parts[0]):
            self.two_rounds(parts[0])
        elif word == "LOOP":
            with suppress(_Exit):
                while True:
                    self.block(parts[0])
                    self.chance()
        elif word == "REPEAT":
            while True:
                try:
                    self.block(parts[0])
                except _Exit:
                    return
                self.chance()
                text, number = closing
                self.here = file, number
                reader = Reader(text)
                reader.take("UNTIL")
                if self.expression(reader):
                    return
        elif word == "SWITCH":
            value = self.expression(reader)
            for part in parts[1:]:
                head = Reader(part[0][0])
                found = head.take() == "DEFAULT"
                while not found and head.kind():
                    found = self.expression(head) == value
                    if head.kind():
                        head.take(",")
                if found:
                    self.block(part[1:])
                    return
        else:
            raise Invalid(word)

    def two_rounds(self, body):
        """Run two rounds of a loop that never ends: the motions of the second must be those of the first."""
        begin = len(self.motions)
        self.block(body)
        end = len(self.motions)
        self.block(body)
        self.rounds = self.motions[begin:end], self.motions[end:]
        del self.motions[end:]
        raise _Stop

    def statement(self, word, file, number, line):
        self.here = file, number
        if word in MOTIONS:
            self.motion(word, file, number, line)
        elif word in ("INTERRUPT", "GLOBAL"):
            self.interrupt(file, number, line)
        elif word == "TRIGGER":
            action = re.search(r"(?i)\bDO\b\s*(.*?)(?:\s+PRIO\s*=.*)?$", line)[1]
            if re.match(r"[\w$]+", action)[0].upper() in self.frames[-1][1]:
                raise Invalid("a trigger must not assign to a variable of the routine")  # KSS 8, TRIGGER: DO
            self.pending.append((self.frames[-1], list(self.callers), file, number, action))
        elif word in ("ANIN", "DIGIN"):
            reader = Reader(line)
            reader.take(word)
            if reader.take("ON", "OFF") == "ON":
                self.cyclic.append((self.place(reader), -5.0, 5.0))
        elif word in ("WAIT", "HALT"):
            if self.motions:
                self.motions[-1] = replace(self.motions[-1], waits=True)
        elif word in ("SIGNAL", "EXT", "CONTINUE", "PULSE", "LABEL", "CONST_VEL", "STOP", "BRAKE"):
            return
        elif word in ("SPLINE", "PTP_SPLINE"):
            self.outside = self.base, self.tool, self.speed, self.cdis
            self.with_settings(line)
        elif word == "ENDSPLINE":
            if "C_SPL" in line.upper():
                self.motions[-1] = replace(self.motions[-1], cdis=self.cdis)
            self.base, self.tool, self.speed, self.cdis = self.outside
        elif word == "SYNCCMD":
            self.synchronised += 1
        elif word == "FORCE":
            self.force = "" if line.upper() == "OFF" else line.upper()
        elif word == "GOTO":
            raise _Goto(line[4:].strip().upper())
        elif word == "EXIT":
            raise _Exit
        elif word == "RESUME":
            raise _Resume
        elif word == "IMPORT":
            self.imported(self.frames[-1][1], line)
        elif word == "RETURN":
            reader = Reader(line)
            reader.take()
            raise _Return(self.expression(reader) if reader.kind() else None)
        elif word == "BAS":
            self.bas(line)
        elif word in ("DECL", "CONST", "STRUC") or (word in TYPES and re.match(r"\w+\s+\w", line)):
            self.declare(self.frames[-1][1], line)
        else:
            self.assignment_or_call(line)

    def imported(self, variables, line):
        """IMPORT type name IS /R1/file..variable: the same variable by another name."""
        name, file, variable = re.match(r"(?i)IMPORT\s+\w+\s+(\w+)\s+IS\s+/R1/(\w+)\s*\.\.\s*(\w+)", line).groups()
        variables[name.upper()] = Place(self.modules[file.upper()].variables[variable.upper()])

    def with_settings(self, line):
        """Follow the settings behind WITH, which hold for one spline motion or one block."""
        for given in filter(None, re.split(r"(?i)\bWITH\b", line)[1:]):
            reader = Reader(given.strip())
            self.system(reader)
            while reader.peek() == ",":
                reader.take()
                self.system(reader)

    def interrupt(self, file, number, line):
        declaration = re.match(r"(?i)(?:GLOBAL\s+)?INTERRUPT\s+DECL\s+(\d+)\s+WHEN\s+(.*?)\bDO\b\s*(.*)$", line)
        if declaration:
            public = line.upper().startswith("GLOBAL")
            action = (self.frames[-1], list(self.callers), file, number, declaration[3])
            self.handlers[int(declaration[1])] = public, *action
            self.conditions[int(declaration[1])] = declaration[2]
            return
        switch = re.match(r"(?i)INTERRUPT\s+(ON|OFF)\s+(\d+)", line)
        (self.active.add if switch[1].upper() == "ON" else self.active.discard)(int(switch[2]))

    def assignment_or_call(self, line):
        reader = Reader(line)
        if reader.peek(1) == "(":
            self.called(reader)
            return
        name = reader.peek()
        if name.startswith("$"):
            self.system(reader)
            return
        place = self.place(reader)
        reader.take("=")
        value = self.expression(reader)
        indexed = any(isinstance(step, int | tuple) for step in place.path)
        if (
            indexed and self.rng is not None and self.rng.random() < 0.5
        ):  # when the index is evaluated is not documented
            place = self.place(Reader(line))
        place.set(value)

    def complete(self, value):
        """A frame with what the controller takes for components that are not given: nobody knows what that is."""
        if not isinstance(value, dict):
            raise Invalid("not a frame")
        missing = [name for name in CARTESIAN if name not in value]
        if missing and self.rng is None:
            raise Invalid("components are missing")
        return value | {name: float(self.rng.uniform(-9, 9)) for name in missing}

    def system(self, reader):
        name, part, index = reader.take(), None, None
        if reader.peek() == "[":
            reader.take()
            index = self.sum(reader)
            reader.take("]")
        while reader.peek() == ".":
            reader.take()
            part = reader.take()
        reader.take("=")
        value = self.expression(reader)
        if name in ("$BASE", "$TOOL"):
            frame = pose(self.complete(value)) if part is None else None
            if part is not None:
                old = components(self.base if name == "$BASE" else self.tool)
                old[part] = float(value)
                frame = pose(old)
            setattr(self, name[1:].lower(), frame)
        elif name == "$VEL" and part in ("CP", None):
            self.speed = float(value if part else value.get("CP", self.speed))
            if self.speed <= 0:
                raise Invalid("speed")
        elif name == "$APO" and part in ("CDIS", None):
            self.cdis = float(value if part else value.get("CDIS", self.cdis))
        elif name in self.modes:
            self.modes[name] = value
        elif name in self.shared:
            self.shared[name].value = value
        elif name == "$FLAG":
            self.flags[index] = Variable("BOOL", value)

    def bas(self, line):
        reader = Reader(line)
        reader.take("BAS")
        reader.take("(")
        command = reader.take()
        value = None
        if reader.peek() == ",":
            reader.take()
            value = self.expression(reader)
        if command == "#INITMOV":
            self.speed, self.cdis = 2.0, 3.0
            self.base, self.tool = self.initial_frames()
            self.modes |= {"$ORI_TYPE": "#VAR", "$CIRC_TYPE": "#BASE", "$IPO_MODE": "#BASE"}
        elif command == "#VEL_CP":
            self.speed = min(float(value), 2.0)
        elif command in ("#VEL_PTP", "#ACC_CP", "#ACC_PTP"):
            return
        elif command in ("#CP_DAT", "#CP_PARAMS", "#FRAMES", "#PTP_DAT", "#PTP_PARAMS"):
            if command in ("#CP_DAT", "#CP_PARAMS"):
                data = self.shared["LDAT_ACT"].value
                self.speed = min(float(data.get("VEL", self.speed)), 2.0)
                self.cdis = float(data.get("APO_DIST", self.cdis))
                self.modes |= {"$ORI_TYPE": data.get("ORI_TYP", "#VAR"), "$CIRC_TYPE": data.get("CIRC_TYP", "#BASE")}
            data = self.shared["PDAT_ACT"].value
            if command in ("#PTP_DAT", "#PTP_PARAMS") and data and data.get("APO_MODE") == "#CDIS":
                self.cdis = float(data["APO_DIST"])
            if command not in ("#CP_DAT", "#PTP_DAT"):
                data = self.shared["FDAT_ACT"].value
                self.base, self.tool = (self.numbered(name, data.get(f"{name}_NO")) for name in ("BASE", "TOOL"))
                self.modes["$IPO_MODE"] = data.get("IPO_FRAME", self.modes["$IPO_MODE"])
            if command == "#CP_PARAMS":
                self.speed = min(float(value), 2.0)
        elif command in ("#BASE", "#TOOL"):
            setattr(self, command[1:].lower(), self.numbered(command[1:], value))
        else:
            raise Invalid(command)

    def initial_frames(self):
        """Return `$BASE` and `$TOOL` behind BAS(#INITMOV,0)."""
        untouched = all(np.allclose(*pair) for pair in zip((self.base, self.tool), self.cell, strict=True))
        if self.initmov == "cell" or (self.initmov is None and untouched):
            return self.cell
        frames = self.numbered("BASE", 0), self.numbered("TOOL", 1)
        return frames if self.initmov == "bas" else Unsaid.choose(self.cell, frames)

    def numbered(self, name, number):
        """BASE_DATA[number] or TOOL_DATA[number]; what a number is that was not given, chance says."""
        number = int(self.rng.integers(1, 3)) if number is None else int(number)
        data = self.shared[f"{name}_DATA"].value
        if number not in data:
            raise Invalid("no such frame")
        return pose(self.complete(data[number]))

    # --- calls ---------------------------------------------------------------------------------------------------

    def find(self, name):
        own = self.frames[-1][0].module.routines.get(name)
        if own:
            return own
        module = self.modules.get(name)
        if module and module.routines:
            return module.routines.get(name) or next(iter(module.routines.values()))
        for module in self.modules.values():
            found = module.routines.get(name)
            if found and found.public:
                return found
        return None

    def called(self, reader):
        name = reader.take()
        reader.take("(")
        routine, arguments = self.find(name), []
        while reader.peek() != ")":
            by_value = routine is not None and len(arguments) < len(routine.parameters)
            by_value = by_value and routine.parameters[len(arguments)][1]
            arguments.append(self.argument(reader, by_value))
            if reader.peek() == ",":
                reader.take()
        reader.take(")")
        if name in ("SBASE", "STOOL", "STOOL2"):
            kind, value = name[1:5], arguments[0].get()
            return components(self.numbered(kind, value[f"{kind}_NO"] if isinstance(value, dict) else value))
        if name in FUNCTIONS:
            return FUNCTIONS[name](*(place.get() for place in arguments if place.variable.value is not None))
        if routine is None:
            for place in arguments:
                if self.rng.random() < 0.7:
                    self.spoil(place)
            return float(self.rng.integers(1, 4))
        return self.call(routine, arguments)

    def argument(self, reader, by_value):
        begin = reader.at
        if reader.peek() in (",", ")"):
            return Place(Variable())
        if reader.peek() == "$FLAG" and not by_value:
            place = Place(self.flag(reader))
            if reader.peek() in (",", ")"):
                return place
            reader.at = begin
        if reader.kind() == "name" and reader.peek(1) != "(" and reader.peek() not in _NO_VARIABLES:
            if reader.peek(1) == "[" and reader.peek(2) == "]":
                found = self.lookup(reader.take())
                reader.take("[")
                reader.take("]")
                return Place(found.variable, list(found.path)) if isinstance(found, Place) else Place(found)
            place = self.place(reader)
            if reader.peek() in (",", ")") and not by_value:
                return place
            reader.at = begin
        return Place(Variable("", self.expression(reader)))

    def spoil(self, place):
        """What an unknown program does to an argument."""
        value = place.variable.value if not place.path else place.get()
        if isinstance(value, dict) and "X" in value:
            place.set({**value, "X": float(self.rng.uniform(-9, 9))})
        elif isinstance(value, int | float) and not isinstance(value, bool):
            place.set(int(self.rng.integers(1, 4)))

    def call(self, routine, arguments):
        if len(self.frames) > 12:
            raise Invalid("too deep")
        local = {}
        for index, (name, by_value) in enumerate(routine.parameters):
            if index >= len(arguments):
                local[name] = Variable()
            elif by_value:
                local[name] = Variable("", copied(arguments[index].get()))
            else:
                local[name] = arguments[index]
        self.frames.append((routine, local))
        self.callers.append((*self.here, routine.name))
        try:
            self.block(routine.body)
        except _Return as result:
            return fitting(routine.result, result.args[0])
        except _Resume as stop:
            if not stop.args or self.frames[-2] is not stop.args[0]:
                raise
        finally:
            self.frames.pop()
            self.here = self.callers.pop()[:2]
        return None

    # --- expressions ---------------------------------------------------------------------------------------------

    def place(self, reader):
        name = reader.take()
        found = self.lookup(name)
        place = Place(found.variable, list(found.path)) if isinstance(found, Place) else Place(found)
        while reader.peek() in ("[", "."):
            if reader.take() == "[":
                if reader.peek() == "]":
                    raise Invalid("whole array")
                place.path.append(self.indices(reader))
                reader.take("]")
            else:
                place.path.append(reader.take())
        return place

    def indices(self, reader):
        """The index of an element; of an array of more dimensions a tuple."""
        found = [self.bits(reader)]
        while reader.peek() == ",":
            reader.take()
            found.append(self.bits(reader))
        if any(index != int(index) for index in found):
            raise Invalid("index")
        return int(found[0]) if len(found) == 1 else tuple(map(int, found))

    def lookup(self, name):
        routine, local = self.frames[-1]
        for table in (local, routine.module.variables, self.shared):
            if name in table:
                return table[name]
        raise Invalid(f"{name} is not declared")

    def expression(self, reader):
        """Terms joined by OR, EXOR, AND, of which the last binds most (KUKA, Expert Programming: priorities)."""
        number = reader.number()
        if number is not None:
            return number
        value = self.exclusion(reader)
        while reader.peek() == "OR":
            reader.take()
            other = self.exclusion(reader)
            value = value or other
        return value

    def exclusion(self, reader):
        value = self.conjunction(reader)
        while reader.peek() == "EXOR":
            reader.take()
            value = value != self.conjunction(reader)
        return value

    def conjunction(self, reader):
        value = self.comparison(reader)
        while reader.peek() == "AND":
            reader.take()
            other = self.comparison(reader)
            value = value and other
        return value

    def comparison(self, reader):
        if reader.peek() == "NOT":
            reader.take()
            return not self.comparison(reader)
        value = self.bits(reader)
        if reader.peek() in ("==", "<>", "<", ">", "<=", ">="):
            sign, negated = reader.take(), reader.peek() == "NOT"
            if negated:
                reader.take()  # NOT ranks before comparisons
            other = self.bits(reader)
            value = compared(sign, value, not other if negated else other)
        return value

    def bits(self, reader, level=0):
        """Terms joined by B_OR, B_EXOR, B_AND, of which the last binds most; they rank before comparisons."""
        if level == len(_BITS):
            return self.sum(reader)
        value = self.bits(reader, level + 1)
        while reader.peek() == _BITS[level]:
            reader.take()
            other = self.bits(reader, level + 1)
            if not (isinstance(value, int) and isinstance(other, int)):
                raise Invalid("bits of what is no INT")
            value = (value | other, value ^ other, value & other)[level]
        return value

    def sum(self, reader):
        number = reader.number()
        if number is not None:
            return number
        value = self.product(reader)
        while reader.peek() in ("+", "-"):
            sign = reader.take()
            other = self.product(reader)
            value = whole(value + other if sign == "+" else value - other)
        return value

    def product(self, reader):
        value = self.sign(reader)
        while reader.peek() in ("*", "/"):
            sign = reader.take()
            other = self.sign(reader)
            if sign == "*":
                value = whole(value * other)
            elif other == 0:
                raise Invalid("division by zero")
            elif isinstance(value, int) and isinstance(other, int):
                value = quotient(value, other)
            else:
                value = value / other
        return value

    def sign(self, reader):
        if reader.peek() in ("+", "-"):
            return self.sign(reader) if reader.take() == "+" else -self.sign(reader)
        value = self.operand(reader)
        while reader.peek() == ":":
            reader.take()
            other = self.operand(reader)
            last = {name: other[name] for name in ("S", "T") if name in other}
            value = components(pose(value) @ pose(other)) | last
        return value

    def operand(self, reader):
        """A value; of a chain of frames, variables must have all components."""
        named = reader.kind() == "name"
        value = self.primary(reader)
        chained = reader.peek() == ":" or (reader.at > 1 and reader.chain < reader.at)
        return self.complete(value) if named and chained and isinstance(value, dict) and "A1" not in value else value

    def primary(self, reader):
        kind, token = reader.kind(), reader.peek()
        if kind == "number":
            reader.take()
            return int(token) if token.isdigit() else float(token)
        if kind == "literal":
            reader.take()
            return int(token[2:-1], 2 if token[1] == "B" else 16)
        if kind in ("enum", "string"):
            return reader.take()
        if token == "(":
            reader.take()
            value = self.expression(reader)
            reader.take(")")
            return value
        if token == "{":
            return self.aggregate(reader)
        if token in ("TRUE", "FALSE"):
            return reader.take() == "TRUE"
        if token == "B_NOT":
            reader.take()
            return ~self.primary(reader)
        if kind != "name":
            raise Invalid(f"{token!r} is no value")
        if reader.peek(1) == "(":
            return self.called(reader)
        if token in ("$IN", "$OUT", "$ANIN"):
            reader.take()
            reader.take("[")
            index = self.sum(reader)
            reader.take("]")
            if f"{token}[{index}]" in self.given:
                return self.given[f"{token}[{index}]"]
            if token == "$ANIN":
                return float(self.rng.uniform(-3, 3))
            return bool(self.rng.random() < 0.5) if self.choices is None else self.choices()
        if token == "$POS_ACT":
            reader.take()
            return self.standing()
        if token == "$FLAG":
            return self.flag(reader).value
        if token in self.modes:
            return self.modes[reader.take()]
        if token in ("$VEL", "$APO"):
            reader.take()
            reader.take(".")
            part = reader.take("CP", "CDIS")
            return self.speed if part == "CP" else self.cdis
        if token in ("$BASE", "$TOOL", "$NULLFRAME", "$WORLD", "$ROBROOT"):
            reader.take()
            frame = {"$BASE": self.base, "$TOOL": self.tool}.get(token, np.eye(4))
            if reader.peek() == ".":
                reader.take()
                return components(frame)[reader.take()]
            return components(frame)
        return copied(self.place(reader).get())

    def flag(self, reader):
        """A flag of the controller, as a variable: what a program wrote, else what chance left there."""
        reader.take("$FLAG")
        reader.take("[")
        index = self.sum(reader)
        reader.take("]")
        if index not in self.flags:
            self.flags[index] = Variable("BOOL", self.choices() if self.rng is None else bool(self.rng.random() < 0.5))
        return self.flags[index]

    def aggregate(self, reader):
        reader.take("{")
        value = {}
        if reader.peek(1) == ":":
            reader.take()
            reader.take(":")
        while True:
            name = reader.take()
            if reader.peek() == "[":
                reader.take()
                reader.take("]")
            item = self.expression(reader)
            value[name] = float(item) if name in CARTESIAN and not isinstance(item, str) else item
            if reader.take(",", "}") == "}":
                return value

    # --- motions -------------------------------------------------------------------------------------------------

    def motion(self, word, file, number, line):
        outside = self.base, self.tool, self.speed, self.cdis
        self.with_settings(line)
        self.moved(word, file, number, line)
        self.base, self.tool, self.speed, self.cdis = outside

    def moved(self, word, file, number, line):
        reader = Reader(line)
        reader.take(word)
        if reader.peek() in ("$POS_ACT", "$AXIS_ACT", "$POS_RET", "$AXIS_RET") and reader.at + 1 == reader.count:
            return  # where it is, or back to its path
        via = None
        if word in ("CIRC", "SCIRC"):
            via = self.target(self.sign(reader))[:3]
            reader.take(",")
        value = self.sign(reader)
        rest = " ".join(reader.tokens[reader.at :])
        kind = word.removesuffix("_REL")
        kind = KINDS.get(kind, kind)
        cdis = self.cdis if "C_DIS" in rest or ("C_SPL" in rest and word == "SLIN") else None
        force = "" if kind == "PTP" else self.force
        mode = self.modes["$IPO_MODE"]
        state = (self.base, self.tool, self.speed, cdis, force, tuple(self.callers), mode, self.synchronised)
        if any(f"A{number}" in value for number in range(1, 7)):
            joints = self.joints_of(value, relative=word.endswith("_REL"))
            self.numbers, self.joints = None, joints
            self.motions.append(Motion(file, number, kind, None, None, joints, *state))
            return
        if word.endswith("_REL"):
            numbers = self.relative(value, "#TOOL" in rest)
        else:
            numbers = self.target(value)
        if kind != "PTP" and self.modes["$ORI_TYPE"] == "#CONSTANT":
            numbers[3:] = list(self.standing().values())[3:]
        if "CA" in rest.split():
            reader.take(",")
            reader.take("CA")
            arc = list(self.standing().values())[:3], via, numbers[:3]
            angle = self.sum(reader)
            via, numbers[:3] = turned(*arc, 0.5 * angle), turned(*arc, angle)
        self.numbers, self.joints = numbers, None
        self.stood = self.base, self.tool
        self.motions.append(Motion(file, number, kind, list(numbers), via, None, *state))

    def joints_of(self, value, *, relative):
        """Return A1 … A6 of a target [deg]: those that are not given stay as they are."""
        names = [f"A{number}" for number in range(1, 7)]
        if self.joints is None and (relative or any(name not in value for name in names)):
            raise PositionUnknown("joint angles that are not known")
        if relative:
            return [angle + float(value.get(name, 0.0)) for name, angle in zip(names, self.joints, strict=True)]
        return [float(value[name]) if name in value else self.joints[at] for at, name in enumerate(names)]

    def standing(self):
        """Where the robot is, in the frames of now."""
        if self.numbers is None:
            raise PositionUnknown("where the robot is, is not known")
        base, tool = self.stood
        flange = base @ abc(*self.numbers) @ np.linalg.inv(tool)
        return components(np.linalg.inv(self.base) @ flange @ self.tool)

    def target(self, value):
        if self.numbers is None and any(name not in value for name in CARTESIAN):
            raise PositionUnknown("components are missing")
        return [float(value[n]) if n in value else self.numbers[k] for k, n in enumerate(CARTESIAN)]

    def relative(self, value, along_tool):
        if self.numbers is None:
            raise PositionUnknown("relative to what is not known")
        numbers = list(self.standing().values())
        step = np.array([float(value.get(name, 0.0)) for name in "XYZ"])
        if along_tool:
            step = abc(0, 0, 0, *numbers[3:])[:3, :3] @ step
        return [*(np.array(numbers[:3]) + step).tolist(), *numbers[3:]]


def leaves(body):
    """Whether a loop may be left by a statement of its body."""
    for item in body:
        if item[0] in OPENING:
            if any(leaves(part) for part in item[4]):
                return True
        elif item[0] in ("EXIT", "GOTO", "RETURN"):
            return True
    return False


def shown(motion):
    """What a motion does, to compare it with another."""
    numbers = np.round(motion.numbers if motion.joints is None else motion.joints, 6).tolist()
    frames = np.round([motion.base, motion.tool], 9).tolist()
    via = None if motion.via is None else np.round(motion.via, 6).tolist()
    return motion.kind, numbers, via, frames, motion.speed, motion.cdis


def turned(start, via, end, angle):
    """X, Y, Z of the end of an arc that turns by an angle [deg] from its start: < 0 away from its auxiliary point."""
    start, one, two = np.array(start), np.subtract(via, start), np.subtract(end, start)
    normal = np.cross(one, two) / np.linalg.norm(np.cross(one, two))
    centre = np.linalg.solve(np.array([one, two, normal]), [0.5 * one @ one, 0.5 * two @ two, 0.0])
    turn = rot(normal, np.radians(angle))
    return list(start + centre - turn @ centre)


def pose(value):
    """4×4 of X…C in mm and degrees; a missing component is 0."""
    if not isinstance(value, dict):
        raise Invalid("not a frame")
    return abc(*(float(value.get(name, 0.0)) for name in CARTESIAN))


def components(frame):
    """X…C [mm, deg] of a 4×4."""
    r = frame[:3, :3]
    b = np.arctan2(-r[2, 0], np.hypot(r[0, 0], r[1, 0]))
    a, c = np.arctan2(r[1, 0], r[0, 0]), np.arctan2(r[2, 1], r[2, 2])
    values = [*(frame[:3, 3] * 1000), *np.degrees([a, b, c])]
    return dict(zip(CARTESIAN, (float(value) for value in values), strict=True))
