"""One thread for each library: Dask has the threads, and those of OpenBLAS, OpenMP and numba would multiply them.

The libraries read these settings once, when they are loaded. Who has imported numpy before lightstage keeps the
threads that it has; while a kernel computes they are limited all the same (`dag.task`).
"""

import os

_SETTINGS = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")


def one_each() -> None:
    """For this process and those that it starts; a setting that is there already stays."""
    for name in _SETTINGS:
        os.environ.setdefault(name, "1")
