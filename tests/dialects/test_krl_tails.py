"""What follows the target of a spline motion, when its orientation is set free or a line replaces a circle."""

import pytest

from postproc.dialects.krl.language.parser import statement
from postproc.dialects.krl.language.source import Source
from postproc.dialects.krl.write.target_statements import tail_text
from postproc.dialects.text import decode


@pytest.mark.parametrize(
    ("tail", "changes", "wanted"),
    [
        (" WITH $VEL.CP=0.1, $ORI_TYPE=SORI_TYP(L1) C_SPL", {"is_free"}, " WITH $VEL.CP=0.1, $ORI_TYPE=#VAR C_SPL"),
        (" C_SPL", {"is_free"}, " WITH $ORI_TYPE=#VAR C_SPL"),
        (" WITH $VEL.CP=0.1", {"is_free"}, " WITH $ORI_TYPE=#VAR, $VEL.CP=0.1"),
        ("", {"is_free", "ignores_auxiliary"}, " WITH $ORI_TYPE=#VAR, $CIRC_MODE.AUX_PT.ORI=#IGNORE"),
        (
            " WITH $CIRC_MODE=SCIRC_M(L1)",
            {"ignores_auxiliary"},
            " WITH $CIRC_MODE=SCIRC_M(L1), $CIRC_MODE.AUX_PT.ORI=#IGNORE",
        ),
        (" C_SPL", {"ignores_auxiliary"}, " WITH $CIRC_MODE.AUX_PT.ORI=#IGNORE C_SPL"),
        (" with $circ_mode.aux_pt.ori=mode C_SPL", {"ignores_auxiliary"}, " with $circ_mode.aux_pt.ori=#IGNORE C_SPL"),
        (" WITH $VEL.CP=0.1, $CIRC_MODE={AUX_PT {ORI #IGNORE}} C_SPL", {"is_straightened"}, " WITH $VEL.CP=0.1 C_SPL"),
        (" WITH $CIRC_TYPE=#PATH, $VEL.CP=F(1,2)", {"is_straightened"}, " WITH $VEL.CP=F(1,2)"),
        (" WITH $CIRC_TYPE=#PATH C_SPL", {"is_straightened"}, " C_SPL"),
        (" WITH $CIRC_TYPE=#PATH", {"is_straightened", "is_free"}, " WITH $ORI_TYPE=#VAR"),
    ],
)
def test_only_what_must_change_is_changed(tail, changes, wanted):
    line = f"SCIRC {{X 1,Y 2,Z 3}},{{X 1,Y 2,Z 5}}{tail}"
    source = Source.of(decode("part.src", f"DEF part( )\n{line}\nEND\n".encode()), 0)
    every = {"is_free", "is_straightened", "ignores_auxiliary"}
    assert tail_text(source, statement(source, 2).tail, **{name: name in changes for name in every}) == wanted
