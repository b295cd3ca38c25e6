"""The gaits of a walker at one slope, without a study."""

import contextlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from gaitsweep.pipeline.dispatch import ask, for_question, telling
from gaitsweep.pipeline.errors import NoGaitError
from gaitsweep.pipeline.study import files, slopes, target
from gaitsweep.pipeline.study.fields import VIOLATION_LIMITS
from gaitsweep.pipeline.study.files import Reader
from gaitsweep.pipeline.study.location import Location
from gaitsweep.pipeline.study.model import Definition
from gaitsweep.pipeline.study.parse import accuracy
from gaitsweep.tasks.contract.registry import GAITS, MAX_STEPS, nameable


def solve(
    definition: Definition,
    slope: float,
    keys: Mapping[str, Any],
    every: bool,
    steps: int = 1,
    asked: float | None = None,
    limits: Mapping[str, float] | None = None,
    tuned: Sequence[str] = (),
) -> dict[str, Any]:
    """Find the gaits of a walker at one slope.

    Parameters
    ----------
    definition : str or dict
        Name, file or table of the walker.
    slope : float [rad]
    keys : mapping
        Walker keys to change, and `toward`, the name, file or text of a table of the
        walker that `detuning` leads to.
    every : bool
        Include gaits whose swing leg passes the stance leg more than once.
    steps : int
        Number of steps after which a gait repeats, at most MAX_STEPS.
    asked : float, optional
        Largest error bound wanted.
    limits : mapping, optional
        Limits of violations, by name.
    tuned : sequence of str
        Keys changed by least so that the walker meets the static conditions.

    Returns
    -------
    dict
        `gaits`, `units`, `search`, which describes the search, and `absent`, why there
        are none.

    Raises
    ------
    StudyError
        If the walker, a key, the slope, the accuracy or a limit is invalid.
    """
    slopes.check(slope, may_be_level=True)
    Location("", "steps").count(steps, MAX_STEPS)
    if every and steps > 1:
        raise Location("", "steps").wrong(
            "must be 1 for gaits whose legs pass more than once", steps
        )

    params = _of_walker(definition, keys, tuned, limits)
    check_driven(params["walker"], params["set"], slope)
    params |= {"slope": slope, "all": every, "steps": steps}
    if asked is not None:
        params["accuracy"] = accuracy(asked, Location("", "accuracy"))
    with for_question(), _telling_of(steps):
        answer: dict[str, Any] = ask("solve", params)
    return answer


def _telling_of(steps: int) -> contextlib.AbstractContextManager[None]:
    """Tell who waits long why: gaits of several steps are searched for, and followed
    from those of fewer, over all slopes.
    """
    if steps == 1:
        return contextlib.nullcontext()
    return telling(f"Following gaits of up to {steps} steps over all slopes.")


def solve_at(
    definition: Definition,
    at: Mapping[str, float],
    vary: str,
    between: Sequence[float] | None,
    slope: float | None,
    keys: Mapping[str, Any],
    limits: Mapping[str, float] | None = None,
    tuned: Sequence[str] = (),
    steps: int = 1,
) -> dict[str, Any]:
    """Find the gaits of a walker at which a measure has a value.

    Parameters
    ----------
    definition : str or dict
        Name, file or table of the walker.
    at : mapping
        The name of one measure, and the value wanted in the walker's units.
    vary : str
        `slope`, or a key of the walker.
    between : sequence of float, optional
        Least and largest value of what is varied.
    slope : float, optional [rad]
        Where a key is varied.
    keys, limits, tuned, steps
        As for `solve`.

    Returns
    -------
    dict
        As from `solve`.

    Raises
    ------
    StudyError
        If the walker, a key, the measure, its value, the range or the slope is invalid.
    """
    if not isinstance(at, Mapping):
        raise Location("", "at").wrong("must be a table of one measure", at)
    if len(at) != 1:
        raise Location("", "at").wrong("must name one measure", ", ".join(at))

    ((measure, value),) = at.items()
    Location("", "at").check_names([measure], nameable(), "measure")
    params: dict[str, Any] = {
        "measure": measure,
        "value": Location("", measure).number(value),
        "steps": steps,
        **target.varied(vary, between),
    }
    target.check_steps(steps, params, Location("", "steps"))
    if vary == "slope":
        if slope is not None:
            raise Location("", "slope").wrong("is varied and cannot be set too", slope)
    else:
        if slope is None:
            place = Location("", "vary")
            raise place.wrong("needs `slope`, as a key is varied", vary)
        slopes.check(slope, may_be_level=True)
        params["slope"] = slope

    params |= _of_walker(definition, keys, tuned, limits)
    if slope is not None and slopes.is_level(slope):
        checked = ask("check_target", {**params, "values": [params["value"]]})
        _refuse_undriven(checked, slope)

    with for_question(), _telling_of(steps):
        answer: dict[str, Any] = ask("solve_at", params)
    return answer


def _of_walker(
    definition: Definition,
    keys: Mapping[str, Any],
    tuned: Sequence[str],
    limits: Mapping[str, float] | None,
) -> dict[str, Any]:
    """The walker, the keys to set and the limits of violations, checked."""
    given, changes = led(definition, keys)
    params = {"walker": files.changed(given, tuned=tuned), "set": changes}
    if limits:
        place = Location("", "violation_limits")
        params["violation_limits"] = VIOLATION_LIMITS.read(limits, place)
    return params


def check_driven(walker: Definition, keys: Mapping[str, Any], slope: float) -> None:
    """Refuse a slope of 0, or below, of a walker that nothing drives there.

    Raises
    ------
    StudyError
        If it is one, or there is no such walker.
    """
    if not slopes.is_level(slope):
        return
    _refuse_undriven(ask("check_walker", {"walker": walker, "set": keys}), slope)


def _refuse_undriven(checked: Mapping[str, Any], slope: float) -> None:
    """Refuse a level slope of a walker that was checked, if nothing drives it."""
    if not checked["driven"]:
        raise slopes.undriven(slope)


def state_of(
    walker: Definition, slope: float, keys: Mapping[str, Any], label: str
) -> list[float]:
    """State of a gait just after heelstrike, (stance_angle, stance_rate, thigh_rate),
    in the walker's units.

    Raises
    ------
    StudyError
        As `solve`, and if there is no such label.
    NoGaitError
        If the walker has no such gait.
    """
    Location("", "gait").check_names([label], GAITS)
    answer = solve(walker, slope, keys, every=False)
    for gait in answer["gaits"]:
        if gait["gait"] == label:
            return [
                gait[name] for name in ("stance_angle", "stance_rate", "thigh_rate")
            ]

    why = [
        sentence for sentence in answer["absent"] if sentence.startswith(f"No {label} ")
    ]
    raise NoGaitError(why[0] if why else f"There is no {label} gait at this slope.")


def led(
    definition: Definition, keys: Mapping[str, Any], number: Reader = float
) -> tuple[Definition, dict[str, Any]]:
    """A walker with the other one that `toward` among its keys names, and the other
    keys.

    Raises
    ------
    StudyError
        If one is no walker, or nothing says how far the walker is detuned.
    """
    walker, changes, place = (
        files.walker(definition, Path(), number=number),
        dict(keys),
        Location("", "toward"),
    )
    toward = changes.pop("toward", None)
    if toward is None:
        return walker, changes
    if "detuning" not in changes and "detuning" not in walker:
        raise place.wrong(
            "needs `detuning`, which says how far the walker is led", toward
        )

    return files.changed(walker, files.other(toward, Path(), place, number)), changes
