"""What the fields of a study must be together, one sentence each.

A rule yields an error for each place at which a study breaks it.
"""

from collections.abc import Callable, Iterator
from typing import TypeAlias

from gaitsweep.pipeline.errors import StudyError
from gaitsweep.pipeline.study.fields import WANT
from gaitsweep.pipeline.study.location import Location
from gaitsweep.pipeline.study.model import Study
from gaitsweep.tasks.contract import registry
from gaitsweep.tasks.contract.registry import (
    NEEDED_KINDS,
    OVER_LINES,
    SENSITIVITIES,
    VARIABLES,
)

Rule: TypeAlias = Callable[[Study, Location], Iterator[StudyError]]
#: Largest grid; anything above is taken for a mistake.
MAX_POINTS = 10**12


def check(study: Study, top: Location) -> None:
    """Check a study by all rules.

    Raises
    ------
    StudyError
        If it breaks one.
    """
    for rule in RULES:
        for error in rule(study, top):
            raise error


def _accuracy_is_of_grids(study: Study, top: Location) -> Iterator[StudyError]:
    """An accuracy is of the gaits of a grid."""
    if study.accuracy and study.kind != "grid":
        yield top.at("accuracy").error(
            f"`accuracy` is of the gaits of a grid; this study is a `{study.kind}`"
        )


def _what_is_wanted_has_its_kind(study: Study, top: Location) -> Iterator[StudyError]:
    """What is wanted is made by studies of this kind."""
    for key, name in _wanted(study, "fits", "figures", "claims"):
        place, needed = top.at("want", key), NEEDED_KINDS.get(name, study.kind)
        if needed != study.kind:
            yield place.error(
                f"`{name}` needs a study of kind `{needed}`; this one is `{study.kind}`"
            )
        if study.kind == "design" and name in OVER_LINES:
            yield place.error(f"`{name}` needs a study of another kind than `design`")


def _adaptive_slopes_follow_branches(
    study: Study, top: Location
) -> Iterator[StudyError]:
    """Slopes that follow the gaits are those of a study of branches."""
    if "adaptive" in study.options and study.kind != "branch":
        yield top.at("axes", "slope", "adaptive").error(
            '`adaptive` is for studies of kind "branch", whose points follow the gaits'
        )


def _curves_have_a_range(study: Study, top: Location) -> Iterator[StudyError]:
    """The range of the key of curves rises."""
    if study.kind == "curve":
        options = registry.options("curve", study.options)
        if not options["from"] < options["to"]:
            bound = f"must be less than `to` = {options['to']!r}"
            yield top.at("options", "from").wrong(bound, options["from"])


def _planes_have_their_own_keys(study: Study, top: Location) -> Iterator[StudyError]:
    """Curves over a plane vary its keys, and nothing else sets them."""
    plane = study.options.get("plane", {})
    if not plane:
        return
    for name in ("key", "from", "to"):
        if name in study.options:
            yield top.at("options", name).error(
                f"`{name}` is of curves over the slope and a key, and `plane` is set"
            )
    for axis in study.line_axes:
        if axis.name in plane:
            yield top.at("axes", axis.name).error(
                f"`{axis.name}` is a key of `plane`, and can be no axis"
            )


def _curves_are_of_something(study: Study, top: Location) -> Iterator[StudyError]:
    """Curves are of special points or of levels."""
    if study.kind == "curve":
        options = registry.options("curve", study.options)
        if not options["kinds"] and not options["levels"]:
            yield top.at("options", "kinds").wrong(
                "must name special points, where there are no `levels`", []
            )


def _ground_needs_a_slope(study: Study, top: Location) -> Iterator[StudyError]:
    """Steps of the ground are survived at a slope."""
    if study.kind == "design":
        options = registry.options("design", study.options)
        if options["ground"] and options["at_slope"] is None:
            yield top.at("options").error(
                "`ground` needs the slope at which the walker walks, `at_slope`"
            )


def _the_transition_is_of_short_gaits(
    study: Study, top: Location
) -> Iterator[StudyError]:
    """The transition is a law of short gaits."""
    if "transition" in study.fits and "short" not in study.gaits:
        yield top.at("gaits").error(
            "`transition` is a law of short gaits, which `gaits` leaves out"
        )


def _a_grid_has_a_size(study: Study, top: Location) -> Iterator[StudyError]:
    """A grid is not larger than any that is meant; the slopes of designs are a window."""
    count = study.lines if study.kind == "design" else study.points
    if count > MAX_POINTS:
        yield top.at("axes").error(
            f"The grid has {count:.3g} points, more than {MAX_POINTS:.0e}"
        )


def _a_window_has_two_ends(study: Study, top: Location) -> Iterator[StudyError]:
    """Slopes that are a window are two at least."""
    slopes = study.slope
    is_window = study.kind in registry.WINDOWED and "plane" not in study.options
    if is_window and slopes.min() == slopes.max():
        yield top.at("axes", "slope").error(
            f"The slopes of a `{study.kind}` are a window: give at least two; got {slopes[0]:g}"
        )


def _several_steps_have_no_laws(study: Study, top: Location) -> Iterator[StudyError]:
    """Of gaits of several steps nothing is wanted that is known for one step only."""
    if study.steps == 1:
        return
    for key, name in _wanted(study, *WANT):
        if is_of_one_step(name) or key == "claims":
            yield top.at("want", key).error(
                f"`{name}` is of gaits of one step, and `steps` is {study.steps}"
            )
    if "adaptive" in study.options:
        yield top.at("axes", "slope").error(
            f"`adaptive` is for gaits of one step, and `steps` is {study.steps}: give `n`"
        )


def _targets_are_of_gaits_of_a_grid(
    study: Study, top: Location
) -> Iterator[StudyError]:
    """Gaits of one step are sought at values of a measure, in place of a grid's slopes."""
    if not study.at:
        return
    if study.kind != "grid":
        yield top.at("at").error(
            f"`at` is of the gaits of a grid; this study is a `{study.kind}`"
        )
    if study.steps > 1:
        yield top.at("options", "steps").error(
            f"`at` is of gaits of one step, and `steps` is {study.steps}"
        )
    for key, name in _wanted(study, "fits", "figures", "claims"):
        if name in registry.READS or key != "figures":
            yield top.at("want", key).error(
                f"`{name}` is of gaits at slopes, and `at` seeks them at values"
            )
    for name in ("proved", "proved_radius"):
        if name in study.variables:
            yield top.at("want", "variables").error(
                f"`{name}` is of gaits at slopes, and `at` seeks them at values"
            )


def is_of_one_step(name: str) -> bool:
    """Whether something that may be wanted is known of gaits of one step only."""
    about = VARIABLES.get(name)
    is_derivative = about is not None and about.group == SENSITIVITIES
    return is_derivative or name in registry.OF_ONE_STEP


def _wanted(study: Study, *keys: str) -> Iterator[tuple[str, str]]:
    """Names in some fields of what a study wants, each after its field."""
    for key in keys:
        for name in getattr(study, key):
            yield key, name


RULES: tuple[Rule, ...] = (
    _accuracy_is_of_grids,
    _what_is_wanted_has_its_kind,
    _adaptive_slopes_follow_branches,
    _curves_have_a_range,
    _planes_have_their_own_keys,
    _curves_are_of_something,
    _ground_needs_a_slope,
    _the_transition_is_of_short_gaits,
    _a_grid_has_a_size,
    _a_window_has_two_ends,
    _several_steps_have_no_laws,
    _targets_are_of_gaits_of_a_grid,
)
