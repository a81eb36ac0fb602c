"""Random KRL of few statements: a value is given in some way, made uncertain in at most one, and used by a motion.

Programs of `krl_generator` hold so much that most are refused, whatever a fault does. Here all that is not the one
uncertainty is known, so that a program is accepted unless that is noticed: faults by which the reader passes over
something that may happen are seen, and so are those that need a certain statement to be accepted.
"""

from __future__ import annotations

from tests.attack.krl_generator import Generator

KINDS = ("INT", "REAL", "BOOL", "E6POS", "FRAME", "INT", "REAL", "E6POS")
FIXED = """DEFDAT part PUBLIC
DECL E6POS XA={X 100.5,Y 20,Z 30,A 10,B 20,C 170,S 2,T 10,E1 0.0,E2 0.0}
DECL E6POS XB={X -50.25,Y 21,Z 35.125,A 15,B 20,C 170}
DECL GLOBAL E6POS XG={X 9,Y 23,Z 32,A 10,B 20,C 160}
DECL E6POS P[4]
P[1]={X 1,Y 2,Z 3,A 4,B 5,C 6}
P[2]={X 11,Y 2,Z 3,A 4,B 5,C 6}
P[3]={X 21,Y 2,Z 3,A 4,B 5,C 6}
P[4]={X 31,Y 2,Z 3,A 4,B 5,C 6}
DECL E6POS Q[2,2]
Q[1,1]={X 1,Y 12,Z 3,A 4,B 5,C 6}
Q[1,2]={X 2,Y 12,Z 3,A 4,B 5,C 6}
Q[2,1]={X 3,Y 12,Z 3,A 4,B 5,C 6}
Q[2,2]={X 4,Y 12,Z 3,A 4,B 5,C 6}
DECL INT N[4]
N[1]=2
N[2]=3
N[3]=1
N[4]=4
DECL REAL R[3]
R[1]=0.5
R[2]=1.25
R[3]=7.5
STRUC PT INT N,REAL R,BOOL B
STRUC INNER FRAME F,INT N
STRUC WHOLE INT X,INNER I
DECL WHOLE SN={X 2,I {F {X 1,Y 2,Z 3,A 4,B 5,C 6},N 3}}
DECL PT SX={N 1,R 2.5,B TRUE}
DECL PT SA[3]
SA[1]={N 1,R 1.5,B TRUE}
SA[2]={N 2,R 2.5,B FALSE}
SA[3]={N 3,R 3.5,B TRUE}
DECL FDAT FA={TOOL_NO 2,BASE_NO 3,IPO_FRAME #BASE,POINT2[] " "}
DECL FDAT FB={TOOL_NO 1,BASE_NO 2,IPO_FRAME #BASE}
DECL LDAT LA={VEL 0.7,ACC 100.0,APO_DIST 7.5,APO_FAC 50.0,ORI_TYP #VAR}
DECL LDAT LB={VEL 3.0,ACC 100.0,APO_DIST 0.5}
DECL E6AXIS XHOME={A1 0,A2 -80,A3 95,A4 0,A5 45,A6 0}
DECL CONST INT NC=2
DECL INT I=1
DECL INT J=2
"""
GIVEN = {"GIVENN": 2, "GIVENR": 0.375, "GIVENB": True, "GIVENX": 2.6, "$IN[5]": True, "$IN[6]": False}
"""What `[krl.values]` of the cell gives."""


IMPOSSIBLE = (
    "CIRC XA",
    "CIRC XA,XB,CA 0",
    "CIRC XA,XB,CA GONE()",
    "BAS(#PARK,1)",
    "BAS()",
    "LIN XA C_FAST",
    "SLIN XA WITH $SPEED=1",
    "SLIN XA WITH $BASE",
    "SLIN {X $BASE.X,Y 1,Z 2,A 3,B 4,C 5} WITH $BASE=BASE_DATA[2]",
    "SLIN XA WITH $BASE=$BASE:XB",
    "ENDWHILE",
    "ENDSPLINE",
    "SPL XA",
    "CONST_VEL START=1",
    "GOTO NOWHERE",
    "ASYPTP {E1 5}",
    "LIN XHOME",
    "CIRC XHOME,XA",
    "LIN_REL {A1 5}",
    "LIN {X 1,Y 2,Z 3,A1 4}",
    "LIN {X 1,W 2}",
    "LIN {X 99999,Y 1,Z 2,A 3,B 4,C 5}",
    "LIN NOWHERE",
    "$VEL.CP=0.0",
    "$VEL.CP=9",
    "$VEL.CP=-0.5",
    "$VEL={CP 0}",
    "BAS(#VEL_CP,0)",
    "$ORI_TYPE=#FAST",
    "$ORI_TYPE=GONE()",
    "$CIRC_TYPE=#FAST",
    "$IPO_MODE=#TCP",
    "$IPO_MODE=GONE()",
    "$ROBROOT={X 0,Y 0,Z 0,A 0,B 0,C 0}",
    "$WORLD=$NULLFRAME",
    "$BASE={X 99999,Y 1,Z 2,A 3,B 4,C 5}",
    "$BASE=XHOME",
    "$BASE=EK(MACHINE_DEF[2].ROOT,MACHINE_DEF[2].MECH_TYPE,{X 0})",
    "$BASE.W=3",
    "$BASE=SBASE(GONE())",
    "$TOOL=STOOL2(I+GONE())",
    "$TOOL={X 99999,Y 1,Z 2,A 3,B 4,C 5}",
    "$TECH[1].MODE=#CYCLE",
    "ANIN ON $VEL.CP=0.1*$ANIN[1]+0",
    "PARK",
    "I==2",
    "LIN",
)
"""Statements at which the controller stops, or by which the robot moves otherwise than programs that are corrected."""
LONGEST_NAME = 24
"""Characters of a name at most (KUKA, Expert Programming: names)."""


class Snippets(Generator):
    """Writes one program of this kind, and the files that it calls."""

    def __init__(self, rng, *, keep=False):
        self.rng, self.keep = rng, keep
        self.data, self.routines, self.others, self.count = [], [], {}, 0
        self.shared = []
        self.uncertain = 1 if self.maybe(0.55) else 0

    def new(self, stem):
        self.count += 1
        name = f"{stem}{self.count}"
        if self.maybe(0.003):
            return name.ljust(LONGEST_NAME + 1, "X")
        return name.ljust(LONGEST_NAME, "X") if self.maybe(0.04) else name

    def variable(self, kind, value=None):
        """Declare a variable with a value in the data list."""
        name = self.new({"INT": "IV", "REAL": "RV", "BOOL": "BV", "E6POS": "XV", "FRAME": "FV"}[kind])
        public = "GLOBAL " if self.maybe(0.3) else ""
        self.data.append(f"DECL {public}{kind} {name}={self.literal(kind) if value is None else value}")
        return name

    # --- values --------------------------------------------------------------------------------------------------

    def literal(self, kind):
        if kind == "INT":
            return str(int(self.rng.integers(1, 4)))
        if kind == "REAL":
            return f"{self.rng.uniform(0.05, 3):.3f}"
        if kind == "BOOL":
            return self.one("TRUE", "FALSE")
        numbers = self.rng.uniform(-80, 80, 6)
        last = self.one("", "", ",S 2,T 10", ",E1 0.0") if kind == "E6POS" else ""
        return "{" + ",".join(f"{n} {v:.3f}" for n, v in zip("XYZABC", numbers, strict=True)) + last + "}"

    def value(self, kind, depth=0):
        """An expression of a type whose value is known."""
        if kind in ("INT", "REAL", "BOOL") and self.maybe(0.05):
            return self.function(kind)
        return getattr(self, f"value_{kind.lower()}")(depth)

    def function(self, kind):
        """A call of a function that only gives a value: one of the program, or of another file."""
        name, given = self.new("FN"), self.one("INT", "REAL")
        early = [f"IF A>{self.literal(given)} THEN", f"RETURN ({self.value_in(kind, given)})", "ENDIF"]
        body = [*self.one([], early), f"RETURN ({self.value_in(kind, given)})"]
        lines = [f"DEFFCT {kind} {name}(A:IN)", f"DECL {given} A", *body, "ENDFCT"]
        if self.maybe(0.7):
            self.routines.append(lines)
        else:
            self.others[f"{name.lower()}.src"] = lines
        return f"{name}({self.value(given) if self.maybe(0.5) else self.literal(given)})"

    def value_int(self, depth):
        known = [
            "1",
            "2",
            "3",
            "I",
            "J",
            "NC",
            "N[2]",
            "N[J]",
            "SX.N",
            "SA[J].N",
            "GIVENN",
            "SA[N[3]].N",
            "SN.X",
            "SN.I.N",
        ]
        if depth > 1 or self.maybe(0.4):
            return self.one(*known)
        a, b = self.value_int(depth + 1), self.value_int(depth + 1)
        return self.one(
            f"({a}+{b})-{b}",
            f"{a}*{b}/{b}",
            f"(7+{a})/2-3",
            f"ABS({a}-{b})+1",
            f"({a} B_AND 1)+1",
            f"({a} B_OR 2)",
            f"({a} B_EXOR 1)+1",
            f"B_NOT {a}+5",
            f"-(-{a})",
            f"{a}-1+1",
            f"{a}*2-{a}",
        )

    def value_real(self, depth):
        known = [
            "0.5",
            "1.25",
            "R[1]",
            "R[J]",
            "SX.R",
            "SA[2].R",
            "GIVENR",
            "SA[J].R",
            "XA.X/100",
            "P[J].Y",
            "SN.I.F.Y",
        ]
        if depth > 1 or self.maybe(0.4):
            return self.one(*known)
        a, b = self.value_real(depth + 1), self.one(self.value_real(depth + 1), self.value_int(depth + 1))
        return self.one(
            f"({a}+{b})/2",
            f"{a}*{b}+0.1",
            f"ABS({a}-{b})+0.2",
            f"SQRT({a})",
            f"SIN({a})+0.5",
            f"COS({a})",
            f"TAN({a})+0.3",
            f"ACOS(0.5)/100+{a}",
            f"ATAN2({a},{b})/90+0.1",
            f"{a}-(-{b})",
            f"1.0*{b}/4",
        )

    def value_bool(self, depth):
        if depth > 1 or self.maybe(0.3):
            return self.one("TRUE", "FALSE", "GIVENB", "SX.B", "SA[2].B", "$IN[5]", "$IN[6]")
        a, b = self.value_int(depth + 1), self.value_int(depth + 1)
        r, s = self.value_real(depth + 1), self.one(self.value_real(depth + 1), a)
        sign = self.one("==", "<>", "<", ">", "<=", ">=")
        p, q = self.value_bool(depth + 1), self.value_bool(depth + 1)
        logic = self.one("AND", "OR", "EXOR")
        return self.one(
            f"({a}{sign}{b})",
            f"({a}{sign}{b})",
            f"({r}{sign}{s})",
            f"({p} {logic} {q})",
            f"(({a}{sign}{b}) {logic} NOT {p})",
            f"(NOT {p})",
            f"(({a} B_AND 1)==1)",
            f"({a} B_AND {self.one('1', '3')}{sign}{b} {logic} NOT {p})",
            f"(NOT {p} {logic} {b}{sign}{a} B_AND 3)",
            f"({a} B_AND 1{sign}{b} {logic} NOT {p} {logic} {r}{sign}{s})",
            f"({p}=={q})",
            f"({self.one('SX.B', 'GIVENB')}{self.one('==', '<>')}NOT {q})",
            f"({p} EXOR {q})",
            f"({p} {logic} {q} {self.one('AND', 'OR', 'EXOR')} {self.value_bool(2)})",
            "($ORI_TYPE==#VAR)",
        )

    def value_e6pos(self, depth):
        index = self.value_int(2)
        return self.one(
            "XA",
            "XB",
            "XG",
            f"P[{index}]",
            "P[J]",
            "Q[I,J]",
            f"Q[{self.one('1', '2')},J]",
            "P[I+1]",
            self.literal("E6POS"),
            self.computed(),
        )

    def computed(self):
        """An aggregate with components that are computed."""
        names = iter("YZABC")
        rest = ",".join(f"{name} {self.rng.uniform(-80, 80):.2f}" for name in names)
        return f"{{X {self.value_real(1)},{rest}}}"

    def value_frame(self, depth):
        if depth > 1 or self.maybe(0.3):
            return self.one(self.literal("FRAME"), "BASE_DATA[2]", "BASE_DATA[J]", "$NULLFRAME", "$BASE", "$TOOL")
        a, b = self.value_frame(2), self.value_frame(2)
        operand = a if a[0] != "{" else self.variable("FRAME", a)
        return self.one(f"{operand}:{b}", f"INV_POS({operand})", f"{operand}:{self.variable('FRAME')}")

    # --- giving --------------------------------------------------------------------------------------------------

    def give(self, kind, name, depth=0):
        """Statements that give a variable a value that is known."""
        value = self.value(kind)
        plain = [f"{name}={value}"]
        choice = int(self.rng.integers(24))
        if depth > 1 or choice < 6:
            return plain
        ways = [self.by_component, self.by_function, self.by_reference, self.by_routine, self.by_other_file]
        ways += [self.by_value, self.hidden, self.by_branch, self.by_switch, self.by_loop, self.by_copy]
        ways += [self.by_shared, self.by_array, self.by_label, self.by_leaving, self.by_array]
        ways += [self.by_rounding, self.by_jump, self.by_return, self.by_counting, self.by_nested_call, self.by_element]
        return ways[int(self.rng.integers(len(ways)))](kind, name, depth + 1)

    def by_copy(self, kind, name, depth):
        other = self.variable(kind)
        return [f"{other}={self.value(kind)}", f"{name}={other}", f"{other}={self.literal(kind)}"]

    def by_component(self, kind, name, depth):
        if self.maybe(0.25) and kind in ("INT", "FRAME", "REAL"):
            member = {"INT": self.one("SN.X", "SN.I.N"), "FRAME": "SN.I.F", "REAL": "SN.I.F.Z"}[kind]
            value = self.literal("FRAME") if kind == "FRAME" else self.one(self.value(kind), self.value("REAL"))
            return [f"{member}={value}", f"{name}={member}"]
        if kind in ("E6POS", "FRAME"):
            component = self.one("X", "Y", "Z", "X", "Y", "A")
            return [f"{name}={self.value(kind)}" if self.maybe(0.5) else "", f"{name}.{component}={self.value('REAL')}"]
        member = {"INT": "N", "REAL": "R", "BOOL": "B"}[kind]
        record = self.one("SX", "SA[1]", "SA[J]")
        extra = self.one([], [f"SA[J]={self.one('SX', 'SA[1]')}"], ["SX=SA[3]"])
        return [f"{record}.{member}={self.value(kind)}", *extra, f"{name}={record}.{member}"]

    def by_element(self, kind, name, depth):
        array = {"INT": "N", "REAL": "R", "E6POS": self.one("P", "P", "Q")}.get(kind)
        if array is None:
            return self.by_copy(kind, name, depth)
        index = f"{self.one('1', '2')},{self.one('I', '2', 'J')}" if array == "Q" else self.one("1", "J", "I+1", "3")
        other = self.one(index, "1,1" if array == "Q" else "2")
        return [f"{array}[{index}]={self.value(kind)}", f"{name}={array}[{other}]"]

    def by_function(self, kind, name, depth):
        function, given = self.new("FN"), self.one("INT", "REAL")
        early = [f"IF A>{self.literal(given)} THEN", f"RETURN ({self.value_in(kind, given)})", "ENDIF"]
        body = [*(early if self.maybe(0.4) else []), f"RETURN ({self.value_in(kind, given)})"]
        if kind in ("E6POS", "FRAME"):
            local = self.one([f"DECL {kind} L", f"L={self.value(kind)}", "L.X=A", "RETURN L"], ["RETURN XA"])
            body = local if kind == "E6POS" or len(local) > 1 else ["RETURN $BASE"]
        result = kind if kind != "REAL" or self.maybe(0.8) else "INT"
        declared = [line for line in body if line.startswith("DECL")]
        way = self.one(":IN", ":IN", "", ":OUT")
        if kind in ("INT", "REAL") and self.maybe(0.3):
            declared, body = [f"DECL {kind} L"], [f"L={body[-1][8:-1]}", *body[:-1], "RETURN (L)"]
        lines = [f"DEFFCT {result} {function}(A{way})", f"DECL {given} A", *declared]
        self.routines.append([*lines, *(line for line in body if line not in declared), "ENDFCT"])
        argument = self.value(given)
        call = f"{function}({argument})"
        if kind in ("INT", "REAL") and self.maybe(0.3):
            return [f"{name}={call}*2-{call}"]
        return [f"{name}={call}"]

    def value_in(self, kind, given):
        """An expression with the parameter A of a function."""
        if kind == "BOOL":
            return self.one("A>1", "(A>1) AND (A<3)", "TRUE")
        if kind == "REAL":
            return self.one("A+0.25", "A/4.0", "A")
        return self.one("A+1-1", "A*1", "2") if given == "INT" else self.one("1", "3")

    def by_reference(self, kind, name, depth):
        routine, way = self.new("SUB"), self.one("OUT", "")
        parameter = "A" + (f":{way}" if way else "")
        body = [f"A={self.value(kind)}"]
        if kind == "INT" and self.maybe(0.4):
            body = ["A=A+1", "IF A>3 THEN", "A=1", "ENDIF"]
        if kind in ("E6POS", "FRAME") and self.maybe(0.5):
            body = [f"A.{self.one('X', 'Z')}={self.value('REAL')}"]
        if self.maybe(0.3):
            body = [f"A={self.value(kind)}", "RETURN", f"A={self.value(kind)}"]
        declared = [f"DECL {kind} A"] if self.maybe(0.8) else []
        self.routines.append([f"DEF {routine}({parameter})", *declared, *body, "END"])
        if kind == "E6POS" and self.maybe(0.4):
            element = self.one("P[I]", "P[J]", "Q[2,J]", "P[N[3]]")
            return [f"{routine}({element})", f"{name}={element}"]
        if kind == "INT" and self.maybe(0.2):
            return [f"{routine}(N[J])", f"{name}=N[J]"]
        if kind == "BOOL" and self.maybe(0.3):
            return [f"{routine}($FLAG[5])", f"{name}=$FLAG[5]"]
        if kind == "REAL" and self.maybe(0.2):
            return [f"{routine}(XB.Y)", f"{name}=XB.Y/10"]
        return [f"{routine}({name})"]

    def by_routine(self, kind, name, depth):
        routine = self.new("SUB")
        self.routines.append([f"DEF {routine}()", *self.give(kind, name, depth), "END"])
        return [f"{routine}()"]

    def by_nested_call(self, kind, name, depth):
        inner, outer = self.new("SUB"), self.new("SUB")
        self.routines.append(
            [
                f"DEF {inner}(B:OUT,K:IN)",
                f"DECL {kind} B",
                "DECL INT K",
                "IF K>0 THEN",
                f"B={self.value(kind)}",
                "ELSE",
                f"B={self.value(kind)}",
                "ENDIF",
                "END",
            ]
        )
        self.routines.append(
            [f"DEF {outer}(A:OUT)", f"DECL {kind} A", f"{inner}(A,{self.one('I', '0', 'J-2')})", "END"]
        )
        return [f"{outer}({name})"]

    def by_other_file(self, kind, name, depth):
        file, value = self.new("LIB"), self.literal(kind)
        count = self.one([], ["KEPT=KEPT+1"])
        body = ["IF KEPT>1 THEN", "A=OWN", "ELSE", f"A={self.literal(kind)}", "ENDIF"]
        lines = [f"DEF {file}(A:OUT)", f"DECL {kind} A", *count, *(body if self.maybe(0.6) else ["A=OWN"]), "END"]
        kept = self.one("1", "2")
        data = [f"DEFDAT {file}", f"DECL {kind} OWN={value}", f"DECL INT KEPT={kept}", "DECL INT I=3", "ENDDAT"]
        if self.maybe(0.3):
            data.insert(1, f"DECL {kind} {name}={self.literal(kind)}")  # hides that of the program, if not GLOBAL
            lines.insert(2, f"{name}=A" if self.maybe(0.3) else f"{name}={self.literal(kind)}")
        self.others[f"{file.lower()}.src"], self.others[f"{file.lower()}.dat"] = lines, data
        return [f"{file}({name})"] * self.one(1, 1, 2)

    def by_value(self, kind, name, depth):
        """A routine that changes a copy."""
        routine = self.new("SUB")
        self.routines.append([f"DEF {routine}(A:IN)", f"DECL {kind} A", f"A={self.value(kind)}", "END"])
        return [f"{name}={self.value(kind)}", f"{routine}({name})"]

    def hidden(self, kind, name, depth):
        """A routine with a variable of the same name."""
        routine = self.new("SUB")
        inner = self.new("SUB")
        self.routines.append([f"DEF {inner}()", f"{name}={self.value(kind)}", "END"])
        calls = [f"{inner}()"] if self.maybe(0.5) else []
        self.routines.append([f"DEF {routine}()", f"DECL {kind} {name}", f"{name}={self.value(kind)}", *calls, "END"])
        return [f"{name}={self.value(kind)}", f"{routine}()"]

    def by_branch(self, kind, name, depth):
        tail = ["ELSE", *self.give(kind, name, depth)] if self.maybe(0.6) else []
        before = self.give(kind, name, depth) if self.maybe(0.5) else []
        return [*before, f"IF {self.value('BOOL')} THEN", *self.give(kind, name, depth), *tail, "ENDIF"]

    def by_switch(self, kind, name, depth):
        cases = self.one(["1"], ["1,2"], ["2", "3"], ["I", "NC"], ["1", "2", "3"])
        lines = [f"SWITCH {self.value('INT')}"]
        for case in cases:
            lines += [f"CASE {case}", *self.give(kind, name, depth)]
        default = ["DEFAULT", *self.give(kind, name, depth)] if self.maybe(0.6) else []
        return [f"{name}={self.value(kind)}", *lines, *default, "ENDSWITCH"]

    def by_loop(self, kind, name, depth):
        counter = self.variable("INT", "0")
        value = {"INT": counter, "REAL": f"{counter}*0.25"}.get(kind, self.value(kind))
        leave = [f"IF {counter}{self.one('>', '>=', '==')}2 THEN", "EXIT", "ENDIF"]
        bounds = self.one("1 TO 3", "3 TO 1 STEP -1", "1 TO J", "I TO 3 STEP 2", "2 TO 1", "1 TO N[1]", "2 TO 3 STEP I")
        step, give = f"{counter}={counter}+1", f"{name}={value}"
        behind = [f"{name}={counter}-1"] if kind == "INT" and self.maybe(0.5) else []
        return self.one(
            [give, f"FOR {counter}={bounds}", give, *(leave if self.maybe(0.4) else []), "ENDFOR", *behind],
            [f"FOR {counter}={bounds}", f"{name}={self.value(kind)}", "ENDFOR", give],
            [f"WHILE {counter}<{self.one('2', 'J', '3')}", step, give, *(leave if self.maybe(0.4) else []), "ENDWHILE"],
            ["REPEAT", step, give, f"UNTIL {counter}>{self.one('1', 'I', '2')}"],
            ["LOOP", step, *leave, give, "ENDLOOP", *behind],
            [f"FOR {counter}=1 TO 2", "LOOP", give, "EXIT", "ENDLOOP", "ENDFOR"],
        )

    def by_shared(self, kind, name, depth):
        """A GLOBAL variable of a data list that belongs to no program."""
        self.shared.insert(0, f"DECL GLOBAL {kind} {name}S={self.literal(kind)}")
        change = self.one([], [f"{name}S={self.value(kind)}"])
        if self.maybe(0.3):  # read for the first time where it is not known whether that runs
            change = [f"IF $IN[{self.one('1', '2')}] THEN", f"{self.variable(kind)}={name}S", "ENDIF", *change]
        return [*change, f"{name}={name}S"]

    def by_array(self, kind, name, depth):
        """A routine that gets a whole array."""
        array = {"INT": "N", "REAL": "R", "E6POS": "P"}.get(kind)
        if array is None:
            return self.by_copy(kind, name, depth)
        routine, inner = self.new("SUB"), self.new("SUB")
        body = self.one(
            [f"A[2]={self.value(kind)}"],
            ["A[1]=A[3]", f"A[I+1]={self.value(kind)}", f"{name}=A[1]"],
            ["FOR J=1 TO 2", f"A[J]={self.literal(kind)}", "ENDFOR", "J=2"],
            [f"{inner}(A[])", "A[1]=A[2]"],
            ["LIN A[2]", "A[2]=A[1]", "LIN A[2]"] if kind == "E6POS" else ["A[2]=A[1]"],
        )
        self.routines.append([f"DEF {inner}(B[])", f"DECL {kind} B[]", f"B[2]={self.literal(kind)}", "END"])
        self.routines.append([f"DEF {routine}(A[]{self.one(':OUT', '')})", f"DECL {kind} A[]", *body, "END"])
        return [f"{routine}({array}[])", f"{name}={array}[{self.one('1', '2', 'J')}]"]

    def by_label(self, kind, name, depth):
        """A label to which a GOTO leads back."""
        counter, label = self.variable("INT", "0"), self.new("L")
        value = {"INT": counter, "REAL": f"{counter}*0.25"}.get(kind, self.value(kind))
        moves = self.one([], [], [f"LIN {self.literal('E6POS')}"])
        back = [f"IF {counter}<{self.one('1', '2', '3')} THEN", f"GOTO {label}", "ENDIF"]
        rounds = [f"{label}:", f"{counter}={counter}+1", *moves, f"{name}={value}", *back]
        if self.maybe(0.7):
            return rounds
        outer = self.variable("INT")
        return [f"FOR {outer}=1 TO 2", f"{counter}=0", *rounds, "ENDFOR"]

    def by_leaving(self, kind, name, depth):
        """A loop that a GOTO leaves."""
        counter, label = self.variable("INT", "0"), self.new("L")
        value = {"INT": counter, "REAL": f"{counter}*0.25"}.get(kind, self.value(kind))
        leave = [f"IF {counter}{self.one('==', '>=')}{self.one('1', '2', '3')} THEN", f"GOTO {label}", "ENDIF"]
        moves = self.one([], [], [f"LIN {self.literal('E6POS')}"])
        head, end = self.one((f"FOR {counter}=1 TO 3", "ENDFOR"), (f"FOR {counter}=1 TO 2", "ENDFOR"))
        behind = self.one([], [f"{name}={self.value(kind)}"])
        return [head, *moves, *leave, f"{name}={value}", end, *behind, f"{label}:"]

    def by_rounding(self, kind, name, depth):
        if kind == "INT":
            return [f"{name}={self.one('1.4', '2.6', '1.0', 'R[1]*2.4', '2.9999', 'SX.R-0.1', '0.6+1.1')}"]
        if kind == "REAL":
            return [f"{name}={self.value('INT')}", f"{name}={name}/2"]
        return self.by_copy(kind, name, depth)

    def by_jump(self, kind, name, depth):
        label = self.new("L")
        skip = self.one([f"GOTO {label}"], [f"IF {self.value('BOOL')} THEN", f"GOTO {label}", "ENDIF"])
        return [f"{name}={self.value(kind)}", *skip, f"{name}={self.value(kind)}", f"{label}:"]

    def by_return(self, kind, name, depth):
        routine = self.new("SUB")
        stop = self.one(
            [f"IF {self.value('BOOL')} THEN", "RETURN", "ENDIF"],
            ["FOR J=1 TO 3", "IF J==2 THEN", "RETURN", "ENDIF", "ENDFOR"],
            ["LOOP", "RETURN", "ENDLOOP"],
        )
        self.routines.append(
            [f"DEF {routine}()", f"{name}={self.value(kind)}", *stop, f"{name}={self.value(kind)}", "END"]
        )
        return [f"{routine}()"]

    def by_counting(self, kind, name, depth):
        """A routine that does something else at each call."""
        count, routine = self.variable("INT", "0"), self.new("SUB")
        body = [
            f"{count}={count}+1",
            f"IF {count}>{self.one('1', '2')} THEN",
            f"{name}={self.value(kind)}",
            "ELSE",
            f"{name}={self.value(kind)}",
            "ENDIF",
        ]
        self.routines.append([f"DEF {routine}()", *body, "END"])
        return [f"{routine}()"] * self.one(1, 2, 3)

    # --- making uncertain ----------------------------------------------------------------------------------------

    def doubt(self, kind, name):
        """Statements after which it is not known what a variable is, or that it may change at any time."""
        value, number = self.literal(kind), int(self.rng.integers(4, 7))
        write = f"{name}={value}"
        routine, inner = self.new("SUB"), self.new("SUB")
        target = self.one("$IN[1]", "$IN[I]", "$FLAG[3]")
        on = f"INTERRUPT ON {number}"
        choice = int(self.rng.integers(33))
        choice = 23 if kind in ("INT", "BOOL") and self.maybe(0.05) else choice
        if choice == 32 and kind in ("INT", "E6POS"):
            array = {"INT": "N", "E6POS": "P"}[kind]
            self.routines.append([f"DEF {routine}(A:OUT)", f"DECL {kind} A", f"A={value}", "END"])
            return ["J=GONE()", f"{routine}({array}[J])", f"{name}={array}[2]", "J=2"]
        if choice == 32 and kind == "BOOL":
            self.routines.append([f"DEF {routine}(A:OUT)", "DECL BOOL A", f"A={value}", "END"])
            return [f"{routine}($OUT[3])", f"{name}=$OUT[3]"]
        if choice == 29:
            label = self.new("L")
            return [f"{label}:", write, f"IF {target} THEN", f"GOTO {label}", "ENDIF"]
        if choice == 30 and kind in ("E6POS", "FRAME"):
            part = self.variable(kind, self.one("{X 1,Y 2,Z 3}", "{X 4.5,B 20}"))
            return [f"{part}={self.one('{X 5}', '{X 5,Y 6}')}", f"{name}={part}"]
        if choice == 31:
            self.routines.append([f"DEF {routine}()", write, f"IF {target} THEN", f"{inner}()", "ENDIF", "END"])
            self.routines.append([f"DEF {inner}()", f"{name}={self.literal(kind)}", "END"])
            return [f"{routine}()"]
        if choice == 27:
            self.routines.append([f"DEFFCT BOOL {routine}()", write, "RETURN (FALSE)", "ENDFCT"])
            return [f"INTERRUPT DECL {number} WHEN {routine}() DO $OUT[2]=TRUE", on]
        if choice == 28 and kind in ("INT", "E6POS"):
            self.shared += [(f"DECL GLOBAL {kind} {name}T={value}"), f"DECL GLOBAL {kind} {name}T={self.literal(kind)}"]
            return [f"{name}={name}T"]
        if choice in (0, 1):
            return [f"INTERRUPT DECL {number} WHEN {target}==TRUE DO {write}", on]
        if choice == 2:
            self.routines.append([f"DEF {routine}()", write, "END"])
            return [f"GLOBAL INTERRUPT DECL {number} WHEN {target} DO {routine}()", on]
        if choice == 3:
            self.routines.append([f"DEF {routine}(A:OUT)", f"DECL {kind} A", f"A={value}", "END"])
            return [f"INTERRUPT DECL {number} WHEN {target} DO {routine}({name})", on]
        if choice == 4:
            return [f"TRIGGER WHEN DISTANCE={self.one('0', '1')} DELAY=0 DO {write}", f"LIN {self.literal('E6POS')}"]
        if choice == 5:
            self.routines.append([f"DEF {routine}()", write, "END"])
            return [f"TRIGGER WHEN PATH=-5 DELAY=0 DO {routine}() PRIO=-1", f"LIN {self.literal('E6POS')} C_DIS"]
        if choice == 6:
            return [f"GONE({name})"]
        if choice == 7:
            return [f"{name}=GONE()"] if kind in ("INT", "REAL") else [f"GONE(I,{name})"]
        if choice == 8:
            return [f"IF {target} THEN", write, "ENDIF"]
        if choice == 9:
            self.routines.append([f"DEF {routine}()", write, "END"])
            return [f"IF {target} THEN", f"{routine}()", "ENDIF"]
        if choice == 10:
            self.routines.append(
                [f"DEF {routine}(A:OUT)", f"DECL {kind} A", f"IF {target} THEN", f"A={value}", "ENDIF", "END"]
            )
            return [f"{routine}({name})"]
        if choice == 11:
            return [f"WHILE {target}", write, "ENDWHILE"]
        if choice == 12:
            head = self.one("SWITCH GONE()", "SWITCH N[GONE()]")
            return [head, "CASE 1", write, "CASE 2", "I=I", "ENDSWITCH"]
        if choice == 13:
            counter = self.variable("INT")
            return [f"FOR {counter}=1 TO GONE()-1", write, "ENDFOR"]
        if choice == 14 and kind in ("INT", "REAL"):
            return [self.one(f"ANIN ON {name}=0.1*$ANIN[1]+0", f"DIGIN ON {name}=1.0*$DIGIN1+0")]
        if choice == 15 and kind != "FRAME":
            return {"INT": [f"{name}=$ANIN[1]"], "REAL": [f"{name}=0.5+$ANIN[2]*0.1"], "BOOL": [f"{name}=$IN[3]"]}.get(
                kind, [f"{name}=XA", f"{name}.Y=$ANIN[1]"]
            )
        if choice == 16 and kind in ("INT", "REAL", "E6POS"):
            array = {"INT": "N", "REAL": "R", "E6POS": "P"}[kind]
            unknown = self.one([f"{array}[GONE()]={value}"], ["J=GONE()", f"{array}[J]={value}"])
            return [*unknown, f"{name}={array}[2]"]
        if choice == 17 and kind in ("INT", "E6POS"):
            array = {"INT": "N", "E6POS": "P"}[kind]
            self.routines.append(
                [f"DEFFCT {kind} {routine}()", "J=3", f"RETURN {'3' if kind == 'INT' else 'XB'}", "ENDFCT"]
            )
            return [f"{array}[J]={routine}()", f"{name}={array}[2]"]
        if choice == 18:
            other = self.variable(kind)
            self.routines.append(
                [
                    f"DEF {routine}(A:OUT)",
                    f"DECL {kind} A",
                    f"A={value}",
                    f"{other}={name}",
                    f"{name}={self.literal(kind)}",
                    f"{other}=A",
                    f"A={other}",
                    "END",
                ]
            )
            return [f"{routine}({name})"]
        if choice == 19:
            self.routines.append([f"DEF {routine}()", f"IF {target} THEN", "RETURN", "ENDIF", write, "END"])
            return [f"{routine}()"]
        if choice == 20:
            counter = self.variable("INT")
            return [f"FOR {counter}=1 TO 3", f"IF {target} THEN", "EXIT", "ENDIF", write, "ENDFOR"]
        if choice == 21:
            self.routines.append([f"DEF {inner}()", write, "END"])
            self.routines.append([f"DEF {routine}()", f"INTERRUPT DECL {number} WHEN {target} DO {inner}()", on, "END"])
            return [f"{routine}()"]
        if choice == 22:
            self.routines.append(
                [f"DEF {routine}()", f"GLOBAL INTERRUPT DECL {number} WHEN {target} DO {write}", on, "END"]
            )
            return [f"{routine}()"]
        if choice == 23 and kind == "INT":
            return [f"{name}={self.one('2.5', '1.5', '(1-4)/2+3', '2147483647+1', '0-3/2+4', 'N[9]')}"]
        if choice == 23 and kind == "BOOL":
            sign, large = self.one("==", "<>", "<", ">="), self.one("100.00005", "99.99995", "1000.0005")
            small = f"({self.one('0.1*3', '0.3')}{sign}{self.one('0.3', '0.1+0.2')})"
            return [f"{name}={self.one(small, f'({large}{sign}{round(float(large))}.0)')}"]
        if choice == 24:
            label = self.new("L")
            skipped = self.one([write], ["I=I", write], [write, f"LIN {self.literal('E6POS')}"])
            return [f"IF {target} THEN", f"GOTO {label}", "ENDIF", *skipped, f"{label}:"]
        if choice == 25 and kind in ("E6POS", "FRAME"):
            return [f"{name}={{X 5,Y 7}}"]
        if choice == 26:
            call = self.new("LIB")
            self.others[f"{call.lower()}.src"] = [
                f"DEF {call}(A:OUT)",
                f"DECL {kind} A",
                f"IF {target} THEN",
                f"A={value}",
                "ENDIF",
                "END",
            ]
            return [f"{call}({name})"]
        return [f"GONE({name})"]

    # --- using ---------------------------------------------------------------------------------------------------

    def use(self, kind, name):
        """Statements with a motion that depends on a variable."""
        tail = self.one("", " C_DIS")
        end = f"LIN {self.literal('E6POS')}{tail}"
        there = f"LIN {self.literal('E6POS')}"
        point = self.variable("E6POS")
        if kind in ("INT", "REAL") and self.maybe(0.12):
            return self.use_in_function(kind, name, end, there)
        if kind == "INT":
            counter = self.variable("INT")
            return self.one(
                [f"LIN P[{name}]{tail}"],
                [f"LIN P[{name}+1-1]{tail}"],
                [f"LIN Q[1,{name} B_AND 1+1]" if self.maybe(0.1) else f"LIN P[{name}]"],
                [f"LIN {{X {name}*10,Y 1,Z 2,A 3,B 4,C 5}}{tail}"],
                [f"IF {name}{self.one('>', '==', '<>', '<=')}2 THEN", end, "ELSE", there, "ENDIF"],
                [f"IF ({name} B_AND {self.one('1', '2')})=={self.one('1', '0')} THEN", end, "ENDIF", there],
                [f"FOR {counter}=1 TO {name}", f"LIN P[{counter}]{tail}", "ENDFOR"],
                [f"FOR {counter}={name} TO 4 STEP 2", f"LIN P[{counter}]{tail}", "ENDFOR", f"LIN P[{counter}-2]"],
                [f"FOR {counter}={name} TO 1 STEP -1", f"LIN P[{counter}]{tail}", "ENDFOR", f"LIN P[{counter}+1]"],
                [f"FOR N[{name}]=1 TO 2", f"LIN P[N[{name}]]{tail}", "ENDFOR"],
                [
                    f"FOR {counter}=1 TO {name}",
                    f"LIN {{X {counter}*5,Y 1,Z 2,A 3,B 4,C 5}}",
                    "ENDFOR",
                    f"LIN P[{counter}]",
                ],
                [f"SWITCH {name}", "CASE 1", end, "CASE 2,3", there, "ENDSWITCH"],
                [f"$BASE=BASE_DATA[{name}]", end],
                [f"BAS(#BASE,{name})", end],
                [f"{point}.X={name}*7", f"LIN {point}{tail}"],
                [f"{self.moving('INT', 'LIN P[A]')}({name})"],
                [f"WHILE {name}<4", f"LIN P[{name}]", f"{name}={name}+1", "ENDWHILE"],
            )
        if kind == "REAL":
            return self.one(
                [f"LIN {{X 1,Y {name},Z 2,A 3,B 4,C 5}}{tail}"],
                [f"$VEL.CP={name}", end],
                [f"BAS(#VEL_CP,{name})", end],
                [f"$APO.CDIS={name}", f"{there} C_DIS"],
                [f"LIN_REL {{Z {name}}}", end],
                [f"IF {name}>1 THEN", end, "ENDIF", there],
                [f"IF {name}*3=={name}+{name}+{name} THEN", end, "ENDIF", there],  # equal but for rounding
                [f"{point}.Z={name}*3", f"LIN {point}"],
                [f"{self.moving('REAL', 'LIN {X A*10,Y 1,Z 2,A 3,B 4,C 5}')}({name})"],
                [f"SLIN {point} WITH $VEL.CP={name}", end],
                [f"$BASE.X=900+{name}", end],
            )
        if kind == "BOOL":
            counter = self.variable("INT", "1")
            return self.one(
                [f"IF {name} THEN", end, "ELSE", there, "ENDIF"],
                [f"IF NOT {name} THEN", end, "ENDIF"],
                [f"IF {name} EXOR {self.one('SX.B', 'TRUE', 'NOT GIVENB')} THEN", end, "ENDIF"],
                [f"IF SX.B==NOT {name} THEN", end, "ENDIF"],
                [f"IF {name} AND (I>0) THEN", f"{point}=XB", "ENDIF", f"LIN {point}"],
                [f"IF {name} OR GIVENB THEN", end, "ENDIF"],
                [f"WHILE {name} AND ({counter}<3)", f"LIN P[{counter}]", f"{counter}={counter}+1", "ENDWHILE"],
                ["REPEAT", f"LIN P[{counter}]", f"{counter}={counter}+1", f"UNTIL {name} OR ({counter}>2)"],
                [f"{self.moving('BOOL', 'IF A THEN', 'LIN XA', 'ENDIF')}({name})"],
            )
        if kind == "FRAME":
            return self.one(
                [f"$BASE={name}", end],
                [f"$TOOL={name}", end],
                [f"LIN {name}:{point}{tail}"],
                [f"LIN {name}:{self.literal('FRAME')}{tail}"],
                [f"$BASE=$BASE:{name}", end],
                [f"$BASE.Y={name}.Y", end],
                [f"BASE_DATA[3]={name}", "BAS(#BASE,3)", end],
                [f"{self.moving('FRAME', 'LIN A:XA')}({name})"],
            )
        return self.one(
            [f"LIN {name}{tail}"],
            [f"LIN {name}{tail}", f"LIN XA:{name}"],
            [f"PTP {name}", end],
            [f"SLIN {name} WITH {self.one('$VEL.CP=0.2', '$BASE=BASE_DATA[2]', '$TOOL=TOOL_DATA[2]')}", end],
            [f"P[2]={name}", f"LIN P[{self.one('J', '2')}]"],
            [f"LIN {{X {name}.X,Y 2,Z 1,A {name}.A,B 4,C 5}}"],
            [f"{self.moving('E6POS', 'LIN A')}({name})"],
            [f"{self.moving('E6POS', 'A.X=A.X+1', 'LIN A')}({name})"],
            ["SPLINE", f"SLIN {name}", f"S{there}", "ENDSPLINE"],
            [f"CIRC {{X 50.5,Y 60,Z 70}},{name}{tail}", end],
            ["SPLINE", f"SPL {name}", self.one("SPL XB", f"S{there}", "STOP WHEN PATH=0 IF $IN[1]"), "ENDSPLINE", end],
            ["SPLINE", "CONST_VEL START=1", f"SLIN {name}", f"S{there}", "CONST_VEL END=-1", "ENDSPLINE"],
            [f"LIN {name}", self.one("LIN $POS_ACT", "PTP $POS_ACT"), end],
        )

    def use_in_function(self, kind, name, end, there):
        """Motions that depend on a function which only gives a value, by a condition, a bound, an index or a target."""
        call, counter = self.function("INT"), self.variable("INT")
        whole = name if kind == "INT" else "J"
        return self.one(
            [f"IF {call}>={name} THEN", end, "ENDIF", there],
            [f"FOR {counter}=1 TO {call}", f"LIN P[{whole}]", "ENDFOR", there],
            [f"LIN {{X {call}+{name},Y 1,Z 2,A 3,B 4,C 5}}"],
            [f"SWITCH {call}", f"CASE {whole}", end, "DEFAULT", there, "ENDSWITCH"],
            [f"LIN P[({call} B_AND 1)+1]", end],
        )

    def moving(self, kind, *body):
        """A routine that moves to what it gets."""
        routine = self.new("MOV")
        self.routines.append([f"DEF {routine}(A:IN)", f"DECL {kind} A", *body, "END"])
        return routine

    # --- settings ------------------------------------------------------------------------------------------------

    def setting(self):
        """Statements that set frames, speed or approximation, and a motion under them."""
        end = [f"LIN {self.literal('E6POS')} C_DIS"]
        if self.maybe(0.06):
            end = ["LIN {X 1,Y 2,Z $BASE.Z,A $BASE.A,B $BASE.B,C 5}"]
        real, data, frames = self.value("REAL"), self.one("LA", "LB"), self.one("FA", "FB")
        number = self.one("1", "2", "3", "I", "J")
        chosen = self.one(
            [f"$VEL.CP={real}"],
            [f"$VEL.CP={self.literal('REAL')}", f"$APO.CDIS={self.literal('REAL')}"],
            [f"$APO.CDIS={self.literal('REAL')}"],
            [f"$VEL={{CP {self.literal('REAL')},ORI1 200.0,ORI2 200.0}}"],
            ["$VEL={ORI1 200.0}"],
            [f"$APO.CDIS={real}"],
            [f"$APO={{CDIS {self.literal('REAL')},CPTP 50}}"],
            [f"FDAT_ACT={frames}", "BAS(#FRAMES)"],
            [f"FDAT_ACT={frames}", f"BAS(#PTP_PARAMS,{self.one('100', '50')})"],
            [f"LDAT_ACT={data}", "BAS(#CP_DAT)"],
            [f"FDAT_ACT={frames}", f"LDAT_ACT={data}", f"BAS(#CP_PARAMS,{real})"],
            [f"FDAT_ACT={frames}", f"LDAT_ACT={data}", f"BAS(#CP_PARAMS,{self.literal('REAL')})"],
            ["LDAT_ACT=LB", "BAS(#CP_DAT)"],
            [f"PDAT_ACT={{VEL 100.0,ACC 100.0,APO_DIST 6.0,APO_MODE {self.one('#CDIS', '#CPTP')}}}", "BAS(#PTP_DAT)"],
            [f"FDAT_ACT={{TOOL_NO {number},BASE_NO 2,IPO_FRAME #BASE}}", "BAS(#FRAMES)"],
            [f"{frames}.BASE_NO={number}", f"FDAT_ACT={frames}", "BAS(#FRAMES)"],
            [f"BAS(#TOOL,{self.one('1', '2', 'J')})", f"BAS(#BASE,{number})"],
            ["BAS(#INITMOV,0)"],
            ["BAS(#VEL_PTP,50)", "BAS(#ACC_CP,10)"],
            ["$TOOL=TOOL_DATA[2]", "$TOOL.Z=$TOOL.Z+5.5"],
            [f"$BASE={self.value('FRAME')}"],
            [f"$BASE={self.value('FRAME')}", f"$BASE.{self.one('X', 'Y', 'Z')}={real}"],
            ["$BASE=BASE_DATA[2]", "BASE_DATA[2].X=950.5"],
            [f"$BASE=SBASE({number})", f"$TOOL=STOOL2({frames})"],
            [f"$BASE=SBASE({frames})", f"$TOOL=STOOL2({self.one(frames, '2')})"],
            [f"$VEL=SVEL_CP({self.literal('REAL')},,{data})"],
            [f"$APO=SAPO({data})"],
            [f"$ORI_TYPE={self.one('#VAR', 'SORI_TYP(LA)', '#JOINT')}"],
            [f"$IPO_MODE={self.one('#BASE', 'SIPO_MODE(FA)')}"],
            [f"$CIRC_TYPE={self.one('#BASE', '#PATH', 'SCIRC_TYPE(LA)')}"],
            [f"$CIRC_MODE.AUX_PT.ORI={self.one('#CONSIDER', '#IGNORE', '#INTERPOLATE')}"],
            ["$CIRC_MODE={AUX_PT {ORI #IGNORE,E1 #CONSIDER}}", f"SCIRC XA,{self.literal('E6POS')}"],
            [f"$BASE={{X 1000,Y 50,Z 500,A 10,B {self.one('120', '-95.5')},C 20}}"],
        )
        inline = self.one(
            f"$VEL=SVEL_CP({self.literal('REAL')},,{data}), $TOOL=STOOL2({frames}), "
            f"$BASE=SBASE({frames}.BASE_NO), $APO=SAPO({data})",
            f"$VEL.CP={self.literal('REAL')}",
            f"$BASE=BASE_DATA[{number}],$TOOL=TOOL_DATA[2]",
            f"$APO={{CDIS {self.literal('REAL')}}}",
            "$VEL={CP 0.25,ORI1 200.0},$ACC={CP 2.0}",
        )
        save = [self.variable("FRAME"), self.variable("REAL")]
        kept = self.one(
            [f"{save[0]}=$BASE", *chosen, *end, f"$BASE={save[0]}"],
            [f"{save[0]}=$TOOL", *chosen, *end, f"$TOOL={save[0]}"],
            [f"{save[1]}=$VEL.CP", *chosen, *end, f"$VEL.CP={save[1]}"],
            [f"{save[1]}=$APO.CDIS", *chosen, *end, f"$APO.CDIS={save[1]}"],
        )
        doubtful = []
        if self.uncertain and self.maybe(0.7):
            self.uncertain = 0
            doubtful = self.doubtful_setting(chosen)
        first = self.one(
            chosen,
            kept,
            kept,
            [f"SLIN {self.literal('E6POS')} WITH {inline}"],
            [f"SPLINE WITH {inline}", f"SLIN {self.literal('E6POS')}", self.one("ENDSPLINE", "ENDSPLINE C_SPL")],
            ["SPLINE", f"SLIN {self.literal('E6POS')}", self.one("ENDSPLINE", "ENDSPLINE C_SPL")],
        )
        if doubtful and first == chosen:
            first = []
        return [*first, *doubtful, *end, *end[: self.one(0, 1)]]

    def doubtful_setting(self, chosen):
        routine, number = self.new("SUB"), int(self.rng.integers(4, 7))
        self.routines.append([f"DEF {routine}()", *chosen, "END"])
        target = self.one("$IN[1]", "$IN[2]")
        frame = self.one("$BASE", "$TOOL")
        function, block = self.new("FN"), [f"SLIN {self.literal('E6POS')}", "ENDSPLINE"]
        self.routines.append([f"DEFFCT REAL {function}()", *chosen, "RETURN (5.5)", "ENDFCT"])
        return self.one(
            ["SPLINE", f"SLIN {{X {function}(),Y 1,Z 2,A 3,B 4,C 5}}", *block],
            [f"IF {target} THEN", "$VEL.ORI1=150", "ENDIF"],
            [f"IF {target} THEN", *chosen, "ENDIF"],
            [f"IF {target} THEN", f"{routine}()", "ENDIF"],
            [f"INTERRUPT DECL {number} WHEN {target} DO {routine}()", f"INTERRUPT ON {number}"],
            [f"TRIGGER WHEN DISTANCE=0 DELAY=0 DO {routine}()", f"LIN {self.literal('E6POS')}"],
            [f"GONE({frame})"],
            [f"{frame}=GONE5()" if self.maybe(0.1) else f"{frame}.X=GONE()"],
            [f"{frame}=BASE_DATA[9]"],
            [f"{frame}={{X 5,Y 7}}"],
            ["$VEL.CP=GONE()"],
            ["$APO.CDIS=GONE()"],
            ["FDAT_ACT={TOOL_NO 1,IPO_FRAME #BASE}", "BAS(#FRAMES)"],
            ["FDAT_ACT={TOOL_NO 2,BASE_NO 3,IPO_FRAME #TCP}", f"BAS({self.one('#FRAMES', '#PTP_PARAMS,50')})"],
            ["BAS(#BASE,GONE())"],
            [f"WHILE {target}", *chosen, "ENDWHILE"],
        )

    # --- wrapping ------------------------------------------------------------------------------------------------

    def wrapped(self, lines):
        """The same statements inside of something whose way is known."""
        counter, label = self.variable("INT", "0"), self.new("L")
        routine = self.new("SUB")
        jumps = any("GOTO" in line or line.endswith(":") for line in lines)
        choice = int(self.rng.integers(18))
        if choice < 3:
            return lines
        if choice == 3 and not jumps:
            return [f"FOR {counter}={self.one('1 TO 2', '2 TO 1 STEP -1', 'I TO J')}", *lines, "ENDFOR"]
        if choice == 4:
            condition = self.value("BOOL")
            return [f"IF {condition} THEN", *lines, "ELSE", f"LIN {self.literal('E6POS')}", "ENDIF"]
        if choice == 5 and not jumps:
            return [f"WHILE {counter}<{self.one('1', '2')}", f"{counter}={counter}+1", *lines, "ENDWHILE"]
        if choice == 6 and not jumps:
            return ["REPEAT", *lines, f"{counter}={counter}+1", f"UNTIL {counter}>{self.one('0', '1')}"]
        if choice == 7 and not jumps:
            stop = [f"IF {counter}>1 THEN", "EXIT", "ENDIF"]
            return ["LOOP", f"{counter}={counter}+1", *stop, *lines, "ENDLOOP"]
        if choice == 8:
            return [
                f"SWITCH {self.value('INT')}",
                "CASE 1,2",
                *lines,
                "DEFAULT",
                f"LIN {self.literal('E6POS')}",
                "ENDSWITCH",
            ]
        if choice in (9, 10, 11) and (not jumps or self.maybe(0.2)):
            self.routines.append([f"DEF {routine}()", *lines, *self.ending(), "END"])
            between = self.one([], [f"LIN {self.literal('E6POS')}"], ["$VEL.CP=0.4"], ["I=2"], ["$BASE=BASE_DATA[2]"])
            return [f"{routine}()", *([*between, f"{routine}()"] if choice == 11 else [])]
        if choice == 12:
            self.routines.append(
                [f"DEF {routine}(K:IN)", "DECL INT K", "IF K==1 THEN", *lines, "ENDIF", "LIN P[K]", "END"]
            )
            return [f"{routine}({number})" for number in self.one(["1"], ["1", "2"], ["2", "1"], ["I", "J"])]
        if choice == 13:
            skip = self.one(
                [f"GOTO {label}", "LIN XB"], [f"IF {self.value('BOOL')} THEN", f"GOTO {label}", "ENDIF", "LIN XB"]
            )
            return [*skip, f"{label}:", *lines]
        if choice == 15 and not jumps:
            back = [f"IF {counter}<{self.one('1', '2')} THEN", f"GOTO {label}", "ENDIF"]
            return [f"{label}:", f"{counter}={counter}+1", *lines, *back]
        if choice == 16 and not jumps:
            leave = [f"IF {counter}=={self.one('1', '2', '5')} THEN", f"GOTO {label}", "ENDIF"]
            body = self.one([*lines, *leave], [*leave, *lines], [*lines, *leave, f"LIN {self.literal('E6POS')}"])
            return [f"FOR {counter}=1 TO 2", *body, "ENDFOR", f"LIN {self.literal('E6POS')}", f"{label}:"]
        if choice == 14 and not jumps:
            inner = [f"FOR J=1 TO {self.one('I', '2')}", "LIN P[J]", "ENDFOR", "J=2"]
            return [f"FOR {counter}=1 TO 2", *inner, *lines, "ENDFOR"]
        return lines

    def ending(self):
        """What may be at the end of a routine."""
        return self.one(
            [], [], ["RETURN"], ["RETURN", "LIN XB"], [f"IF {self.value('BOOL')} THEN", "RETURN", "ENDIF", "LIN XA"]
        )

    def kept_motions(self):
        """Motions that only the running robot knows."""
        there = f"LIN {self.literal('E6POS')}"
        routine = self.new("SUB")
        self.routines.append([f"DEF {routine}()", there, *self.one([], ["LIN_REL {X 5}"]), "END"])
        return self.one(
            ["WHILE $IN[3]", there, "I=I", "ENDWHILE", there],
            ["LIN $POS_ACT:{X 1,Y 2,Z 5,A 0,B 0,C 0}", there],
            ["IF $IN[4] THEN", there, "ENDIF", there],
            ["IF $IN[4] THEN", f"{routine}()", "ENDIF", there, f"{routine}()"],
            ["J=GONE()", "LIN P[J]", there, "J=2"],
            ["WHILE $IN[3]", f"{routine}()", "ENDWHILE", there],
            ["LIN_REL {X 5}", there],
            self.kept_file(there),
            ["LIN $POS_ACT:{X 1,Y 2,Z 5,A 0,B 0,C 0}", "LIN {Z 5}", *self.one([], ["LIN {X 3.5}", "LIN {Y 4}"]), there],
            *self.kept_functions(there),
            *self.kept_routines(there),
        )

    def refused(self, there):
        """Statements at which the controller stops or that cannot be corrected, and a motion behind them."""
        spline = there.replace("LIN", "SLIN")
        wrong = self.one(
            self.moving_event,
            self.moving_event,
            self.impossible_call,
            self.impossible_call,
            lambda _: [self.one(*IMPOSSIBLE)],
            lambda _: [self.one(*IMPOSSIBLE)],
            lambda _: [self.one(*IMPOSSIBLE)],
            lambda _: ["$APO.CDIS=-1", f"{there} C_DIS"],
            lambda _: [f"SN.I.F={self.one('{X 5,Y 6}', '{Z 7}')}", self.one("LIN SN.I.F", "$BASE=SN.I.F")],
            lambda _: [self.one("$IPO_MODE=#TCP", "$IPO_MODE=GONE()", "BAS(#BASE,9)", "BAS(#TOOL,GONE())")],
            lambda _: [f"FOR {self.one('I=1 TO 3 STEP 0', 'SX.N=1 TO 2', 'I=1', '1 TO 2')}", there, "ENDFOR"],
            lambda _: ["SPLINE", self.one(there, "SPTP XA", "SPLINE", "$VEL.CP=0.4"), spline, "ENDSPLINE"],
            lambda _: ["PTP_SPLINE", self.one("SPTP XA", spline), "ENDSPLINE"],
            lambda _: ["SPLINE", spline, self.one("ENDSPLINE FAST", "LIN XB", "ENDIF")],
            self.impossible_structure,
            self.impossible_structure,
            self.impossible_structure,
            lambda _: [self.one("WHILE I<2", "IF I==1 THEN", "LOOP"), "I=I+1", there],
        )
        return [*wrong(there), there]

    def impossible_structure(self, there):
        """A loop or a branch around motions that cannot be followed, or a jump into one."""
        label, real = self.new("L"), self.variable("REAL")
        return self.one(
            [f"FOR {real}=1 TO 2", there, "ENDFOR"],
            [f"FOR I=1 TO {self.one('R[3]', '2.5')}", there, "ENDFOR"],
            ["FOR I=1 TO J", "J=3", there, "ENDFOR"],
            [f"{label}:", there, "IF J==2 THEN", f"GOTO {label}", "ENDIF"],
            ["FOR I=1 TO 2", "LOOP", there, "ENDLOOP", "ENDFOR"],
            [f"GOTO {label}", "FOR I=1 TO 2", f"{label}:", there, "ENDFOR"],
            ["FOR I=1 TO 2", f"GOTO {label}", f"{label}:", there, "ENDFOR"],
            ["SWITCH I", "CASE", there, "ENDSWITCH"],
            ["IF 1<J<3 THEN", there, "ENDIF"],
            ["IF J==2==TRUE AND SX.B THEN", there, "ENDIF"],
            ["WHILE J==2", there, "ENDWHILE"],
            ["IF $IN[1] THEN", there, "IF $IN[2] THEN", f"GOTO {label}", "ENDIF", "ENDIF", there, f"{label}:"],
            ["IF $IN[1] THEN", there, f"GOTO {label}", "I=1", "ENDIF", there, f"{label}:"],
        )

    def moving_event(self, there):
        """An interrupt or a trigger that moves the robot."""
        action, routine, file = self.new("SUB"), self.new("SUB"), self.new("LIB")
        leads_back = self.one([], [], ["PTP $POS_RET"])
        self.routines.append([f"DEF {action}()", *(leads_back or [there]), "END"])
        public = self.one("", "GLOBAL ")
        event = self.one(
            [f"{public}INTERRUPT DECL 8 WHEN $IN[1] DO {action}()", "INTERRUPT ON 8"],
            [f"TRIGGER WHEN DISTANCE=0 DELAY=0 DO {action}() PRIO=-1", *self.one([], [there])],
        )
        if self.maybe(0.4):
            return event
        moves = self.one([], [there])
        self.routines.append([f"DEF {routine}()", *event, *moves, "END"])
        self.others[f"{file.lower()}.src"] = [
            *(f"DEF {file}()", *event, *moves, "END"),
            *(f"DEF {action}()", *(leads_back or [there]), "END"),
        ]
        return [f"{self.one(routine, file)}()"]

    def impossible_call(self, there):
        """A call that cannot be followed, of a routine that moves the robot or sets what the next motion uses."""
        routine, inner, number = self.new("SUB"), self.new("SUB"), self.variable("INT")
        does = self.one([there], ["$BASE=BASE_DATA[2]"], [f"{number}=3"])
        last = f"LIN P[{number}]"
        self.routines.append([f"DEF {inner}()", *does, "BRAKE", "RESUME", "END"])
        head, body, call = self.one(
            ("()", [*does, f"IF I>9 THEN\n{routine}()\nENDIF"], "()"),
            ("()", [*does, "PART()"], "()"),
            ("(A:IN)", [*does], "(1,2)"),
            ("(A:OUT)", ["A=2", *does], "(N[])"),
            ("(A:OUT,B:OUT)", ["A=2", "B=3", *does], f"({number},{number})"),
            ("(A:OUT)", [f"{number}=1", "A=2", *does], f"({number})"),
            ("(A[])", ["A[2]=3", *does], "(R[])"),
            ("()", [f"INTERRUPT DECL 9 WHEN $IN[1] DO {inner}()", "INTERRUPT ON 9", *does], "()"),
            ("(A:OUT)", ["INTERRUPT DECL 9 WHEN $IN[1] DO A=2", "INTERRUPT ON 9", *does], f"({number})"),
        )
        lines = [line for part in body for line in part.split("\n")]
        declared = [f"DECL INT {name}" for name in ("A", "A[]", "B") if f"{name}:" in head or f"({name})" in head]
        self.routines.append([f"DEF {routine}{head}", *declared, *lines, "END"])
        return [f"{routine}{call}", last]

    def kept_file(self, there):
        """A routine of another file that moves and cannot be followed, called under a condition or without one."""
        file = self.new("LIB")
        body = self.one(
            ["AGAIN:", there, "IF $IN[3] THEN", "GOTO AGAIN", "ENDIF"],
            ["WHILE $IN[3]", there, "ENDWHILE"],
            ["LIN_REL {X 5}", "WHILE $IN[3]", there, "ENDWHILE"],
        )
        self.others[f"{file.lower()}.src"] = [f"DEF {file}()", *body, "END"]
        conditional = self.one(["IF $IN[4] THEN", f"{file}()", "ENDIF"], ["WHILE $IN[4]", f"{file}()", "ENDWHILE"])
        call = self.one([f"{file}()"], [f"{file}()"], conditional)
        return [*call, *self.one(["PTP XHOME"], ["PTP XHOME"], []), there]

    def synchronised(self):
        """Commands that wait for another robot, or move in time with it."""
        command = f'SYNCCMD(#{self.one("PROGSYNC", "PROGSYNC", "MOTIONSYNC")},"A",3)'
        there, routine = f"LIN {self.literal('E6POS')}", self.new("SUB")
        if self.maybe(0.4):
            return self.one([command, there], [command, there, command, there])
        moves, file = self.one([], [there]), self.new("LIB")
        head, call = f"DEF {routine}()", self.one(f"{routine}()", f"{file}()")
        self.routines.append([head, *self.one([command, *moves], [*moves, command]), "END"])
        self.others[f"{file.lower()}.src"] = [f"DEF {file}()", command, *moves, "END"]
        return self.one(
            [call, there],
            [there, call],
            [f"IF {self.value('BOOL')} THEN", call, "ENDIF", there],
            ["IF $IN[4] THEN", command, "ENDIF", there],
            [f"INTERRUPT DECL 7 WHEN $IN[1] DO {call}", "INTERRUPT ON 7", there],
        )

    def kept_functions(self, there):
        """Targets by a function that changes what a condition, an index or a bound depends on."""
        function, counter = self.new("FN"), self.variable("INT", "1")
        self.routines.append([f"DEFFCT REAL {function}()", f"{counter}={counter}+1", "RETURN(5.5)", "ENDFCT"])
        target = f"LIN {{X {function}(),Y 1,Z 2,A 3,B 4,C 5}}"
        return [
            [target, f"IF {counter}==1 THEN", "LIN XA", "ELSE", there, "ENDIF", there],
            [target, f"LIN P[{counter}]", there],
            [target, f"FOR J=1 TO {counter}", "LIN P[J]", "ENDFOR", "J=2", there],
        ]

    def kept_routines(self, there):
        """Calls of a routine with motions that only the running robot knows, which gives a counter its value."""
        routine, counter = self.new("SUB"), self.variable("INT")
        kept = self.one(["WHILE $IN[3]", there, "ENDWHILE"], ["LIN $POS_ACT:XA"], ["IF $IN[4] THEN", there, "ENDIF"])
        self.routines.append([f"DEF {routine}()", *kept, f"{counter}=2", "END"])
        loop = [f"FOR J=1 TO {counter}", "LIN P[J]", "ENDFOR", "J=2"]
        return [
            [f"{routine}()", there, *loop],
            [f"{counter}=1", f"{routine}()", f"{there} C_DIS", f"IF {counter}>1 THEN", "LIN XA", "ENDIF", there],
            [f"{routine}()", f"{counter}=1", there, *loop],
        ]

    def plain_loop(self):
        """A loop over points, of the kind that may be read at once."""
        counter, end = self.variable("INT", "0"), self.one("2", "3", "4", "J")
        change = self.one([], [], [f"P[2]={self.literal('E6POS')}"], [f"P[J].X={self.literal('REAL')}"], ["R[2]=0.9"])
        trigger = f"TRIGGER WHEN DISTANCE=0 DELAY=0 DO {self.one('$OUT[2]=TRUE', 'I=I', 'R[2]=0.5')}"
        setting = self.one(
            [], [f"$VEL.CP=R[{counter}]"], ["$VEL.CP=0.3"], ["$APO.CDIS=2.5"], [trigger], ["$OUT[2]=TRUE"]
        )
        move = self.one(
            f"LIN P[{counter}]",
            f"LIN P[{counter}] C_DIS",
            f"LIN P[{counter}+1]",
            f"LIN {{X {counter}*5,Y 1,Z 2,A 3,B 4,C 5}} C_DIS",
            f"LIN {{X 90*COS({counter}*30),Y R[J],Z 2,A 3,B 4,C 5}}",
        )
        twice = self.one([], [f"LIN {{X 7,Y {counter},Z 2,A 3,B 4,C 5}}"])
        head = f"FOR {counter}={self.one('1', '1', 'I')} TO {end if '+' not in move else '3'}"
        return [*change, head, *setting, move, *twice, "ENDFOR", f"LIN P[{self.one('2', counter + '-1')}] C_DIS"]

    def branches(self):
        """Branches of which it is not known which runs, and that meet in one pose."""
        meet, other = (f"LIN {self.literal('E6POS')}" for _ in range(2))
        routine = self.new("SUB")
        self.routines.append([f"DEF {routine}()", other, meet, "END"])
        first = [self.one(other, f"{self.variable('INT')}=1", "$OUT[1]=TRUE"), meet]
        target = self.one("$IN[1]", "NOT $IN[2]", "$IN[1] AND (I>0)", "$IN[3] OR $IN[6]")
        label = self.new("L")
        return self.one(
            [f"IF {target} THEN", *first, "ELSE", meet, "ENDIF"],
            [meet, f"IF {target} THEN", *first, "ENDIF"],
            ["SWITCH GONE()", "CASE 1", *first, "CASE 2", meet, "DEFAULT", meet, "ENDSWITCH"],
            [f"IF {target} THEN", f"{routine}()", "ELSE", *first, "ENDIF"],
            [f"IF {target} THEN", "IF $IN[7] THEN", *first, "ELSE", meet, "ENDIF", "ELSE", meet, "ENDIF"],
            [meet, f"IF {target} THEN", f"GOTO {label}", "ENDIF", *first, f"{label}:"],
            [f"{label}:", meet, f"IF {target} THEN", f"GOTO {label}", "ENDIF"] if self.keep else [meet],
            self.left_in_branch(target, first, meet),
            *self.branches_with_settings(target, other, meet),
            *self.branches_with_settings(target, other, meet),
        )

    def branches_with_settings(self, target, other, meet):
        """Branches that set frames or speeds for their motions, and what holds behind them."""
        chosen = self.one("$BASE=BASE_DATA[2]", "BAS(#BASE,3)", "$TOOL=TOOL_DATA[2]", "$VEL.CP=R[1]", "$APO.CDIS=R[J]")
        other = f"{other} C_DIS"
        behind = ["$BASE=BASE_DATA[1]", "$TOOL=TOOL_DATA[1]", "$VEL.CP=R[2]", "$APO.CDIS=2.0"]
        return [
            [*behind, meet, f"IF {target} THEN", chosen, other, other, *behind, meet, "ENDIF", f"{meet} C_DIS"],
            [*behind, f"IF {target} THEN", other, *behind, meet, "ELSE", chosen, other, *behind, meet, "ENDIF", meet],
            [f"IF {target} THEN", chosen, other, *behind, meet, "ELSE", other, *behind, meet, "ENDIF", meet],
        ]

    def left_in_branch(self, target, first, meet):
        """A routine that may return in one of its branches."""
        routine = self.new("SUB")
        branch = self.one([f"IF {target} THEN", "RETURN", "ENDIF"], [f"IF {target} THEN", *first, "RETURN", "ENDIF"])
        self.routines.append([f"DEF {routine}()", *self.one([], [meet]), *branch, *first, "END"])
        return [meet, f"{routine}()"]

    # --- programs ------------------------------------------------------------------------------------------------

    def snippet(self):
        choice = self.rng.random()
        if choice < (0.03 if self.keep else 0.015):
            return self.synchronised()
        if choice < 0.045 and not self.keep:
            return self.kept_file(f"LIN {self.literal('E6POS')}")
        if choice < 0.075:
            return self.plain_loop()
        if choice < 0.23:
            return self.setting()
        if choice < 0.27:
            return self.branches()
        if choice < 0.40 and self.keep:
            return self.kept_motions()
        if self.uncertain and self.maybe(0.1):
            self.uncertain = 0
            return self.refused(f"LIN {self.literal('E6POS')}")
        kind = self.one(*KINDS)
        name = self.variable(kind)
        lines = self.give(kind, name) if self.maybe(0.85) else []
        if self.uncertain and self.maybe(0.7):
            self.uncertain = 0
            doubt = self.doubt(kind, name)
            between = [f"LIN {self.literal('E6POS')}"] * self.one(0, 0, 1)
            lines = [*lines, *doubt, *between, *(self.give(kind, name, 2) if self.maybe(0.15) else [])]
        elif self.maybe(0.3):
            lines += self.give(kind, name)
        lines += [*self.use(kind, name), *(self.use(kind, name) if self.maybe(0.15) else [])]
        if kind == "E6POS" and self.maybe(0.25):  # a point of which others may be copies
            point = self.one("XA", "XB", "P[2]", name)
            lines.append(f"LIN {{X {point}.X,Y 2,Z {point}.Z,A 3,B 4,C 5}}")
        return lines

    def with_dead(self, lines):
        """The same lines with some behind a jump that never run."""
        written = []
        for line in lines:
            written.append(line)
            if line.split(" ")[0] in ("EXIT", "GOTO", "RETURN") and self.maybe(0.1):
                synchronised = 'SYNCCMD(#PROGSYNC,"C",2)'
                written.append(self.one("LIN XB", f"LIN {self.literal('E6POS')}", "I=3", "$VEL.CP=0.9", synchronised))
        return written

    def programs(self):
        """Files of the program's folder: name → text."""
        head = self.one("DEF part()", "DEF part()", "DEF part()", "DEF part(GIVENN:IN)", "DEF part(GIVENX:IN)")
        main = [head, *(f"DECL INT {name}" for name in ("GIVENN", "GIVENX") if name in head)]
        if self.maybe(0.05):
            main.append("DECL INT COUNT=2")
            self.data.append("DECL INT COUNT=4")
        body = ["BAS(#INITMOV,0)"] if self.maybe(0.8) else []
        body += ["PTP $AXIS_ACT"] if self.maybe(0.05) else []
        body += ["LIN P[COUNT]"] if "DECL INT COUNT=2" in main else []
        if self.maybe(0.15):
            kind = self.one("INT", "REAL", "E6POS")
            name = {"INT": "J", "REAL": "RL", "E6POS": "XB"}[kind]
            main.append(f"DECL {kind} {name}")
            body.append(f"{name}={self.literal(kind) if kind != 'INT' else '2'}")
        body.append("LIN P[GIVENX]" if "GIVENX" in head else f"LIN {self.literal('E6POS')}")
        if self.maybe(0.02):
            self.data.append("BASE_DATA[2]={X 1000,Y 0,Z 500,A 25,B 0,C 0}")  # the cell says otherwise
        for _ in range(int(self.rng.integers(1, 4))):
            body += self.wrapped(self.snippet())
        body += [f"LIN {self.literal('E6POS')} C_DIS"] if self.maybe(0.6) else []
        if self.keep and self.maybe(0.1):
            there = f"LIN {self.literal('E6POS')}"
            body += self.one(["LIN $POS_ACT:XA"], ["WHILE $IN[3]", there, "ENDWHILE"], self.kept_file(there)[:-1])
        if self.maybe(0.15):
            carried = self.one([], [], [], [], ["I=I+1"], ["XA.Z=XA.Z+1.5"], ["I=1", "I=I+1"], ["$VEL.CP=$VEL.CP*0.9"])
            waits = self.one('SYNCCMD(#MOTIONSYNC,"B",2)', 'SYNCCMD(#PROGSYNC,"B",2)')
            reset = self.one([], ["I=1"], [waits] if self.maybe(0.4) else [])
            body += [
                "LOOP",
                "PTP XHOME",
                *reset,
                *self.use("E6POS", self.one("XA", "P[I]")),
                *carried,
                "PTP XHOME",
                "ENDLOOP",
            ]
        body += ["RETURN", f"LIN P[{self.one('I', '2')}]"] if self.maybe(0.02) else []
        main += [*self.with_dead(body), "END"]
        for routine in self.routines:
            head = "GLOBAL " + routine[0] if self.maybe(0.15) else routine[0]
            main += [head, *self.with_dead(routine[1:])]
        files = {"part.src": main, "part.dat": [*FIXED.splitlines(), *self.data, "ENDDAT"], **self.others}
        for number, start in ((1, 0), (2, 1)) if self.shared else ():
            lines = [f"DEFDAT shared{number} PUBLIC", *self.shared[start::2], "ENDDAT"]
            files[f"shared{number}.dat"] = lines
        if self.maybe(0.05):
            written = next((line.split()[3].split("=")[0] for line in self.data if " GLOBAL INT " in line), "")
            files["sps.sub"] = ["DEF sps()", f"{written}=2" if written else "$OUT[3]=TRUE", "END"]
        end = self.one("\r\n", "\n")
        return {name: "".join(self.spelling(line) + end for line in lines if line) for name, lines in files.items()}
