"""Kinds of points of branches, which `kinds.toml` lists: folds, flips, ends of walking
and others, by the names that studies, archives and pages give them.

Like the registry, this module imports nothing but the standard library. What equations
define them is in `tasks.branches.conditions`.
"""

import tomllib
from dataclasses import dataclass
from pathlib import Path

#: Quantities of a design that are least or largest at points of its branches.
SMALLEST_SLOPE, LARGEST_STABLE_SLOPE, FASTEST_STABLE_SPEED = (
    "smallest_slope",
    "largest_stable_slope",
    "fastest_stable_speed",
)
#: Those of the points that have the speed asked for: of all, and of the stable ones.
COSTS = ("least_cost", "least_stable_cost")


@dataclass(frozen=True)
class Kind:
    """A kind of points of branches.

    Attributes
    ----------
    meaning : str
        What happens there.
    ends : str
        "walking" where gaits beyond are no steps, "following" where a limit is reached
        up to which branches are continued, empty where they go on or end for another
        reason.
    needs_knee : bool
        Whether only walkers with knees have it.
    is_passed : bool
        Whether it is looked for between the nodes of a branch, which goes on beyond it,
        and listed among the branch's special points.
    exchanges_stability : bool
        Whether the stability of gaits may change there.
    critical : float, "pair" or None
        The multiplier that is on the unit circle by definition, or a pair of them.
    turns_slope : bool
        Whether the slope turns there along the branch, or along the one that begins.
    doubles_steps : bool
        Whether gaits of twice as many steps begin there.
    is_crossing : bool
        Whether branches cross there, so that two solutions lie near each other.
    steps_vanish : bool
        Whether steps vanish there.
    is_edge : bool
        Whether nothing happens there, and only what was asked for ends.
    is_asked_for : bool
        Whether the value that a quantity has there is asked for by a study.
    undefined : tuple of str
        Kinds whose conditions have no value there.
    is_followed : bool
        Whether it may be followed as a walker's key varies, in studies of kind `curve`.
    is_sought : bool
        Whether it is looked for between nodes wherever a design's extremes are.
    is_rival : bool
        Whether it may take the place of another point as a design's extreme.
    extremes : tuple of str
        Quantities of a design that may be least or largest there.
    """

    meaning: str
    ends: str = ""
    needs_knee: bool = False
    is_passed: bool = False
    exchanges_stability: bool = False
    critical: float | str | None = None
    turns_slope: bool = False
    doubles_steps: bool = False
    is_crossing: bool = False
    steps_vanish: bool = False
    is_edge: bool = False
    is_asked_for: bool = False
    undefined: tuple[str, ...] = ()
    is_followed: bool = False
    is_sought: bool = False
    is_rival: bool = False
    extremes: tuple[str, ...] = (
        SMALLEST_SLOPE,
        LARGEST_STABLE_SLOPE,
        FASTEST_STABLE_SPEED,
    )

    @property
    def is_of_stable_gaits(self) -> bool:
        """Whether only stable gaits may have an extreme there."""
        return all("stable" in quantity for quantity in self.extremes)

    def defines(self, name: str) -> bool:
        """Whether the condition of the kind `name` has a value there."""
        return name not in self.undefined


def _read() -> dict[str, Kind]:
    text = Path(__file__).with_suffix(".toml").read_text(encoding="utf-8")
    kinds = {}
    for name, row in tomllib.loads(text).items():
        for field in ("extremes", "undefined"):
            if field in row:
                row[field] = tuple(row[field])
        kinds[name] = Kind(**row)
    return kinds


#: Every kind, by its name.
KINDS = _read()
#: What follows from other reasons why branches end.
_NO_KIND = Kind("a branch ends for a reason of its own")
#: Those whose curves a study of kind `curve` follows.
FOLLOWED = tuple(name for name, kind in KINDS.items() if kind.is_followed)
#: Those that may take the place of another point as a design's extreme.
RIVALS = tuple(name for name, kind in KINDS.items() if kind.is_rival)


def kind_of(name: str) -> Kind:
    """Return what is known of points of a name; nothing follows from one that is no
    kind, as of a reason why a branch ends.
    """
    return KINDS.get(name, _NO_KIND)
