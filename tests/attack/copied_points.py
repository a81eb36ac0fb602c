"""Random KRL that copies points, passes them to routines and reads them, against a controller that executes it.

    python -m tests.attack.copied_points --seed 5000 --programs 700

A corrected point is written where its numbers are, also if a motion uses a copy of it; but not where anything else than
a motion reads it, or one of its copies. What is written must move to the corrected targets.
"""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np

from postproc.errors import PostprocError
from tests.attack.driver import parser, try_seeds
from tests.attack.krl import confirmed, read_job

_POINTS = ("XT", "YT", "FT", "ZT", "GT", "PP[1]", "PP[2]", "PP[3]", "PP[4]", "PP[I]", "PP[N]")
_POINTS_DAT = (
    *("DEFDAT part", "DECL INT I=1,N=2", "DECL REAL R=1", "DECL BOOL OK=TRUE", "DECL E6POS PP[6]"),
    *("DECL E6POS XT={X 900,Y 1,Z 600,A 0,B 90,C 0}", "DECL E6POS YT={X 930,Y 4,Z 640,A 1,B 88,C 0}"),
    *("DECL FRAME FT={X 910,Y 2,Z 610,A 0,B 90,C 0}", "DECL GLOBAL E6POS GT={X 905,Y 4,Z 620,A 1,B 88,C 0}"),
    *(f"PP[{n}]={{X {880 + 7 * n},Y {5 * n},Z {600 + n},A 0,B 90,C {n}}}" for n in range(1, 7)),
    "ENDDAT",
)
_FIRST_LINES = (
    *("DEF part( )", "DECL E6POS ZT", "DECL FRAME KT", "BAS (#INITMOV,0 )"),
    *("PTP {A1 0,A2 -70,A3 110,A4 0,A5 50,A6 0}", "$VEL.CP=0.2", "$BASE=BASE_DATA[1]", "$TOOL=TOOL_DATA[1]"),
    "ZT={X 911,Y 3,Z 605,A 0,B 90,C 0}",
)
_ROUTINES = (
    ("DEF CUT(C:IN)", "DECL E6POS C", "LIN C C_DIS", "END"),
    ("DEF CUT2(D:IN,K:IN)", "DECL E6POS D,W", "DECL INT K", "W=D", "IF K>1 THEN", "LIN W", "ENDIF", "LIN PP[K]", "END"),
    ("DEF SHIFT(E:OUT)", "DECL E6POS E", "E.Z=E.Z+1", "LIN E", "END"),
    ("DEF LOOK(F:IN)", "DECL E6POS F", "LIN {X 890,Y 3,Z F.Z,A 0,B 90,C 0}", "END"),
    ("DEFFCT REAL HIGH(G:IN)", "DECL E6POS G", "RETURN(G.Z+1)", "ENDFCT"),
    ("DEF SWAP(H:OUT,J:OUT)", "DECL E6POS H,J,V", "V=H", "H=J", "J=V", "END"),
    ("DEF DEEP(M:IN)", "DECL E6POS M", "CUT(M)", "CUT(M)", "END"),
    ("DEF WHOLE(Q[]:OUT,L:IN)", "DECL E6POS Q[]", "DECL INT L", "LIN Q[L]", "XT=Q[L]", "END"),
    ("DEF SETS()", "XT=PP[2]", "END"),
    ("DEF GOES()", "LIN XT", "END"),
)
"""Each has names of its own: a name that something else reads anywhere keeps its points as they are."""
_NAMES = [routine[0].partition("(")[0].split()[-1] for routine in _ROUTINES]
_STATEMENTS = (
    *(("{p}={q}",), ("{p}={q}",), ("{p}={q}", "LIN {p}"), ("{p}={q}", "CUT({p})"), ("KT={p}", "LIN KT")),
    *(("LIN {p}",), ("LIN {p} C_DIS",), ("CUT({p})",), ("CUT({p})",), ("CUT2({p},{n})",), ("DEEP({p})",)),
    *(
        ("SHIFT({p})",),
        ("LOOK({p})",),
        ("R=HIGH({p})", "LIN {{X 890,Y 3,Z R,A 0,B 90,C 0}}"),
        ("SWAP({p},{q})",),
        ("WHOLE(PP[],{n})",),
        ("SETS()",),
    ),
    *(("GOES()",), ("{p}.Z={q}.Z+1",), ("LIN {p}:{{X 1,Y 0,Z 0,A 0,B 0,C 0}}",), ("N={n}",), ("PTP {p}",)),
    *(("R={p}.Z", "LIN {{X 890,Y 3,Z R,A 0,B 90,C 0}}"), ("LIN {{X 890,Y 3,Z 607,A 0,B 90,C 0}}",)),
    ("LIN {{X {p}.X,Y {q}.Y,Z 600,A 0,B 90,C 0}}",),
)
_AROUND = ("FOR I=1 TO 3", "FOR I=1 TO 4", "IF {p}.Z>603 THEN", "IF OK THEN")


def _lines(rng: np.random.Generator, depth: int = 0) -> list[str]:
    """Return some statements, perhaps with some in a control structure behind them."""

    def filled(text: str) -> str:
        return text.format(p=p, q=q, n=rng.integers(1, 4))

    lines: list[str] = []
    for _ in range(int(rng.integers(2, 6))):
        p, q = rng.choice(_POINTS, 2).tolist()
        lines += map(filled, _STATEMENTS[int(rng.integers(len(_STATEMENTS)))])
    if depth < 2 and rng.random() < 0.7:
        opener = filled(str(rng.choice(_AROUND)))
        lines += [opener, *_lines(rng, depth + 1), f"END{opener.split()[0]}"]
    return lines


def files_of(rng: np.random.Generator) -> dict[str, str]:
    """Return a random program: name → text."""
    lines = _lines(rng)
    called = {name for name in _NAMES if any(f"{name}(" in line for line in lines)}
    called |= {"CUT"} if "DEEP" in called else set()
    routines = [line for name, routine in zip(_NAMES, _ROUTINES, strict=True) if name in called for line in routine]
    source = (*_FIRST_LINES, *lines, "LIN {X 900,Y 0,Z 650,A 0,B 90,C 0}", "END", *routines)
    return {name: "\r\n".join([*lines, ""]) for name, lines in (("part.src", source), ("part.dat", _POINTS_DAT))}


def attempt(seed: int, folder: Path) -> str:
    """Return what became of the program of a seed: ``"refused"``, ``"invalid"``, ``"accepted"``, or ``"with copies"``.

    :raises Wrong: the package is wrong.
    """
    rng = np.random.default_rng(seed)
    files = files_of(rng)
    try:
        program = read_job(files, folder)
    except PostprocError:
        return "refused"
    state = confirmed(program, files, folder, rng)
    return "with copies" if state == "accepted" and program.layout.copies else state


def attack(seed: int) -> str:
    """Try the program of a seed, see `attempt`."""
    with tempfile.TemporaryDirectory() as folder:
        return attempt(seed, Path(folder))


def main() -> int:
    """Try programs, and count what came of them."""
    return try_seeds(parser(__doc__).parse_args(), attack)


if __name__ == "__main__":
    raise SystemExit(main())
