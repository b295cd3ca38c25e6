"""Origin of an archive: study, walkers, versions, processor and commit, as one JSON
string.
"""

from __future__ import annotations

import errno
import functools
import hashlib
import importlib.metadata
import json
import math
import os
import platform
import re
import shutil
import subprocess
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gaitsweep.pipeline.archive import attributes
from gaitsweep.pipeline.errors import ArchiveError
from gaitsweep.pipeline.study import toml

if TYPE_CHECKING:
    from gaitsweep.pipeline.graph.plan import Plan
    from gaitsweep.pipeline.study.model import Study

_BEGINNING = '{"commit": '  # of the provenance in an archive
_MAX_HEADER = 1 << 22  # bytes of an archive within which the provenance is
_FATAL = 128  # with which git ends where there is no working tree, for example
_ROOT = Path(__file__).resolve().parents[2]
_PACKAGES = ("gaitsweep", "heyoka", "joblib", "netCDF4", "numpy", "scipy")
#: Those of them on which numbers depend.
_NUMERICAL = ("gaitsweep", "heyoka", "numpy", "scipy")
#: Processor features that determine the instructions of compiled code, and so the last
#: bits of results.
_FEATURES = (
    "sse4_2",
    "avx",
    "avx2",
    "fma",
    "avx512f",
    "avx512dq",
    "avx512bw",
    "avx512vl",
    "asimd",
    "sve",
)


def provenance(plan: Plan) -> str:
    """Provenance of the results of a plan. Equal studies on equal processors give equal
    strings.
    """
    study = plan.study
    return json.dumps(
        {
            "study": study.text,
            "walkers": [check["table"] for check in study.checks],
            "violation_limits": list(
                attributes.violation_limits(study).items()
            ),  # in the order of their bits
            "varied": {
                key: axes
                for check in study.checks
                for key, axes in check["varied"].items()
            },
            "tuned": sorted({key for check in study.checks for key in check["tuned"]}),
            **(
                {"ways": ways}
                if (ways := [check["way"] for check in study.checks if "way" in check])
                else {}
            ),
            "tasks": {
                name: layer.task.version for name, layer in plan.graph.layers.items()
            },
            "packages": {name: version(name) for name in _PACKAGES},
            "python": platform.python_version(),
            "cpu": cpu_features(),
            "commit": commit(),
        },
        sort_keys=True,
    )


def stored(path: Path) -> dict[str, Any]:
    """Provenance of an archive, found in its first bytes without the netCDF library,
    which a damaged file can crash, and in `table` the study's text as it is read.

    Empty if there is no archive, or its study or walkers cannot be read.
    """
    try:
        with open(path, "rb") as file:
            text = file.read(_MAX_HEADER).decode("latin-1")
        record: dict[str, Any] = json.JSONDecoder().raw_decode(
            text, text.index(_BEGINNING)
        )[0]
        walkers = [dict(walker) for walker in record["walkers"]]
        return {**record, "walkers": walkers, "table": toml.read(record["study"])}
    except (
        OSError,
        AttributeError,
        LookupError,
        TypeError,
        ValueError,
        RecursionError,
    ):
        return {}


def check_same_study(path: Path, study: Study) -> None:
    """Check that an archive, if there is one, is of the study that is to replace it,
    perhaps with other axes and wants.

    Studies are the same if their kind is, and at least one of their walkers.

    Raises
    ------
    ArchiveError
        If it is of another one; a damaged archive, which does not say, may be replaced.
    """
    record = stored(path)
    if not record:
        return

    kind, walkers = record["table"].get("kind", "grid"), record["walkers"]
    own = [check["table"] for check in study.checks]
    if kind != study.kind:
        difference = f"its kind is {kind}, not {study.kind}"
    elif walkers and own and not any(_is_same(a, b) for a in walkers for b in own):
        changes = (
            f"{key} = {walkers[0][key]}, not {own[0][key]}"
            for key in own[0]
            if not _is_same(walkers[0], own[0], [key])
        )
        difference = f"its walker has {next(changes)}"
    else:
        return

    raise ArchiveError(
        f"{path} holds another study: {difference}; give this one another name, or replace that with --fresh."
    )


def _is_same(a: dict[str, Any], b: dict[str, Any], keys: Iterable[str] = ()) -> bool:
    """Whether two walkers have the same parameters but for rounding."""
    return all(
        a[key] == b[key]
        or (
            isinstance(a[key], float)
            and isinstance(b[key], float)
            and math.isclose(a[key], b[key])
        )
        for key in keys or a.keys() & b.keys()
        if key in a
    )


@functools.cache
def version(package: str) -> str:
    """Version of an installed package."""
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return "not installed"


@functools.cache
def code_digest(folder: str) -> str:
    """Digest of the code of a folder and of its tables, without docstrings, comments
    and layout.
    """
    root = _ROOT / folder
    files = [*root.rglob("*.py"), *root.rglob("*.toml")]
    digest = hashlib.sha256()
    for file in sorted(files):
        parts = file.read_text(encoding="utf-8").split('"""')
        without_docstrings = "".join(parts[::2])
        text = re.sub(r"#[^\n]*", "", without_docstrings)
        digest.update(" ".join(text.split()).encode())

    return digest.hexdigest()


@functools.cache
def software() -> dict[str, str]:
    """Versions of packages, and the digest of the code of `tasks`, on which numbers
    depend.
    """
    return {
        **{name: version(name) for name in _NUMERICAL},
        "code of `tasks`": code_digest("tasks")[:12],
    }


def cpu_features() -> list[str]:
    """Architecture of the processor and its features that affect results."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        flags = next(
            line for line in lines if line.lower().startswith(("flags", "features"))
        ).split()
    except (OSError, StopIteration):
        flags = []

    return [platform.machine(), *(f for f in _FEATURES if f in flags)]


@functools.cache
def commit(root: Path = _ROOT) -> str:
    """Commit of the working tree of this package; empty if there is none, or no git.

    Raises
    ------
    OSError
        If git cannot be started, or has no memory: not for that may archives differ.
    """
    git = root / ".git"
    if not git.exists() or shutil.which("git") is None:
        return ""

    # The tree is named, as an installed package may lie within another one.
    asked = ["git", f"--git-dir={git}", "rev-parse", "--verify", "--quiet", "HEAD"]
    answer = subprocess.run(
        asked, capture_output=True, text=True, env={**os.environ, "LC_ALL": "C"}
    )
    is_answer = answer.returncode in (0, 1, _FATAL)
    if not is_answer or "memory" in answer.stderr:
        raise OSError(errno.ENOMEM, os.strerror(errno.ENOMEM), "git")

    return answer.stdout.strip()
