"""Which poses and loads identify the robot best for the work at hand.

Source: Klimchik et al., second Eq. (10): measurement poses are chosen so that the error that remains after compensation
at test poses (where the user mills, under the forces that act there) is expected to be smallest.

`milling` takes test poses from programs, `arm` and `sensitivity` say what a measurement tells, `criterion` what a plan
is worth, `site` and `shapes` which poses can be measured at all, `candidate_poses` and `search` look for the best plan,
`accuracy` says what to expect of it, `baselines` compares, `order` and `krl_program` bring it to the robot.
"""

from postproc.plan.measurement_plan import Options, PlanResult
from postproc.plan.planning import plan_measurements

__all__ = ["Options", "PlanResult", "plan_measurements"]
