"""FOR over the points of an array: taken at once, it means what it means round by round."""

import numpy as np
import pytest
from msgspec.structs import replace

from postproc.dialects import krl
from postproc.dialects.krl.read import flow, main_routine
from postproc.errors import PostprocError
from postproc.program import PTP
from tests.dialects.krl_programs import CELL, body, forward, read, targets
from tests.effort import calls_for_each
from tests.krl_texts import HOME

KEEPING = replace(CELL, krl=replace(CELL.krl, keep_unresolved=True))
LOOP = ("FOR I=1 TO 4", "LIN P[I] C_DIS", "ENDFOR")
TRIGGER = "TRIGGER WHEN DISTANCE=1 DELAY=0 DO $OUT[2]=TRUE"
POINTS = [
    "{{X {x},Y 2.5,Z 3,A 0,B 0,C 180}}",
    "{{x {x}.125, y 2, z 3, a 0, b 0, c 180}} ; a comment",
    "{{E6POS: X {x},Y 2,Z 3,A 0,B 0,C 180,S 2,T 10,E1 0.0,E2 0.0}}",
    " {{X {x},Y 2,Z 3,A 10,B 20,C 180,S 6,T 35}}",
    "{{X {x}}}",
    "{{X {x},Y 2,Z 3}}",
    "{{X 1E1,Y {x},Z 3,A 0,B 0,C 180}}",
    "{{Y 2,X {x},Z 3,A 0,B 0,C 180}}",
    "{{X {x},Y Z,Z 3,A 0,B 0,C 180}}",
    "{{A1 {x},A2 -70,A3 110,A4 0,A5 50,A6 0}}",
    "{{X 1E7,Y 2,Z 3,A 0,B 0,C 180}}",
]
BODIES = [
    LOOP,
    ("FOR I=4 TO 1 STEP -1", "lin p[i] ; back", "ENDFOR"),
    ("FOR I=1 TO 3 STEP 2", "  PTP P[ I ] C_DIS", "", ";FORCE FX=7", "ENDFOR"),
    ("FOR I=1 TO 4", "LIN P[I]", "LIN Q[I] C_DIS", "ENDFOR"),
    ("FOR I=1 TO 4", "SLIN P[I]", "LIN {X 9,Y I,Z 1}", "ENDFOR"),
    ("FOR I=1 TO 4", "LIN {X 9,Y 1,Z 1}", "SPTP P[I]", "ENDFOR"),
    ("FOR K=1 TO 2", *LOOP, "LIN P[K]", "ENDFOR"),
    (*LOOP, "LIN P[3]"),
    (*LOOP, *LOOP),
    (*LOOP, "LIN P[I-1]"),
    ("P[2].X=4", *LOOP),
    ("P[2]={X 8,Y 8,Z 8,A 0,B 0,C 180}", *LOOP),
    (*LOOP, "Q[1]=P[2]", "LIN Q[1]"),
    ("FOR I=1 TO 4", "LIN P[I]:Q[1]", "ENDFOR"),
    ("FOR I=1 TO 4", "LIN P[I]", "$VEL.CP=0.1", "ENDFOR"),
    ("FOR I=1 TO 3", "LIN P[I+1] C_DIS", "$OUT[1]=TRUE", "ENDFOR", "LIN Q[I]"),
    ("FOR I=2 TO 4", "$OUT[2]=FALSE ; open", "LIN P[I-1]", "LIN Q[I]", "$ANOUT[1]=0.5", "ENDFOR"),
    ("FOR I=2 TO 4", "LIN P[I-1]", "LIN P[I]", "ENDFOR"),
    ("FOR I=4 TO 2 STEP -1", "PTP P[ I - 1 ]", "ENDFOR"),
    ("FOR I=1 TO 4", "LIN P[I+1]", "ENDFOR"),
    ("FOR I=1 TO 3", "LIN P[1+I]", "LIN P[I+K]", "LIN P[I+1.0]", "ENDFOR"),
    ("FOR I=0 TO 3", "$OUT[I]=TRUE", "LIN P[I+1]", "ENDFOR"),
    ("FOR I=1 TO 3", "IF $OUT[1] THEN", "LIN P[I]", "ENDIF", "$OUT[1]=TRUE", "ENDFOR"),
    ("FOR I=1 TO 4", "$VEL.CP=V[I]", "LIN P[I] C_DIS", "ENDFOR", "LIN Q[1] C_DIS"),
    (
        "FOR I=1 TO 4",
        "LIN P[I] C_DIS",
        "$VEL.CP=V[I]",
        "$APO.CDIS=V[I]",
        "ENDFOR",
        "LIN Q[1] C_DIS",
        "LIN {X 1,Z $VEL.CP}",
    ),
    (
        "$VEL.CP=0.3",
        "FOR I=3 TO 2 STEP -1",
        "$APO.CDIS=V[I+1]",
        "LIN P[I]",
        "$VEL.CP=V[I-1]",
        "LIN Q[I] C_DIS",
        "ENDFOR",
    ),
    (
        "FOR I=1 TO 4",
        "$VEL.CP=V[I]",
        "LIN P[I]",
        "$VEL.CP=0.2",
        "LIN Q[I] C_DIS",
        "$APO.CDIS=3",
        "ENDFOR",
        "LIN Q[1] C_DIS",
    ),
    ("FOR I=1 TO 4", "$VEL.CP=V[I]", "$VEL.CP=0", "LIN P[I]", "ENDFOR"),
    ("FOR I=1 TO 4", "$VEL.CP=P[I].X", "LIN P[I]", "ENDFOR"),
    ("V[2]=-1", "FOR I=1 TO 4", "$APO.CDIS=V[I]", "LIN P[I] C_DIS", "ENDFOR"),
    ("V[2]=0", "FOR I=1 TO 4", "$VEL.CP=V[I]", "LIN P[I] C_DIS", "ENDFOR"),
    ("V[2]=$ANIN[1]", "FOR I=1 TO 4", "$VEL.CP=V[I]", "LIN P[I] C_DIS", "ENDFOR"),
    ("V[2]=.7", "FOR K=1 TO 2", "FOR I=1 TO 4", "$VEL.CP=V[I]", "LIN P[I] C_DIS", "ENDFOR", "V[1]=V[1]/2", "ENDFOR"),
    ("INTERRUPT DECL 4 WHEN $IN[1] DO V[2]=V[1]", "FOR I=1 TO 4", "$VEL.CP=V[I]", "LIN P[I]", "ENDFOR"),
    ("FOR I=1 TO 5", "$VEL.CP=V[I]", "LIN P[1]", "LIN Q[I-1]", "ENDFOR"),
    ("FOR I=1 TO 4", "$VEL.CP=N[I]", "$APO.CDIS=N[I]", "LIN P[I] C_DIS", "ENDFOR"),
    ("FOR I=1 TO 4", TRIGGER, "LIN P[I] C_DIS", "ENDFOR"),
    (
        "FOR I=1 TO 4",
        "TRIGGER WHEN PATH=-1 DELAY=0 DO $OUT[I]=TRUE",
        "LIN P[I]",
        TRIGGER,
        TRIGGER,
        "LIN Q[I]",
        "ENDFOR",
        TRIGGER,
    ),
    (
        "FOR I=1 TO 4",
        TRIGGER,
        "$VEL.CP=V[I]",
        "LIN P[I]",
        "ENDFOR",
        "LIN Q[1]",
        TRIGGER,
        "LIN Q[2]",
        *LOOP,
        TRIGGER,
        "LIN Q[3]",
    ),
    ("FOR I=1 TO 4", "TRIGGER WHEN PATH=V[I] DELAY=0 DO $OUT[1]=TRUE", "LIN P[I]", "ENDFOR"),
    ("FOR I=1 TO 4", "TRIGGER WHEN DISTANCE=0 DELAY=0 DO V[1]=0.2", "LIN P[I]", "ENDFOR", "$VEL.CP=V[1]", "LIN Q[1]"),
    ("FOR I=1 TO 4", "TRIGGER WHEN DISTANCE=0 DELAY=0 DO GONE() PRIO=-1", "LIN P[I]", "ENDFOR"),
    ("FOR I=1 TO 4", "TRIGGER WHEN DISTANCE=0 DO $OUT[1]=TRUE", "LIN P[I]", "ENDFOR"),
    (
        "$ANOUT[1]=0.5",
        "FOR I=1 TO 4",
        "TRIGGER WHEN DISTANCE=0 DELAY=0 DO $ANOUT[1]=0.4",
        "LIN P[I]",
        "ENDFOR",
        "LIN {X $ANOUT[1]}",
    ),
    ("IF $IN[1] THEN", "FOR I=1 TO 4", "$VEL.CP=V[I]", TRIGGER, "LIN P[I]", "ENDFOR", "ENDIF", "LIN Q[2] C_DIS"),
    ("FOR I=1 TO 5", "LIN P[I]", "ENDFOR"),
    ("V[2]=200", "FOR I=1 TO 4", "$VEL.CP=V[I]", "LIN P[I]", "ENDFOR"),  # faster than any robot
    ("FOR I=1 TO 0", "LIN P[I]", "ENDFOR", "LIN P[1]"),
    ("INTERRUPT DECL 4 WHEN $IN[1] DO P[2]=Q[1]", "INTERRUPT ON 4", *LOOP),
    ("INTERRUPT DECL 4 WHEN $IN[1] DO I=2", "INTERRUPT ON 4", *LOOP),
    ("$VEL.CP=Z", "$VEL.CP=$ANIN[1]", *LOOP),
    ("SUB()", "SUB()"),
    ("IF $IN[1] THEN", "LIN Q[1]", *LOOP, "LIN Q[2]", "ELSE", "LIN Q[2]", "ENDIF", *LOOP),
]
SUB = "DEF SUB()\r\nDECL INT I\r\n" + "\r\n".join(LOOP) + "\r\nEND\r\n"


def data(form, declared="DECL E6POS"):
    """Points of one form but for one in the middle of the second array."""
    points = [f"P[{n}]={form.format(x=10 * n)}" for n in range(1, 5)]
    others = [f"Q[{n}]={POINTS[0].format(x=5 * n)}" for n in range(1, 5)]
    speeds = [
        "DECL REAL V[4]",
        *(f"V[{n}]=0.{n}5" for n in range(1, 5)),
        "DECL INT N[4]",
        *(f"N[{n}]={n}" for n in range(1, 5)),
    ]
    names = ["DECL INT I=1", "DECL INT K=0", "DECL REAL Z=2.5"]
    lines = ["DEFDAT part PUBLIC", *names, *speeds, f"{declared} P[4]", *points]
    return "\r\n".join([*lines, "DECL E6POS Q[4]", *others, "ENDDAT", ""])


def outcome(lines, points, cell):
    """What is read, and what is written for some changes; or the message."""
    try:
        program = read(body(HOME, *lines) + SUB, points, cell)
    except PostprocError as error:
        return str(error)
    m = program.motions
    found = [m.kind, m.line, m.target, m.joints, m.feed, m.blend, m.status, m.turn, program.layout.numbers]
    found = [np.nan_to_num(each, nan=-1e9).tolist() for each in found]
    if not np.isnan(m.joints[:, 0]).any():
        return found
    rng, written = np.random.default_rng(3), []
    for size, part, pieces in ((1e-3, 1.0, {}), (1e-3, 0.5, {}), (1e-3, 1.0, {2: [0.5]}), (1e-3, 0.0, {})):
        shift = np.full((len(m), 3), size) * (rng.random(len(m)) < part)[:, None] * rng.integers(1, 3)
        pieces = {row: t for row, t in pieces.items() if row < len(m) and m.kind[row] != PTP}
        out = krl.rewrite(program, targets(program, shift, pieces=pieces))
        written.append([[d.text for d in out.documents], out.output_line.tolist(), [str(i) for i in out.issues]])
    return found, [str(issue) for issue in program.issues], written


CASES = [(lines, data(form), CELL) for form in POINTS for lines in BODIES[:4]]
CASES += [(lines, data(POINTS[0]), cell) for lines in BODIES[4:] for cell in (CELL, KEEPING)]
CASES += [(lines, data(POINTS[0], "DECL GLOBAL E6POS"), CELL) for lines in BODIES[:6]]


STATEMENTS = [
    *(f"{word} {array}[{index}]{tail}" for word in ("LIN", "PTP") for array in "PQ" for index in ("I", "I+1", "I-1")
      for tail in ("", " C_DIS")),
    *(f"{setting}={value}" for setting in ("$VEL.CP", "$APO.CDIS") for value in ("V[I]", "V[I+1]", "N[I]", "0.4", "7")),
    *(f"TRIGGER WHEN {place}={value} DELAY=0 DO {action}" for place in ("DISTANCE", "PATH") for value in (0, 1)
      for action in ("$OUT[2]=TRUE", "$ANOUT[I]=V[I]", "V[3]=0.1")),
    "$OUT[3]=FALSE", "V[2]=0.5", "V[I]=V[I]+0.1", "K=K+I", "Z=V[2]", "IF V[I]>0.3 THEN", "IF $IN[1] THEN", "EXIT",
    "SUB()", "LIN {X Z,Y K}",
]  # fmt: skip
MAY_RUN_AGAIN = ("V[2]=0.5", "$VEL.CP=V[4]", "V[3]=V[3]/2", "LIN Q[2] C_DIS", "K=K+1", "LIN {X K,Y 1}", TRIGGER)


def random_lines(seed):
    """Return nested loops over points with what may stand in their bodies, and lines around them."""
    rng = np.random.default_rng(seed)
    inner = [f"FOR I={rng.integers(1, 3)} TO {rng.integers(2, 5)}"]
    for statement in rng.choice(STATEMENTS[: -10 if rng.random() < 0.7 else None], rng.integers(1, 5)).tolist():
        inner += [statement, "LIN Q[I]", "ENDIF"] if statement.startswith("IF") else [statement]
    inner += ["LIN P[I] C_DIS", "ENDFOR", *rng.choice(MAY_RUN_AGAIN, rng.integers(0, 3)).tolist()]
    before = rng.choice(MAY_RUN_AGAIN, rng.integers(0, 3)).tolist()
    looped = ["FOR K=1 TO 2", *inner, "ENDFOR"] if rng.random() < 0.4 else inner
    return (*before, *looped, "LIN Q[1] C_DIS")


def random_case(seed):
    """Return lines, points and cell of a random program."""
    return random_lines(seed), data(POINTS[0]), KEEPING if seed % 3 == 0 else CELL


CASES += [random_case(seed) for seed in range(40)]


ONE_BY_ONE = ((main_routine, "motions_and_settings_of"), (flow, "plain_body"))
"""What takes rounds at once: it gives up, or no body is plain. They take turns: each body meets both."""


@pytest.mark.parametrize(
    ("lines", "points", "cell", "place", "name"),
    [(*case, *ONE_BY_ONE[number % 2]) for number, case in enumerate(CASES)],
)
def test_rounds_taken_at_once_mean_what_they_mean_one_by_one(lines, points, cell, place, name, monkeypatch):
    at_once = outcome(lines, points, cell)
    monkeypatch.setattr(place, name, lambda *_: None)
    assert at_once == outcome(lines, points, cell), lines


def test_points_of_a_loop_are_corrected_where_they_are():
    program = read(body(HOME, *LOOP), data(POINTS[0]))
    assert not program.layout.statements.keys() & {1, 2, 3, 4}
    shift = np.arange(len(program.motions))[:, None] * np.array([1e-3, 0, 0])
    source, written = krl.rewrite(program, targets(program, shift)).documents
    assert source.text == program.documents[0].text
    wanted = [f"P[{n}]={{X {11 * n}.0000,Y 2.5000,Z 3.0000,A 0.00000,B 0.00000,C 180.00000}}" for n in range(1, 5)]
    assert [line for line in written.text.split("\r\n") if line.startswith("P[")] == wanted
    again = krl.read_program((source, written), CELL, forward, "part")
    np.testing.assert_allclose(again.motions.target[1:, 0, 3], [0.011, 0.022, 0.033, 0.044], atol=1e-12)


@pytest.mark.parametrize(
    "lines",
    [
        ["LIN P[I] C_DIS"],
        ["LIN P[I+1] C_DIS"],
        ["LIN P[I] C_DIS", "$OUT[1]=TRUE"],
        ["$VEL.CP=V[I]", "LIN P[I] C_DIS"],
        ["TRIGGER WHEN DISTANCE=1 DELAY=0 DO $OUT[2]=TRUE", "LIN P[I] C_DIS"],
    ],
)
def test_a_round_costs_no_more_calls_than_a_plain_line_a_few_times_over(lines, monkeypatch):
    monkeypatch.setattr("postproc.dialects.krl.read.flow.MOST_TRACED", 400_000)  # random programs have a lower limit

    def making(count):
        points = "".join(f"P[{n}]={{X {n % 90},Y 2,Z 3,A 0,B 0,C 180}}\r\n" for n in range(1, count + 2))
        speeds = "".join(f"V[{n}]=0.{n % 7 + 1}\r\n" for n in range(1, count + 1) if "$VEL.CP=V[I]" in lines)
        names = f"DECL INT I=1\r\nDECL REAL V[{count}]\r\n{speeds}DECL E6POS P[{count + 1}]\r\n"
        text = f"DEFDAT part\r\n{names}{points}ENDDAT\r\n"
        source = body(HOME, f"FOR I=1 TO {count}", *lines, "ENDFOR")
        program = read(source, text)
        moved = targets(program, np.full((len(program.motions), 3), 1e-3))

        def work():
            krl.rewrite(read(source, text), moved)

        return work

    limit = 60 if len(lines) == 1 or "$OUT[1]=TRUE" in lines else 150  # speeds and TRIGGER have values of their own
    assert calls_for_each(making, 3000, 3600) < limit  # round by round: over 400
