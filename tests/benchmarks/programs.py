"""Programs as CAM systems write them, for measuring: a finishing pass, loops of half circles, rounded corners."""

from __future__ import annotations

import numpy as np

RAMP_UNDER_FORCE = "%\nG21 G90 G17\nS10000 M3\nG0 X0 Y0 Z20\n(FORCE FX=60 FY=-40 FZ=90)\nG1 Z0 F3000\n"
TAIL = "G0 Z50\nM5\nM30\n%\n"
LINES = {
    "modal lines": "X{:.3f} Y{:.3f} Z{:.3f}",
    "lines": "G1 X{:.3f} Y{:.3f} Z{:.3f}",
    "numbered lines": "N{n} G1 X{:.3f} Y{:.3f} Z{:.3f}",
}
"""Stretches to write the blocks of a finishing pass."""


def _zigzag(blocks: int) -> np.ndarray:
    """Return the points (blocks, 3) of a zigzag over a wavy surface, 0.5 mm steps [mm]."""
    s = np.arange(blocks) * 0.5
    x, y = np.abs(s % 240 - 120), (s // 120) * 0.1 % 300
    return np.stack([x, y, 3 * np.sin(x / 20) * np.cos(y / 15)], axis=1)


def lines(blocks: int, form: str) -> str:
    """Return a finishing pass of straight blocks."""
    rows = enumerate(_zigzag(blocks).tolist())
    return RAMP_UNDER_FORCE + "".join(form.format(*row, n=10 * n) + "\n" for n, row in rows) + TAIL


def half_circles(blocks: int) -> str:
    """Return a pocket cut in loops: half circles of 1 to 4 mm, one after the other, feed along y."""
    out, x, y = [], 0.0, 0.0
    for n in range(blocks):
        radius, sign = 1.0 + (n * 7 % 31) / 10.0, 1.0 if n // 50 % 2 == 0 else -1.0
        y = round(y + sign * 2.0 * radius, 3)
        out.append(f"G{2 + n % 2} X{x:.3f} Y{y:.3f} I0.000 J{sign * radius:.3f}\n")
    return RAMP_UNDER_FORCE + "".join(out) + TAIL


def rounded_corners(blocks: int) -> str:
    """Return an adaptive clearing: straight runs, quarter circles between them, and every 40th arc a helix."""
    out, x, y, z, heading = [], 0.0, 0.0, 0.0, 0.0
    for n in range(blocks):
        if n % 2 == 0:
            run = 2.0 + (n * 13 % 37) / 10.0
            x, y = x + run * np.cos(heading), y + run * np.sin(heading)
            out.append(f"G1 X{x:.4f} Y{y:.4f}\n")
        else:
            radius, left = 0.5 + (n * 11 % 23) / 5.0, (n // 2) % 4 < 2
            turn = np.pi / 2.0 * (1.0 if left else -1.0)
            i, j = -radius * np.sin(heading) * np.sign(turn), radius * np.cos(heading) * np.sign(turn)
            heading += turn
            x, y = (x + i + radius * np.sin(heading) * np.sign(turn), y + j - radius * np.cos(heading) * np.sign(turn))
            rise = ""
            if n % 40 == 1:
                z = -0.1 if z == 0.0 else 0.0
                rise = f" Z{z:.3f}"
            out.append(f"G{3 if left else 2} X{x:.4f} Y{y:.4f}{rise} I{i:.4f} J{j:.4f}\n")
            if not (-200.0 < x < 200.0 and -200.0 < y < 200.0):
                heading = np.arctan2(-y, -x)
    return RAMP_UNDER_FORCE + "".join(out) + TAIL


def calls(blocks: int) -> tuple[str, str]:
    """Return pockets by subprogram and holes by cycle, and the same as the lines that are executed."""
    pocket = ["G1 Z-1.000", *(f"G1 X{n % 8:.3f} Y{n / 8:.3f}" for n in range(60)), "G0 Z5.000"]
    holes = [f"X{n * 3.0:.3f} Y{n % 5:.3f}" for n in range(36)]
    body, written = [], []
    for n in range(max(1, blocks // 100)):
        place = f"X{n % 12 * 10.0:.3f} Y{n // 12 % 25 * 9.0:.3f}"
        first = "G98 G83 X0.000 Y0.000 Z-4.000 R2.000 Q3.000"
        body += [f"G52 {place}", "G0 X0 Y0", f"o100 call [{n % 3}]", first, *holes, "G80"]
        written += [f"G52 {place}", "G0 X0 Y0", *pocket, first, *holes, "G80"]
    sub = ["o100 sub", *(line.replace("G1 Z-1.000", "G1 Z[-1 - #1 / 10]") for line in pocket), "o100 endsub"]
    return RAMP_UNDER_FORCE.replace("%\n", "%\n" + "\n".join(sub) + "\n", 1) + "\n".join(body) + "\n" + TAIL, "\n".join(
        written
    )


def krl(blocks: int) -> str:
    """Return the finishing pass as a KRL program of another post-processor."""
    form = f"LIN {{{{{_POSE}}}}} C_DIS\r\n"
    return _KRL_HEAD + "".join(form.format(*row) for row in _zigzag(blocks).tolist()) + "END\r\n"


def krl_loop(blocks: int) -> tuple[str, str]:
    """Return the same as a FOR over the points of an array, `.src` and `.dat`."""
    form = f"XP[{{}}]={{{{{_POSE}}}}}\r\n"
    points = "".join(form.format(n, *row) for n, row in enumerate(_zigzag(blocks).tolist(), 1))
    data = f"DEFDAT PART PUBLIC\r\nDECL INT I=1\r\nDECL E6POS XP[{blocks}]\r\n{points}ENDDAT\r\n"
    return f"{_KRL_HEAD}FOR I=1 TO {blocks}\r\nLIN XP[I] C_DIS\r\nENDFOR\r\nEND\r\n", data


_POSE = "X {:.3f},Y {:.3f},Z {:.3f},A 0.000,B 0.000,C 180.000"
_KRL_HEAD = (
    "&ACCESS RVP\r\nDEF PART( )\r\nBAS (#INITMOV,0 )\r\n$BASE={X 1500,Y -200,Z 700,A 0,B 0,C 0}\r\n"
    "$TOOL={X 0,Y 0,Z 350,A 0,B 0,C 0}\r\n$APO.CDIS=0.2\r\nPTP {A1 0,A2 -70,A3 110,A4 0,A5 50,A6 0}\r\n"
    "$VEL.CP=0.05\r\n;FORCE FX=60 FY=-40 FZ=90\r\n"
)
