"""What the bench ran on, in words that name no host."""

from __future__ import annotations

import importlib.metadata
import os
import platform
import time
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits

PACKAGES = ("heyoka", "numpy", "scipy", "numba", "xarray", "netCDF4", "matplotlib")


def described() -> dict[str, str]:
    """CPU, cores and versions."""
    import heyoka as hy

    model = "unknown"
    try:
        for line in Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines():
            if line.startswith("model name"):
                model = line.partition(":")[2].strip()
                break
    except OSError:
        pass
    found = {
        "cpu": model,
        "cores": str(len(os.sched_getaffinity(0))),
        "lanes of double": str(hy.recommended_simd_size()),
        "python": platform.python_version(),
    }
    for name in PACKAGES:
        try:
            found[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            found[name] = "not installed"
    return found


def peak_flops(size: int = 384, repeats: int = 8) -> float:
    """Floating-point operations one core does in a second at its best: a matrix product of numpy's."""
    a = np.random.default_rng(0).random((size, size))
    best = np.inf
    with threadpool_limits(1):
        for _ in range(repeats):
            start = time.perf_counter()
            a @ a
            best = min(best, time.perf_counter() - start)
    return 2.0 * size**3 / best
