"""Random KRL: calls, assignments, functions in expressions, interrupts, triggers, arrays, frames, other files."""

from __future__ import annotations

import re
from dataclasses import dataclass, field

POINTS = ("XP1", "XP2", "XP3", "XG1")
FRAMES = ("FR1", "FR2")
INTS = ("I", "J", "IG")
REALS = ("V", "W")
POINTS_DAT = """DEFDAT part PUBLIC
DECL E6POS XP1={X 100.5,Y 20,Z 30,A 10,B 20,C 170,S 2,T 10}
DECL E6POS XP2={X -50.25,Y 21,Z 35.125,A 15,B 20,C 170}
DECL E6POS XP3={X 7,Y 22,Z 31,A 10,B 25,C 170}
DECL GLOBAL E6POS XG1={X 9,Y 23,Z 32,A 10,B 20,C 160}
DECL E6POS P[3]
P[1]={X 1,Y 2,Z 3,A 4,B 5,C 6}
P[2]={X 11,Y 2,Z 3,A 4,B 5,C 6}
P[3]={X 21,Y 2,Z 3,A 4,B 5,C 6}
DECL FRAME FR1={X 5,Y 0,Z 1,A 10,B 0,C 0}
DECL FRAME FR2={X 50,Y -20,Z 10,A 0,B 0,C 5}
DECL INT I=1
DECL INT J=2
DECL GLOBAL INT IG=1
DECL REAL V=0.125
DECL REAL W=2.5
DECL BOOL OK=TRUE
ENDDAT
"""
STRUCTURE = "STRUC PT INT N,REAL R\nDECL PT SX={N 1,R 2.5}\nENDDAT"
RECORDS = """STRUC PT INT N,REAL R
DECL PT SX={N 1,R 2.5}
DECL PT SA[3]
SA[1]={N 1,R 1.5}
SA[2]={N 2,R 2.5}
SA[3]={N 3,R 3.5}
DECL CONST INT NC=2
ENDDAT"""
OTHER_DATA = """DEFDAT other
DECL E6POS XP1={X 1,Y 1,Z 1,A 0,B 0,C 0}
DECL INT I=2
DECL REAL V=0.25
ENDDAT
"""


@dataclass
class Routine:
    name: str
    function: str = ""
    parameters: list = field(default_factory=list)
    local: list = field(default_factory=list)
    file: str = "part"


class Generator:
    """Writes one program and the files that it calls."""

    def __init__(self, rng, *, more=False, mixed=False, keep=False, harder=False):
        """
        :param more: values of other types, structures, functions that give points, frames with gaps.
        :param mixed: nested loops with motions, spline blocks, SYNCCMD, #JOINT besides.
        :param keep: motions that only the running robot knows besides.
        :param harder: functions in targets and bounds, arrays of structures, GOTO, nested EXIT, WITH besides.
        """
        self.rng, self.more, self.mixed, self.keep, self.harder = rng, more, mixed, keep, harder
        self.labels = 0
        self.files = {}
        names = ["SUB1", "SUB2", "NEXT", "FN1", "LIB1", "LIBFN", "POINT", "LIB2"]
        names = names[: int(rng.integers(0, 9 if more else 7))]
        self.routines = [self.routine(name) for name in names]
        self.here = None
        self.wild = rng.random()
        self.moving = 0.6 if rng.random() < 0.5 else 0.0

    def routine(self, name):
        rng = self.rng
        kinds = [("PX", "E6POS"), ("NX", "INT"), ("RX", "REAL")]
        parameters = [(n, kind, rng.choice(["IN", "OUT", ""])) for n, kind in kinds if rng.random() < 0.3]
        local = [one for one in (("XP2", "E6POS"), ("I", "INT"), ("W", "REAL")) if rng.random() < 0.12]
        file = str(rng.choice(["other", "lib/shared"])) if name.startswith("LIB") else "part"
        result = (self.one("INT", "INT", "REAL") if self.more else "INT") if "FN" in name or name == "NEXT" else ""
        return Routine(name, "E6POS" if name == "POINT" else result, parameters, local, file)

    def one(self, *options):
        return options[int(self.rng.integers(len(options)))]

    def maybe(self, share):
        return self.rng.random() < share

    # --- values --------------------------------------------------------------------------------------------------

    def names(self, kind):
        found = {"E6POS": POINTS, "FRAME": FRAMES, "INT": INTS, "REAL": REALS}[kind]
        if self.here is not None and self.here.file != "part":
            found = {"E6POS": ("XP1", "XG1"), "INT": ("I", "IG"), "REAL": ("V",), "FRAME": ()}[kind]
        if self.here is not None:
            own = [name for name, k, *_ in (*self.here.parameters, *self.here.local) if k == kind]
            found = (*found, *own, *own)
        return found

    def member(self, kind):
        """A member of a structure, often of an element of an array."""
        index = self.one("1", "2", "3", *self.names("INT"))
        return f"{self.one('SX', f'SA[{index}]')}.{'N' if kind == 'INT' else 'R'}"

    def integer(self, depth=0):
        if self.harder and self.in_part() and self.maybe(0.12):
            return self.one("NC", self.member("INT"))
        choice = int(self.rng.integers(8 if depth < 2 else 4))
        if choice < 3:
            return str(int(self.rng.integers(1, 4)))
        if self.more and choice == 5 and self.maybe(0.2) and self.in_part():
            return "SX.N"
        if choice < 6:
            return self.one(*self.names("INT"))
        sign = self.one("+", "-", "*", "/") if self.maybe(0.3) else self.one("+", "-")
        return f"{self.integer(depth + 1)}{sign}{self.integer(depth + 1)}"

    def real(self, depth=0):
        choice = int(self.rng.integers(9 if depth < 2 else 5))
        if choice < 3:
            return f"{self.rng.uniform(0.01, 30):.3f}"
        if choice == 3:
            return self.one(*self.names("REAL"))
        if choice == 4:
            return f"{self.one(*self.names('E6POS'))}.{self.one('X', 'Y', 'Z')}"
        if choice == 5 and self.maybe(0.3):
            return self.function_call() or "1.5"
        if choice == 6:
            return f"-({self.real(depth + 1)})"
        return f"({self.real(depth + 1)}{self.one('+', '-', '*')}{self.real(depth + 1)})"

    def speed(self):
        return self.one(*self.names("REAL")) if self.maybe(0.4) else f"{self.rng.uniform(0.01, 1):.3f}"

    def aggregate(self, full=True):
        items = []
        for name in "XYZABC":
            if not full and self.maybe(0.3):
                continue
            if self.maybe(0.12):
                items.append(f"{name} {self.real(1)}")
            else:
                items.append(f"{name} {self.rng.uniform(-90, 90):.3f}")
        return "{" + ",".join(items or ["X 1"]) + "}"

    def in_part(self):
        return self.here is None or self.here.file == "part"

    def element(self):
        if not self.in_part():
            return "XG1"
        return f"P[{self.one(*self.names('INT')) if self.more and self.maybe(0.4) else self.integer(1)}]"

    def point(self):
        return self.element() if self.maybe(0.25) else self.one(*self.names("E6POS"))

    def frame(self):
        names = self.names("FRAME")
        choice = int(self.rng.integers(6))
        if choice < 2 and names:
            return self.one(*names)
        if self.more and choice == 2 and self.maybe(0.05):
            return self.aggregate(full=False)
        if choice == 2:
            return f"BASE_DATA[{self.integer(1) if self.maybe(0.4) else self.one('1', '2', '3')}]"
        if choice == 3 and names:
            return f"{self.one(*names)}:{self.aggregate()}"
        return self.aggregate()

    def argument(self, kind):
        if self.harder and self.in_part() and kind != "E6POS" and self.maybe(0.2):
            return self.one(self.member(kind), f"{self.point()}.{self.one('X', 'Y')}")
        if kind == "E6POS":
            return self.element() if self.more and self.maybe(0.3) else self.point()
        if self.more and self.maybe(0.1):
            kind = {"INT": "REAL", "REAL": "INT"}[kind]
        if self.maybe(0.6):
            return self.one(*self.names(kind))
        return self.integer() if kind == "INT" else self.real()

    def call(self, routine):
        arguments = [self.argument(kind) for _, kind, _ in routine.parameters]
        return f"{routine.name}({','.join(arguments)})"

    def callable(self, function):
        """Routines that the present one sees: those of its file, and of others those that are public."""
        kinds = {"": ("",), "number": ("INT", "REAL"), "point": ("E6POS",)}[function]
        return [r for r in self.routines if r.function in kinds and self.sees(r)]

    def sees(self, routine):
        here = "part" if self.here is None else self.here.file
        return routine.file in (here, "other", "lib/shared") and (routine.file != "part" or here == "part")

    def function_call(self):
        found = self.callable("number")
        if found and self.maybe(0.9):
            return self.call(self.one(*found))
        return f"GONE({self.argument('E6POS')})" if self.maybe(0.5) else ""

    def condition(self):
        choice = int(self.rng.integers(5))
        if choice == 0:
            return "$IN[1]"
        if choice == 1:
            call = self.function_call()
            return f"{call}>1" if call else "OK2==1".replace("OK2", self.one(*self.names("INT")))
        if choice == 2:
            return f"NOT {self.one('TRUE', 'FALSE')}"
        if choice == 3 and self.maybe(0.4):
            a, b = (f"{self.one(*self.names('INT'))}{self.one('==', '<>', '>=', '<')}{self.integer(2)}" for _ in "ab")
            return self.one(f"({a}) AND ({b})", f"{a} OR {b}", f"NOT ({a})", f"({a}) EXOR (NOT ({b}))")
        return f"{self.one(*self.names('INT'))}{self.one('==', '>', '<')}{self.integer(2)}"

    # --- statements ----------------------------------------------------------------------------------------------

    def assignment(self):
        choice = int(self.rng.integers(11))
        if self.more and choice == 0 and self.maybe(0.1) and self.in_part():
            return f"SX.{self.one('N', 'R')}={self.one(self.integer(), self.real())}"
        if self.more and choice == 1 and (found := self.callable("point")):
            return f"{self.element() if self.maybe(0.5) else self.point()}={self.call(self.one(*found))}"
        if choice == 0:
            return f"{self.point()}={self.aggregate()}"
        if choice == 1:
            return f"{self.point()}={self.point()}"
        if choice in (2, 3):
            return f"{self.point()}.{self.one('X', 'Y', 'Z', 'A')}={self.real()}"
        if choice == 4:
            return f"{self.one(*self.names('INT'))}={self.integer()}"
        if choice == 5:
            return f"{self.one(*self.names('INT'))}={self.function_call() or self.integer()}"
        if choice == 6:
            return f"{self.one(*self.names('REAL'))}={self.one(self.real(), self.speed())}"
        if choice == 7 and self.names("FRAME"):
            return f"{self.one(*self.names('FRAME'))}={self.frame()}"
        if choice == 8 and self.names("FRAME"):
            return f"{self.one(*self.names('FRAME'))}.{self.one('X', 'Y', 'Z')}={self.real()}"
        if choice == 9:
            return self.one(f"BASE_DATA[{self.one('1', '3')}]={self.aggregate()}", f"TOOL_DATA[2].Z={self.real()}")
        return f"{self.one(*self.names('INT'))}={self.integer()}"

    def setting(self):
        return self.one(
            f"$BASE={self.frame()}",
            f"$TOOL={self.one('TOOL_DATA[2]', 'TOOL_DATA[1]', self.aggregate())}",
            f"$BASE.Z={self.real()}",
            f"$VEL.CP={self.speed()}",
            f"$VEL.CP={self.speed()}",
            f"$APO.CDIS={self.rng.uniform(0.1, 5):.2f}",
            f"BAS(#BASE,{self.integer(1)})",
            f"BAS(#VEL_CP,{self.speed()})",
            "BAS(#TOOL,2)",
            "BAS(#INITMOV,0)",
            "$VEL.ORI1=200",
        )

    def calling(self):
        found = self.callable("")
        if found and self.maybe(0.9):
            return self.call(self.one(*found))
        return self.one("GONE2()", f"GONE3({self.point()})", f"GONE4({self.one(*self.names('INT'))})", 'MSG("a;b")')

    def asynchronous(self):
        action = self.one(self.assignment(), self.assignment(), self.calling(), "$OUT[2]=TRUE", self.setting())
        number = int(self.rng.integers(4, 7))
        return self.one(
            [f"INTERRUPT DECL {number} WHEN $IN[1]==TRUE DO {action}", f"INTERRUPT ON {number}"],
            [f"GLOBAL INTERRUPT DECL {number} WHEN $IN[1] DO {action}", f"INTERRUPT ON {number}"],
            [f"TRIGGER WHEN DISTANCE={self.one('0', '1')} DELAY=0 DO {action}"],
            [f"TRIGGER WHEN PATH=-5 DELAY=0 DO {action} PRIO=-1"],
            [f"DIGIN ON {self.one(*self.names('INT'))}=1.0*$DIGIN1+0"],
            [f"ANIN ON {self.one(*self.names('REAL'))}=0.1*$ANIN[1]+0"],
        )

    def structure(self, depth):
        body = [line for _ in range(int(self.rng.integers(1, 3))) for line in self.statement(depth + 1)]
        if self.maybe(self.moving):
            body.insert(int(self.rng.integers(len(body) + 1)) if len(body) < 3 else 0, self.motion())
        choice = int(self.rng.integers(8))
        counter = self.one(*self.names("INT"))
        if choice == 0:
            return [f"FOR {counter}={self.one('1 TO 2', '1 TO 3', '3 TO 1 STEP -1', '1 TO 3 STEP 2')}", *body, "ENDFOR"]
        if choice == 1:
            return ["REPEAT", *body, f"UNTIL {self.one('TRUE', self.condition())}"]
        if choice == 2:
            head = f"SWITCH {counter}"
            return [head, "CASE 1", *body, "DEFAULT", *self.statement(depth + 1), "ENDSWITCH"]
        if choice == 3:
            return [f"WHILE {counter}<3", *body, f"{counter}={counter}+1", "ENDWHILE"]
        if choice == 4:
            return ["LOOP", *body, f"IF {self.condition()} THEN", "EXIT", "ENDIF", f"{counter}={counter}+1", "ENDLOOP"]
        tail = ["ELSE", *self.statement(depth + 1)] if self.maybe(0.4) else []
        return [f"IF {self.condition()} THEN", *body, *tail, "ENDIF"]

    def combined(self, depth):
        """What `mixed` and `keep` have besides."""
        whole = f"LIN {self.aggregate()}"
        options = [
            [f'SYNCCMD(#{self.one("PROGSYNC", "ProgSync", "MotionSync")},"A",3)'],
            [f"$ORI_TYPE={self.one('#JOINT', '#VAR', '#VAR')}"],
            [self.one("TRIGGER WHEN DISTANCE=0 DELAY=0 DO $OUT[2]=TRUE", "WAIT FOR $IN[2]"), whole],
        ]
        if self.in_part() and depth == 0 and self.moving:
            inner = [self.motion(), *self.statement(2)]
            options += 2 * [
                ["FOR I=1 TO 2", f"FOR J={self.one('1 TO 2', 'I TO 2')}", *inner, "ENDFOR", "ENDFOR", whole]
            ]
            options.append(["SPLINE", f"SLIN {self.aggregate()}", f"SLIN {self.point()}", "ENDSPLINE"])
        if self.keep and self.in_part() and depth == 0:
            options += [
                ["WHILE $IN[3]", whole, *self.statement(2), "ENDWHILE", whole],
                ["LIN $POS_ACT:{X 1,Y 2,Z 5,A 0,B 0,C 0}", whole],
                ["IF $IN[4] THEN", whole, "ENDIF", f"LIN {self.aggregate()}"],
            ]
        if self.harder and self.maybe(0.7):
            options = self.hard(depth, whole)
        return options[int(self.rng.integers(len(options)))]

    def hard(self, depth, whole):
        """What `harder` programs have besides."""
        self.labels += 1
        label = f"L{self.labels}"
        asked = self.function_call() or self.integer()
        moves = [self.motion()] if self.moving and depth == 0 and self.in_part() else []
        body = [*moves, *self.statement(2)]
        jump = [f"IF {self.condition()} THEN", *self.statement(2), f"GOTO {label}", "ENDIF", *body, f"{label}:"]
        left = [f"IF {self.condition()} THEN", *(self.statement(2) if self.maybe(0.4) else []), "EXIT", "ENDIF"]
        counter, other = self.one(*self.names("INT")), self.one(*self.names("INT"))
        bounds = f"{self.integer(1)} TO {asked if self.maybe(0.3) else self.integer(1)}"
        selected = asked if self.maybe(0.3) else self.integer()
        step, end = f"{counter}={counter}+1", self.one("2", "3")
        case = f"CASE {self.one('1', '1', self.integer(1))}"
        options = [
            [
                "SWITCH " + selected,
                case,
                *body,
                "CASE 2,3",
                *left[1:-2],
                "DEFAULT",
                *self.statement(2),
                "ENDSWITCH",
            ],
            [f"FOR {counter}={bounds}", *body, *(left if self.maybe(0.5) else []), "ENDFOR"],
            ["REPEAT", "LOOP", *body, *left, step, "ENDLOOP", f"{other}={other}+1", f"UNTIL {other}>{end}"],
            [f"{counter}=1", "REPEAT", f"FOR {other}=1 TO 3", *left, *body, "ENDFOR", step, f"UNTIL {counter}>2"],
            jump,
            jump,
        ]
        if self.in_part():
            options.append([f"{self.member('INT')}={self.integer()}", f"{self.member('REAL')}={self.real()}"])
            options.append([f"SA[{self.integer(1)}]={self.one('SX', 'SA[1]', 'SA[I]')}"])
        if moves:
            speed = f"WITH $VEL.CP={self.speed()}"
            block, line = (f"{word} {self.one('', speed)}".rstrip() for word in ("SPLINE", f"SLIN {self.point()}"))
            options.append([block, "S" + whole, line, "S" + whole, "ENDSPLINE"])
            options.append([f"SLIN {self.point()} {speed}", whole])
            options.append([f"LIN P[{asked}]", whole])
        return options

    def statement(self, depth=0):
        if self.mixed and self.maybe(0.15):
            return self.combined(depth)
        choice = self.rng.random()
        if choice < 0.42:
            return [self.assignment()]
        if choice < 0.6:
            return [self.setting()]
        if choice < 0.8:
            return [self.calling()]
        if choice < 0.8 + 0.12 * self.wild:
            return self.asynchronous()
        if choice < 0.96 and depth < 2:
            return self.structure(depth)
        return [self.one("; comment", "$OUT[1]=TRUE", "WAIT SEC 0.1", "INTERRUPT OFF 4", "PULSE($OUT[1],TRUE,0.5)")]

    def motion(self):
        tail = self.one("", " C_DIS", " C_DIS")
        choice = int(self.rng.integers(12))
        if choice < 2:
            return f"LIN {self.aggregate()}{tail}"
        if choice < 6:
            return f"LIN {self.point()}{tail}"
        if choice == 6:
            return f"LIN {self.aggregate(full=False)}{tail}"
        if choice == 7:
            return f"PTP {self.one(*self.names('E6POS'))}"
        if choice == 8:
            return f"LIN_REL {{Z {self.real()}}}" + self.one("", " #TOOL", " C_DIS #BASE", " C_DIS", " C_VEL #TOOL")
        if choice == 9:
            return f"LIN {self.one(*(self.names('FRAME') or ('$NULLFRAME',)))}:{self.point()}{tail}"
        if choice == 10:
            return "PTP {A1 10,A2 -80,A3 95,A4 0,A5 45,A6 0}"
        via = (
            f"{{X {self.rng.uniform(-90, 90):.2f},Y {self.rng.uniform(-90, 90):.2f},Z {self.rng.uniform(-90, 90):.2f}}}"
        )
        return f"CIRC {via},{self.aggregate()}{tail}"

    # --- files ---------------------------------------------------------------------------------------------------

    def written(self, routine):
        self.here = routine
        parameters = ",".join(name + (f":{way}" if way else "") for name, _, way in routine.parameters)
        public = "GLOBAL " if routine.file == "lib/shared" or self.maybe(0.2) else ""
        head = f"{public}DEFFCT {routine.function} {routine.name}({parameters})" if routine.function else None
        lines = [head or f"{public}DEF {routine.name}({parameters})"]
        lines += [f"DECL {kind} {name}" for name, kind, *_ in (*routine.parameters, *routine.local)]
        for name, kind, *_ in routine.local:
            lines.append(f"{name}={self.aggregate() if kind == 'E6POS' else self.integer(2)}")
        for _ in range(int(self.rng.integers(1, 5))):
            lines += self.statement()
        if self.maybe(0.08):
            result = "" if not routine.function else " XG1" if routine.function == "E6POS" else " (1)"
            lines += ["IF $IN[3] THEN", f"RETURN{result}", "ENDIF", self.assignment()]
        if self.maybe(0.04 if routine.function or not self.moving else 0.5):
            lines.append(self.motion())
        if routine.function:
            given = self.real() if self.more and self.maybe(0.15) else self.integer()
            lines.append(f"RETURN {self.point()}" if routine.function == "E6POS" else f"RETURN ({given})")
        self.here = None
        return [*lines, "ENDFCT" if routine.function else "END"]

    def programs(self):
        """Files of the program's folder: name → text; `lib/` is a folder of the search path."""
        rng = self.rng
        main = ["DEF part()", *(["BAS(#INITMOV,0)"] if self.maybe(0.8) else [])]
        if self.maybe(0.7):
            main.append(f"LIN {{X {rng.uniform(-9, 9):.2f},Y 5,Z 6,A 1,B 2,C 3}}")
        for _ in range(int(rng.integers(3, 9))):
            main += self.statement() if self.maybe(0.6) else []
            main.append(self.motion())
        main.append("END")
        if self.maybe(0.25):
            self.local(main)
        for routine in self.routines:
            if routine.file == "part":
                main += self.written(routine)
        data = POINTS_DAT.replace("ENDDAT", RECORDS if self.harder else STRUCTURE) if self.more else POINTS_DAT
        files = {"part.src": main, "part.dat": data.splitlines()}
        others = [r for r in self.routines if r.file == "other"]
        for routine in others:
            files.setdefault(f"{routine.name.lower()}.src", self.written(routine))
            files.setdefault(f"{routine.name.lower()}.dat", OTHER_DATA.replace("other", routine.name).splitlines())
        shared = [line for r in self.routines if r.file == "lib/shared" for line in self.written(r)]
        if shared:
            files["lib/shared.src"] = ["DEF shared()", "END", *shared]
            files["lib/shared.dat"] = OTHER_DATA.replace("other", "shared").splitlines()
        if self.maybe(0.04):
            files["sps.sub"] = ["DEF sps()", self.one("IG=IG+1", "XG1.Z=XG1.Z+1", "BASE_DATA[3].X=4"), "END"]
        end = self.one("\r\n", "\n")
        return {name: "".join(self.spelling(line) + end for line in lines) for name, lines in files.items()}

    def local(self, main):
        """Give the main routine variables of its own that hide those of the data file."""
        name, kind = self.one(("XP2", "E6POS"), ("J", "INT"), ("W", "REAL"))
        value = {"E6POS": "{X 3,Y 3,Z 3,A 1,B 2,C 3}", "INT": "2", "REAL": "0.5"}[kind]
        main[1:1] = [f"DECL {kind} {name}", f"{name}={value}"]

    def spelling(self, line):
        """The same line in another spelling."""
        choice = self.rng.random()
        if choice < 0.12:
            return line.lower()
        if choice < 0.2 and "DEF" not in line and "'" not in line:
            apart = re.sub(r"(?<![<>=])=(?!=)", " = ", line)
            return "  " + apart.replace("(", " ( ").replace(",", " , ")
        if choice < 0.24:
            return line + " ; C_DIS XP1=5"
        return line
