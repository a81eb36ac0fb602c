"""Pictures of concepts: `python -m tests.documentation.concepts` writes them into docs/pictures as SVG.

correction.svg    nominal path, deflected tool, commanded path
frames.svg        root, $BASE, $TOOL and part
answers.svg       the three answers of a verdict
"""

# ruff: noqa: E501 - shapes of SVG

from __future__ import annotations

import math

from tests.places import ROOT

FOLDER = ROOT / "docs" / "pictures"
INK, SOFT, BEFORE, AFTER, COMMAND, PART = "#1c2430", "#5b6776", "#b4451f", "#0b6e99", "#4d6b1f", "#dbe1e8"
_STYLE = "font-family: system-ui, 'DejaVu Sans', sans-serif; font-size: 15px"


def svg(width: int, height: int, *shapes: str) -> str:
    marker = (
        '<defs><marker id="tip" viewBox="0 0 10 10" refX="9" refY="5" markerWidth="7" markerHeight="7" orient="auto-start-reverse">'
        '<path d="M0 0 L10 5 L0 10 z" fill="context-stroke"/></marker></defs>'
    )
    back = f'<rect width="{width}" height="{height}" rx="8" fill="#ffffff"/>'
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" width="{width}" height="{height}" '
        f'style="{_STYLE}">{marker}{back}{"".join(shapes)}</svg>\n'
    )


def text(x: float, y: float, words: str, colour: str = INK, anchor: str = "start", weight: int = 400) -> str:
    return f'<text x="{x:g}" y="{y:g}" fill="{colour}" text-anchor="{anchor}" font-weight="{weight}">{words}</text>'


def line(
    points: list[tuple[float, float]], colour: str, width: float = 2.5, dash: str = "", *, arrow: bool = False
) -> str:
    path = " ".join(f"{x:.1f},{y:.1f}" for x, y in points)
    end = ' marker-end="url(#tip)"' if arrow else ""
    return f'<polyline points="{path}" fill="none" stroke="{colour}" stroke-width="{width}" stroke-dasharray="{dash}"{end}/>'


def tool(x: float, y: float, colour: str, *, hollow: bool = False) -> str:
    """A flat cutter whose tip is at a place."""
    fill = "none" if hollow else f"{colour}33"
    return (
        f'<rect x="{x - 11:g}" y="{y - 62:g}" width="22" height="62" rx="2" fill="{fill}" stroke="{colour}" stroke-width="2"/>'
        f'<rect x="{x - 17:g}" y="{y - 92:g}" width="34" height="30" rx="3" fill="{fill}" stroke="{colour}" stroke-width="2"/>'
    )


def frame(x: float, y: float, name: str, colour: str, turn: float = 0.0, length: float = 52.0) -> str:
    """Axes X to the right and Z up, turned [deg]."""
    shapes = []
    for axis, angle in (("X", 0.0), ("Z", 90.0)):
        a = math.radians(angle + turn)
        end = (x + length * math.cos(a), y - length * math.sin(a))
        shapes.append(line([(x, y), end], colour, 2.5, arrow=True))
        shapes.append(text(end[0] + 6, end[1] + 4, axis, colour))
    return "".join(shapes) + text(x - 8, y + 20, name, colour, "end", 600)


def correction() -> str:
    """Without and with correction, side by side; the deflection is enlarged."""
    shapes = []
    for left, with_correction in ((20, False), (460, True)):
        surface = 240
        nominal = [(left + 20, surface - 40), (left + 380, surface - 40)]
        shapes.append(f'<rect x="{left + 20}" y="{surface - 40}" width="360" height="90" fill="{PART}"/>')
        shapes.append(line(nominal, INK, 2.5))
        off = 34
        if with_correction:
            shapes.append(line([(x, y + off) for x, y in nominal], COMMAND, 2, "8 5"))
            shapes.append(tool(left + 200, surface - 40 + off, COMMAND, hollow=True))
            shapes.append(tool(left + 200, surface - 40, AFTER))
            shapes.append(line([(left + 240, surface - 40 + off), (left + 240, surface - 36)], BEFORE, 2.5, arrow=True))
            shapes.append(text(left + 250, surface - 14, "deflection", BEFORE))
            shapes.append(text(left + 24, surface - 12, "commanded", COMMAND))
            shapes.append(text(left + 24, surface - 48, "tool = nominal", AFTER))
            shapes.append(text(left + 200, 32, "corrected: the deflected tool is on the path", INK, "middle", 600))
        else:
            shapes.append(line([(x, y - off) for x, y in nominal], BEFORE, 2, "8 5"))
            shapes.append(tool(left + 200, surface - 40, SOFT, hollow=True))
            shapes.append(tool(left + 200, surface - 40 - off, BEFORE))
            shapes.append(line([(left + 240, surface - 40), (left + 240, surface - 70)], BEFORE, 2.5, arrow=True))
            shapes.append(text(left + 250, surface - 50, "deflection", BEFORE))
            shapes.append(text(left + 24, surface - 20, "nominal = commanded", INK))
            shapes.append(text(left + 24, surface - 82, "where the tool is", BEFORE))
            shapes.append(text(left + 200, 32, "as programmed: material is left", INK, "middle", 600))
    return svg(880, 310, *shapes)


def frames() -> str:
    """Robot, flange, tool and part with their frames, from the side."""
    arm = [(120, 330), (120, 240), (210, 110), (400, 130), (470, 150)]
    shapes = [f'<rect x="60" y="330" width="120" height="16" fill="{SOFT}"/>', line(arm, SOFT, 16)]
    shapes += [
        f'<circle cx="{x}" cy="{y}" r="11" fill="#ffffff" stroke="{SOFT}" stroke-width="3"/>' for x, y in arm[1:4]
    ]
    shapes += [f'<rect x="456" y="150" width="28" height="46" fill="{SOFT}"/>', tool(470, 290, AFTER)]
    shapes += [f'<rect x="420" y="290" width="280" height="40" fill="{PART}" stroke="{SOFT}"/>']
    shapes += [f'<rect x="380" y="330" width="360" height="16" fill="{SOFT}"/>']
    shapes += [
        frame(120, 330, "", INK),
        text(20, 366, "$ROBROOT", INK, "start", 600),
        frame(700, 290, "", BEFORE),
        text(712, 316, "$BASE", BEFORE, "start", 600),
    ]
    shapes += [text(500, 250, "$TOOL: the tip", AFTER, "start", 600), text(500, 270, "in the flange frame", AFTER)]
    shapes += [line([(560, 180), (488, 190)], INK, 1.5, arrow=True), text(566, 184, "flange")]
    shapes += [text(560, 316, "part", INK, "middle")]
    shapes += [
        line([(150, 362), (690, 362)], SOFT, 1.2, "4 4"),
        text(420, 380, "[base] of the cell: X, Y, Z, A, B, C in the root", BEFORE, "middle"),
    ]
    return svg(800, 400, *shapes)


def answers() -> str:
    """Three questions, each with what it is answered from."""
    rows = [
        ("May it be driven?", "limits, speeds, collisions, material,", "the written text read back and simulated", AFTER),
        ("Is it better than uncorrected?", "expected errors (95 %) with and without correction,", "by the uncertainty of model and forces", AFTER),
        ("Does it hold your tolerance?", "expected error on the part against [part] tolerance_mm;", "what would help, if it does not", AFTER),
    ]  # fmt: skip
    shapes = []
    for k, (question, first, second, colour) in enumerate(rows):
        y = 24 + 92 * k
        shapes.append(f'<rect x="20" y="{y}" width="270" height="72" rx="8" fill="{colour}"/>')
        shapes.append(text(155, y + 42, question, "#ffffff", "middle", 600))
        shapes.append(line([(290, y + 36), (330, y + 36)], colour, 2.5, arrow=True))
        shapes.append(text(344, y + 32, first) + text(344, y + 52, second))
    return svg(800, 300, *shapes)


def main() -> None:
    for draw in (correction, frames, answers):
        (FOLDER / f"{draw.__name__}.svg").write_text(draw(), encoding="utf-8")


if __name__ == "__main__":
    main()
