"""Random KRL jobs that a robot can do: loops, calls, branches, arrays, frames, splines, forces by comments.

Unlike `krl_generator`, whose programs are to be understood, these are to be corrected: all poses can be reached.
"""

from __future__ import annotations

from tests.krl_texts import HOME

TURN = "A 180,B 0,C 180"
ARRAY = 5
JOB_DAT = "\n".join(
    [
        "DEFDAT part PUBLIC",
        "DECL STRUC PT INT N,FRAME FCNC",
        "DECL E6POS XS={X 0,Y 0,Z 50,A 180,B 0,C 180}",
        "DECL E6POS XP1={X 40.5,Y 20,Z 8,A 180,B 0,C 180,S 2,T 10,E1 0.0}",
        "DECL GLOBAL E6POS XP2={X 80,Y -10.25,Z 5,A 175,B 3,C 178}",
        "DECL FRAME FR={X 3,Y -2,Z 1,A 2,B 0,C 0}",
        "DECL INT I=1",
        "DECL INT K=0",
        "DECL REAL V=0.05",
        "DECL REAL Z=4.5",
        "DECL BOOL OK=TRUE",
        f"DECL E6POS P[{ARRAY}]",
        *(f"P[{n}]={{X {n * 20 - 10},Y {n * n * 3},Z {n},{TURN}}}" for n in range(1, ARRAY + 1)),
        f"DECL PT S[{ARRAY}]",
        *(f"S[{n}]={{N {n},FCNC {{X {n * 15},Y {-n * 5},Z 2,{TURN}}}}}" for n in range(1, ARRAY + 1)),
        "ENDDAT",
        "",
    ]
)


class Job:
    """One job.

    :param keep: it may hold motions that only the running robot knows.
    :param forces: it has comments with forces.
    :param selects: inputs choose jobs that begin and end in the home position.
    :param endless: it ends in a LOOP without EXIT.
    :param jumps: it may jump over statements, leave routines early, and call functions that move.
    :ivar files: name → text.
    """

    def __init__(self, rng, *, keep=False, unknown=True, forces=True, jumps=False, selects=False, endless=False):
        self.jumps, self.selects = jumps, selects
        self.rng, self.keep, self.unknown, self.forces = rng, keep, unknown, forces
        self.routines = ["CUT", "DEEP", "FACE"][: int(rng.integers(0, 4))]
        self.labels = 0
        self.loops = 0
        main = ["DEF part()", "DECL INT n", *(["BAS(#INITMOV,0)"] if self.maybe(0.7) else [])]
        if keep:
            main.append("GLOBAL INTERRUPT DECL 5 WHEN $IN[9] DO STOPPED()")
        main += ["$VEL.CP=0.05", "$APO.CDIS=0.5", *(["PTP $POS_ACT"] if self.maybe(0.2) else []), "PTP XS"]
        main += [self.force()] if forces else []
        main.append(self.line())
        for _ in range(int(rng.integers(2, 6))):
            main += self.statement(0, "main")
        main += self.endless_loop() if endless else [self.pick("PTP XS", "LIN XS", "LIN XP1")]
        main.append("END")
        subs = []
        elsewhere = []
        for number, name in enumerate(self.routines):
            away = name == "CUT" and self.maybe(0.4)
            below = self.routines[number + 1 :]
            body = [f"DEF {name}(n:IN)", "DECL INT n"]
            for _ in range(int(rng.integers(1, 4))):
                body += self.statement(1, "away" if away else "sub", [] if away else below)
            if jumps and unknown and not away and self.maybe(0.3):
                body += self.left_early(below)
            (elsewhere if away else subs).extend([*body, "END"])
        if keep:
            back = self.pick("$OUT[7]=TRUE", "PTP $AXIS_RET") if jumps else "$OUT[7]=TRUE"
            subs += ["DEF STOPPED()", back, "END"]
        if keep and jumps:
            called = f"{self.pick(*self.routines)}(2)" if self.routines else self.line()
            subs += ["DEFFCT INT MEASURE()", self.pick(called, self.line()), "RETURN(1)", "ENDFCT"]
        end = self.pick("\r\n", "\n")
        self.files = {"part.src": self.text([*main, *subs], end), "part.dat": JOB_DAT.replace("\n", end)}
        self.files["points.dat"] = (
            f"DEFDAT points PUBLIC{end}DECL GLOBAL E6POS XG={{X 25,Y 35,Z 6,{TURN}}}{end}ENDDAT{end}"
        )
        if elsewhere:
            self.files["cut.src"] = self.text(elsewhere, end)

    def text(self, lines, end):
        return "".join(line + end for line in lines)

    def pick(self, *options):
        return options[int(self.rng.integers(len(options)))]

    def maybe(self, share):
        return self.rng.random() < share

    # --- single lines ----------------------------------------------------------------------------------------------

    def force(self):
        if self.maybe(0.15):
            return "; FORCE OFF"
        x, y, z = self.rng.uniform(-300, 300, 3)
        frame = self.pick("", "", "", " FRAME=TOOL")
        moment = f" MX={self.rng.uniform(-9, 9):.1f}" if self.maybe(0.2) else ""
        return f"; FORCE FX={x:.1f} FY={y:.1f} FZ={z:.1f}{moment}{frame}"

    def xyz(self):
        x, y, z = self.rng.uniform((0, -60, -5), (110, 60, 20))
        return f"X {x:.3f},Y {y:.3f},Z {z:.3f}"

    def turn(self):
        if self.maybe(0.8):
            return TURN
        a, b, c = self.rng.uniform((160, -5, 178), (180, 5, 180))
        return f"A {a:.2f},B {b:.2f},C {c:.2f}"

    def line(self):
        return f"LIN {{{self.xyz()},{self.turn()}}}" + self.pick("", " C_DIS")

    def motion(self, where, inner=False):
        """A motion; `inner`: in a branch, where it must give all of its components."""
        tail = self.pick("", " C_DIS", " C_DIS")
        kind = int(self.rng.integers(11))
        own = where != "away"
        if kind < 3 or (inner and kind > 8):
            return self.line()
        if kind == 3 and not inner:
            return f"LIN {{{self.xyz()}}}{tail}"
        if kind == 4 and own:
            return f"LIN {self.pick('XP1', 'XP2', 'P[2]', 'S[3].FCNC', 'XG')}{tail}"
        if kind == 5 and own:
            return f"LIN FR:{self.pick('XP1', 'P[4]')}{tail}"
        if kind == 6 and where != "main":
            return f"LIN {{X n*10+5,Y {self.rng.uniform(-30, 30):.2f},Z 3,{TURN}}}{tail}"
        if kind == 7 and own:
            return f"LIN {{X K*4+2.5,Y Z,Z {self.rng.uniform(0, 9):.2f},{TURN}}}{tail}"
        if kind == 8 and not inner and where != "main":
            return f"LIN_REL {{X {self.rng.uniform(2, 9):.2f},Z {self.rng.uniform(-2, 2):.2f}}}{tail}"
        if kind == 9:
            return self.pick("PTP XS", "PTP XS", self.line()) if own else self.line()
        return self.line()

    def arc(self):
        """A line to a place, and an arc from there."""
        x, y, z = self.rng.uniform((10, -30, 0), (60, 30, 5))
        a, b = self.rng.uniform(10, 30, 2)
        angle = self.pick("", "", "", ",CA 90.5", ", CA 300", ",CA -45")
        return [
            f"LIN {{X {x:.3f},Y {y:.3f},Z {z:.3f},{TURN}}}",
            f"{self.pick('CIRC', 'SCIRC')} {{X {x + a:.3f},Y {y + b:.3f},Z {z:.3f}}},"
            f"{{X {x + 2 * a:.3f},Y {y:.3f},Z {z + 1:.3f},{TURN}}}{angle}{self.pick('', ' C_DIS')}",
            *([self.line()] if angle else []),
        ]

    # --- structures ------------------------------------------------------------------------------------------------

    def statement(self, depth, where, below=None, inner=False):
        choice = self.rng.random()
        if choice < 0.3:
            return [self.motion(where, inner)]
        if choice < 0.42 and not inner:
            return [self.force(), self.motion(where)] if self.forces else [self.motion(where)]
        if choice < 0.5:
            return self.arc()
        if choice < 0.58:
            return [
                self.pick("$OUT[1]=TRUE", "WAIT SEC 0.1", "$VEL.CP=0.04", "; a note", "CONTINUE", "WAIT FOR $OUT[1]")
            ]
        if choice < 0.61 and where == "main" and not inner:
            frame = self.pick(
                "$BASE=BASE_DATA[4]", "$BASE=BASE_DATA[3]:{X 2,A 1}", "BAS(#BASE,4)", "$TOOL=TOOL_DATA[2]"
            )
            return [frame, self.line()]
        if choice < 0.64:
            return ["TRIGGER WHEN DISTANCE=0 DELAY=0 DO $OUT[2]=TRUE", self.line()]
        if choice < 0.67 and not inner:
            return ["SPLINE", f"  SLIN {{{self.xyz()},{TURN}}}", f"  SLIN {{{self.xyz()},{TURN}}}", "ENDSPLINE"]
        if choice < 0.72 and where == "main" and not inner:
            return self.pick(["K=K+1"], ["Z=Z+0.5"], ["FR.X=FR.X+1"], ["XP1.Z=XP1.Z+0.5"])
        if choice < 0.82 and (below is None or below):
            names = self.routines if below is None else below
            if names:
                return [f"{self.pick(*names)}({int(self.rng.integers(1, 6))})"]
        if depth > 2 or where == "away":
            return [self.line()]
        return self.structure(depth, where, below, inner)

    def left_early(self, below):
        """The end of a routine that may return before it."""
        meet = self.line().removesuffix(" C_DIS")
        left = [f"IF $IN[{int(self.rng.integers(1, 9))}] THEN", "RETURN", "ENDIF"]
        return [meet, *left, *self.body(1, "sub", below, inner=True), meet]

    def skipping(self, depth, where, below):
        """A jump over statements, on an input: to a label behind which all goes on from one place."""
        self.labels += 1
        label = f"fault{self.labels}"
        jump = [
            f"IF $IN[{int(self.rng.integers(1, 9))}] THEN",
            *self.pick([], ["$OUT[3]=TRUE"]),
            f"GOTO {label}",
            "ENDIF",
        ]
        if self.maybe(0.6):
            rest = self.body(depth, where, below)
            again = self.pick([], [jump[0], f"GOTO {label}", "ENDIF", self.line()])
            return [*jump, self.line(), *rest, self.line(), *again, f"{label}:", HOME, self.line()]
        meet = self.line().removesuffix(" C_DIS")
        return [meet, *jump, *self.body(depth, where, below, inner=True), meet, f"{label}:", self.line()]

    def endless_loop(self):
        """A LOOP without EXIT: its round ends where, and under the force with which, the motion before it does."""
        meet = self.pick(HOME, "LIN XS", "LIN XP1")
        force = [self.force()] if self.forces and self.maybe(0.8) else []
        wait = self.pick("WAIT SEC 1", "WAIT FOR $OUT[1]", "HALT")
        head = self.pick([], [wait], [wait], ["$OUT[4]=FALSE", wait])
        if self.unknown and head and self.maybe(0.3):
            head = [f"IF $IN[{int(self.rng.integers(1, 9))}] THEN", *self.pick([], [self.line(), meet]), wait, "ENDIF"]
        begin = [self.force()] if force else []
        body = self.body(1, "main", None, inner=True)
        return [*force, meet, "LOOP", *head, *begin, *body, *force, meet, *self.pick([], [], [wait]), "ENDLOOP"]

    def selected(self, depth, where, below):
        """Jobs chosen by inputs, or a detour; each begins and ends in the home position."""
        heads = [f"IF $IN[{int(self.rng.integers(1, 9))}] THEN" for _ in range(2)]
        one, other = ([HOME, *self.body(depth, where, below, inner=True), HOME] for _ in range(2))
        first = self.pick([], [HOME], ["PTP XS"])
        ends = self.pick([HOME, self.line()], ["PTP XS"], [self.line()]) if first == [HOME] else [HOME, self.line()]
        return self.pick(
            [*first, heads[0], *one, "ELSE", *other, "ENDIF", HOME, self.line()],
            [*first, heads[0], *one, "ENDIF", heads[1], *other, "ENDIF", HOME, self.line()],
            [*first, heads[0], *one, "ENDIF", *ends],
            [HOME, heads[0], *one, "ELSE", heads[1], *other, "ENDIF", "ENDIF", self.line()],
            [heads[0], HOME, "ENDIF", HOME, self.line()],
        )

    def body(self, depth, where, below, inner=False):
        lines = []
        for _ in range(int(self.rng.integers(1, 4))):
            lines += self.statement(depth + 1, where, below, inner)
        return lines

    def structure(self, depth, where, below, inner):
        counter = None if where != "main" else "I" if depth % 2 == 0 else "n"
        choice = int(self.rng.integers(10))
        if choice < 3 and counter and not self.loops:
            self.loops += 1
            bounds = self.pick("1 TO 3", "1 TO 5", "5 TO 1 STEP -2", "2 TO 4 STEP 2")
            point = self.pick(
                f"LIN P[{counter}] C_DIS", f"LIN S[{counter}].FCNC", f"LIN {{X {counter}*10,Y 5,Z 3,{TURN}}}"
            )
            body = self.body(depth, where, below, inner) if self.maybe(0.6) else []
            self.loops -= 1
            return [f"FOR {counter}={bounds}", point, *body, "ENDFOR"]
        if choice == 3 and where == "main" and not self.loops and not inner:
            self.loops += 1
            body = self.body(depth, where, below)
            self.loops -= 1
            body = [line for line in body if not line.startswith("K=")]
            return self.pick(
                ["K=0", "WHILE K<3", "K=K+1", *body, "ENDWHILE"],
                ["K=1", "REPEAT", *body, "K=K+2", "UNTIL K>4"],
                ["K=0", "LOOP", "K=K+1", "IF K==3 THEN", "EXIT", "ENDIF", *body, "ENDLOOP"],
            )
        if choice == 4:
            return [self.pick("IF OK THEN", "IF NOT OK THEN", "IF I<9 THEN"), *self.body(depth, where, below, inner),
                    "ELSE", *self.body(depth, where, below, inner), "ENDIF"]  # fmt: skip
        if choice == 5 and where == "main":
            return ["SWITCH K+1", "CASE 1,2", *self.body(depth, where, below, inner),
                    "DEFAULT", self.line(), "ENDSWITCH"]  # fmt: skip
        if (
            choice == 6
            and self.jumps
            and self.unknown
            and where == "main"
            and not inner
            and not self.loops
            and depth == 0
        ):
            return self.skipping(depth + 1, where, below)
        if choice < 9 and self.unknown and self.selects and not self.loops and self.maybe(0.4):
            return self.selected(depth, where, below)
        if choice < 9 and self.unknown:
            meet = self.line()
            number = int(self.rng.integers(1, 9))
            one = [*self.body(depth, where, below, inner=True), meet]
            if self.maybe(0.3):
                return [meet.removesuffix(" C_DIS"), f"IF $IN[{number}] THEN", *one, "ENDIF"]
            other = [*self.body(depth, where, below, inner=True), meet]
            if self.forces and self.maybe(0.3):
                meeting = [self.force(), meet.removesuffix(" C_DIS")]
                one, other = ([self.force(), *branch, *meeting] for branch in (one, other))
                return [f"IF $IN[{number}] THEN", *one, "ELSE", *other, "ENDIF", self.pick("; a note", self.force())]
            head = self.pick(f"IF $IN[{number}] THEN", f"IF NOT $IN[{number}] THEN", f"IF $IN[{number}]==TRUE THEN")
            return [head, *one, "ELSE", *other, "ENDIF"]
        if self.keep and where == "main" and not inner:
            self.labels += 1
            label = f"again{self.labels}"
            measured = [f"{'n' if depth % 2 else 'K'}=MEASURE()", self.line()] if self.jumps else []
            return self.pick(
                *([measured, measured] if measured else []),
                ["WHILE $IN[3]", self.line(), "ENDWHILE", self.line()],
                ["LIN $POS_ACT:{Z 5}", self.line()],
                ["LIN_REL {Z 3}", "LIN $POS_ACT", self.line()],
                [f"{label}:", self.line(), "IF $IN[4] THEN", f"GOTO {label}", "ENDIF", self.line()],
                ["IF $IN[5] THEN", self.line(), "ENDIF", self.line()],
            )
        return [self.line()]
