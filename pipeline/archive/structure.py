"""Whether an archive has gaitsweep's layout, whoever wrote it: attributes, dimensions,
types and codes.
"""

import json
import math
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from gaitsweep.pipeline import dispatch
from gaitsweep.pipeline.archive import layout
from gaitsweep.pipeline.grid.boxes import MOST_POINTS, box_shape, boxes
from gaitsweep.pipeline.statuses import ALL_STATUSES
from gaitsweep.pipeline.study import slopes, toml
from gaitsweep.tasks.contract.accuracy import always
from gaitsweep.tasks.contract.registry import GAITS, MAX_STEPS, TASKS, VARIABLES

_CF_ATTRIBUTES = (
    "Conventions",
    "title",
    "institution",
    "source",
    "history",
    "references",
)
_ATTRIBUTES = (*_CF_ATTRIBUTES, "provenance", "study", "kind", "checksums")
#: Numbers that an archive may have among its attributes: kinds of types, the least and
#: the largest.
_RANGES = {
    "accuracy": ("f", 0.0, 1.0),
    "steps": ("i", 1, MAX_STEPS),
    "not_attempted": ("i", 0, 2**62),
}
#: Parts of the provenance.
_ORIGIN = {
    **{
        "study": str,
        "walkers": list,
        "varied": dict,
        "tasks": dict,
        "packages": dict,
        "python": str,
    },
    **{"cpu": list, "commit": str},
}
_WORDS = {str: "text", list: "list", dict: "table"}
_FLAGS = {"status": "flag_values", "violations": "flag_masks"}
#: Errors that a check may raise on an arbitrary file.
_UNEXPECTED = (
    ArithmeticError,
    AttributeError,
    LookupError,
    RecursionError,
    TypeError,
    ValueError,
)


def misfits(file: Any) -> Iterator[str]:
    """Departures of an open archive from gaitsweep's layout, one sentence each."""
    for check in (
        _attributes,
        _origins,
        _dimensions,
        _coordinates,
        _types,
        _states,
        _descriptions,
    ):
        try:
            yield from check(file)
        except _UNEXPECTED as error:
            yield f"Its {check.__name__.strip('_')} are not those of an archive ({type(error).__name__})."


def _attributes(file: Any) -> Iterator[str]:
    for name in _ATTRIBUTES:
        if not isinstance(getattr(file, name, None), str):
            yield f"The attribute `{name}` is missing."

    for name in ("provenance", "checksums"):
        try:
            if not isinstance(json.loads(getattr(file, name)), dict):
                raise ValueError
        except (AttributeError, TypeError, ValueError, RecursionError):
            yield f"`{name}` is not JSON."

    if getattr(file, "kind", "grid") not in ("grid", *TASKS):
        yield "`kind` is no kind of study."
    for name, (kinds, low, high) in _RANGES.items():
        value = np.asarray(getattr(file, name, low))
        if value.ndim or value.dtype.kind not in kinds or not low <= value <= high:
            yield f"The attribute `{name}` is no number that it may be."

    for name in (*_required(file), "reason_text"):
        if name not in file.variables:
            yield f"`{name}` is missing."


def _origins(file: Any) -> Iterator[str]:
    record = json.loads(file.provenance)
    for name, kind in _ORIGIN.items():
        if not isinstance(record.get(name, kind()), kind):
            yield f"`{name}` in `provenance` is no {_WORDS[kind]}."

    toml.read(record["study"])
    if not record["walkers"]:
        yield "`provenance` holds no walker."
    yield from (
        f"`provenance` holds a walker whose {key}"
        for w in record["walkers"]
        for key in _not_numbers(w)
    )


def _not_numbers(parameters: Mapping[str, Any]) -> Iterator[str]:
    """Parameters of a walker that are no finite numbers."""
    for key in set(parameters) & set(
        dispatch.resolve("gaitsweep.tasks.walkers.walker:NUMBERS")
    ):
        if not isinstance(parameters[key], int | float) or not math.isfinite(
            parameters[key]
        ):
            yield f"{key} is not a finite number."


def _coordinates(file: Any) -> Iterator[str]:
    """Values that say where on a grid something stands: coordinates, and parameters of
    walkers.
    """
    yield from (
        f"The attribute {sentence}"
        for sentence in _not_numbers({n: file.getncattr(n) for n in file.ncattrs()})
    )
    tuned = json.loads(file.provenance).get("tuned", ())
    axes = {
        name for name in file.dimensions if name != "slope"
    }  # tables give the slope of what was not found, too
    for path, variable in layout.variables(file):
        name, is_number = variable.name, np.dtype(variable.dtype).kind == "f"
        is_coordinate = layout.dims(variable) == (name,)
        is_parameter = path == name and "gait" not in variable.dimensions
        if not (is_coordinate or (is_number and (is_parameter or name in axes))):
            continue

        values = np.ma.getdata(variable[...])
        if (
            is_number and not np.isfinite(values).all() and name not in tuned
        ):  # where no walker is tuned
            yield f"`{path}` holds values that are not finite."
        elif is_coordinate and len(np.unique(values)) < values.size:
            yield f"`{path}` holds a value twice."
        elif (
            is_coordinate
            and name == "slope"
            and not (slopes.is_slope(values) | slopes.is_level(values)).all()
        ):
            yield f"`slope` {slopes.BOUND_OF_DRIVEN}."


def _required(file: Any) -> tuple[str, ...]:
    """Variables that an archive of its kind and accuracy holds, whatever was wanted."""
    is_grid = getattr(file, "kind", "grid") == "grid"
    return always(getattr(file, "accuracy", 0.0)) if is_grid else ("status", "reason")


def _dimensions(file: Any) -> Iterator[str]:
    order = list(file.dimensions)
    for name, variable in file.variables.items():
        if [order.index(d) for d in variable.dimensions] != sorted(
            {order.index(d) for d in variable.dimensions}
        ):
            yield f"`{name}` has its dimensions in another order."

    for name in file.dimensions:
        if (
            name not in file.variables
            and name != "reason_index"
            and not layout.is_of_characters(name)
        ):
            yield f"The dimension `{name}` has no coordinate."
        elif name in file.variables and layout.dims(file.variables[name]) != (name,):
            yield f"The coordinate `{name}` has other dimensions."


def _types(file: Any) -> Iterator[str]:
    """Dimensions, types and flags of variables."""
    grid = file.variables["status"].dimensions
    for name, variable in file.variables.items():
        about = VARIABLES.get(name)
        if not about or name in file.dimensions:
            continue

        dims = (
            (*(d for d in grid if d != "gait"), *about.dims) if "gait" in grid else grid
        )
        if (
            variable.dimensions != dims
            or np.dtype(variable.dtype).kind != np.dtype(about.dtype).kind
        ):
            yield f"`{name}` has another type or other dimensions."

        flags = _FLAGS.get(name)
        if flags and len(np.atleast_1d(getattr(variable, flags))) != len(
            variable.flag_meanings.split()
        ):
            yield f"The flags of `{name}` have other meanings."

    sentences = file.variables["reason_text"]
    if (
        layout.dims(sentences) != ("reason_index",)
        or sentences[:0].dtype.kind not in "OU"
    ):
        yield "`reason_text` is no table of sentences."


def _descriptions(file: Any) -> Iterator[str]:
    for path, variable in layout.variables(file):
        for attribute in ("long_name", "units"):
            if not isinstance(getattr(variable, attribute, None), str):
                yield f"`{path}` has no {attribute}."


def _states(file: Any) -> Iterator[str]:
    unknown = outside = left = 0
    for status in _parts(file.variables["status"]):
        unknown += int(np.count_nonzero(~np.isin(status, list(ALL_STATUSES.values()))))
        left += int(np.count_nonzero(status == ALL_STATUSES["not_attempted"]))

    for reason in _parts(file.variables["reason"]):
        outside += int(
            np.count_nonzero(
                (reason < 0) | (reason >= len(file.dimensions["reason_index"]))
            )
        )

    if unknown:
        yield "`status` holds values without a meaning."
    if outside:
        yield "`reason` points outside its table."
    if left:
        yield f"It is not complete: {left:,} values of `status` are not_attempted."
    if "gait" in file.variables and not set(
        file.variables["gait"][...].tolist()
    ) <= set(GAITS):
        yield "`gait` holds unknown names."


def _parts(variable: Any) -> Iterator[np.ndarray]:
    """Values of a variable box by box: memory may not hold all of them."""
    sizes = dict(zip(variable.dimensions, variable.shape, strict=True))
    for box in boxes(sizes, box_shape(sizes, MOST_POINTS), MOST_POINTS):
        yield np.asarray(variable[box])
