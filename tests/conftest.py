"""What holds for all tests."""

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")  # tests run side by side: threads of BLAS would be in each other's way
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from hypothesis import settings

# How long an example takes is the machine's business.  The examples are the same every time, so that what passed
# passes again; `pytest --hypothesis-profile explore` draws others.
settings.register_profile("imuarray", deadline=None, derandomize=True)
settings.register_profile("explore", deadline=None)
settings.load_profile("imuarray")
