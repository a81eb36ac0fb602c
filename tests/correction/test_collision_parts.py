"""Parts of the check of collisions, each against a loop: stocks over time, rows that are compared, words of errors."""

from __future__ import annotations

from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest
from msgspec.structs import replace
from scipy.spatial.transform import Rotation

from postproc.correction import collisions
from postproc.correction.collisions import STOCK, Contact, States
from postproc.correction.runs import Run
from postproc.program import CIRC
from tests.collision.setting import frame
from tests.correction.test_closely import arcs_and_lines
from tests.programs import program


class ShrinkingStock:
    """Stock that loses some of its size at each motion."""

    def __init__(self, rng, count):
        self.size = np.sort(rng.uniform(0.0, 1.0, count))[::-1]
        self.motions = []
        self.accuracy = 0.0005

    def mesh(self, motion):
        self.motions.append(motion)
        return np.full((int(self.size[motion] > 0.1), 3), self.size[motion]), np.zeros((1, 3), dtype=int)


class Solids:
    """The moving bodies and a stock of some size."""

    def __init__(self, size):
        self.size = size

    def replace_last(self, body):
        assert (body.name, body.role, body.kind) == (STOCK, "obstacle", "mesh")
        return Solids(body.points[0, 0])


@pytest.fixture
def reaching(monkeypatch):
    """Samples touch the stock if it is larger than their joint angle A1."""

    def contacts(solids, states, need):
        for motion, angle in zip(states.motion, states.q[1:, 0], strict=True):
            if angle < solids.size:
                yield Contact(("spindle", STOCK), int(motion), 0.0, need)

    monkeypatch.setattr(collisions, "_contacts_of_solids", contacts)
    monkeypatch.setattr(collisions, "_solids", lambda scene, moving, fixed: Solids(fixed[0].points[0, 0]))


def states_of(rng, count=60, motions=20):
    motion = np.sort(rng.integers(0, motions, count))
    q = rng.uniform(0.0, 1.4, (count + 1, 6)) ** 0.5
    return States(motion, q, None, None)


@pytest.mark.parametrize("seed", range(30))
def test_contacts_with_the_stock_are_those_of_its_size_before_each_motion(reaching, seed):
    rng = np.random.default_rng(seed)
    states, stock = states_of(rng), ShrinkingStock(rng, 20)
    rows = rng.random(60) < 0.8
    search = collisions._StockSearch(None, [], states, stock, 0.003)
    found = list(search.contacts(rows))
    expected = {
        int(states.motion[i])
        for i in range(60)
        if rows[i] and stock.size[states.motion[i]] > 0.1 and states.q[i + 1, 0] < stock.size[states.motion[i]]
    }
    assert {contact.motion for contact in found} == expected
    assert all((contact.names, contact.least_distance) == (("spindle", STOCK), 0.003) for contact in found)
    assert len(stock.motions) == search.stock_count == len(set(stock.motions))


def test_few_stocks_are_enough_where_nothing_comes_close(reaching):
    """The stock before all motions decides; without a sample that is looked at, none is made."""
    rng = np.random.default_rng(1)
    states, stock = states_of(rng), ShrinkingStock(rng, 20)
    states.q[:, 0] = 2.0
    search = collisions._StockSearch(None, [], states, stock, 0.0)
    assert not list(search.contacts(np.arange(60) >= 12))
    assert stock.motions == [states.motion[12]]
    assert not list(search.contacts(np.zeros(60, dtype=bool)))
    assert len(stock.motions) == 1


def test_what_is_not_decided_by_the_most_stocks_counts_as_close_pairs(reaching, monkeypatch):
    rng = np.random.default_rng(2)
    states, stock = states_of(rng), ShrinkingStock(rng, 20)
    monkeypatch.setattr(collisions, "MOST_STOCKS", 3)
    found = {
        contact.motion
        for contact in collisions._StockSearch(None, [], states, stock, 0.0).contacts(np.ones(60, dtype=bool))
    }
    exact = {int(m) for m, angle in zip(states.motion, states.q[1:, 0], strict=True) if angle < stock.size[m]}
    assert found > exact
    assert 3 <= len(stock.motions) <= 6
    monkeypatch.setattr(collisions, "MOST_STOCKS", 1)
    undivided = {
        contact.motion
        for contact in collisions._StockSearch(None, [], states, stock, 0.0).contacts(states.q[1:, 0] > 0)
    }
    assert undivided == {
        int(m) for m, angle in zip(states.motion, states.q[1:, 0], strict=True) if angle < stock.size[0]
    }


def body(name, of, kind="cylinder", *, fixed=False):
    return SimpleNamespace(name=name, role=of, kind=kind, is_fixed=fixed)


BODIES = [
    body("link", "arm"), body("case", "tool", "mesh"), body("holder", "tool"), body("cutter", "cutter"),
    body("foot", "arm", fixed=True), body("vice", "obstacle", fixed=True),
]  # fmt: skip


@pytest.mark.parametrize(
    ("compared", "cuts", "expected"),
    [
        ([1, 1, 1], [1, 1, 1], [(("link", "case"), 0.02, [1, 1, 1], True)]),
        (
            [1, 0, 0], [1, 1, 0],
            [
                (("link", "case"), 0.02, [1, 1, 1], True), (("holder",), 0.02, [0, 1, 1], True),
                (("inner cutter",), 0.0, [0, 0, 1], False),
            ],
        ),
        ([1, 0, 0], [1, 1, 1], [(("link", "case"), 0.02, [1, 1, 1], True), (("holder",), 0.02, [0, 1, 1], True)]),
    ],
)  # fmt: skip
def test_the_tool_is_compared_where_it_turns_and_the_cutter_where_it_does_not_cut(
    monkeypatch, compared, cuts, expected
):
    searches = []

    class Search:
        def __init__(self, scene, bodies, states, stock, need):
            self.entry = tuple(each.name for each in bodies), need, states.commanded_q is not None

        def contacts(self, rows):
            names, need, is_commanded = self.entry
            searches.append((names, need, rows.astype(int).tolist(), is_commanded))
            return iter(())

    monkeypatch.setattr(collisions, "_StockSearch", Search)
    monkeypatch.setattr(collisions.collision, "inscribed_capsule", lambda part: body(f"inner {part.name}", part.role))
    states = States(np.array([0, 1, 2]), np.zeros((4, 6)), np.zeros((4, 6)), None)
    stock = SimpleNamespace(is_compared=np.array(compared, dtype=bool), removes_material=np.array(cuts, dtype=bool))
    assert not list(collisions.stock_contacts(SimpleNamespace(bodies=BODIES), states, stock, 0.02))
    assert searches == expected


@pytest.mark.parametrize("shift", [None, "carried"])
def test_parts_of_a_path_begin_before_their_first_sample(shift):
    q, commanded = np.arange(36.0).reshape(6, 6), 100.0 + np.arange(36.0).reshape(6, 6)
    carried = None if shift is None else np.arange(18.0).reshape(6, 3)
    states = States(np.array([0, 0, 1, 1, 2]), q, commanded, carried)
    part = states.part(2, 4)
    assert part.motion.tolist() == [1, 1]
    np.testing.assert_array_equal(part.q, q[[2, 3, 4]])
    np.testing.assert_array_equal(part.commanded_q, commanded[[2, 3, 4]])
    arrival = states.arrival()
    assert arrival.motion.tolist() == [0]
    np.testing.assert_array_equal(arrival.q, q[[2, 2]])
    np.testing.assert_array_equal(arrival.commanded_q, commanded[[2, 2]])
    if carried is None:
        assert part.shift is None
        assert arrival.shift is None
    else:
        np.testing.assert_array_equal(part.shift, carried[[2, 3, 4]])
        np.testing.assert_array_equal(arrival.shift, carried[[2, 2]])
    bare = States(states.motion, q, None, carried)
    assert bare.part(0, 2).commanded_q is None
    assert bare.arrival().commanded_q is None


@pytest.mark.parametrize("seed", range(8))
def test_stretches_of_samples_are_those_of_a_loop(seed):
    rows, stretches = np.random.default_rng(seed).random(15) < 0.5, []
    for i in range(15):
        if rows[i]:
            stretches += [] if i and rows[i - 1] else [[i, i]]
            stretches[-1][1] = i + 1
    assert [list(stretch) for stretch in collisions._stretches(rows)] == stretches


@pytest.mark.parametrize(
    ("spindle", "axis"), [("+Z", (0, 0, 1)), ("-Z", (0, 0, -1)), ("+X", (1, 0, 0)), ("-X", (-1, 0, 0))]
)
@pytest.mark.parametrize("begin", [0, 2])
def test_a_tool_leaves_its_cut_along_its_axis_away_from_the_part(spindle, axis, begin):
    """Off by 0.7°, and by 0.9°; towards the part; and where it stays it does not cut either."""
    rng = np.random.default_rng(3)
    rotation = Rotation.random(8, random_state=1).as_matrix()
    rotation[:] = rotation[0]
    up = -rotation[0] @ np.array(axis)
    across = np.cross(up, rng.normal(size=3))
    across /= np.linalg.norm(across)
    angles = np.radians([0.0, 0.7, 0.9, 90.0, 180.0, 0.7, 0.0])
    pose = np.tile(np.eye(4), (8, 1, 1))
    pose[:, :3, :3] = rotation
    steps = 0.03 * (np.cos(angles)[:, None] * up + np.sin(angles)[:, None] * across)
    steps[-1] = 0.0
    pose[1:, :3, 3] = np.cumsum(steps, axis=0)
    path, sample = SimpleNamespace(robot_in_cell=SimpleNamespace(spindle=spindle)), SimpleNamespace(pose=pose)
    expected = [True, True, True, False, False, False, True, True]
    assert collisions._retracts(path, sample, Run(slice(begin, 8), 0, begin - 1)).tolist() == expected[begin:]
    pose[begin, :3, 3] += pose[6, :3, 3] + up - pose[max(begin - 1, 0), :3, 3]  # from the seventh sample upwards
    assert collisions._retracts(path, sample, Run(slice(begin, begin + 1), 0, 6)).all()
    pose[begin, :3, 3] -= 2.0 * up
    assert not collisions._retracts(path, sample, Run(slice(begin, begin + 1), 0, 6)).any()


def test_e1_carries_the_robot_from_the_place_before_the_samples():
    begin, end = np.array([0.0, 0.1, 0.5]), np.array([0.1, 0.5, 0.4])
    direction = np.array([0.0, 0.6, 0.8])

    def offset(motion, t):
        return (begin[motion] + t * (end[motion] - begin[motion]))[:, None] * direction

    sample = SimpleNamespace(motion=np.array([0, 0, 1, 1, 2]), t=np.array([0.5, 1.0, 0.25, 1.0, 1.0]))
    path = SimpleNamespace(program=SimpleNamespace(carriage=SimpleNamespace(offset=offset)))
    e1 = [0.05, 0.1, 0.2, 0.5, 0.4]
    for run, places in (
        (Run(slice(0, 3), 0, -1), [0.0, *e1[:3]]),
        (Run(slice(3, 5), 0, 2), [0.2, 0.5, 0.4]),
        (Run(slice(2, 3), 0, 4), [0.4, 0.2]),
        (Run(slice(4, 5), 0, 4), [0.4, 0.4]),
    ):
        np.testing.assert_allclose(collisions._e1_displacements(path, sample, run), np.outer(places, direction))
    fixed = SimpleNamespace(program=SimpleNamespace(carriage=None))
    assert collisions._e1_displacements(fixed, sample, Run(slice(0, 3), 0, -1)) is None


def worst_of(notes, stock=True):
    made = program([("RAPID", 0, 0, 0), ("LIN", 10, 0, 0), ("LIN", 20, 0, 0)])
    worst = collisions._CloseBodies(made.motions, SimpleNamespace(accuracy=0.00123) if stock else None)
    for note in notes:
        names, distance, line, need, is_only_on_first_move = note
        motion = int(np.flatnonzero(made.motions.line == line)[0])
        worst.add(Contact(names, motion, distance, need), is_only_on_first_move=is_only_on_first_move)
    return worst.issues()


def test_the_smallest_distance_of_two_bodies_is_told_with_all_lines():
    (issue,) = worst_of(
        [
            (("spindle", "vice"), 0.004, 2, 0.01, False),
            (("spindle", "vice"), 0.00256, 3, 0.01, False),
            (("spindle", "vice"), 0.003, 1, 0.01, True),
        ]
    )
    assert (issue.level, issue.kind, issue.source_line, issue.count) == ("error", "collision", 3, 3)
    assert issue.subject == "spindle, vice"
    assert issue.message == (
        "collision: spindle comes within 2.6 mm of vice; [collision] asks for 10 mm. Move the part, turn the tool, or "
        "correct the bodies in the cell"
    )


def test_contact_on_the_way_from_the_start_is_told_with_another_remedy():
    first, second = worst_of(
        [
            (("cutter", "part"), 0.0, 1, 0.0, True), (("cutter", "part"), 0.0, 1, 0.0, False),
            (("link", "wall"), 0.001, 1, 0.005, False), (("link", "wall"), 0.0005, 1, 0.005, True),
        ]
    )  # fmt: skip
    assert first.message == (
        "collision: cutter touches or is inside part on the way from [start] to the first target; it may not touch it "
        "here. Choose [start] joints with the tip above the part, lift the first target, or correct the bodies"
    )
    assert (first.count, second.count) == (1, 1)
    assert "link comes within 0.5 mm of wall on the way from [start] to the first target; [coll" in second.message


@pytest.mark.parametrize(
    ("line", "advice"),
    [(1, "Lift the tool before it moves rapidly, begin elsewhere"), (2, "Use a longer tool, cut here first, tilt")],
)
def test_a_distance_to_the_stock_is_told_with_the_size_of_its_cells(line, advice):
    (issue,) = worst_of([(("holder", STOCK), 0.0, line, 0.0, False)])
    assert (
        f"holder touches or is inside stock, which is rounded up to cells of 1.2 mm; it may not touch it here. {advice}"
        in issue.message
    )
    (other,) = worst_of([(("holder", STOCK), 0.0, line, 0.0, False)], stock=False)
    assert "rounded up" not in other.message
    assert "Move the part" in other.message


NO_ARCS = SimpleNamespace(motion=np.zeros(0, dtype=int), sweep=np.zeros(0), radial=np.zeros((0, 3)))


def path_of(rng, tools, from_ptp):
    """A path of twelve samples on six motions, some of them with other tools."""
    made = program(
        [("PTP" if from_ptp else "LIN", 0, 0, 0), *(("LIN" if k % 2 else "RAPID", 10 * k, 0, 0) for k in range(1, 6))]
    )
    made = replace(made, motions=replace(made.motions, tool=np.array(tools)), tools=np.tile(np.eye(4), (3, 1, 1)))
    motion = np.repeat(np.arange(6), 2)
    pose = np.tile(np.eye(4), (12, 1, 1))
    pose[:, :3, 3] = np.cumsum(rng.normal(size=(12, 3)), axis=0)
    sample = SimpleNamespace(motion=motion, t=np.tile([0.5, 1.0], 6), pose=pose)
    cell = SimpleNamespace(collision=SimpleNamespace(clearance_mm=5.0), start_joints=np.full(6, -1.0))
    return SimpleNamespace(
        program=made, sample=sample, joints=SimpleNamespace(q=rng.uniform(0.0, 1.0, (12, 6))),
        robot_in_cell=SimpleNamespace(cell=cell, robot="robot", spindle="+Z"),
        motions=SimpleNamespace(forces=SimpleNamespace(stock=None), segments=SimpleNamespace(arcs=NO_ARCS)),
    )  # fmt: skip


@pytest.mark.parametrize("from_ptp", [True, False])
@pytest.mark.parametrize("is_corrected", [True, False])
@pytest.mark.parametrize("seed", range(6))
def test_distances_are_those_of_the_bodies_of_each_tool_from_the_place_before(
    monkeypatch, seed, is_corrected, from_ptp
):
    """By a formula of the joint angles: the smallest one, and each pair below the clearance with its lines."""
    rng = np.random.default_rng(seed)
    tools = np.sort(rng.integers(0, 3, 6)) if seed % 2 else np.zeros(6, dtype=int)
    path = path_of(rng, tools, from_ptp)
    commanded = path.joints.q + (1e-3 if is_corrected else 0.0)
    made, line = path.program, path.program.motions.line[path.sample.motion]
    calls = []

    def scene_of(robot, cell, tool):
        assert (robot, cell) == ("robot", path.robot_in_cell.cell)
        return SimpleNamespace(
            bodies=(body("link", "arm"), body("vice", "obstacle"), body("tip", "cutter")), remarks=("r",)
        )

    def distance(q):
        return float(0.02 + 0.019 * np.sin(50.0 * q.sum()))

    def along(scene, q, need, shift, commanded_q):
        calls.append((q, shift, commanded_q))
        assert need == pytest.approx(0.005)
        values = [distance(row) for row in q]
        rows = [n for n, value in enumerate(values) if value < need]
        best = int(np.argmin(values))
        return SimpleNamespace(
            closest=SimpleNamespace(distance=values[best], row=best, first=0, second=1), largest_decrease=0.0002,
            row=np.array(rows, dtype=int), first=np.zeros(len(rows), dtype=int), second=np.full(len(rows), 1),
            distance=np.array([values[n] for n in rows]),
        )  # fmt: skip

    monkeypatch.setattr(collisions.collision, "Scene", SimpleNamespace(of=scene_of))
    monkeypatch.setattr(collisions.collision, "path_hits", along)
    monkeypatch.setattr(collisions, "_close_pairs", lambda scene, states, stock, need: set())
    monkeypatch.setattr(collisions, "part_contacts", lambda scene, states, rapid: iter(()))
    smallest, issues = collisions.path_clearance(path, commanded)
    sample_tools = tools[path.sample.motion]
    begins = [0, *(n for n in range(1, 12) if sample_tools[n] != sample_tools[n - 1])]
    assert len(calls) == len(begins)
    values, hits = [], []
    for call, begin, end in zip(calls, begins, [*begins[1:], 12], strict=True):
        before = path.robot_in_cell.cell.start_joints if begin == 0 else path.joints.q[begin - 1]
        q = np.array([before, *path.joints.q[begin:end]])
        np.testing.assert_array_equal(call[0], q)
        assert call[1] is None
        if is_corrected:
            np.testing.assert_array_equal(
                call[2], [before if begin == 0 else commanded[begin - 1], *commanded[begin:end]]
            )
        assert (call[2] is None) != is_corrected
        lines = [line[begin], *line[begin:end]]
        for n, row in enumerate(q):
            values.append((distance(row), lines[n]))
            is_arrival = begin == 0 and from_ptp and path.sample.motion[max(n - 1, 0)] == 0
            hits += [(distance(row), lines[n], is_arrival)] if distance(row) < 0.005 else []
    least, at = min(values, key=lambda value: value[0])
    assert (smallest.distance, smallest.line, smallest.bodies) == (least, at, ("link", "vice"))
    assert smallest.remarks[0] == "r"
    assert "the stock is not checked" in smallest.remarks[1]
    assert "reduced by the motion of the bodies due to the correction, 0.2 mm at most" in smallest.remarks[2]
    if not hits:
        assert not issues
        return
    (issue,) = issues
    worst = min(hits, key=lambda hit: hit[0])
    assert (issue.source_line, issue.count) == (worst[1], len({hit[1] for hit in hits}))
    assert ("on the way from [start]" in issue.message) == worst[2]
    assert f"comes within {1e3 * worst[0]:.2g} mm of vice" in issue.message
    assert made.motions.kind[0] == (2 if from_ptp else 0)


def test_without_the_table_nothing_is_compared():
    path = path_of(np.random.default_rng(1), np.zeros(6, dtype=int), True)
    path.robot_in_cell.cell.collision = None
    assert collisions.path_clearance(path, path.joints.q) == (None, [])


@pytest.mark.parametrize("reduction", [0.9e-6, 1.1e-6])
def test_the_reduction_by_the_correction_is_stated_from_a_micrometre_on(reduction):
    assert len(list(collisions._correction_sentence(reduction))) == (reduction > 1e-6)


def test_remarks_on_the_stock_say_how_it_was_compared():
    scene = SimpleNamespace(bodies=(body("vice", "obstacle"),))
    (unchecked,) = collisions._stock_sentences(scene, None)
    assert unchecked.startswith("the stock is not checked")
    assert not list(collisions._stock_sentences(SimpleNamespace(bodies=(body("blank", "part"),)), None))
    (compared,) = collisions._stock_sentences(scene, SimpleNamespace(accuracy=0.00025))
    assert "up to cells of 0.25 mm" in compared


def test_without_two_bodies_to_compare_the_distance_is_infinite(monkeypatch):
    path = path_of(np.random.default_rng(1), np.zeros(6, dtype=int), True)
    none = np.zeros(0, dtype=int)
    nothing = SimpleNamespace(closest=None, largest_decrease=0.0, row=none, first=none, second=none, distance=none)
    scene = SimpleNamespace(bodies=(), remarks=())
    monkeypatch.setattr(collisions.collision, "Scene", SimpleNamespace(of=lambda *parts: scene))
    monkeypatch.setattr(collisions.collision, "path_hits", lambda *parts: nothing)
    smallest, issues = collisions.path_clearance(path, path.joints.q)
    assert (smallest.distance, smallest.bodies, smallest.line) == (np.inf, ("", ""), 1)
    assert not issues


@pytest.mark.parametrize(
    ("kinds", "rapid", "expected"),
    [
        ("part cutter", [0, 1, 1, 0, 1], [(1, 3), (4, 5)]), ("part cutter", [0, 0, 0, 0, 0], []),
        ("part", [1, 1, 1, 1, 1], []), ("cutter", [1, 1, 1, 1, 1], []),
    ],
)  # fmt: skip
def test_the_cutter_is_compared_with_parts_on_rapid_moves_on_its_nominal_path(monkeypatch, kinds, rapid, expected):
    of = kinds.split()
    scene = SimpleNamespace(bodies=[body("link", "arm"), *(body(f"a {kind}", kind) for kind in of)])
    monkeypatch.setattr(collisions.collision, "inscribed_capsule", lambda part: body(f"inner {part.name}", part.role))
    pairs = []

    def solids(scene, moving, fixed):
        pairs.append(([part.name for part in moving], [part.name for part in fixed]))
        return "solids"

    def contacts(found, states, least_distance):
        assert (found, least_distance, states.commanded_q) == ("solids", 0.0, None)
        yield tuple(states.q[:, 0].astype(int).tolist())

    monkeypatch.setattr(collisions, "_solids", solids)
    monkeypatch.setattr(collisions, "_contacts_of_solids", contacts)
    q = np.tile(np.arange(6.0)[:, None], (1, 6))
    states = States(np.arange(5), q, q + 0.1, None)
    found = list(collisions.part_contacts(scene, states, np.array(rapid, dtype=bool)))
    assert found == [tuple(range(low, high + 1)) for low, high in expected]
    assert pairs == ([(["inner a cutter"], ["a part"])] if expected else [])


def test_moving_bodies_are_compared_with_all_fixed_ones_and_contacts_name_their_motion(monkeypatch):
    moving = [
        SimpleNamespace(name="spindle", carrier=6),
        SimpleNamespace(name="foot", carrier=-1),
        SimpleNamespace(name="link", carrier=2),
    ]
    fixed = [SimpleNamespace(name="vice", carrier=-1), SimpleNamespace(name="stock", carrier=-1)]
    monkeypatch.setattr(collisions, "Solids", lambda scene, pairs: SimpleNamespace(bodies=scene.bodies, pairs=pairs))
    monkeypatch.setattr(collisions, "Scene", lambda robot, bodies: SimpleNamespace(bodies=bodies))
    solids = collisions._solids(SimpleNamespace(robot="robot"), moving, fixed)
    assert [body.name for body in solids.bodies] == ["spindle", "foot", "link", "vice", "stock"]
    assert solids.pairs == [(0, 3), (0, 4), (2, 3), (2, 4)]
    hits = SimpleNamespace(
        row=np.array([0, 1, 3]),
        first=np.array([0, 2, 0]),
        second=np.array([3, 4, 4]),
        distance=np.array([0.1, 0.2, 0.0]),
    )
    calls = []

    def among(*parts):
        calls.append(parts)
        return hits

    monkeypatch.setattr(collisions.collision, "pair_hits", among)
    states = States(np.array([4, 5, 7]), np.zeros((4, 6)), np.ones((4, 6)), np.full((4, 3), 2.0))
    found = list(collisions._contacts_of_solids(solids, states, 0.25))
    assert found == [
        Contact(("spindle", "vice"), 4, 0.1, 0.25), Contact(("link", "stock"), 4, 0.2, 0.25),
        Contact(("spindle", "stock"), 7, 0.0, 0.25),
    ]  # fmt: skip
    assert calls == [(solids, states.q, 0.25, states.shift, states.commanded_q)]


@pytest.mark.parametrize("has_stock", [True, False])
def test_what_is_close_pairs_where_the_robot_arrives_is_close_pairs_with_all_bodies(monkeypatch, has_stock):
    scene = SimpleNamespace(bodies=[body("link", "arm"), body("vice", "obstacle"), body("tip", "cutter")])
    states = States(np.array([0, 0]), np.zeros((3, 6)), None, None)
    hits = SimpleNamespace(
        row=np.array([1, 2]), first=np.array([0, 2]), second=np.array([1, 1]), distance=np.array([0.001, 0.0])
    )
    monkeypatch.setattr(collisions.collision, "path_hits", lambda *parts: hits)
    rows = []

    def with_parts(scene, states, rapid):
        rows.append(rapid.tolist())
        yield Contact(("tip", "blank"), 0, 0.0, 0.0)

    monkeypatch.setattr(collisions, "part_contacts", with_parts)
    monkeypatch.setattr(collisions, "stock_contacts", lambda *parts: iter([Contact(("link", STOCK), 0, 0.0, 0.0)]))
    found = collisions._close_pairs(scene, states, "stock" if has_stock else None, 0.005)
    assert found == {("link", "vice"), ("tip", "vice"), ("tip", "blank")} | ({("link", STOCK)} if has_stock else set())
    assert rows == [[True, True]]


def test_chords_of_arcs_are_off_by_a_hundredth_of_a_millimetre_and_are_no_shorter_than_that_needs():
    """The arm by Pinocchio. Places of the path stay; between them corrections are linear."""
    path = arcs_and_lines()
    rng, sample, m = np.random.default_rng(3), path.sample, path.program.motions
    commanded = path.joints.q + np.radians(0.05) * rng.normal(size=path.joints.q.shape)
    dense, q, dense_commanded = collisions._refine_arcs(path, commanded)
    places = list(zip(dense.motion.tolist(), dense.t.tolist(), strict=True))
    kept = [places.index(place) for place in zip(sample.motion.tolist(), sample.t.tolist(), strict=True)]
    np.testing.assert_allclose(dense_commanded[kept], commanded, atol=1e-9)
    program = path.program
    for k, (motion, _) in enumerate(places):
        base, tool = program.bases[m.base[motion]], program.tools[m.tool[motion]]
        np.testing.assert_allclose(frame(q[k], 6) @ tool, base @ dense.pose[k], atol=1e-9)
    radius = np.linalg.norm(m.target[:][:, :3, 3] - m.centre, axis=1)
    ends, added = [-1, *kept], 0
    for begin, end in pairwise(ends):
        motion = places[end][0]
        previous = places[begin][1] if begin >= 0 and places[begin][0] == motion else 0.0
        if m.kind[motion] != CIRC:
            assert end == begin + 1
            continue
        angle = m.sweep[motion] * np.diff([previous, *(t for _, t in places[begin + 1 : end + 1])])
        np.testing.assert_allclose(angle, angle[0], rtol=1e-6)
        allowed = 2.0 * np.arccos(1.0 - 1e-5 / radius[motion])
        assert angle[0] <= allowed * (1.0 + 1e-3)
        assert len(angle) - 1 <= angle.sum() / allowed * (1.0 + 1e-3)
        share = np.arange(1, len(angle) + 1)[:, None] / len(angle)
        correction = (dense_commanded - q)[begin + 1 : end + 1]
        before = (dense_commanded - q)[begin] if begin >= 0 else correction[-1]
        np.testing.assert_allclose(correction, before + share * (correction[-1] - before), atol=1e-9)
        added += len(angle) - 1
    assert added > 0
