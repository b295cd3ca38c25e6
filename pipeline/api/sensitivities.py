"""Derivatives of gaits by slope and keys, from Python."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from gaitsweep.pipeline.api.threads import in_turn
from gaitsweep.pipeline.dispatch import ask, for_question
from gaitsweep.pipeline.study import broadcast, files, slopes, units
from gaitsweep.pipeline.study.location import Location
from gaitsweep.pipeline.study.single_point import check_driven, led
from gaitsweep.tasks.contract.registry import GAITS, VARIABLES


@in_turn
def sensitivities(
    walker: str | Path | Mapping[str, object],
    slope: broadcast.Values,
    *,
    keys: Sequence[str] | None = None,
    variables: Sequence[str] | None = None,
    tuned: Sequence[str] = (),
    **changes: float,
) -> xr.Dataset:
    """Differentiate measures of a walker's gaits by slope and by its keys.

    Parameters
    ----------
    walker : str, Path or mapping
        A name from the catalogue, a walker file, or the table of a walker.
    slope : float, array or DataArray [rad]
        Slopes of the ground, in [1e-18, 0.5), of one dimension at most; of driven
        walkers also of 0 and below.
    keys : sequence of str, optional
        Keys of the walker, `detuning` or `foot_mass_ratio`; by default all keys that
        hold a number, of a leg of one link its own, and of those that drive the ones
        that are not 0.
    variables : sequence of str, optional
        Names of variables that hold a number of each gait, of one step; by default all.
    tuned : sequence of str
        Keys that follow the others so that the walker stays tuned, as for `gaits`; by
        one of them nothing is differentiated.
    **changes : float
        Walker keys to change, `foot_mass_ratio` or `detuning`.

    Returns
    -------
    xarray.Dataset
        Each variable's derivatives over the slopes, `gait` and `key`, whose first is
        the slope, all others at a fixed slope: in the variable's unit over the key's,
        `key_units`. NaN where there is no gait, at folds, of measures that are not
        smooth there, and by keys of which `key_reason` says why.

    Raises
    ------
    StudyError
        If the walker, a key, a variable or a slope is invalid.

    Notes
    -----
    The implicit function theorem gives how a gait moves with a key; its derivatives,
    and those of measures along it, are differences of the sixth order, which err by
    1e-9 of the larger of value and derivative, or what rounding leaves where a gait
    moves much.
    """
    definition, values = broadcast.definition(walker), broadcast.changes(changes)
    given, settings = led(definition, values)
    (grid,) = broadcast.broadcast({"slope": slope})[1]
    changed, each = files.changed(given, tuned=tuned), _slopes(grid)
    check_driven(changed, settings, float(each.min(initial=np.inf)))
    asked = {
        "walker": changed,
        "set": settings,
        "slope": each,
        "keys": None if keys is None else list(keys),
        "measures": None if variables is None else list(variables),
    }
    with for_question(grid.size):
        answer = ask("differentiate", asked)
    return _dataset(answer, grid)


def _slopes(grid: xr.DataArray) -> np.ndarray:
    """Slopes along one dimension, checked."""
    if grid.ndim > 1:
        bound = "must have one dimension at most"
        raise Location("", "slope").wrong(bound, f"{grid.ndim} dimensions")
    flat = grid.values.ravel().astype(float)
    for each in flat.tolist():
        slopes.check(each, may_be_level=True)
    return flat


def _dataset(answer: dict[str, Any], grid: xr.DataArray) -> xr.Dataset:
    """An answer over slopes, gaits and keys."""
    arrays: dict[str, Any] = {}
    for name, derivatives in answer["derivatives"].items():
        shaped = derivatives.reshape(*grid.shape, *derivatives.shape[1:])
        about = {
            "long_name": f"derivative of the {VARIABLES[name].long_name}",
            "units": answer["units"][name],
            "comment": "units are over those of the key, key_units",
        }
        arrays[name] = ((*grid.dims, "gait", "key"), shaped, about)

    kinds = units.kinds()
    checks = [{"si": answer["si"]}]
    coordinates: dict[str, Any] = {str(name): v for name, v in grid.coords.items()}
    coordinates["slope"] = (grid.dims, grid.values.astype(float), {"units": "rad"})
    coordinates["gait"] = list(GAITS)
    coordinates["key"] = answer["keys"]
    of_keys = [units.of_kind(kinds[key], checks) for key in answer["keys"]]
    coordinates["key_units"] = ("key", of_keys)
    reasons = [answer["absent"].get(key, "") for key in answer["keys"]]
    coordinates["key_reason"] = ("key", reasons)
    return xr.Dataset(arrays, coordinates)
