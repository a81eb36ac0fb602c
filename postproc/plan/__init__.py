"""Poses and loads that identify the robot best for the work at hand.

Source: Klimchik et al., second Eq. (10): measurement poses are chosen so that the error that remains after compensation
at test poses (where the user mills, under the forces that act there) is expected to be smallest.

`milling` takes test poses from programs; `sensitivity` and `criterion` compute what readings contribute there; `site`
and `constraints` decide which poses can be measured; `search` looks for the best plan; `planning` is the whole.
`compensator` plans the readings of the gravity compensator's markers.
"""

from postproc.plan.planning import Options, PlanResult, plan_measurements

__all__ = ["Options", "PlanResult", "plan_measurements"]
