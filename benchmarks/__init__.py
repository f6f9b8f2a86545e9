"""Benchmarks and Monte-Carlo studies of ph_control.

Importing this package before numpy gives the linear algebra one thread: the matrices are small, and times of runs
with several workers are those of a single core each.
"""

import os

THREADS = {name: "1" for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")}
os.environ.update(THREADS)
