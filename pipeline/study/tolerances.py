"""By how much keys of a walker may be off: `[figures.tolerances]`, in their units or as
percentages of their values.
"""

from typing import TYPE_CHECKING, TypeVar

if TYPE_CHECKING:
    import xarray as xr

_Values = TypeVar("_Values", float, "xr.DataArray")


def is_percentage(tolerance: float | str) -> bool:
    """Whether a tolerance is a percentage of a key's value."""
    return isinstance(tolerance, str)


def size(tolerance: float | str, value: _Values) -> _Values:
    """By how much a key of some value, or of each of several, may be off [its units]."""
    if isinstance(tolerance, str):
        return abs(value) * (float(tolerance.rstrip("% ")) / 100)
    return 0 * value + tolerance
