"""FOR whose points are computed from the counter: taken at once, it means what it means round by round."""

import contextlib

import numpy as np
import pytest
from msgspec.structs import replace

from postproc.dialects import krl
from postproc.dialects.krl.read import flow, main_routine
from postproc.errors import PostprocError
from tests.dialects.krl_programs import CELL, body, read, targets
from tests.dialects.test_krl_plain_rounds import KEEPING, POINTS, SUB, data, outcome
from tests.effort import calls_for_each
from tests.krl_texts import HOME

GIVING = replace(CELL, krl=replace(CELL.krl, values={"G": 2.5, "G2[2]": 3.0}))
VARIABLES = (
    *("DECL FRAME XT,XU={X 4,Y 4,Z 4,A 0,B 0,C 180}", "DECL E6POS XE", "DECL REAL R,G=1,G2[4]", "DECL INT N1,T[4]"),
    *("T[1]=2", "T[2]=1", "T[3]=4", "T[4]=3", "G2[2]=5"),
)
MOTIONS = [
    "LIN {X 9+I,Y 2,Z 1,A 0,B 0,C 180} C_DIS",
    "LIN {X 90*COS(I*20.5),Y 90*SIN(-I*0.7),Z 1+I/4,A 0,B 0,C 180}",
    "PTP {A I,B 0,C 180,X ABS(2.5-I),Y SQRT(I),Z ATAN2(I,2)}",
    "LIN {X I*V[I],Y N[I]/2,Z T[T[I]],A 0,B TAN(I),C 180-ACOS(I/8)} C_DIS",
    "LIN {X Z,Y K,Z G+R,A 0,B 0,C 180}",
    "LIN {X I}",
    "LIN {X I,Y 2,Z 1,A 0,B 0,C 180,S 2}",
    *("LIN XT C_DIS", "LIN XT", "PTP XE", "LIN XU C_DIS", "LIN XT:Q[1]", "SLIN XE"),
]
FITTING = [
    *(("XT=P[I]", "LIN XT C_DIS"), ("XE=Q[T[I]]", "PTP XE"), ("XU=P[5-I]", "LIN XU C_DIS"), ("XT=P[1]", "LIN XT")),
    *(("R=I*1.5", "LIN {X R,Y -R,Z 1,A 0,B 0,C 180}"), ("N1=I*0.7", "LIN {X N1/2,Y I/N1,Z 1,A 0,B 0,C 180}")),
    *(("R=V[I]", "LIN {X 1,Y R*I,Z SQRT(R),A 0,B 0,C 180}"), ("N1=T[I]", "LIN {X N1*N1,Y T[N1],Z 1,A 0,B 0,C 180}")),
    *(("$OUT[3]=TRUE", MOTIONS[0]), ("N1=N[I]*2", "LIN {X 1,Y 2,Z N1/2,A 0,B 0,C 180}"), ("XE=P[I]", MOTIONS[1])),
]
OTHERS = [
    *(f"{name}={value}" for name in ("XT", "XE", "XU") for value in ("P[I]", "Q[I+1]", "P[5-I]", "Q[T[I]]", "P[1]")),
    *(f"R={value}" for value in ("I/2", "I*2", "V[I]", "R+1", "Z*I", "ATAN2(I,0)", "I*1E200*1E200", "SQRT(2-I)")),
    *(f"N1={value}" for value in ("I*0.4", "I/2", "I*2147483640", "7/(I-2)", "N[I]", "I*0.5", "G2[2]+I", "-7/I")),
    *("$OUT[3]=TRUE", "$VEL.CP=0.3", "XT.X=4", "XT={X 1,Y 2,Z 3,A 0,B 0,C 180}", "XT=XU", "P[I]=Q[I]", "N1=T[N1]"),
    *("Z=K", "T[1]=I", "G=G+0", "R=G2[I]", "XT=P[I]:Q[1]"),
]
AROUND = [
    *(
        "LIN XT",
        "LIN XU",
        "LIN {X R,Y N1,Z 1}",
        "R=2",
        "N1=3",
        "XT=Q[1]",
        "XE=XU",
        "LIN P[2]",
        "LIN {X I,Y Z}",
        "SUB()",
    ),
    *("INTERRUPT DECL 4 WHEN $IN[1] DO XT=Q[1]", "INTERRUPT DECL 5 WHEN $IN[1] DO R=2", "P[2].X=7", "Q[3]={X 1}"),
    *("SUB()", "P[2]={X 7,Y 7,Z 7,A 0,B 0,C 180}", "IF R>2 THEN", "V[2]=$ANIN[1]", "XU=P[1]"),
]


def random_lines(seed):
    """Return a loop that computes its points, perhaps in another one, and lines around it."""
    rng = np.random.default_rng(seed)

    def some(kinds, most):
        chosen = rng.choice(kinds, rng.integers(0, most)).tolist()
        return [line for one in chosen for line in ([one, "LIN P[1]", "ENDIF"] if one.startswith("IF") else [one])]

    head = ("FOR I=1 TO 4", "FOR I=4 TO 1 STEP -1", "FOR I=1 TO 3 STEP 2", "FOR I=N1 TO 4", "FOR I=2 TO 3")[
        int(rng.choice(5, p=[0.5, 0.15, 0.15, 0.05, 0.15]))
    ]
    assignment = rng.choice(("XT=P[I]", "XE=Q[I]", "R=I*1.5", "N1=2*I", "XT=Q[I+1]", "XU=P[I]"))
    inner = [*some(OTHERS, 3), str(assignment), *some(OTHERS, 2), *some(MOTIONS, 4), str(rng.choice(MOTIONS))]
    if rng.random() < 0.6:
        pairs = [FITTING[n] for n in rng.choice(len(FITTING), rng.integers(1, 3))]
        inner = [*(line for pair in pairs for line in pair), *some(MOTIONS[:4], 2)]
    loop = [head, *inner, "ENDFOR"]
    if rng.random() < 0.25:
        loop = ["FOR K=1 TO 2", *loop, *some(AROUND, 2), "ENDFOR"]
    return [*some(AROUND, 3), *loop, *some(AROUND, 3), "LIN Q[1] C_DIS"]


def points(seed):
    """Return a data list; most points are complete."""
    form = POINTS[0] if seed % 4 else POINTS[seed // 4 % len(POINTS)]
    return data(form).replace("ENDDAT", "\r\n".join([*VARIABLES, "ENDDAT"]))


ONE_BY_ONE = ((main_routine, "computed_motions"), (flow, "computed_body"))
"""What computes rounds at once: it gives up, or no body is computed."""


def random_case(seed):
    """Return lines, points and cell of a random program."""
    return random_lines(seed), points(seed), (CELL, CELL, KEEPING, GIVING)[seed % 4]


@pytest.mark.parametrize("seed", range(48))
def test_rounds_computed_at_once_mean_what_they_mean_one_by_one(seed, monkeypatch):
    """For thousands of programs: `python -m tests.benchmarks.krl_rounds`."""
    monkeypatch.setattr(flow, "FEWEST_ROUNDS", 1)
    case = random_case(seed)
    at_once = outcome(*case)
    place, name = ONE_BY_ONE[seed // 4 % 2]
    monkeypatch.setattr(place, name, lambda *_: None)
    assert at_once == outcome(*case), case[0]


def test_many_of_the_random_rounds_are_computed_at_once(monkeypatch):
    monkeypatch.setattr(flow, "FEWEST_ROUNDS", 1)
    taken = []

    def noting(*arguments):
        motions = computed_motions(*arguments)
        taken.append(motions is not None)
        return motions

    computed_motions = main_routine.computed_motions
    monkeypatch.setattr(main_routine, "computed_motions", noting)
    for seed in range(100):
        with contextlib.suppress(PostprocError):
            read(body(HOME, *random_lines(seed)) + SUB, points(seed))
    assert sum(taken) > 20
    assert taken.count(False) > 5


@pytest.mark.parametrize(
    ("lines", "limit"),
    [
        (["LIN {X 90*COS(I*0.7),Y 90*SIN(I*0.7),Z 1+0.001*I,A 0,B 0,C 180} C_DIS"], 320),  # round by round: over 750
        (["XT=P[I]", "LIN XT C_DIS"], 400),  # over 560
    ],
)
def test_a_computed_round_costs_few_calls(lines, limit, monkeypatch):
    monkeypatch.setattr(flow, "MOST_TRACED", 400_000)  # random programs have a lower limit

    def making(count):
        elements = "".join(f"P[{n}]={{X {n % 90},Y 2,Z 3,A 0,B 0,C 180}}\r\n" for n in range(1, count + 1))
        text = f"DEFDAT part\r\nDECL INT I=1\r\nDECL FRAME XT\r\nDECL E6POS P[{count}]\r\n{elements}ENDDAT\r\n"
        source = body(HOME, f"FOR I=1 TO {count}", *lines, "ENDFOR")
        program = read(source, text)
        moved = targets(program, np.full((len(program.motions), 3), 1e-3))

        def work():
            krl.rewrite(read(source, text), moved)

        return work

    assert calls_for_each(making, 3000, 3600) < limit
