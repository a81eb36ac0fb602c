"""Random KRL whose routines save, change and restore what the controller keeps.

Frames saved, combined and restored; system variables on right-hand sides, in conditions, as arguments and as operands
of targets; routines called twice in different states; data that a call leaves for the next one; interrupts and
triggers that fire and change what no motion depends on.
"""

from __future__ import annotations

from tests.attack.krl_generator import Generator, Routine

SAVED = """DECL FRAME OLD={X 4,Y 3,Z 2,A 0,B 0,C 0}
DECL FRAME OLDT={X 1,Y 0,Z 210,A 0,B 0,C 0}
DECL REAL OLDV=0.375
DECL INT CALLS=1
DECL INT SEEN=0
DECL BOOL LEFT=FALSE
ENDDAT"""


class States(Generator):
    """Writes one program that reads what it sets, and the files that it calls."""

    def routine(self, name):
        routine = super().routine(name)
        if self.maybe(0.3) and routine.file == "part":
            routine.parameters.append(("FX", "FRAME", "IN"))
        return routine

    def names(self, kind):
        if kind == "FRAME" and self.in_part():
            return (*super().names(kind), "OLD", "OLD")
        if kind == "INT" and self.in_part():
            return (*super().names(kind), "CALLS")
        return super().names(kind)

    # --- values --------------------------------------------------------------------------------------------------

    def real(self, depth=0):
        if self.maybe(0.1):
            return self.one("$BASE.X", "$BASE.Y", "$BASE.Z", "$TOOL.Z", "$BASE.A", "$TOOL.X")
        return super().real(depth)

    def speed(self):
        return self.one("$VEL.CP", "OLDV" if self.in_part() else "$VEL.CP") if self.maybe(0.2) else super().speed()

    def frame(self):
        if not self.maybe(0.4):
            return super().frame()
        own = ["OLD", f"OLD:{self.aggregate()}", "INV_POS(OLD)"] if self.in_part() else []
        return self.one("$BASE", f"$BASE:{self.aggregate()}", "$TOOL", "INV_POS($BASE)", f"$BASE:{self.point()}", *own)

    def argument(self, kind):
        if kind != "FRAME":
            return super().argument(kind)
        return self.one("$BASE", "$BASE", "$TOOL", *(self.names("FRAME") or ("$NULLFRAME",)))

    def condition(self):
        if not self.maybe(0.35):
            return super().condition()
        return self.one(
            f"$BASE.X>{self.one('1000', '1150', '50')}",
            f"$TOOL.Z<{self.one('250', '300')}",
            "$ORI_TYPE==#VAR",
            "$IPO_MODE==#BASE",
            f"$FLAG[{self.one('1', '2')}]",
            f"($BASE.Y>60) AND NOT $FLAG[{self.one('1', '2')}]",
            *(["LEFT", "NOT LEFT", "CALLS>2"] if self.in_part() else []),
        )

    # --- statements ----------------------------------------------------------------------------------------------

    def assignment(self):
        if not self.maybe(0.3):
            return super().assignment()
        own = ["OLD=$BASE", "OLD=$BASE", "OLDT=$TOOL", "OLDV=$VEL.CP", "CALLS=CALLS+1", f"OLD={self.frame()}"]
        own += ["LEFT=TRUE", "LEFT=FALSE"]
        return self.one(
            *(own if self.in_part() else []),
            f"$FLAG[{self.one('1', '2')}]={self.one('TRUE', 'FALSE')}",
            f"{self.one(*self.names('REAL'))}=$BASE.{self.one('X', 'Y')}",
        )

    def setting(self):
        if not self.maybe(0.45):
            return super().setting()
        own = ["$BASE=OLD", "$BASE=OLD", "$TOOL=OLDT", "$VEL.CP=OLDV"] if self.in_part() else []
        axis = self.one("X", "Y", "Z")
        return self.one(
            *own,
            f"$BASE=$BASE:{self.aggregate()}",
            f"$TOOL=$TOOL:{{X 0,Y 0,Z {self.rng.uniform(1, 9):.2f},A 0,B 0,C 0}}",
            f"$BASE.{axis}=$BASE.{axis}+{self.rng.uniform(1, 20):.2f}",
            f"$BASE.A={self.rng.uniform(-40, 40):.2f}",
            "BAS(#BASE,3)",
            "$VEL.CP=$VEL.CP*0.5",
        )

    def calling(self):
        return super().calling() if self.callable("") or self.maybe(0.3) else "$OUT[4]=TRUE"

    def asynchronous(self):
        if self.maybe(0.3):
            return super().asynchronous()
        action = self.one("$OUT[2]=TRUE", "SEEN=SEEN+1" if self.in_part() else "$OUT[3]=FALSE", "$FLAG[7]=TRUE")
        number = int(self.rng.integers(4, 7))
        return self.one(
            [f"INTERRUPT DECL {number} WHEN $IN[1]==TRUE DO {action}", f"INTERRUPT ON {number}"],
            [f"TRIGGER WHEN DISTANCE={self.one('0', '1')} DELAY=0 DO {action}"],
        )

    def statement(self, depth=0):
        choice = self.rng.random()
        if choice < 0.08 and self.callable(""):
            routine = self.one(*self.callable(""))
            moves = [self.motion()] if depth == 0 and self.in_part() else []
            return [self.call(routine), self.setting(), *moves, self.call(routine)]
        if choice < 0.16 and self.in_part():
            inner = [self.setting(), *([self.motion()] if depth == 0 and self.moving else []), *super().statement(2)]
            return self.one(
                ["OLD=$BASE", f"$BASE={self.frame()}", *inner, "$BASE=OLD"],
                ["OLDT=$TOOL", "$TOOL=TOOL_DATA[2]", *inner, "$TOOL=OLDT"],
                [f"WHILE $BASE.Z<{self.one('640', '720')}", "$BASE.Z=$BASE.Z+40.5", *inner[1:], "ENDWHILE"],
                ["REPEAT", "$TOOL=$TOOL:{X 0,Y 0,Z 30.5,A 0,B 0,C 0}", *inner[1:], "UNTIL $TOOL.Z>260"],
                ["OLDV=$VEL.CP", f"$VEL.CP={self.speed()}", *inner, "$VEL.CP=OLDV"],
            )
        return super().statement(depth)

    def motion(self):
        if self.maybe(0.12):
            own = [f"OLD:{self.point()}", f"INV_POS($BASE):OLD:{self.point()}"] if self.in_part() else []
            tail = self.one("", " C_DIS")
            chain = self.one(f"$BASE:{self.point()}", f"INV_POS($BASE):{self.point()}", *own)
            if self.maybe(0.3):
                frame = self.one("$BASE=BASE_DATA[2]", "$BASE=F1", "$TOOL=TOOL_DATA[2]", "$VEL.CP=0.25")
                return f"SLIN {self.point()} WITH {frame}"
            return f"LIN {self.one(chain, self.read_point())}{tail}"
        return super().motion()

    def read_point(self):
        """A point with components of the frames in force."""
        y, angle = self.rng.uniform(-90, 90), self.one("$BASE.C", "30")
        return f"{{X $BASE.{self.one('X', 'Y')},Y {y:.2f},Z $TOOL.Z,A 10,B 20,C {angle}}}"

    def local_frame(self, lines):
        """Let a routine save the frame with which it is called, and restore it."""
        first = next(at for at in range(1, len(lines) + 1) if at == len(lines) or not lines[at].startswith("DECL "))
        last = next(
            at for at in range(len(lines), 0, -1) if lines[at - 1].split(" ")[0] not in ("END", "ENDFCT", "RETURN")
        )
        begin = ["BEFORE=$BASE", f"$BASE=BEFORE:{self.aggregate()}"]
        return [
            lines[0],
            "DECL FRAME BEFORE",
            *lines[1:first],
            *begin,
            *lines[first:last],
            "$BASE=BEFORE",
            *lines[last:],
        ]

    # --- files ---------------------------------------------------------------------------------------------------

    def written(self, routine: Routine):
        lines = super().written(routine)
        return self.local_frame(lines) if self.maybe(0.3) else lines

    def programs(self):
        files = super().programs()
        name = "part.dat"
        end = "\r\n" if "\r\n" in files[name] else "\n"
        at = files[name].upper().rindex("ENDDAT")
        files[name] = files[name][:at] + SAVED.replace("\n", end) + end
        return files
