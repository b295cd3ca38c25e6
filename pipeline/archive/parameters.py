"""Parameters of the walkers in the archive: variables along the axes where they vary,
attributes where they do not.
"""

import json
from collections.abc import Collection, Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from gaitsweep.pipeline import dispatch
from gaitsweep.pipeline.archive.attributes import put
from gaitsweep.pipeline.archive.written import write_variable
from gaitsweep.pipeline.study import units
from gaitsweep.pipeline.study.model import Definition, Study

_OFFSET = (
    "where the walker is tuned to rounding, the double nearest the offset that tunes it "
    "exactly, as it is solved"
)


def write(file: Any, study: Study) -> None:
    """Write every parameter of the study's walkers that is not an axis itself.

    Parameters
    ----------
    file : netCDF4.Dataset
        With the dimensions and coordinates of the lines' axes.
    study : Study

    Notes
    -----
    A parameter that the walkers of a study do not share is a variable along `walker`,
    one that axes such as `detuning` move, or that is tuned anew along them, is one along
    these; so `ds.where(ds.R > 0.2)` selects by either. All others are global attributes
    under their own names. Exact offsets of tuned walkers are in the attribute
    `exact_offsets`.
    """
    axes = {axis.name: axis.values for axis in study.line_axes}
    tables = [check["table"] for check in study.checks]
    for key in _constant_along_lines(study):
        if key not in axes and key != study.along:
            _write_one(file, study, key, axes)

    moved = set(axes)
    for check in study.checks:
        for key, owners in check["varied"].items():
            if axes.keys() & owners:
                moved.add(key)

    names = study.names if study.walker_axis else ()
    put(file, exact_offsets(moved, tables, names))


def _constant_along_lines(study: Study) -> list[str]:
    """Keys of walkers but for those that are varied until gaits have the values wanted
    of them.
    """
    sought: set[str] = set()
    for check in study.checks:
        sought.update(check.get("sought", ()))

    numbers = dispatch.resolve("gaitsweep.tasks.walkers.walker:NUMBERS")
    return [key for key in numbers if key not in sought]


def described(
    key: str, checks: Sequence[Mapping[str, Any]], is_moved: bool
) -> dict[str, str]:
    """CF attributes of a parameter, which axes may move."""
    about = units.described(f"walker's {key}", units.kinds()[key], checks)
    if is_moved and key in ("w_t", "w_s"):
        about["comment"] = _OFFSET
    return about


def exact_offsets(
    varying: Collection[str],
    tables: Sequence[Mapping[str, Any]],
    names: Sequence[str] = (),
) -> dict[str, str]:
    """The attribute with the exact offsets of tuned walkers, of which others hold the
    nearest doubles.

    Parameters
    ----------
    varying : collection of str
        Keys that vary along axes; those of the static conditions leave no constant
        offsets.
    tables : sequence of mapping
        The walkers.
    names : sequence of str
        Theirs, where there are several.

    Returns
    -------
    dict
        `exact_offsets`, JSON: decimal numbers by key, by walker where there are
        several. Empty without such walkers.
    """
    conditioned = dispatch.resolve("gaitsweep.tasks.walkers.statics:CONDITIONED")
    if not {*varying}.isdisjoint(conditioned):
        return {}

    walker = dispatch.resolve("gaitsweep.tasks.walkers.walker:Walker")
    exact = dispatch.resolve("gaitsweep.tasks.walkers.exact:exact_offsets")
    found = [exact(walker(**table)) for table in tables]
    if not any(found):
        return {}

    about = found[0]
    if names:
        pairs = zip(names, found, strict=True)
        about = {name: offsets for name, offsets in pairs if offsets}

    return {"exact_offsets": json.dumps(about)}


def _on_grid(
    walker: Definition, key: str, axes: Mapping[str, np.ndarray]
) -> np.ndarray:
    """A walker's parameter at every point of a grid of axes, flattened; NaN where it
    cannot be tuned.
    """
    grid = np.meshgrid(*map(np.asarray, axes.values()), indexing="ij")
    changes = {}
    for name, values in zip(axes, grid, strict=True):
        changes[name] = values.ravel().astype(float)

    return of_walkers(walker, key, changes)


def _movers(study: Study, key: str, axes: Iterable[str]) -> tuple[str, ...]:
    """The axes that move a parameter of any of the study's walkers."""
    owners: set[str] = set()
    for check in study.checks:
        owners.update(check["varied"].get(key, ()))
    return tuple(axis for axis in axes if axis in owners)


def _write_one(
    file: Any, study: Study, key: str, axes: Mapping[str, np.ndarray]
) -> None:
    """Write a parameter of the study's walkers along the axes that move it."""
    tables = [check["table"] for check in study.checks]
    across = _movers(study, key, axes)
    if not across and not any(key in table for table in tables):
        return

    # Tables leave out what their walker is not driven by.
    values = np.array([float(table.get(key, 0.0)) for table in tables])
    is_own = study.walker_axis and (across or len(set(values)) > 1)
    sizes = {axis: len(axes[axis]) for axis in across}
    if is_own:
        sizes = {"walker": len(study.walkers), **sizes}
    if across:
        moving = {axis: axes[axis] for axis in across}
        values = np.array([_on_grid(w, key, moving) for w in study.walkers])

    if not sizes:
        put(file, {key: float(values.ravel()[0])})
        return

    about = described(key, study.checks, bool(across))
    on_axes = values.reshape(list(sizes.values()))
    write_variable(file, key, tuple(sizes), on_axes, about)


def of_walkers(walker: Definition, key: str, changes: Mapping[str, Any]) -> np.ndarray:
    """A parameter of a walker with n values of keys, (n,), and others that all share;
    NaN where it cannot be tuned.
    """
    resolve = dispatch.resolve("gaitsweep.tasks.walkers.resolve:resolve_many")
    walkers = resolve(walker, changes)
    n = max(np.size(value) for value in changes.values())
    return np.broadcast_to(getattr(walkers, key), n)
