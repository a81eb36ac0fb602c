"""Tests of the package: they compute in one thread, which is set before numpy is imported."""

import os

# as `cli` does: others would wait in a loop
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
