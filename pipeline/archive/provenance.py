"""Origin of an archive: study, walkers, versions, processor and commit, as one JSON string."""

from __future__ import annotations

import functools
import hashlib
import importlib.metadata
import json
import platform
import re
from pathlib import Path
from typing import TYPE_CHECKING

import tasks
from pipeline.archive import attributes

if TYPE_CHECKING:
    from pipeline.plan.missing import Plan

_ROOT = Path(__file__).resolve().parents[2]
_PACKAGES = ("gaitsweep", "heyoka", "joblib", "netCDF4", "numpy", "scipy")
#: Those of them on which numbers depend.
_NUMERICAL = ("gaitsweep", "heyoka", "numpy", "scipy")
#: Processor features that determine the instructions of compiled code, and so the last bits of results.
_FEATURES = ("sse4_2", "avx", "avx2", "fma", "avx512f", "avx512dq", "avx512bw", "avx512vl", "asimd", "sve")


def provenance(plan: Plan) -> str:
    """Provenance of the results of a plan. Equal studies on equal processors give equal strings."""
    study = plan.study
    return json.dumps(
        {
            "study": study.text,
            "walkers": [check["table"] for check in study.checks],
            "violation_limits": list(
                attributes.violation_limits(study.options.get("violation_limits")).items()  # in the order of their bits
            ),
            "varied": {key: axis for check in study.checks for key, axis in check["varied"].items()},
            "tasks": {name: layer.task.version for name, layer in plan.layers.items()},
            "packages": {name: version(name) for name in _PACKAGES},
            "python": platform.python_version(),
            "cpu": cpu_features(),
            "commit": commit(),
        },
        sort_keys=True,
    )


def version(package: str) -> str:
    """Version of an installed package."""
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return "not installed"


def code_digest() -> str:
    """Digest of the code of `tasks` without docstrings, comments and layout."""
    digest = hashlib.sha256()
    for file in sorted(Path(tasks.__file__).parent.rglob("*.py")):
        text = re.sub(r'"""(.|\n)*?"""|#[^\n]*', "", file.read_text(encoding="utf-8"))
        digest.update(" ".join(text.split()).encode())
    return digest.hexdigest()


@functools.cache
def software() -> dict[str, str]:
    """Versions of packages, and the digest of the code of `tasks`, on which numbers depend."""
    return {**{name: version(name) for name in _NUMERICAL}, "code of `tasks`": code_digest()[:12]}


def cpu_features() -> list[str]:
    """Architecture of the processor and its features that affect results."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        flags = next(line for line in lines if line.lower().startswith(("flags", "features"))).split()
    except (OSError, StopIteration):
        flags = []
    return [platform.machine(), *(f for f in _FEATURES if f in flags)]


def commit(root: Path = _ROOT) -> str:
    """Commit of the working tree of this package; empty if there is none."""
    git = root / ".git"
    try:
        if git.is_file():  # of a linked working tree
            git = root / git.read_text().removeprefix("gitdir: ").strip()
        head = (git / "HEAD").read_text().strip()
        if not head.startswith("ref: "):
            return head
        shared = git / "commondir"
        git = git / shared.read_text().strip() if shared.is_file() else git
        ref = git / head[5:]
        if ref.is_file():
            return ref.read_text().strip()
        packed = (git / "packed-refs").read_text().splitlines()
        return next((line.split()[0] for line in packed if line.endswith(head[5:])), "")
    except OSError:
        return ""
