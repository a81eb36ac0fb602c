"""What the flange carried while it was measured goes into the model; a model that was identified can be the prior."""

import numpy as np
import pytest

from postproc import kinematics, robot
from postproc.errors import MeasurementError
from postproc.identification import identify_folder
from samples.paper_study import simulator

CENTRE = [-100.0, 50.0, 200.0]
PAYLOAD = "\n[payload]\nmass_kg = 6.0\nX = -100.0\nY = 50.0\nZ = 200.0\n"


def measured(folder, robot_name="kuka_kr16_2", more=""):
    rng = np.random.default_rng(105)
    true = simulator.small(rng, "linear", links=False)
    q, f = simulator.plan(rng, 12, load=157.0, tilt=50.0)
    _, raw = simulator.measure(true, q, f, rng, 0.02e-3)
    simulator.write(folder, q, f, raw, 0.02e-3, robot=robot_name)
    with (folder / "experiment.toml").open("a", encoding="utf-8") as file:
        file.write(more)
    return folder / "measurements.csv", folder / "experiment.toml", folder / "model"


def test_a_stated_payload_is_part_of_the_state_in_which_the_robot_was_measured(tmp_path):
    done = identify_folder(*measured(tmp_path, more=PAYLOAD))
    model = robot.load(tmp_path / "model")
    expected = robot.load(robot.find("kuka_kr16_2")).with_payload(6.0, np.array(CENTRE) / 1e3)
    q = np.random.default_rng(0).uniform(model.lower, model.upper, (20, 6))
    for mine in (model.actual, model.loaded, done.result.prior.actual):
        np.testing.assert_allclose(
            kinematics.gravity_torque(mine, q), kinematics.gravity_torque(expected.loaded, q), atol=1e-9
        )
    entry = next(entry for entry in model.sources if entry.name == "payload when measured")
    assert entry.value == "6 kg at -100, 50, 200 mm of the flange"
    assert entry.source == "stated in experiment.toml"
    assert not np.allclose(model.nominal.mass, model.actual.mass)  # the drawing carries nothing


@pytest.mark.parametrize("line", ["mass_kg = -1.0", "mass_kg = 5.0\nx = 3.0", "X = 1.0"])
def test_an_impossible_payload_is_refused(tmp_path, line):
    with pytest.raises(MeasurementError, match="payload"):
        identify_folder(*measured(tmp_path, more=f"\n[payload]\n{line}\n"))


def test_an_identified_model_can_be_the_prior_of_the_next_identification(tmp_path):
    """Its springs of links and fading parts are looked for anew."""
    first = identify_folder(*measured(tmp_path / "first"))
    path = tmp_path / "first" / "model" / "model.toml"
    links = '[links.A2]\nsource = "x"\nRX_urad_per_Nm = 0.1\n\n[joints.A2]'
    text = path.read_text(encoding="utf-8").replace("[joints.A2]", links)
    path.write_text(text, encoding="utf-8")
    assert robot.load(path.parent).link_springs
    again = identify_folder(*measured(tmp_path / "again", robot_name=str(path.parent)))
    for name, entry in first.data.parameters.items():
        assert again.data.parameters[name].value == pytest.approx(entry.value, rel=1e-5)
