"""What follows the target of a spline motion, when its orientation is set free or a line replaces a circle."""

import pytest

from postproc.dialects.krl.language.parser import statement
from postproc.dialects.krl.language.source import Source
from postproc.dialects.krl.write.target_statements import tail_text
from postproc.dialects.text import decode


@pytest.mark.parametrize(
    ("tail", "changes", "wanted"),
    [
        (" WITH $VEL.CP=0.1, $ORI_TYPE=SORI_TYP(L1) C_SPL", {"free"}, " WITH $VEL.CP=0.1, $ORI_TYPE=#VAR C_SPL"),
        (" C_SPL", {"free"}, " WITH $ORI_TYPE=#VAR C_SPL"),
        (" WITH $VEL.CP=0.1", {"free"}, " WITH $ORI_TYPE=#VAR, $VEL.CP=0.1"),
        ("", {"free", "unheeding"}, " WITH $ORI_TYPE=#VAR, $CIRC_MODE.AUX_PT.ORI=#IGNORE"),
        (" WITH $CIRC_MODE=SCIRC_M(L1)", {"unheeding"}, " WITH $CIRC_MODE=SCIRC_M(L1), $CIRC_MODE.AUX_PT.ORI=#IGNORE"),
        (" C_SPL", {"unheeding"}, " WITH $CIRC_MODE.AUX_PT.ORI=#IGNORE C_SPL"),
        (" with $circ_mode.aux_pt.ori=mode C_SPL", {"unheeding"}, " with $circ_mode.aux_pt.ori=#IGNORE C_SPL"),
        (" WITH $VEL.CP=0.1, $CIRC_MODE={AUX_PT {ORI #IGNORE}} C_SPL", {"straight"}, " WITH $VEL.CP=0.1 C_SPL"),
        (" WITH $CIRC_TYPE=#PATH, $VEL.CP=F(1,2)", {"straight"}, " WITH $VEL.CP=F(1,2)"),
        (" WITH $CIRC_TYPE=#PATH C_SPL", {"straight"}, " C_SPL"),
        (" WITH $CIRC_TYPE=#PATH", {"straight", "free"}, " WITH $ORI_TYPE=#VAR"),
    ],
)
def test_only_what_must_change_is_changed(tail, changes, wanted):
    line = f"SCIRC {{X 1,Y 2,Z 3}},{{X 1,Y 2,Z 5}}{tail}"
    source = Source.of(decode("part.src", f"DEF part( )\n{line}\nEND\n".encode()), 0)
    every = {"free", "straight", "unheeding"}
    assert tail_text(source, statement(source, 2).tail, **{name: name in changes for name in every}) == wanted
