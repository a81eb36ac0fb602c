from __future__ import annotations

import json

from postproc import robot
from tests.commands import invoke


def test_robots_lists_the_shipped_ones():
    done = invoke("robots")
    assert done.exit_code == 0
    head, *lines = done.stdout.splitlines()
    assert head.split() == ["name", "robot", "values"]
    assert [line.split()[0] for line in lines] == list(robot.shipped_models())
    assert {"kuka_kr16_2", "kuka_kr270"} <= set(robot.shipped_models())


def test_a_robot_is_shown_with_source_and_what_is_assumed():
    lines = invoke("robots", "kuka_kr270").stdout.splitlines()
    (assumed,) = (line for line in lines if "compliance A2" in line)
    (published,) = (line for line in lines if "compliance A1" in line)
    assert "ASSUMED" in assumed
    assert "ASSUMED" not in published
    assert "Klimchik" in published
    assert lines[-1] == "k1 … k6, of A1 … A6, contain the spring of the link about the same axis."


def test_robot_as_json_has_the_same_values():
    content = json.loads(invoke("robots", "kuka_kr270", "--json").stdout)
    assert content["name"] == "kuka_kr270"
    assert all(set(value) == {"name", "value", "source", "assumed"} for value in content["values"])
    assert list(json.loads(invoke("robots", "--json").stdout)) == list(robot.shipped_models())
    assert json.loads(invoke("robots", "show", "kuka_kr270", "--json").stdout) == content


def test_unknown_robot_names_the_known_ones():
    done = invoke("robots", "kuka_kr999")
    assert done.exit_code == 1
    assert "kuka_kr270" in done.stderr
