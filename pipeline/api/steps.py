"""Single steps in Python: the step map at a state with its modes, and simulations from
a state.
"""

from collections.abc import Mapping, Sequence, Set
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from gaitsweep.pipeline import dispatch
from gaitsweep.pipeline.api.threads import in_turn
from gaitsweep.pipeline.archive.result_tables import meaning_of
from gaitsweep.pipeline.errors import StudyError
from gaitsweep.pipeline.study import slopes, units
from gaitsweep.pipeline.study.broadcast import changes, definition, number
from gaitsweep.pipeline.study.location import Location
from gaitsweep.pipeline.study.single_point import check_driven

_MAX_STEPS, _MAX_SAMPLES = 100_000, 1_000_000
#: What archives have not, of a series of the motion.
_OF_SERIES = {
    "step_number": ("number", "number of the step, from 0"),
    "time": ("time", "time since the start"),
    "rate_st": ("rate", "angular rate of the stance leg"),
    "rate_th": ("rate", "angular rate of the swing leg's thigh"),
    "rate_sh": ("rate", "angular rate of the swing leg's shank"),
}
#: What archives have under no name.
_OF_STEPS = {"thigh_angle": ("angle", "swing leg's angle just after heelstrike")}


class Times(NamedTuple):
    """Times of the strikes after the start of a step; NaN for the knees that a walker
    does not have.
    """

    kneestrike: float
    heelstrike: float


class Losses(NamedTuple):
    """Energy lost in a step, by impact and by eigenvector of the contact mass matrix;
    NaN without knees.
    """

    normal: float
    tangential: float
    kneestrike: float


@dataclass(frozen=True)
class StepMap:
    """The step map at a state, in the walker's units; states are (stance_angle,
    stance_rate, thigh_rate).

    Attributes
    ----------
    state : ndarray, shape (3,)
        Just after the heelstrike that ends the step.
    jacobian : ndarray, shape (3, 3)
        Its derivative by the initial state.
    by_slope : ndarray, shape (3,)
        Its derivative by the slope.
    eigenvalues : ndarray of complex, shape (3,)
        Of the Jacobian, largest magnitude first; at a gait the multipliers.
    eigenvectors : ndarray of complex, shape (3, 3)
        Its columns are the modes, of length one and with a positive largest entry.
    times : Times
    losses : Losses
    """

    state: np.ndarray
    jacobian: np.ndarray
    by_slope: np.ndarray
    eigenvalues: np.ndarray
    eigenvectors: np.ndarray
    times: Times
    losses: Losses


@in_turn
def step_map(
    walker: str | Path | Mapping[str, object],
    slope: float,
    state: Sequence[float] | np.ndarray,
    **keys: float,
) -> StepMap:
    """Evaluate the step map and its derivatives at a state.

    Parameters
    ----------
    walker : str, Path or mapping
        A name from the catalogue, a walker file, or the table of a walker.
    slope : float [rad]
        Slope of the ground, in [1e-18, 0.5), or in (-0.5, 0].
    state : sequence of float, shape (3,), (4,) or (6,)
        (stance_angle, stance_rate, thigh_rate) just after heelstrike [rad, and the
        walker's rates]. The swing leg stands at minus the stance angle; the rate of a
        free shank is the one that a heelstrike gives it. A state within a step, from
        which the walker goes on to the heelstrike first, is (stance angle, thigh angle,
        stance rate, thigh rate), with a free knee (three angles, three rates).
    **keys : float
        Walker keys to change, `foot_mass_ratio` or `detuning`.

    Returns
    -------
    StepMap

    Raises
    ------
    StudyError
        If the walker, the slope or the state is invalid, or the step does not end in a
        heelstrike.
    """
    with dispatch.for_question():
        answer = dispatch.ask("step_map", _params(walker, slope, state, keys))
    times = (
        np.nan if (t := answer[f"{name}_time"]) is None else t for name in Times._fields
    )
    losses = (
        np.nan if (e := answer[f"loss_{name}"]) is None else e
        for name in Losses._fields
    )
    arrays = {
        name: answer[name]
        for name in ("state", "jacobian", "by_slope", "eigenvalues", "eigenvectors")
    }
    return StepMap(**arrays, times=Times(*times), losses=Losses(*losses))


@in_turn
def simulate(
    walker: str | Path | Mapping[str, object],
    slope: float,
    state: Sequence[float] | np.ndarray,
    steps: int,
    *,
    motion: bool = False,
    pushes: Mapping[int, Sequence[float]] | None = None,
    ground: Mapping[int, float] | None = None,
    dt: float | None = None,
    samples: int | None = None,
    limits: bool = False,
    **keys: float,
) -> xr.Dataset:
    """Simulate steps from a state until they are done or the walker falls.

    Parameters
    ----------
    walker : str, Path or mapping
        A name from the catalogue, a walker file, or the table of a walker.
    slope : float [rad]
        Slope of the ground, in [1e-18, 0.5), or in (-0.5, 0].
    state : sequence of float, shape (3,), (4,) or (6,)
        (stance_angle, stance_rate, thigh_rate) just after heelstrike, or a state within
        a step, as for `step_map`; its swing foot must not be below the ground.
    steps : int
        Number of steps.
    motion : bool
        Sample the motion of every step.
    dt, samples : float and int, optional
        Sample it instead as one series over all steps, at this constant step in the
        walker's unit of time, or at so many times from the start to the last heelstrike.
    limits : bool
        With `dt` or `samples`: also both limits at each strike.
    pushes : mapping, optional
        By the number of a step, from 0, the changes of (stance_rate, thigh_rate) at its
        start; the state recorded of the step is that before the push.
    ground : mapping, optional
        By the number of a step the height by which the ground is higher where it ends
        (negative: a step down), at right angles to the slope, in the walker's unit of
        length. It stays so afterwards.
    **keys : float
        Walker keys to change, `foot_mass_ratio` or `detuning`.

    Returns
    -------
    xarray.Dataset
        Along `step`, from 0 to `steps`: `stance_angle`, `thigh_angle`, `stance_rate`,
        `thigh_rate`, `shank_rate` just after the heelstrike with which the step begins,
        the last of them the state that is reached; `period` and `kneestrike_time`; NaN
        after a fall. `outcome` says in words how the simulation ended, and `reason` in
        a sentence; `steps_taken` counts the heelstrikes. With `motion` also `time`
        after the start of the step, `theta_st`, `theta_th`, `theta_sh` and `foot_x`,
        along `phase` (the knee free, locked) and `sample`; in a series along `sample`
        alone, with `time` from the start, `step_number`, and the rates `rate_st`,
        `rate_th` and `rate_sh`. The attribute `start` tells of a state whose swing foot
        is above the ground behind the stance foot on which slope both feet would stand.

    Raises
    ------
    StudyError
        If an argument is invalid.
    """
    steps = Location("", "steps").count(steps, _MAX_STEPS)
    pushed = {
        k: _numbers("pushes", v, 2)
        for k, v in _by_step("pushes", pushes, steps).items()
    }
    heights = {
        k: number("ground", v) for k, v in _by_step("ground", ground, steps).items()
    }
    params = _params(walker, slope, state, keys)
    checks = [dispatch.ask("check_walker", params)]
    asked = {**params, "steps": steps, "motion": bool(motion)}
    asked |= {"pushes": pushed, "ground": heights}
    with dispatch.for_question():
        answer = dispatch.ask("simulate", asked)
    if dt is not None or samples is not None:
        step = _time_step(dt, samples, answer["period"])
        asked |= {"dt": step, "limits": bool(limits), "motion": False}
        with dispatch.for_question():
            answer = dispatch.ask("simulate", asked)
    elif limits:
        raise StudyError("`limits` needs `dt` or `samples`.")

    return _dataset(answer, steps, checks)


def _dataset(
    answer: dict[str, Any], steps: int, checks: list[dict[str, Any]]
) -> xr.Dataset:
    """What was simulated, with words and units."""
    taken, cause = answer.pop("steps_taken"), answer.pop("cause")
    series, above = answer.pop("series", {}), answer.pop("above_ground_of")
    variables: dict[str, Any] = {}
    for name, values in answer.items():
        kind, meaning = _OF_STEPS.get(name) or meaning_of(name)
        # Of steps that are not taken.
        missing = np.full((steps + 1 - len(values), *values.shape[1:]), np.nan)
        dims = ("step", "phase", "sample")[: values.ndim]
        about = units.described(meaning, kind, checks)
        variables[name] = (dims, np.concatenate([values, missing]), about)

    for name, values in series.items():
        kind, meaning = _OF_SERIES.get(name) or meaning_of(name)
        variables[name] = ("sample", values, units.described(meaning, kind, checks))

    variables |= _outcome(cause, taken, steps)
    named = {"long_name": "number of the step", "units": "1"}
    coordinates = {"step": ("step", np.arange(steps + 1, dtype=np.int32), named)}
    return xr.Dataset(variables, coordinates, _of_start(above))


def _of_start(ground: float | None) -> dict[str, str]:
    """What is said of a start on ground of another slope."""
    if ground is None:
        return {}

    degrees = np.degrees(ground)
    sentence = (
        "The swing foot begins above the ground, behind; both feet would stand on a"
        f" slope of {ground:.6g} rad ({degrees:.2f}°), to which the state belongs."
    )
    return {"start": sentence}


def _outcome(cause: str, taken: int, steps: int) -> dict[str, Any]:
    """How a simulation ended."""
    reason = f"Step {taken}: {cause}."
    if taken == steps:
        reason = f"All {steps} steps end in a heelstrike."
    variables = {}
    for name, value, text in (
        ("outcome", cause, "how the simulation ended"),
        ("reason", reason, "the outcome in a sentence"),
        ("steps_taken", np.int32(taken), "number of steps that end in a heelstrike"),
    ):
        variables[name] = ((), value, {"long_name": text, "units": "1"})

    return variables


def _time_step(dt: object, samples: object, period: np.ndarray) -> float:
    """The constant step of a series over steps of some periods."""
    taken = period[np.isfinite(period)]
    if not len(taken):
        raise StudyError("No step is taken, of which a series could be sampled.")
    if dt is not None and samples is not None:
        raise StudyError("`dt` and `samples` cannot both be given.")

    whole = float(taken.sum())
    if samples is not None:
        return whole / (Location("", "samples").count(samples, _MAX_SAMPLES, 2) - 1)

    step, least = number("dt", dt), whole / _MAX_SAMPLES
    if not 0 < step <= taken.min():
        raise Location("", "dt").wrong(
            f"must be above 0 and at most the shortest step, {taken.min():.4g}", step
        )
    if step < least:
        raise Location("", "dt").wrong(
            f"must be at least {least:.2g}, for {_MAX_SAMPLES:,} samples", step
        )

    return step


def _params(
    walker: object, slope: object, state: object, keys: Mapping[str, Any]
) -> dict[str, Any]:
    """Parameters of a call of `tasks`, checked as far as possible without it."""
    value = number("slope", slope)
    slopes.check(value, may_be_level=True)
    checked, set_keys = definition(walker), changes(keys)
    check_driven(checked, set_keys, value)

    return {
        "walker": checked,
        "slope": value,
        "set": set_keys,
        "state": _numbers("state", state, 3, 4, 6),
    }


def _numbers(name: str, value: Any, *counts: int) -> list[float]:
    try:
        values = [] if isinstance(value, str | bytes | Mapping | Set) else list(value)
    except TypeError:  # not a sequence
        values = []

    if len(values) not in counts:
        *most, last = map(str, counts)
        wanted = " or ".join(filter(None, (", ".join(most), last)))
        raise Location("", name).wrong(f"must be {wanted} numbers", value)

    return [number(name, v) for v in values]


def _by_step(name: str, value: Any, steps: int) -> Mapping[int, Any]:
    """Checked values by step."""
    if value is None:
        return {}
    if not isinstance(value, Mapping):
        raise Location("", name).wrong("must be a mapping from steps", value)

    for k in value:
        if (
            isinstance(k, bool)
            or not isinstance(k, int | np.integer)
            or not 0 <= k < steps
        ):
            raise StudyError(
                f"`{name}` must name steps from 0 to {steps - 1}; got {k!r}."
            )

    return {int(k): v for k, v in value.items()}
