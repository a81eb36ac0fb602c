"""Computed forces and materials in words, from numbers that are stated here."""

from __future__ import annotations

from postproc.machining.material import Entry
from postproc.report.process_forces import ForcesSummary, ToolSummary, as_text, materials, summary

MILL = ToolSummary(
    tool="T3", max_force_N=412.5, max_force_line=17, max_torque_Nm=3.25, max_power_W=812.5, max_depth_mm=4.0,
    max_width_mm=7.5, max_removal_mm3_per_s=250.0,
)  # fmt: skip
DRILL = ToolSummary(
    tool="T4", max_force_N=612.5, max_force_line=29, max_torque_Nm=1.5, max_power_W=300.0, max_depth_mm=22.0,
    max_width_mm=8.0, max_removal_mm3_per_s=100.0, max_feed_force_N=610.0,
)  # fmt: skip


def test_each_tool_has_its_largest_force_and_cut():
    """60 mm³/s are 3.6 cm³/min."""
    content = ForcesSummary(
        program="part.nc", places=4, removed_mm3=12_345.6, left_mm3=987_654.3, tools=[MILL, DRILL], by_operation=0
    )
    assert as_text(content).splitlines() == [
        "tool T3: mean force up to 412.5 N (line 17); torque 3.25 N·m; power 812.5 W",
        "  depth of cut up to 4 mm, width 7.5 mm, 15 cm³/min",
        "tool T4: mean force up to 612.5 N (line 29); torque 1.5 N·m; power 300 W",
        "  drilled up to 22 mm deep, feed force up to 610 N, torque up to 1.5 N·m, 6 cm³/min",
        "removed 12.35 cm³, left 987.7 cm³",
    ]


def test_forces_of_a_table_of_operations_are_counted():
    assert as_text(summary(None, None, 1)) == "forces by operation for 1 move"
    assert as_text(summary(None, None, 12)) == "forces by operation for 12 moves"
    assert as_text(summary(None, None, 0)) == ""


def test_the_table_of_materials_has_the_coefficients_of_either_law():
    first = Entry(
        Ktc_N_per_mm2=700.0, Krc_N_per_mm2=150.0, Kac_N_per_mm2=90.0, Kte_N_per_mm=12.0, Kre_N_per_mm=14.0,
        Kae_N_per_mm=2.5, sigma_percent=12.0, title="Aluminium", source="a paper", assumed=True, warning="dry only",
    )  # fmt: skip
    second = Entry(
        kc11_N_per_mm2=1500.0, mc=0.25, radial_ratio=0.4, axial_ratio=0.3, sigma_percent=20.0, title="Steel",
        source="a table",
    )  # fmt: skip
    assert materials({"al": first, "st": second}).splitlines() == [
        "al: Aluminium (assumed), sigma 12 %",
        "  Ktc 700, Krc 150, Kac 90 N/mm²; Kte 12, Kre 14, Kae 2.5 N/mm", "  source: a paper", "  warning: dry only",
        "st: Steel, sigma 20 %", "  kc1.1 1500 N/mm², mc 0.25; radial 0.4, axial 0.3 of the tangential force",
        "  source: a table",
    ]  # fmt: skip
