"""Which poses and loads identify the robot best for the work at hand.

Source: Klimchik et al., second Eq. (10): measurement poses are chosen so that the error that remains after compensation
at test poses (where the user mills, under the forces that act there) is expected to be smallest.

`milling` takes test poses from programs; `sensitivity` and `criterion` say what readings are worth for them; `site` and
`constraints` which poses can be measured; `directions` to which sides joints are to be loaded; `candidate_poses` and
`search` look for the best plan; `accuracy` and `remarks` state what to expect of it; `baselines` compares it with
others; `order` and `krl_program` bring it to the robot. `planning` is the whole. `compensator` plans the readings of
the gravity compensator's markers.
"""

from postproc.plan.planning import Options, PlanResult, plan_measurements

__all__ = ["Options", "PlanResult", "plan_measurements"]
