"""The computer that the bench ran on, without its name."""

import importlib.metadata
import os
import platform
import re
import time
from pathlib import Path

import heyoka as hy
import numpy as np
from threadpoolctl import threadpool_limits

PACKAGES = ("heyoka", "numpy", "scipy", "numba", "xarray", "netCDF4", "matplotlib")


def describe() -> dict[str, str]:
    """CPU, cores and versions of the packages."""
    cpu = re.search(
        r"model name\s*: (.*)", Path("/proc/cpuinfo").read_text(encoding="utf-8")
    )
    return {
        "cpu": cpu[1] if cpu else "unknown",
        "cores": str(len(os.sched_getaffinity(0))),
        "lanes of double": str(hy.recommended_simd_size()),
        "python": platform.python_version(),
        **{name: importlib.metadata.version(name) for name in PACKAGES},
    }


#: Least processor time that is measured [s].
_LEAST = 0.05


def peak_flops(size: int = 384, repeats: int = 8) -> float:
    """Peak floating-point operations of one core per second, from the fastest of some
    matrix products.
    """
    a = np.random.default_rng(0).random((size, size))
    best = np.inf
    with threadpool_limits(1):
        for _ in range(repeats):
            start, count = time.process_time(), 0
            # Some clocks of processor time tick a hundred times a second only.
            while (seconds := time.process_time() - start) < _LEAST:
                a @ a
                count += 1
            best = min(best, seconds / count)
    return 2.0 * size**3 / best
