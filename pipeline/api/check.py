"""Whether states that somebody holds for gaits are gaits, and if not, why."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
import pandas as pd
import xarray as xr

from gaitsweep.pipeline.api.threads import in_turn
from gaitsweep.pipeline.dispatch import ask, for_question
from gaitsweep.pipeline.errors import StudyError
from gaitsweep.pipeline.study import slopes, states
from gaitsweep.pipeline.study.broadcast import changes, definition
from gaitsweep.pipeline.study.location import Location
from gaitsweep.pipeline.study.single_point import check_driven
from gaitsweep.pipeline.study.states import States
from gaitsweep.tasks.contract.registry import MAX_STEPS_OF_STATES

#: States: a file, columns by name, or rows of numbers. So is a pandas.DataFrame.
Table: TypeAlias = (
    str
    | Path
    | Mapping[str, Sequence[float]]
    | Sequence[Sequence[float]]
    | np.ndarray
    | xr.Dataset
    | pd.DataFrame
)
_RATES = ("walker", "scaled")


@in_turn
def check(
    table: Table,
    walker: str | Path | Mapping[str, object],
    slope: float | None = None,
    *,
    convention: str = "gaitsweep",
    rename: Mapping[str, str] | None = None,
    degrees: bool = False,
    rates: str | None = None,
    tolerance: float = 1e-6,
    steps: int = 1,
    **keys: float,
) -> pd.DataFrame:
    """Check whether states are gaits of a walker, and say why where they are not.

    Parameters
    ----------
    table : DataFrame, Dataset, mapping, array or Path
        States, one a row: columns of the convention, or rows of its numbers without the
        swing leg's angle, or a CSV file. Without a column of the swing leg's angle both
        feet are on the ground.
    walker : str, Path or mapping
        A name from the catalogue, a walker file, or the table of a walker.
    slope : float, optional [rad]
        Slope of the ground, if the table has no column `slope`.
    convention : str
        Whose variables: `gaitsweep`, `garcia`, `goswami`, `drake` or `mcgeer`.
    rename : mapping, optional
        Names of the convention's columns, or `slope`, by those of the table.
    degrees : bool
        Angles, rates and slopes are in degrees.
    rates : str, optional
        `walker` for rates in the walker's units, `scaled` for rates over sqrt(g/l) with l
        the length of the leg; by default the convention's own.
    tolerance : float
        Relative difference from a gait up to which a state is one, beside one unit of
        the last digit that the table gives.
    steps : int
        After which the states are held to repeat, 1 to 8.
    **keys : float
        Walker keys to change, `foot_mass_ratio` or `detuning`.

    Returns
    -------
    pandas.DataFrame
        A row per state: `verdict`, one of those in docs/your-own-walker.md, `reason` in a
        sentence, `is_gait`, `slope` [rad], `gait`, the label of the nearest gait at that
        slope, `steps` after which that repeats, `distance` to it and what the state
        `missed` itself by after a step, both relative, NaN of a fall; `spectral_radius`
        of the nearest gait and `stable`; `belongs_to_slope` [rad] and `walker` where the
        state is a gait of another; `flown`, whether it was flown to the next heelstrike;
        `stance_angle`, `stance_rate` and `thigh_rate` as judged and those of the nearest
        gait, `nearest_...`. `attrs` has the `summary` in a sentence and the walker's
        `curves`.

    Raises
    ------
    StudyError
        If the table, the walker or another argument is invalid.
    """
    renamed = dict(rename or {})
    if isinstance(table, str | Path):
        given, _ = states.from_csv(Path(table), convention, renamed)
    else:
        given = states.from_python(table, convention, renamed)

    of_rows = _in_rad(given, slope, degrees)
    params = {
        "walker": definition(walker),
        "set": changes(keys),
        **of_rows,
        "convention": convention,
        "rates": _rates(rates),
        "tolerance": _tolerance(tolerance),
        "steps": Location("", "steps").count(steps, MAX_STEPS_OF_STATES),
    }
    # A slope above 0 may have been rounded to 0.
    rounded = 0.5 * of_rows["sizes"].get("slope", 0.0)
    highest = np.atleast_1d(of_rows["slope"] + rounded)
    if highest.size and slopes.is_level(float(highest.min())):
        given_slope = np.broadcast_to(of_rows["slope"], highest.shape)
        slope_of_row = float(given_slope[highest.argmin()])
        check_driven(params["walker"], params["set"], slope_of_row)

    with for_question(given.count):
        answer = ask("check_states", params)
    return _frame(answer)


def _in_rad(given: States, slope: float | None, degrees: bool) -> dict[str, Any]:
    """Slope and columns of states in rad."""
    unit = np.pi / 180 if degrees else 1.0
    values = {name: unit * column for name, column in given.values.items()}
    digits = {name: unit * column for name, column in given.digits.items()}
    sizes = {name: unit * column for name, column in given.sizes.items()}
    column = values.pop("slope", None)
    if (column is None) == (slope is None):
        raise StudyError(
            "`slope` is needed once: as an argument, or as a column of the table; got "
            + ("both." if slope is not None else "neither.")
        )
    if column is None:
        column = np.full(given.count, unit * Location("", "slope").number(slope))

    wrong = np.flatnonzero(~(slopes.is_slope(column) | slopes.is_level(column)))
    if len(wrong):
        row = f"row {wrong[0] + 1}" if "slope" in given.values else ""
        slopes.check(float(column[wrong[0]]), Location(row, "slope"), may_be_level=True)

    return {"slope": column, "table": values, "digits": digits, "sizes": sizes}


def _rates(rates: str | None) -> str | None:
    if rates is not None and rates not in _RATES:
        raise Location("", "rates").unknown(str(rates), _RATES, "unit of rates")
    return rates


def _tolerance(tolerance: float) -> float:
    value = Location("", "tolerance").number(tolerance)
    if not 1e-12 <= value <= 0.1:
        raise Location("", "tolerance").wrong("must lie in [1e-12, 0.1]", tolerance)
    return value


def _frame(answer: dict[str, Any]) -> pd.DataFrame:
    """The answer as a table with a summary."""
    curves = answer.pop("curves")
    frame = pd.DataFrame(answer)
    stable = frame["spectral_radius"] < 1
    frame.insert(8, "stable", stable)
    frame.attrs = {"summary": _summary(frame), "curves": curves}
    return frame


def _summary(frame: pd.DataFrame) -> str:
    """How many states are gaits, and what the others are, in a sentence."""
    count, gaits = len(frame), int(frame["is_gait"].sum())
    stable = int(frame["stable"].sum())
    if gaits == count == 1:
        return f"The one state is a gait, {'stable' if stable else 'unstable'}."
    if gaits == count:
        return f"All {count:,} states are gaits, {stable:,} of them stable."

    others = frame.loc[~frame["is_gait"], "verdict"].value_counts()
    told = [f"{number:,} {name.replace('_', ' ')}" for name, number in others.items()]
    return f"{gaits:,} of {count:,} states are gaits; the others: {', '.join(told)}."
