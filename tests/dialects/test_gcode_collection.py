"""Programs as many CAM systems, hobby senders and controls have them: converted right, or refused with what to do.

They were written after what posts print, for this test. Those that rs274 accepts are held against it; the others say
something that it does not know (G43.4, G187, no M2), or are for something else.
"""

from __future__ import annotations

from functools import cache
from pathlib import Path

import pytest
from msgspec.structs import replace

from postproc.cell import Frame, Machine, Rotary
from postproc.errors import ProgramError
from postproc.program import Program
from tests.attack import collected
from tests.attack.collected import difference
from tests.dialects.gcode_reading import CELL, read
from tests.oracle.rs274 import Move, RejectedError, needs_rs274

COLLECTION = Path(__file__).parent / "collection"
NAMES = sorted(path.name for path in COLLECTION.iterdir())
HERE = replace(
    CELL,
    base=Frame(),
    gcode=replace(CELL.gcode, spindle_on=["; on"], spindle_ccw=["; backwards"]),
    machine=Machine(home=(0.0, -90.0, 100.0, 0.0, 20.0, 0.0), clearance_Z=50.0),
    work_offsets={},
    tools={str(number): Frame(Z=350.0) for number in range(1, 10)},
)
AXES = {
    "fusion_linuxcnc_tcp.ngc": ["C", "B"],
    "solidcam_5x.nc": ["C", "B"],
    "delta_5ax_ac.nc": ["C", "A"],
    "freecad_rotary.ngc": ["A"],
    "mastercam_haas_4x.nc": ["A"],
}
"""Programs with rotary axes, read with them."""
REFUSED = {
    # line, problem
    "aspire_shopbot.nc": (1, "this is not plain G-code, but a ShopBot program"),
    "block_delete.nc": (7, "unexpected character '/'"),
    "brother.nc": (4, "G100 is not known"),
    "carbide_create.nc": (18, "arc without I, J, K or R"),
    "catia_apt.nc": (1, "this is not plain G-code, but an APT cutter-location (CLSF) program"),
    "cura.gcode": (3, "this is not plain G-code, but a slicer (3-D printing) program"),
    "dwell_ms.nc": (3, "G4 P3000 is 3000 s or 3000 ms: the cell does not say"),
    "eding.nc": (6, "this is not plain G-code, but a Fanuc custom macro (B) program"),
    "fanuc_g41_offset.nc": (1, "an O word among other words"),
    "fanuc_lathe.nc": (4, "this is not plain G-code, but a lathe program"),
    "fanuc_m6_no_t.nc": (4, "M6 without a T before it"),
    "freecad_centroid.cnc": (7, "M25 is not known"),
    "fusion_haas_wcs.nc": (8, "G54.1 is not supported"),
    "g187_g68.nc": (3, "G68 is not supported"),
    "g50_lathe.nc": (3, "G50 is not supported"),
    "heidenhain_iso.nc": (2, "this is not plain G-code, but a Heidenhain DIN/ISO program"),
    "hpgl.nc": (1, "this is not plain G-code, but a plotter (HP-GL) or isel program"),
    "inventor_siemens.mpf": (4, "this is not plain G-code, but a Siemens Sinumerik program"),
    "isel.ncp.nc": (1, "this is not plain G-code, but a plotter (HP-GL) or isel program"),
    "laserweb.gcode": (6, "cutting move before the position is known"),
    "lightburn.gcode": (10, "cutting move before the position is known"),
    "linuxcnc_aux.ngc": (7, "G96 is not supported"),
    "linuxcnc_msgs.ngc": (9, "M64 is not supported"),
    "linuxcnc_polar.ngc": (3, "unexpected character '@'"),
    "linuxcnc_probe.ngc": (3, "G38.2 is not supported"),
    "linuxcnc_state.ngc": (3, "M73 is not supported"),
    "mastercam_comp.nc": (9, "G41 is not supported"),
    "mastercam_g65.nc": (5, "G65 is not supported"),
    "mastercam_macro.nc": (7, "this is not plain G-code, but a Fanuc custom macro (B) program"),
    "mastercam_subs.nc": (9, "subprogram O33001 is neither in this file nor in its folder"),
    "mazak_eia.eia.nc": (7, "2 T words in one block"),
    "nx_clsf.nc": (1, "this is not plain G-code, but an APT cutter-location (CLSF) program"),
    "nx_fanuc.ptp": (2, "this is not plain G-code, but a Siemens Sinumerik program"),
    "okuma.nc": (1, "this is not plain G-code, but an Okuma program"),
    "plasmac.ngc": (4, "M65 is not supported"),
    "powermill_heidenhain.h.nc": (1, "this is not plain G-code, but a Heidenhain Klartext program"),
    "prusaslicer.gcode": (5, "this is not plain G-code, but a slicer (3-D printing) program"),
    "rotary_wrap.nc": (5, "cutting move before the position is known"),
    "siemens_frames.mpf": (2, "this is not plain G-code, but a Siemens Sinumerik program"),
    "siemens_plain.mpf": (1, "this is not plain G-code, but a Siemens Sinumerik program"),
    "siemens_r.spf.nc": (1, "this is not plain G-code, but a Siemens Sinumerik program"),
    "smoothie_s_curve.nc": (6, "G5 is not supported"),
    "solidcam_g68.nc": (6, "G68.2 is not supported"),
    "xy_only_2d.nc": (3, "cutting move before the position is known"),
}


def here(name: str) -> Program:
    cell = replace(HERE, rotary=Rotary(axes=AXES[name], kind="tcp")) if name in AXES else HERE
    return read((COLLECTION / name).read_bytes(), cell)


@pytest.mark.parametrize("name", REFUSED)
def test_what_is_refused_says_where_why_and_what_to_do(name: str) -> None:
    line, problem = REFUSED[name]
    with pytest.raises(ProgramError) as caught:
        here(name)
    assert (caught.value.line, caught.value.problem) == (line, problem)
    assert caught.value.advice


@needs_rs274
@pytest.mark.parametrize("name", [name for name in NAMES if name not in REFUSED])
def test_what_is_converted_cuts_what_rs274_cuts(name: str) -> None:
    program = here(name)
    assert (~program.motions.rapid).any()
    compare(name, program)


@needs_rs274
def test_most_of_them_are_compared() -> None:
    compared = [name for name in NAMES if name not in REFUSED and there(name) is not None]
    assert len(NAMES) > 100
    assert len(compared) >= 40


def compare(name: str, program: Program) -> None:
    """Compare cutting moves, rapids and what is switched; nothing if rs274 refuses the program."""
    found = there(name)
    if found is not None:
        text = (COLLECTION / name).read_bytes().decode()
        assert difference(program, found, text, turning=name in AXES) == ""


@cache
def there(name: str) -> list[Move] | None:
    """Return the moves of rs274; None if it refuses the program."""
    try:
        return collected.moves_there(COLLECTION / name, alone=True)
    except RejectedError:
        return None


@needs_rs274
def test_a_wrong_program_would_be_noticed() -> None:
    with pytest.raises(AssertionError):
        compare("edgecam.nc", here("gibbscam.nc"))
