"""What the fields of a study must be together, one sentence each.

A rule yields an error for each place at which a study breaks it.
"""

from collections.abc import Callable, Iterable, Iterator
from typing import TypeAlias

from gaitsweep.pipeline.errors import StudyError
from gaitsweep.pipeline.study import slopes, target, tolerances
from gaitsweep.pipeline.study.corners import parameters
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
#: Most free keys of an optimum.
_MOST_FREE = 8
#: The figure of what is varied until gaits have values of a measure.
_SOUGHT = "sought"
#: Largest grid; anything above is taken for a mistake.
MAX_POINTS = 10**12


def check(study: Study, top: Location) -> None:
    """Check a study by the rules for its fields.

    Raises
    ------
    StudyError
        If it breaks one.
    """
    _check(study, top, RULES)


def check_with_walkers(study: Study, top: Location) -> None:
    """Check a study, whose walkers are known to be, by the rules for both.

    Raises
    ------
    StudyError
        If it breaks one.
    """
    _check(study, top, RULES_OF_WALKERS)


def _check(study: Study, top: Location, rules: Iterable[Rule]) -> None:
    for rule in rules:
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
    """Points that follow the gaits are those of a study of branches, along these."""
    if "adaptive" not in study.options:
        return
    place = top.at("axes", study.along, "adaptive")
    if study.kind != "branch":
        yield place.error(
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
    """Curves are of special points, of levels or of onsets."""
    if study.kind == "curve":
        options = registry.options("curve", study.options)
        if not any(options[name] for name in ("kinds", "levels", "onsets")):
            yield top.at("options", "kinds").wrong(
                "must name special points, where there are no `levels` and `onsets`", []
            )


def _optima_are_of_something(study: Study, top: Location) -> Iterator[StudyError]:
    """An optimum is of one objective over free keys, which nothing else sets."""
    if study.kind != "optimum":
        return

    options, place = registry.options("optimum", study.options), top.at("options")
    objectives = [options[name] for name in ("minimise", "maximise") if options[name]]
    if len(objectives) != 1:
        both = ", not both" if objectives else ""
        yield place.error(f"An optimum needs either `minimise` or `maximise`{both}")
        return

    if not 1 <= len(options["free"]) <= _MOST_FREE:
        yield place.error(
            f"An optimum needs 1 to {_MOST_FREE} keys that are `free`, with their ranges"
        )

    axes = [axis.name for axis in study.line_axes]
    for key in options["free"]:
        if key in axes:
            yield place.at("free", key).error(
                f"`{key}` is free, and an axis sets it too"
            )

    (objective,) = objectives
    if objective in axes or (objective == "slope" and len(study.values_along) == 1):
        yield place.error(f"`{objective}` is what is best, and its axis fixes it")


def _optima_are_not_fixed(study: Study, top: Location) -> Iterator[StudyError]:
    """No constraint of an optimum contradicts another or fixes the objective."""
    if study.kind != "optimum":
        return

    options, place = registry.options("optimum", study.options), top.at("options")
    objective = options["minimise"] or options["maximise"]
    for name, (low, high) in options["within"].items():
        own = place.at("within", name)
        if name == objective and low == high:
            yield own.error(f"`{name}` is what is best, and this fixes it")
        if name in options["tradeoff"]:
            yield own.error(
                f"`{name}` has the values of `tradeoff`, and this range too"
            )

        if name == "spectral_radius" and options["stable"] and low >= 1:
            yield own.error(
                "Stable gaits have less than 1; `stable = false` allows more"
            )

    if len(options["tradeoff"]) > 1:
        yield place.at("tradeoff").error("The objective is traded for one measure")
    if objective in options["tradeoff"]:
        yield place.at("tradeoff").error(f"`{objective}` is what is best")
    if not {"long", "short"} & set(study.gaits):
        yield top.at("gaits").error("The gaits of an optimum are `long` or `short`")


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


def _level_ground_has_its_kinds(study: Study, top: Location) -> Iterator[StudyError]:
    """On slopes of 0 and below gaits are solved point by point, or followed over two
    keys or over what drives.
    """
    level = _level(study)
    is_pointwise = study.kind in ("grid", "orbit", "basin")
    if not level or is_pointwise or study.drive or "plane" in study.options:
        return
    if study.kind == "optimum":
        yield from _optima_have_one_level_slope(study, top)
        return

    wrong = f"`slope` {slopes.BOUND} in studies of kind `{study.kind}`"
    instead = "grids, orbits, basins and optima of driven walkers have gaits"
    if study.kind == "curve":
        instead = "curves are over a `plane` of two keys"
    if study.kind == "design":
        instead = (
            "folds, flips and ends over `push_off` or `hip_torque` and another key are "
            "followed in studies of kind `curve` with a `plane`"
        )
    if study.kind in registry.OVER_DRIVE:
        instead = (
            "give an axis `push_off` or `hip_torque`, over which they are followed"
        )
        drives = [a.name for a in study.axes if a.name in registry.DRIVES]
        if drives:
            # Beside slopes above 0, or all would be along what drives.
            highest = float(study.values_along.max())
            yield top.at("axes", "slope").error(
                f"Slopes must be all <= 0 where gaits are followed over "
                f"`{drives[0]}`, or all > 0; got {level[0]:g} and {highest:g}"
            )
            return

    yield top.at("axes", "slope").error(
        f"{wrong}; got {level[0]:g}: on level ground and uphill {instead}"
    )


def _optima_have_one_level_slope(study: Study, top: Location) -> Iterator[StudyError]:
    """The slopes of an optimum are a window of positive ones, or one of any sign."""
    low, high = float(study.values_along.min()), float(study.values_along.max())
    if low != high:
        yield top.at("axes", "slope").error(
            f"Slopes of an optimum must be all > 0, or one that is 0 or below; got "
            f"{low:g} and {high:g}"
        )


def _level_ground_needs_a_drive(study: Study, top: Location) -> Iterator[StudyError]:
    """Slopes of 0 and below are those of walkers that are driven."""
    level = _level(study)
    if level and not study.is_driven:
        yield top.at("axes", "slope").error(
            f"`slope` {slopes.BOUND} for passive walkers; got {level[0]:g}: "
            f"{slopes.WHAT_DRIVES}"
        )


def _what_is_turned_has_inertia(study: Study, top: Location) -> Iterator[StudyError]:
    """A torque between the thighs turns a swing leg that has an inertia about the hip."""
    for name, check in zip(study.names, study.checks, strict=True):
        if study.drive == "hip_torque" and check["massless_leg"]:
            yield top.at("axes", "hip_torque").error(
                f"Gaits are followed over `hip_torque` where the swing leg has an "
                f"inertia about the hip; that of `{name}` is 0"
            )


def _level(study: Study) -> list[float]:
    """Slopes of 0 and below that a study asks for."""
    level: list[float] = []
    for axis in study.axes:
        if axis.name == "slope":
            level += axis.values[slopes.is_level(axis.values)].tolist()

    return level


def _what_drives_has_a_logarithm(study: Study, top: Location) -> Iterator[StudyError]:
    """Gaits are followed over the logarithm of what drives."""
    least = float(study.values_along.min())
    if study.drive and study.kind != "grid" and least <= 0:
        yield top.at("axes", study.drive).wrong(
            "must be > 0 where gaits are followed over it", least
        )


def _what_is_over_slopes_has_slopes(
    study: Study, top: Location
) -> Iterator[StudyError]:
    """Fits, claims and figures of a walker's gaits over slopes are of such studies."""
    if not study.drive or study.kind == "grid":
        return
    for key, name in _wanted(study, "fits", "figures", "claims"):
        if key != "figures" or set(registry.READS.get(name, ())) & {*registry.TASKS}:
            yield top.at("want", key).error(
                f"`{name}` is of gaits over slopes, and these are followed over "
                f"`{study.drive}`"
            )


def _a_window_has_two_ends(study: Study, top: Location) -> Iterator[StudyError]:
    """Slopes that are a window are two at least, and so are values of what drives."""
    values = study.values_along
    is_window = study.kind in registry.WINDOWED and "plane" not in study.options
    if is_window and values.min() == values.max():
        what = f"values of `{study.drive}`" if study.drive else "slopes"
        yield top.at("axes", study.along).error(
            f"The {what} of a `{study.kind}` are a window: give at least two; got {values[0]:g}"
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
        yield top.at("axes", study.along).error(
            f"`adaptive` is for gaits of one step, and `steps` is {study.steps}: give `n`"
        )

    if study.options.get("sensitivities"):
        yield top.at("options", "sensitivities").error(
            f"`sensitivities` are of gaits of one step, and `steps` is {study.steps}"
        )


def _slopes_are_differentiated_over_slopes(
    study: Study, top: Location
) -> Iterator[StudyError]:
    """Of special points over what drives at one slope none is differentiated."""
    if study.options.get("sensitivities") and study.along != "slope":
        yield top.at("options", "sensitivities").error(
            f"`sensitivities` are of slopes; this branch is followed over `{study.along}`"
        )


def _targets_are_of_gaits_of_a_grid(
    study: Study, top: Location
) -> Iterator[StudyError]:
    """Gaits are sought at values of a measure in place of a grid's slopes."""
    if not study.at:
        if _SOUGHT in study.figures:
            yield top.at("want", "figures").error(
                f"`{_SOUGHT}` is of gaits at values of a measure, and there is no `at`"
            )
        return

    try:
        target.check_steps(study.steps, study.at, top.at("options", "steps"))
    except StudyError as error:
        yield error

    for key, name in _wanted(study, "fits", "figures", "claims"):
        if key != "figures" or (name in registry.READS and name != _SOUGHT):
            yield top.at("want", key).error(
                f"`{name}` is of gaits at slopes, and `at` seeks them at values"
            )

    for name in ("proved", "proved_radius"):
        if name in study.variables:
            yield top.at("want", "variables").error(
                f"`{name}` is of gaits at slopes, and `at` seeks them at values"
            )


def _tolerances_have_derivatives(study: Study, top: Location) -> Iterator[StudyError]:
    """What follows from tolerances is known from derivatives by keys."""
    if not study.tolerances:
        return

    place = top.at("figures", "tolerances")
    if study.kind == "grid":
        if not any(VARIABLES[n].group == SENSITIVITIES for n in study.variables):
            yield place.error(
                f"`tolerances` need derivatives by keys: add `{SENSITIVITIES}` to the "
                "`variables` of `[want]`"
            )
    elif study.kind != "branch":
        yield place.error(
            "`tolerances` are of gaits of a grid, or of special points of branches; "
            f"this study is a `{study.kind}`"
        )
    elif not study.options.get("sensitivities"):
        yield place.error(
            "`tolerances` need derivatives by keys: add `sensitivities = true` to "
            "`[options]`"
        )
    elif "slope" in study.tolerances:
        yield place.error("Special points have slopes, and no tolerance of them")


def _costs_of_designs_are_of_gravity(
    study: Study, top: Location
) -> Iterator[StudyError]:
    """What else drives a walker pays for its gaits, too."""
    at_speed = study.options.get("at_speed") if study.kind == "design" else None
    if at_speed is not None and study.is_driven:
        yield top.at("options", "at_speed").wrong(
            "must be left out of maps of walkers that more than gravity drives: their "
            "cost of transport is not that of the slope alone",
            at_speed,
        )


def _tolerances_are_of_keys_of_walkers(
    study: Study, top: Location
) -> Iterator[StudyError]:
    """Tolerances are of keys that a walker has, and percentages of what is not 0."""
    if not study.tolerances:
        return

    place = top.at("figures", "tolerances")
    tables = list(parameters(study))
    for key, tolerance in study.tolerances.items():
        axes = [axis.values for axis in study.axes if axis.name == key]
        values = [table[key] for table in tables if key in table]
        values += [value for axis in axes for value in axis.tolist()]
        if not values:
            yield place.at(key).error(f"No walker of this study has a `{key}`")
        if tolerances.is_percentage(tolerance) and 0 in values:
            yield place.at(key).error(
                f"`{key}` = {str(tolerance)!r} is a percentage of 0: give a number"
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
    _optima_are_of_something,
    _optima_are_not_fixed,
    _ground_needs_a_slope,
    _the_transition_is_of_short_gaits,
    _a_grid_has_a_size,
    _level_ground_has_its_kinds,
    _what_drives_has_a_logarithm,
    _what_is_over_slopes_has_slopes,
    _a_window_has_two_ends,
    _several_steps_have_no_laws,
    _slopes_are_differentiated_over_slopes,
    _targets_are_of_gaits_of_a_grid,
    _tolerances_have_derivatives,
)
RULES_OF_WALKERS: tuple[Rule, ...] = (
    _level_ground_needs_a_drive,
    _what_is_turned_has_inertia,
    _costs_of_designs_are_of_gravity,
    _tolerances_are_of_keys_of_walkers,
)
