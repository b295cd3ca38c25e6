"""What other packages add by entry points: walkers, measures and figures.

A name that is not gaitsweep's own is looked up where it is asked for, never at import;
gaitsweep's own come first. docs/extending.md shows a package.
"""

from functools import cache
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint


class ExtensionError(ValueError):
    """What a package adds cannot be used."""


@cache
def _points(group: str) -> "dict[str, list[EntryPoint]]":
    from importlib.metadata import entry_points

    found: dict[str, list[EntryPoint]] = {}
    for point in entry_points(group=f"gaitsweep.{group}"):
        found.setdefault(point.name, []).append(point)
    return found


def names(group: str) -> list[str]:
    """Names that packages add to a group: "walkers", "measures" or "figures"."""
    return sorted(_points(group))


def find(group: str, name: str, kind: type) -> Any:
    """What a package adds under a name, an object of some kind; None if there is no
    such name.

    Raises
    ------
    ExtensionError
        If it cannot be loaded, is of another kind, or two packages add it.
    """
    points = _points(group).get(name, [])
    if not points:
        return None
    packages = " and ".join(
        sorted(point.dist.name if point.dist else "?" for point in points)
    )
    about = f"`{name}`, which {packages} adds to {group},"
    if len(points) > 1:
        raise ExtensionError(f"{about} is added twice")
    try:
        found = points[0].load()
    except Exception as error:  # whatever a module may raise
        raise ExtensionError(
            f"{about} cannot be loaded: {type(error).__name__}: {error}"
        ) from error
    if not isinstance(found, kind):
        raise ExtensionError(
            f"{about} must be a {kind.__name__}; it is a {type(found).__name__}"
        )
    return found
