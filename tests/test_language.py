"""A robot is given no program that its controller does not read."""

from __future__ import annotations

import json
import shutil

import pytest

from postproc import robot
from postproc.identification import model_folder
from tests.commands import invoke
from tests.kr270 import CONTENT
from tests.places import CELL_FILE, SAMPLES
from tests.plan import setting

KUKA, ABB = CELL_FILE, SAMPLES / "cell_irb6700.toml"


@pytest.mark.parametrize(
    ("program", "cell", "to", "reads"),
    [
        ("pocket.nc", ABB, (), "rapid"),
        ("pocket.nc", ABB, ("--to", "krl"), "rapid"),
        ("pocket.nc", ABB, ("--nominal",), "rapid"),
        ("pocket.nc", KUKA, ("--to", "rapid"), "krl"),
    ],
)
def test_a_program_for_another_controller_is_refused_with_what_to_do(tmp_path, program, cell, to, reads):
    result = invoke("convert", SAMPLES / program, "--cell", cell, "-o", tmp_path / "out", *to)
    assert result.exit_code == 1
    assert f"whose controller reads {reads}" in result.stderr
    assert f"--to {reads}" in result.stderr
    assert not (tmp_path / "out").exists()


def test_krl_is_not_predicted_for_an_arm_that_does_not_read_it_but_the_g_code_is(tmp_path):
    result = invoke("predict", SAMPLES / "inline.src", "--cell", ABB, "-o", tmp_path)
    assert result.exit_code == 1
    assert "a program in krl for ABB IRB 6700-200/2.60, whose controller reads rapid" in result.stderr
    assert invoke("predict", SAMPLES / "pocket.nc", "--cell", ABB, "-o", tmp_path).exit_code == 0


def test_a_model_that_does_not_say_is_not_in_the_way(tmp_path):
    shutil.copytree(robot.find("abb_irb6700_200_260"), tmp_path / "mine")
    model = tmp_path / "mine" / "model.toml"
    model.write_text(model.read_text().replace('language = "rapid"\n', ""))
    text = ABB.read_text().replace('"abb_irb6700_200_260"', '"mine"')
    (tmp_path / "cell.toml").write_text(text)
    assert '"mine"' in text
    (tmp_path / "part.nc").write_text("G90 G21\nG0 X0 Y0 Z10\nG1 X20 F600\nM2\n")
    result = invoke("convert", tmp_path / "part.nc", "--cell", tmp_path / "cell.toml", "-o", tmp_path / "out")
    assert result.exit_code == 0, result.output


def test_every_shipped_model_says_what_its_controller_reads():
    said = {name: robot.load(folder).language for name, folder in robot.shipped_models().items()}
    assert said == {name: "rapid" if name.startswith("abb_") else "krl" for name in said}


def test_an_identified_model_reads_what_its_prior_reads():
    prior = model_folder.read_prior(robot.find("abb_irb6700_200_260"), None, "")
    assert model_folder.constant_springs_only(prior).language == "rapid"
    assert CONTENT.language == "krl"


def test_a_plan_for_an_arm_that_does_not_read_krl_has_no_krl_and_says_so(tmp_path):
    setting.experiment(tmp_path, setting.BASIC.replace("kuka_kr270", "abb_irb6700_200_260") + setting.RIG)
    (tmp_path / "tests.csv").write_text("A1,A2,A3,A4,A5,A6,Fx,Fy,Fz\n0,-70,110,0,50,0,100,50,300\n")
    made = invoke(
        "plan", "--experiment", tmp_path / "experiment.toml", "--cell", ABB, "--poses", tmp_path / "tests.csv",
        "--configurations", 3, "--q2-levels", 1, "--test-poses", 1, "-o", tmp_path / "plan.csv",
    )  # fmt: skip
    assert made.exit_code == 0, made.output
    assert "no plan.src: the controller of ABB IRB 6700-200/2.60 reads rapid" in made.stderr
    assert not (tmp_path / "plan.src").exists()
    assert any("plan.src" in warning for warning in json.loads((tmp_path / "plan.json").read_text())["warnings"])
