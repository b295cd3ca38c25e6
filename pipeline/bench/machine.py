"""The computer that the bench ran on, without its name."""

from __future__ import annotations

import importlib.metadata
import os
import platform
import time
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits

PACKAGES = ("heyoka", "numpy", "scipy", "numba", "xarray", "netCDF4", "matplotlib")


def describe() -> dict[str, str]:
    """CPU, cores and versions of the packages."""
    import heyoka as hy

    model = "unknown"
    try:
        for line in Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines():
            if line.startswith("model name"):
                model = line.partition(":")[2].strip()
                break
    except OSError:
        pass
    entries = {
        "cpu": model,
        "cores": str(len(os.sched_getaffinity(0))),
        "lanes of double": str(hy.recommended_simd_size()),
        "python": platform.python_version(),
    }
    for name in PACKAGES:
        try:
            entries[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            entries[name] = "not installed"
    return entries


def peak_flops(size: int = 384, repeats: int = 8) -> float:
    """Peak floating-point operations of one core per second, from the fastest of some matrix products."""
    a = np.random.default_rng(0).random((size, size))
    best = np.inf
    with threadpool_limits(1):
        for _ in range(repeats):
            start = time.perf_counter()
            a @ a
            best = min(best, time.perf_counter() - start)
    return 2.0 * size**3 / best
