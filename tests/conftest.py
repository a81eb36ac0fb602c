"""What holds for all tests."""

import os

from hypothesis import HealthCheck, settings

settings.register_profile(
    "postproc",
    deadline=None,  # how long an example takes says nothing about the code on a machine that others use too
    suppress_health_check=[HealthCheck.too_slow],
    derandomize="CI" in os.environ,
)
settings.load_profile("postproc")
