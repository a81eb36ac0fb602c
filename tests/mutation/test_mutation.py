"""The mutation run itself: it finds a weak suite weak, sees all that a good one sees, and says the same again."""

import shutil
import signal
import tomllib
from collections import Counter
from pathlib import Path

import pytest

from tests.mutation.mutants import compiles, mutants_of
from tests.mutation.run import MutationError, accepted, chosen, run, sources_and_tests

HERE = Path(__file__).parent

LEVER = '''"""A lever."""

import numpy as np

GRAVITY = 9.81
"""Of the earth [m/s²]."""
N_PER_KN = 1e3


def moment(force: np.ndarray, arm: np.ndarray) -> np.ndarray:
    """Return the moment (n, 3) of forces (n, 3) at arms (n, 3)."""
    out = np.zeros_like(force)
    out[:, 0] = arm[:, 1] * force[:, 2] - arm[:, 2] * force[:, 1]
    out[:, 1] = arm[:, 2] * force[:, 0] - arm[:, 0] * force[:, 2]
    out[:, 2] = arm[:, 0] * force[:, 1] - arm[:, 1] * force[:, 0]
    return out


def weight(masses: np.ndarray, unit: float = 1.0) -> float:
    """Return the weight of masses that are positive."""
    if (masses < 0.0).any():
        raise ValueError(f"{masses} below {-1.0 * 0.0}")
    return float(np.einsum("ij,j->", np.eye(len(masses)), masses) * unit * GRAVITY)


def load(mass: float, share: float) -> float:
    """Return the weight [N] of a share of a mass in 1000 kg."""
    return _product(mass * N_PER_KN, share + 1.0) * GRAVITY


def _product(mass: float, number: float) -> float:
    return mass * (number - 1.0)
'''
KINDS = ("sign", "operator", "factor", "condition", "dropped", "index", "argument", "unit")
IMPORTS = """from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from postproc.lever import load, moment, weight


"""
WEAK = """def test_something_comes_out():
    assert moment(np.eye(3), np.ones((3, 3))).shape == (3, 3)


def test_weight_is_positive():
    assert weight(np.ones(2)) > 0.0
"""
STRONG = """def test_moment_is_the_cross_product():
    force, arm = np.random.default_rng(0).normal(size=(2, 20, 3))
    assert np.allclose(moment(force, arm), np.cross(arm, force), atol=1e-12)


def test_weight():
    assert np.isclose(weight(np.array([1.0, 0.0, 2.5])), 3.5 * 9.81, rtol=1e-12)
    assert np.isclose(weight(np.ones(2), 1000.0), 2e3 * 9.81, rtol=1e-12)
    with ThreadPoolExecutor() as pool:  # lines of threads count too
        assert np.isclose(pool.submit(load, 2.0, 0.5).result(), 9810.0, rtol=1e-12)
    with pytest.raises(ValueError):
        weight(np.array([2.0, -1.0]))
"""


def project(folder: Path, tests: str, accepted: str = "") -> Path:
    """Write a repository with one module and its tests."""
    for name, text in (
        ("postproc/__init__.py", ""), ("postproc/lever.py", LEVER), ("tests/__init__.py", ""),
        ("tests/test_lever.py", IMPORTS + tests), ("pyproject.toml", "[tool.pytest.ini_options]\n"),
    ):  # fmt: skip
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(text)
    shutil.copytree(HERE, folder / "tests/mutation", ignore=shutil.ignore_patterns("__pycache__"))
    (folder / "tests/mutation/packages.toml").write_text('lever = ["tests/test_lever.py"]\n')
    (folder / "tests/mutation/accepted.toml").write_text(accepted)
    return folder


def test_a_weak_suite_is_found_weak_and_a_good_one_good(tmp_path):
    weak, strong = project(tmp_path / "weak", WEAK), project(tmp_path / "strong", STRONG)
    files, tests = sources_and_tests("lever", weak)
    left = [one for one in run(weak, files, tests, seed=3, most=16) if one.outcome == "survived"]
    assert len(left) > 5
    files, tests = sources_and_tests("lever", strong)
    left = [one for one in run(strong, files, tests, seed=3, most=16) if one.outcome != "killed"]
    assert not [one.mutant for one in left if "einsum" not in one.mutant.before]
    assert (weak / "postproc/lever.py").read_text() == LEVER


def test_every_kind_is_planted_once_and_compiles(tmp_path):
    root = project(tmp_path / "one", WEAK)
    every = mutants_of(root / "postproc/lever.py", root)
    assert set(Counter(m.kind for m in every)) == set(KINDS)
    texts = {m.text(LEVER.encode()) for m in every}
    assert len(texts) == len(every)
    assert LEVER.encode() not in texts
    for text in texts:
        assert compiles(text)
    assert not compiles(b"a = (1")
    after = {m.after for m in every}
    assert "out[:, 0] = arm[:, 1] * force[:, 2] + arm[:, 2] * force[:, 1]" in after
    assert "out[:, 0] = arm[:, 1] * force[:, 2]" in after
    assert "out[:, 1] = arm[:, 2] * force[:, 0] - arm[:, 0] * force[:, 1]" in after
    assert "GRAVITY = 19.62" in after
    assert "return _product(share + 1.0, mass * N_PER_KN) * GRAVITY" in after
    assert "return _product(mass * (1.0 / N_PER_KN), share + 1.0) * GRAVITY" in after
    assert "if (masses <= 0.0).any():" in after
    assert "if False:" in after
    assert not [m for m in every if '"""' in m.after or ("below" in m.before and m.after != "pass")]


def test_arguments_of_a_function_that_takes_them_in_any_order_are_not_exchanged(tmp_path):
    (tmp_path / "a.py").write_text(
        "import numpy as np\n\n\ndef f(a, b):\n    return np.maximum(a, b) + np.divide(a, b)\n"
    )
    after = {m.after for m in mutants_of(tmp_path / "a.py", tmp_path) if m.kind == "argument"}
    assert after == {"return np.maximum(a, b) + np.divide(b, a)"}


def test_what_numpy_takes_for_the_same_is_not_planted(tmp_path):
    """Any negative length of a reshape is computed; factors with the same subscripts, a number and its lower limit may
    change places.
    """
    path = tmp_path / "same.py"
    path.write_text(
        "def f(a, b, c):\n"
        "    x = a.reshape(-1, 3) + b.reshape((2, -1)) + dict(zip(a, b, strict=True))\n"
        "    y = 1.0 * x / 1.0 + 0.0\n"
        "    z = np.zeros(0) + np.zeros((0, 3)) + np.zeros(1)\n"
        "    return np.einsum('ij,ij,jk->ik', a, b, c) + np.clip(x, 0, 1)\n"
    )
    texts = {mutant.after for mutant in mutants_of(path, tmp_path)}
    assert not any("-2" in text for text in texts)
    assert any("a.reshape(1, 3)" in text for text in texts)
    assert any("a.reshape(-1, 4)" in text for text in texts)
    assert not any("b, a, c" in text or "strict=False" in text for text in texts)
    assert any("a, c, b" in text for text in texts)
    assert not texts & {
        "y = x / 1.0 + 0.0",
        "y = 1.0 * x + 0.0",
        "y = 1.0 * x / 1.0",
    }  # a factor of one, a summand of zero
    assert texts >= {"y = 1.0 / 1.0 + 0.0", "y = 1.0 / x / 1.0 + 0.0", "y = 2.0 * x / 1.0 + 0.0"}
    assert [text for text in texts if "ones" in text] == ["z = np.zeros(0) + np.zeros((0, 3)) + np.ones(1)"]
    assert not any("np.clip(0, x, 1)" in text for text in texts)
    assert any("np.clip(x, 1, 0)" in text for text in texts)


def test_the_same_seed_takes_the_same_mutants(tmp_path):
    root = project(tmp_path / "one", WEAK)
    every = mutants_of(root / "postproc/lever.py", root)
    assert every == mutants_of(root / "postproc/lever.py", root)
    assert chosen(root, every, 5, 10) == chosen(root, every, 5, 10) != chosen(root, every, 6, 10)
    assert chosen(root, every, 5, None) == chosen(root, every, 6, 1000) == every


def test_a_mutant_that_is_accepted_is_not_run_and_a_stale_entry_is_an_error(tmp_path):
    entry = (
        '[[mutant]]\nfile = "postproc/lever.py"\nline = "GRAVITY = 9.81"\nmutation = "GRAVITY = 19.62"\nreason = "{}"\n'
    )
    root = project(tmp_path / "one", WEAK, entry.format("no planet is named"))
    every = mutants_of(root / "postproc/lever.py", root)
    assert [m.after for m in accepted(root, every)] == ["GRAVITY = 19.62"]
    for stale in (
        entry.format(" "),
        entry.format("why").replace("19.62", "3.7"),
        entry.format("why").replace("= 9.81", "= 9"),
    ):
        (root / "tests/mutation/accepted.toml").write_text(stale)
        with pytest.raises(MutationError, match="no longer"):
            accepted(root, every)


def test_a_package_of_a_package_may_have_tests_of_its_own(tmp_path):
    root = project(tmp_path / "one", WEAK)
    (root / "postproc/gear").mkdir()
    for name in ("__init__", "rack"):
        (root / f"postproc/gear/{name}.py").write_text("")
    (root / "tests/mutation/packages.toml").write_text('gear = ["a.py"]\n"gear.rack" = ["b.py"]\n')
    assert [sources_and_tests(name, root)[1] for name in ("gear", "gear.rack")] == [["a.py"], ["b.py"]]
    with pytest.raises(MutationError, match="no package or module"):
        sources_and_tests("wheel", root)
    with pytest.raises(MutationError, match="names no tests for lever"):
        sources_and_tests("lever", root)


def test_tests_that_fail_without_a_fault_are_an_error(tmp_path):
    root = project(tmp_path / "one", "def test_wrong():\n    assert weight(np.ones(1)) == 3.7\n")
    files, tests = sources_and_tests("lever", root)
    with pytest.raises(MutationError, match=r"fail without a fault: .*test_wrong"):
        run(root, files, tests, most=1)


def test_tests_of_an_interrupt_pass_in_a_job_in_the_background(tmp_path):
    """A shell starts such a job with SIGINT ignored, and processes inherit that."""
    text = "def test_interrupt():\n    with pytest.raises(KeyboardInterrupt):\n        signal.raise_signal(2)\n"
    root = project(tmp_path / "one", f"import signal\n\n\n{text}    assert weight(np.ones(1)) == 9.81\n")
    files, tests = sources_and_tests("lever", root)
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        found = run(root, files, tests, seed=3, most=3)
    finally:
        signal.signal(signal.SIGINT, before)
    assert len(found) == 3


def test_what_is_accepted_in_this_repository_is_still_a_mutant():
    root = HERE.parents[1]
    listed = tomllib.loads((HERE / "accepted.toml").read_text()).get("mutant", [])
    accepted(root, [m for name in sorted({entry["file"] for entry in listed}) for m in mutants_of(root / name, root)])
