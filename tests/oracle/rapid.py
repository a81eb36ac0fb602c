"""A controller that executes RAPID, token by token, written from ABB's manuals and sharing no code with the package.

It knows what CAM systems write: data, routines with parameters, FOR, WHILE, IF, moves by numbers and by names, Offs,
RelTool. Poses are matrices in the world, in mm; what a comment says of the force holds until the next one.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, field

import numpy as np
from scipy.spatial.transform import Rotation

TOKEN = re.compile(
    r'\s+|(?P<comment>!.*)|(?P<word>[A-Za-z]\w*)|(?P<number>\d+(\.\d*)?([eE][-+]?\d+)?)|(?P<text>"[^"]*")'
    r"|(?P<sign>:=|<=|>=|<>|[-+*/=<>\[\](){},;:\\.])"
)
FIELDS = {"trans": 0, "rot": 1, "robconf": 2, "extax": 3, "x": 0, "y": 1, "z": 2}
SPEEDS = {f"v{n}": [float(n), 500.0, 5000.0, 1000.0] for n in (5, 10, 20, 50, 100, 200, 500, 1000)}
ZONES = {f"z{n}": [False, 0.3 if n == 0 else float(n)] for n in (0, 1, 5, 10, 20, 50)} | {"fine": [True, 0.0]}
ORIGIN = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0]]


def matrix(pose):
    """A `pose` of RAPID as a matrix [mm]."""
    out = np.eye(4)
    out[:3, :3] = Rotation.from_quat(np.roll(pose[1], -1)).as_matrix()
    out[:3, 3] = pose[0]
    return out


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


class Controller:
    """Executes the routine `main` of a module."""

    def __init__(self, text: str) -> None:
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
        self.routines: dict[str, tuple[int, list[str]]] = {}
        self.motions: list[Motion] = []
        self.force, self.at = "", 0
        self.data: dict[str, object] = {**SPEEDS, **ZONES, "tool0": [True, ORIGIN], "wobj0": [0, 0, 0, ORIGIN, ORIGIN]}
        self.scopes: list[dict[str, object]] = [self.data]
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
        if words[:1] == ["FORCE"] and len(self.scopes) > 1:
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
        while self.peek() != "module":
            self.next()
        self.next(), self.next()
        while self.peek() != "endmodule":
            word = self.peek()
            if word in ("local", "task"):
                self.next()
            elif word in ("const", "var", "pers"):
                self.declare(self.data)
            elif word == "proc":
                self.next()
                name = self.next().lower()
                parameters: list[str] = []
                self.take("(")
                while not self.accept(")"):
                    self.next()  # its type
                    parameters.append(self.next().lower())
                    self.accept(",")
                self.routines[name] = self.at, parameters
                while self.peek() != "endproc":
                    self.next()
                self.next()
            else:
                raise AssertionError(word)

    def declare(self, scope: dict[str, object]) -> None:
        self.next(), self.next()
        name = self.next().lower()
        if self.accept("{"):
            self.expression()
            self.take("}")
        scope[name] = self.expression() if self.accept(":=") else 0.0
        self.take(";")

    # --- expressions

    def expression(self, level: int = 0):
        signs = (("=", "<>", "<", ">", "<=", ">="), ("+", "-"), ("*", "/"))
        if level == len(signs):
            return self.factor()
        value = self.expression(level + 1)
        while self.peek() in signs[level]:
            sign, other = self.next(), self.expression(level + 1)
            value = {
                "=": lambda a, b: a == b, "<>": lambda a, b: a != b, "<": lambda a, b: a < b, ">": lambda a, b: a > b,
                "<=": lambda a, b: a <= b, ">=": lambda a, b: a >= b, "+": lambda a, b: a + b, "-": lambda a, b: a - b,
                "*": lambda a, b: a * b, "/": lambda a, b: a / b,
            }[sign](value, other)  # fmt: skip
        return value

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
        if self.peek() == "(" and word in ("offs", "reltool", "sin", "cos"):
            return self.function(word)
        value = next(scope[word] for scope in (self.scopes[-1], self.data) if word in scope)
        while self.peek() in ("{", "."):
            if self.accept("{"):
                value = value[int(self.expression()) - 1]
                self.take("}")
            else:
                self.next()
                value = value[FIELDS[self.next().lower()]]
        return value

    def function(self, name: str):
        self.take("(")
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
        if name in ("sin", "cos"):
            return getattr(math, name)(math.radians(values[0]))
        point, *step = values
        if name == "offs":
            return [[a + b for a, b in zip(point[0], step, strict=True)], *point[1:]]
        moved = matrix(point[:2])
        place = (moved @ [*step, 1.0])[:3]
        turned = Rotation.from_matrix(moved[:3, :3]) * Rotation.from_euler("XYZ", list(turns.values()), degrees=True)
        return [place.tolist(), np.roll(turned.as_quat(), 1).tolist(), *point[2:]]

    # --- execution

    def run(self, name: str = "main") -> list[Motion]:
        """The moves of a routine."""
        self.call(name, [])
        return self.motions

    def call(self, name: str, values: list) -> None:
        back = self.at
        self.at, parameters = self.routines[name]
        self.scopes.append(dict(zip(parameters, values, strict=True)))
        self.block(("endproc",))
        self.scopes.pop()
        self.at = back

    def skip(self, ends: tuple[str, ...]) -> None:
        """Go to one of the words that ends a block, over blocks inside; comments are not heeded."""
        depth = 0
        while True:
            kind, word, _ = self.tokens[self.at]
            word = word.lower()
            if kind == "word" and depth == 0 and word in ends:
                return
            if kind == "word" and word in ("for", "while", "if"):
                depth += 1
            if kind == "word" and word in ("endfor", "endwhile", "endif"):
                depth -= 1
            self.at += 1

    def block(self, ends: tuple[str, ...]) -> None:
        while True:
            while self.tokens[self.at][0] == "comment":
                self.remark(self.tokens[self.at][1])
                self.at += 1
            if self.peek() in ends:
                return
            self.statement()

    def statement(self) -> None:
        word = self.peek()
        if word in ("const", "var", "pers"):
            self.declare(self.scopes[-1])
        elif word == "for":
            self.loop()
        elif word == "while":
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
        elif word == "if":
            self.next()
            condition = self.expression()
            self.take("then")
            if condition:
                self.block(("else", "endif"))
                self.skip(("endif",))
            else:
                self.skip(("else", "endif"))
                if self.accept("else"):
                    self.block(("endif",))
            self.next()
        elif word.startswith("move"):
            self.move()
        else:
            self.simple()

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
        while (last - value) * step >= 0.0:
            self.at = begin
            self.scopes[-1][name] = value
            self.block(("endfor",))
            value += step
        self.skip(("endfor",))
        self.next()

    def simple(self) -> None:
        name = self.next().lower()
        if self.peek() == ":=":
            self.next()
            scope = self.scopes[-1] if name in self.scopes[-1] else self.data
            scope[name] = self.expression()
            self.take(";")
            return
        if self.peek() == ".":
            path = []
            while self.accept("."):
                path.append(FIELDS[self.next().lower()])
            self.take(":=")
            value = self.expression()
            scope = self.scopes[-1] if name in self.scopes[-1] else self.data
            scope[name] = place = [list(v) if isinstance(v, list) else v for v in scope[name]]
            for k in path[:-1]:
                place = place[k]
            place[path[-1]] = value
            self.take(";")
            return
        if name in self.routines:
            values = []
            while not self.accept(";"):
                self.accept(",")
                values.append(self.expression())
            self.call(name, values)
            return
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
                values.append(self.expression())
        force = self.force
        following = self.tokens[self.at] if self.at < len(self.tokens) else ("", "", 0)
        if following[0] == "comment" and following[2] == line and following[1][1:].split()[:1] == ["FORCE"]:
            self.remark(following[1])  # in the line of the move: it holds for it
            force = self.force
        *points, speed, zone, tool = values
        frames = options.get("wobj", self.data["wobj0"])
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
