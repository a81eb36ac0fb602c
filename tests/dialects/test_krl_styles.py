"""Whole programs in the styles of CAM systems and of the controller itself, read, rewritten, read again."""

import numpy as np
import pytest

from postproc.dialects import krl
from postproc.program import CIRC, LIN, PTP
from tests.dialects.krl_programs import check_commands, numbers, read, targets
from tests.dialects.test_krl_reading import INLINE, INLINE_DATA

POST = r"""&ACCESS RVP
&REL 1
&PARAM TEMPLATE = C:\KRC\Roboter\Template\vorgabe
&PARAM EDITMASK = *
DEF part ( )
EXT BAS (BAS_COMMAND :IN,REAL :IN )
;FOLD STARTPOS
GLOBAL INTERRUPT DECL 3 WHEN $STOPMESS==TRUE DO IR_STOPM ( )
INTERRUPT ON 3
BAS (#INITMOV,0)
BAS (#VEL_PTP,100)
BAS (#ACC_PTP,20)
$VEL.CP=0.2
BAS (#TOOL,0)
BAS (#BASE,0)
;ENDFOLD
$ADVANCE = 5
;FOLD skip BCO
PTP $AXIS_ACT
;ENDFOLD
$TOOL = {FRAME: X 10.000,Y 0.000,Z 250.000,A 0.000,B 0.000,C 0.000}
$BASE = {FRAME: X 1500.000,Y 0.000,Z 500.000,A 0.000,B 0.000,C 0.000}
$APO.CPTP = 1
$APO.CDIS = 0.5
PTP {A1 10.00000,A2 -80.00000,A3 95.00000,A4 0.00000,A5 40.00000,A6 0.00000} C_PTP
LIN {X 100.000,Y 0.000,Z 50.000,A -180.000,B 0.000,C 180.000} C_DIS
$VEL.CP = 0.05000
LIN {X 100.000,Y 0.000,Z 0.000,A -180.000,B 0.000,C 180.000} C_DIS
CIRC {X 110.0,Y 10.0,Z 0.0,A -180.0,B 0.0,C 180.0},{X 120.0,Y 0.0,Z 0.0,A -180.0,B 0.0,C 180.0} C_DIS
$OUT[5] = TRUE
LIN {X 100.000,Y 0.000,Z 50.000,A -180.000,B 0.000,C 180.000}
END
"""
TAGGED = """&ACCESS RVP
DEF PART()
 ;------- Declaration section
 DECL INT I
 DECL REAL SPEED
 DECL E6POS POINT1
 BAS (#INITMOV,0 )
 FOR I=1 TO 6
   $VEL_AXIS[I]=50
   $ACC_AXIS[I]=50
 ENDFOR
 $VEL.ORI1=200
 $ACC.ORI2=100
 $APO.CDIS=1.0000
 $ORI_TYPE=#VAR
 $BASE=BASE_DATA[3]
 $TOOL=TOOL_DATA[2]
 SPEED=0.025
 $VEL.CP=SPEED
 PTP {E6AXIS: A1 0.0000, A2 -90.0000, A3 90.0000, A4 0.0000, A5 45.0000, A6 0.0000, E1 0.0000}
 PTP {E6POS: X 10.1234, Y -5.0000, Z 100.0000, A 90.0000, B 0.0000, C 180.0000, S 2, T 35, E1 0.0000} C_PTP
 LIN {E6POS: X 10.1234, Y -5.0000, Z 1.1653082E-14, A 90.0000, B 0.0000, C 180.0000, E1 0.0000} C_Dis
 LIN {E6POS: X 20.1234, Y -5.0000, Z 0.0000, A 90.0000, B 0.0000, C 180.0000, E1 0.0000} C_Dis
 POINT1={X 30.0,Y 0.0,Z 10.0,A 90.0,B 0.0,C 180.0}
 LIN POINT1
 HALT
END
"""
LOWER = """DEF part( )
;( Fr\u00e4sen mit \u00d8 8 )
ext bas (bas_command :in,real :in )
bas(#initmov,0)
$base={x 1462.4854,y 0.0000,z 664.8991,a 0.0000,b 0.0000,c 0.0000}
$tool={x 326.6638,y 0.0000,z 454.2762,a 180.0000,b -60.0005,c 0.0000}
ptp  {a1 0.0000,a2 -90.0000,a3 90.0000,a4 0.0000,a5 0.0000,a6 0.0000}
ptp  {x 75.0000,y 150.0000,z 100.0000,a -23.4034,b 0.0000,c 180.0000,s 2,t 35}
$vel.cp=0.05  ;50mm/s
lin  {x 75.0000,y 150.0000,z 5.0000} c_dis
lin  {x 85.0000,y 150.0000} c_dis
circ {x 90.0,y 155.0,z 5.0},{x 95.0,y 150.0,z 5.0} c_dis
lin  {z 100.0}
end
"""
FORMS = "\n".join(["DEF part( )", *INLINE, "END", ""])
PROGRAMS = {
    "post": (POST, None, [PTP, LIN, LIN, CIRC, LIN], [np.nan, 0.2, 0.05, 0.05, 0.05]),
    "tagged": (TAGGED, None, [PTP, PTP, LIN, LIN, LIN], [np.nan, np.nan, 0.025, 0.025, 0.025]),
    "lower case": (LOWER, None, [PTP, PTP, LIN, LIN, CIRC, LIN], [np.nan, np.nan] + 4 * [0.05]),
    "inline forms": (FORMS, INLINE_DATA, [PTP, LIN, LIN], [np.nan, 0.1, 0.2]),
}


@pytest.mark.parametrize("name", PROGRAMS)
@pytest.mark.parametrize("end", ["\r\n", "\n", "\r", "\r\r\n"])
@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "cp1252"])
def test_programs_of_all_styles_are_read_kept_and_corrected(name, end, encoding):
    source, data, kinds, feeds = PROGRAMS[name]
    text = source.replace("\n", end).encode(encoding)
    program = read(text, data)
    assert program.motions.kind.tolist() == kinds
    np.testing.assert_array_equal(program.motions.feed, feeds)
    kept = krl.rewrite(program, targets(program, keep=True))
    assert kept.documents[0].to_bytes() == text
    moved = np.full((len(kinds), 3), 1e-4)
    wanted = targets(program, moved, pieces={len(kinds) - 1: [0.5]})
    written = krl.rewrite(program, wanted)
    again = check_commands(program, wanted, written)
    assert len(again.motions) == len(kinds) + 1
    assert written.documents[0].encoding == program.documents[0].encoding


def test_corrected_programs_keep_their_style():
    program = read(TAGGED)
    lines = krl.rewrite(program, targets(program, np.full((5, 3), 1e-4))).documents[0].text.split("\n")
    assert lines[20:24] == [
        " PTP {E6POS: X 10.2234, Y -4.9000, Z 100.1000, A 90.00000, B 0.00000, C 180.00000, S 2, T 35, E1 0.0000} "
        "C_PTP",
        " LIN {E6POS: X 10.2234, Y -4.9000, Z 0.1000000, A 90.00000, B 0.00000, C 180.00000, E1 0.0000} C_Dis",
        " LIN {E6POS: X 20.2234, Y -4.9000, Z 0.1000, A 90.00000, B 0.00000, C 180.00000, E1 0.0000} C_Dis",
        " POINT1={X 30.1000,Y 0.1000,Z 10.1000,A 90.00000,B 0.00000,C 180.00000}",
    ]


def test_inline_forms_corrected_byte_for_byte():
    source = "DEF part( )\r\n" + "\r\n".join(INLINE) + "\r\nEND\r\n"
    program = read(source, INLINE_DATA)
    shift = np.array([[0, 0, 0], [0, 0, 1e-3], [0, 0, 0]])
    wanted = targets(program, shift)
    wanted.keep[1] = True
    written = krl.rewrite(program, wanted)
    old = "X 214.483856,Y 193.590897,Z 105.80865,A 6.59456158,B -23.4313526,C 9.77940178"
    new = "X 214.483856,Y 193.590897,Z 106.80865,A 6.59456158,B -23.4313526,C 9.77940178"
    assert written.documents[0].text == source
    assert written.documents[1].text == INLINE_DATA.replace(old, new)
    assert numbers(read(source, written.documents[1].text))[1, 2] == 106.80865
