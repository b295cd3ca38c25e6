"""States to be judged, read in anybody's variables, and how accurately they are given."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np

from gaitsweep.tasks.mechanics.arrays import Numbers, Slopes
from gaitsweep.tasks.walkers.conventions import KNEE, rate_unit, shank_of, to_ours
from gaitsweep.tasks.walkers.walker import Walker, WalkerError

#: Stance angle, stance rate and thigh rate of rows.
State = Annotated[np.ndarray, "(3, n) [rad, rad/sqrt(leg/g)]"]
#: By how much a shank in line with its thigh may differ from it, beside the last digits.
_IN_LINE = 1e-9


@dataclass
class Rows:
    """States to be judged, in n lanes.

    Attributes
    ----------
    state : ndarray, shape (3, n)
        Stance angle, stance rate and thigh rate on the section [rad, rad/sqrt(leg/g)].
    thigh : ndarray, shape (n,)
        Angle of the swing thigh [rad].
    shank : ndarray, shape (2, n)
        Angle and rate of the swing shank; NaN of a rate that is not given.
    bent : ndarray of bool, shape (n,)
        Whether the swing knee is.
    slope : ndarray, shape (n,) [rad]
    table_digit, own_digit : ndarray, shape (3, n)
        What one unit of the last digit changes of the state: of the digit to which the
        table gives the column, and of that to which the row itself does.
    slope_rounding : ndarray, shape (n,) [rad]
        What rounding may have changed of the slope.
    tolerance : float
        Relative.
    rate_unit : float
        What the table's rates were multiplied by.
    """

    state: State
    thigh: np.ndarray
    shank: np.ndarray
    bent: np.ndarray
    slope: Slopes
    table_digit: np.ndarray
    own_digit: np.ndarray
    slope_rounding: np.ndarray
    tolerance: float
    rate_unit: float

    @classmethod
    def of(cls, walker: Walker, params: Mapping[str, Any]) -> Rows:
        """Read states in a convention's variables."""
        convention, slope = params["convention"], np.asarray(params["slope"], float)
        unit = rate_unit(walker, convention, params.get("rates"))
        units = np.array([1.0, 1.0, unit, unit])[:, None]
        ours = to_ours(convention, params["table"], slope) * units

        of_table = to_ours(convention, params["sizes"], slope, is_size=True) * units
        of_row = to_ours(convention, params["digits"], slope, is_size=True) * units

        on_section = [0, 2, 3]
        shank, bent = _knees(walker, params, ours[1], of_table[1])
        shank[1] *= unit

        return cls(
            state=ours[on_section].copy(),
            thigh=ours[1],
            shank=shank,
            bent=bent,
            slope=slope,
            table_digit=of_table[on_section],
            own_digit=of_row[on_section],
            slope_rounding=_slope_rounding(params, of_table[on_section]),
            tolerance=float(params["tolerance"]),
            rate_unit=unit,
        )

    def links(self, lanes: Numbers) -> np.ndarray:
        """Angles, then rates, of stance leg, thigh and shank of some rows, (6, k); a shank
        whose rate is not given moves as its thigh.
        """
        angle, stance_rate, thigh_rate = self.state[:, lanes]
        shank_angle, shank_rate = self.shank[:, lanes]
        shank_rate = np.where(np.isnan(shank_rate), thigh_rate, shank_rate)
        angles = [angle, self.thigh[lanes], shank_angle]
        return np.array([*angles, stance_rate, thigh_rate, shank_rate])


def _slope_rounding(params: Mapping[str, Any], digit: np.ndarray) -> np.ndarray:
    """What rounding may have changed of slopes: half of their last digit, where that is as
    fine as one of the states' (3, n); slopes in fewer decimals are taken for exact.
    """
    sizes = params["sizes"].get("slope", np.zeros(digit.shape[1]))
    as_fine = sizes <= digit.max(axis=0) * (1.0 + 1e-9)
    return np.asarray(np.where(as_fine, 0.5 * sizes, 0.0))


def _knees(
    walker: Walker, params: Mapping[str, Any], thigh: np.ndarray, size: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Angle and rate (2, n) of the swing shank, and whether the knee is bent by more than
    the last digits.

    Raises
    ------
    WalkerError
        If a knee is bent of a walker without knees, or of a shank without a rate.
    """
    shank = shank_of(params["convention"], params["table"])
    angle = KNEE[0]
    if angle not in params["table"]:
        shank[0] = thigh
        return shank, np.zeros(len(thigh), bool)

    sizes = size + params["sizes"][angle]
    bent = np.abs(shank[0] - thigh) > _IN_LINE + sizes
    if bent.any():
        row = int(bent.argmax())
        where = f"{shank[0, row]:.6g} rad and {thigh[row]:.6g} rad in row {row + 1}"
        if not walker.knees:
            line = "must be the thigh's angle of a walker without knees"
            raise WalkerError(angle, where, line)
        if KNEE[1] not in params["table"]:
            raise WalkerError(KNEE[1], "no column", f"is needed: a knee bends, {where}")

    return shank, bent


def magnitudes(state: State) -> np.ndarray:
    """What differences of states (3, n) are relative to: the angle, the larger rate."""
    rate = np.maximum(np.abs(state[1]), np.abs(state[2]))
    return np.array([np.abs(state[0]), rate, rate])


def relative_distance(state: State, gait: State) -> np.ndarray:
    """Largest difference of a coordinate of states (3, n), relative to the gaits'."""
    return relative_change(state - gait, gait)


@np.errstate(invalid="ignore", divide="ignore")
def relative_change(change: np.ndarray, state: State) -> np.ndarray:
    """Largest of changes (3, n) of coordinates, relative to states (3, n)."""
    return np.asarray((np.abs(change) / magnitudes(state)).max(axis=0))
