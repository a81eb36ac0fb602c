"""What `make` is asked for and what it returns."""

from __future__ import annotations

from msgspec import Struct

from postproc.frames import Array
from postproc.plan.accuracy import Accuracy
from postproc.plan.directions import Directions
from postproc.plan.milling import TestPoses
from postproc.plan.search import Plan
from postproc.plan.site import Site
from postproc.program import Ints


class Options(Struct, frozen=True):
    """How a plan is made.

    :param configurations: number of poses.
    :param levels: number of levels of q2.
    :param seed: the same seed gives the same plan.
    :param grouped: the criterion as printed instead of pooled.
    :param test_poses: how many poses stand for the programs.
    :param repeats: readings of each point in each state.
    :param starts: starts of the search.
    :param rounds: of refinement, at most.
    :param comparisons: compare with other plans and sizes.
    """

    configurations: int = 15
    levels: int = 5
    seed: int = 0
    grouped: bool = False
    test_poses: int = 20
    repeats: int = 3
    starts: int = 8
    rounds: int = 40
    comparisons: bool = True


class Size(Struct, frozen=True, eq=False):
    """What other numbers of poses would give: criterion of the best plan found, and median of random plans [m²]."""

    configurations: int
    value: float
    random: float


class PlanResult(Struct, frozen=True, eq=False):
    """A plan in the order of least travel, and what it is worth. Row i is the same pose in all arrays.

    :param options: what was asked for.
    :param robot: name of the model.
    :param site: where it is measured.
    :param tests: the test poses.
    :param represented: how far Σ w A₀ᵀA₀ of the test poses is from that of all cutting samples, relative.
    :param plan: the poses; angles and forces as written to the file.
    :param force: (n, 3) at the load point, root axes [N].
    :param second_load: over the first, in the same direction; what to expect counts the first alone.
    :param torque: (n, 6) of the load on the joints [N·m].
    :param directions: to which sides joints were to be loaded.
    :param accuracy: what to expect of the plan (with what was measured already).
    :param before: the same with what was measured already alone, or None.
    :param random: (R,) criterion of random plans [m²].
    :param serial: the semi-intuitive plan of the serial approach, or None.
    :param sizes: other numbers of poses.
    :param seconds: least travel time, the slowest joint at full speed.
    :param via: for each pose the configurations (k, 6) that the robot passes on its way there, none if straight.
    :param blocked: rows to which no free way was found.
    :param compensator_free: K_c and s₀ can be determined too; else they stay at the robot's values.
    :param warnings: what the user should know before measuring.
    :param interrupted: the search was stopped; the plan is the best found so far.
    """

    options: Options
    robot: str
    site: Site
    tests: TestPoses
    represented: float
    plan: Plan
    force: Array
    second_load: float
    torque: Array
    directions: Directions
    accuracy: Accuracy
    before: Accuracy | None
    random: Array
    serial: Plan | None
    sizes: tuple[Size, ...]
    seconds: float
    via: tuple[Array, ...]
    blocked: Ints
    compensator_free: bool
    warnings: tuple[str, ...]
    interrupted: bool
