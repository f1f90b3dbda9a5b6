"""What holds for all tests."""

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")  # tests run side by side: threads of BLAS would be in each other's way
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from hypothesis import settings

settings.register_profile("imuarray", deadline=None)  # how long an example takes is the machine's business
settings.load_profile("imuarray")
