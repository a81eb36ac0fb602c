"""The loop of random attacks: it ends at the first wrong seed, or counts them."""

import pytest

from tests.attack.driver import Wrong, parser, try_seeds


def attack(seed):
    if seed % 5 == 4:
        raise Wrong("not the same")
    if seed == 12:
        raise KeyError("a fault that nobody expects")
    return "same"


@pytest.mark.parametrize(
    ("arguments", "code", "counts"),
    [
        (["--count", "4"], 0, {"same": 4}),
        (["--seed", "3", "--count", "20"], 1, {"same": 1, "WRONG": 1}),
        (["--seed", "3", "--count", "10", "--keep-going"], 1, {"same": 7, "WRONG": 3}),
        (["--minutes", "0"], 0, {}),
    ],
)
def test_seeds_are_tried_until_one_is_wrong(arguments, code, counts, capsys):
    assert try_seeds(parser("").parse_args(arguments), attack) == code
    lines = [line.split() for line in capsys.readouterr().out.splitlines() if not line.startswith(("---", "seeds"))]
    assert {outcome: int(number) for number, outcome in (line for line in lines if len(line) == 2)} == counts


def test_a_fault_is_printed_with_its_seed(capsys):
    try_seeds(parser("").parse_args(["--seed", "12", "--count", "3", "--keep-going"]), attack)
    text = capsys.readouterr().out
    assert "--- attack, seed 12: Traceback" in text
    assert "KeyError: 'a fault that nobody expects'" in text
    assert "--- attack, seed 14: not the same" in text
