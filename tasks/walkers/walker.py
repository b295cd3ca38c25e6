"""A walker: the paper's parameters (figure 1), checked, and the geometry that follows
from them.
"""

from __future__ import annotations

import math
import tomllib
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar

#: Bounds on the size of a number other than 0, and on a length over the leg: squares
#: and quotients of them do not overflow.
MIN_SIZE, MAX_SIZE, MAX_LEGS = 1e-50, 1e50, 1e4
_TABLES = tomllib.loads(
    Path(__file__).with_name("keys.toml").read_text(encoding="utf-8")
)
#: The kind of quantity that each walker key holds, and each key of a leg of one link,
#: beside `R`.
KEYS, ONE_LINK = (
    {key: about["kind"] for key, about in table.items()} for table in _TABLES.values()
)
_ALL = {key: about for table in _TABLES.values() for key, about in table.items()}
#: What each key is.
MEANINGS = {key: about["meaning"] for key, about in _ALL.items()}
#: Keys that hold a number.
NUMBERS = tuple(k for k, kind in KEYS.items() if kind not in ("flag", "text"))
#: Keys by which a walker is driven or braked, 0 in passive ones.
OF_HIP = ("hip_stiffness", "hip_damping", "hip_torque")
OF_DRIVE = ("push_off", *OF_HIP, "hip_rest")
#: What gaits are differentiated by: the slope, and the numbers of walkers, those of what
#: drives them last.
OF_PASSIVE = ("slope", *(key for key in NUMBERS if key not in OF_DRIVE))
DIFFERENTIATED = (*OF_PASSIVE, *OF_DRIVE)
#: Share of a range at which a key has no special value, as 0 is.
ORDINARY = 0.4871
#: Least and largest value of each number by itself.
BOUNDS = {
    k: (_ALL[k].get("least", -MAX_SIZE), _ALL[k].get("largest", MAX_SIZE))
    for k in (*NUMBERS, *ONE_LINK)
}
#: What the knee of the leg that leaves the ground may do during heelstrike; the first
#: is the paper's rule.
TRAILING_KNEES = "free", "locked"
_MAX_SHOWN = 60  # characters of a wrong value in an error


class WalkerError(ValueError):
    """An invalid walker: the key, its value and the bound it breaks."""

    def __init__(self, key: str, value: object, bound: str):
        super().__init__(f"`{_clip(key)}` {bound}; got {_clip(str(value))}.")
        self.key, self.value, self.bound = key, value, bound


def _clip(text: str) -> str:
    return text if len(text) <= _MAX_SHOWN else text[:_MAX_SHOWN] + "..."


def check_number(key: str, value: object) -> None:
    """Check that a value is a number that a walker may have.

    Raises
    ------
    WalkerError
        If it is not.
    """
    if isinstance(value, list | tuple) and len(value) == 2:
        raise WalkerError(key, repr(value), "must be one number, that of both legs")
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise WalkerError(key, repr(value), "must be a number")
    if value != value or (abs(value) == math.inf and key != "m_t"):
        raise WalkerError(key, value, "must be finite")
    if value and not MIN_SIZE <= abs(value) <= MAX_SIZE and abs(value) != math.inf:
        # A whole number may be too long to be shown.
        shown: object = value
        if not isinstance(value, float):
            shown = f"a number of {value.bit_length()} bits"
        raise WalkerError(
            key, shown, f"must be 0 or of a size from {MIN_SIZE:g} to {MAX_SIZE:g}"
        )


@dataclass(frozen=True)
class Walker:
    """Parameters of a walker with two equal legs (paper, figure 1); those of several
    are a `WalkerArray`.

    Parameters
    ----------
    l_t, l_s : float [length]
        Thigh, and shank from the knee to the bottom of the foot.
    w_t, w_s, c_t, c_s : float [length]
        Centres of mass: backward offset, and distance below hip or knee.
    m_t, m_s, m_h : float [mass]
        Thigh, shank, and a point mass at the hip.
    r_t, r_s : float [length]
        Radii of gyration about each link's own centre of mass.
    R : float [length]
        Radius of the foot.
    eps_T : float [rad]
        Angle between the thigh and the line from hip to foot centre at full extension.
    g : float [length/time^2]
        Acceleration of gravity.
    push_off : float [impulse]
        Along the trailing leg, from its contact with the ground to the hip, just before
        heelstrike.
    hip_stiffness, hip_damping, hip_torque : float [torque/rad, torque time/rad, torque]
        Of a spring, a damper and a motor between the thighs; for legs without mass over
        their vanishing inertia, in units of the leg and g.
    hip_rest : float [rad]
        Angle from the stance to the swing thigh at which the spring rests.
    knees : bool
        Whether the swing leg's knee is free.
    units : str
        "SI", or "1" for any consistent units.
    trailing_knee : str
        "free", or "locked" where the knee of the leg that leaves the ground is locked
        during heelstrike and released after it.

    Raises
    ------
    WalkerError
        If a parameter is out of range or the geometry cannot close.
    """

    l_t: float
    w_t: float
    m_t: float
    r_t: float
    c_t: float
    l_s: float
    w_s: float
    m_s: float
    r_s: float
    c_s: float
    R: float
    eps_T: float
    m_h: float = 0.0
    g: float = 1.0
    push_off: float = 0.0
    hip_stiffness: float = 0.0
    hip_damping: float = 0.0
    hip_rest: float = 0.0
    hip_torque: float = 0.0
    knees: bool = False
    units: str = "1"
    trailing_knee: str = TRAILING_KNEES[0]
    #: Functions of numbers.
    _math: ClassVar[Any] = math

    def __post_init__(self) -> None:
        for key in NUMBERS:
            check_number(key, getattr(self, key))
        if self.units not in ("1", "SI"):
            raise WalkerError("units", repr(self.units), 'must be "SI" or "1"')
        if not isinstance(self.knees, bool):
            raise WalkerError("knees", repr(self.knees), "must be true or false")

        self._check_trailing_knee()
        self._refuse(
            "must be > 0",
            {k: getattr(self, k) <= 0 for k in NUMBERS if BOUNDS[k][0] > 0},
        )
        self._refuse(
            "must be >= 0",
            {k: getattr(self, k) < 0 for k in NUMBERS if BOUNDS[k][0] == 0},
        )
        if math.isinf(self.m_t):
            # The paper's spelling of walker D: an infinitely heavy hip, so the foot's
            # mass vanishes beside it.
            hip_offset = bool(self.c_t or self.w_t or self.r_t)
            self._refuse(
                "may be infinite only as a point at the hip (c_t = w_t = r_t = 0)",
                {"m_t": hip_offset},
            )
            object.__setattr__(self, "m_t", 0.5)
            object.__setattr__(self, "m_s", 0.0)

        self._check_geometry()
        self._check_inertia()
        self._refuse(
            "must lie in [-pi, pi] rad", {"hip_rest": abs(self.hip_rest) > math.pi}
        )

    def _check_trailing_knee(self) -> None:
        rule = self.trailing_knee
        if rule not in TRAILING_KNEES:
            raise WalkerError("trailing_knee", repr(rule), 'must be "free" or "locked"')
        if rule == "locked" and not self.knees:
            raise WalkerError(
                "trailing_knee",
                repr(rule),
                "is of walkers with knees (`knees` = true): straight legs have no knee to lock",
            )

    def _refuse(self, bound: str, broken: dict[str, bool]) -> None:
        """Raise WalkerError at the first key that breaks a bound."""
        for key in (k for k, is_broken in broken.items() if is_broken):
            raise WalkerError(key, getattr(self, key), bound)

    def _check_geometry(self) -> None:
        self._refuse(
            "must lie in (-pi/2, pi/2) rad",
            {"eps_T": abs(self.eps_T) >= BOUNDS["eps_T"][1]},
        )
        self._refuse(
            "must leave the walker some mass (m_t, m_s or m_h > 0)",
            {"m_t": self.total_mass <= 0},
        )
        d, sine = self.l_s - self.R, self.l_t * math.sin(self.eps_T)
        bound = f"must satisfy |l_t sin eps_T| <= |l_s - R| = {abs(d):g} or the leg cannot close"
        self._refuse(bound, {"eps_T": abs(sine) > abs(d) or (d == 0 and self.knees)})
        self._refuse("must leave the hip above the foot's centre", {"R": self.l <= 0})
        lengths = [key for key, kind in KEYS.items() if kind == "length"]
        bound = f"must be at most {MAX_LEGS:g} legs l + R = {self.leg:g}"
        self._refuse(
            bound,
            {key: abs(getattr(self, key)) > MAX_LEGS * self.leg for key in lengths},
        )

    def _check_inertia(self) -> None:
        no_swing = (
            not self.knees
            and self.massless_leg
            and not (abs(self.knee + self.shank_centre) + self.r_s)
        )
        too_light = (
            not self.massless_leg
            and self.leg_inertia < 1e-100 * self.total_mass * self.leg**2
        )
        self._refuse(
            "must be > 0 with a free knee", {"m_s": self.knees and self.m_s == 0}
        )
        self._refuse(
            "must leave the shank some inertia about its knee",
            {"r_s": self.knees and not self.shank_inertia},
        )
        self._refuse(
            "may vanish only off the hip: the swing leg has no inertia",
            {"m_s": no_swing},
        )
        self._refuse(
            "must leave the leg some inertia about the hip", {"m_s": too_light}
        )
        self._refuse(
            "must be > 0 where the thigh has no inertia about the hip: the knee of a "
            "straight leg has none",
            {"r_s": self.knees and self._knee_without_inertia()},
        )
        self._refuse(
            "must be > 0 where the legs are points at feet without a radius: a walker "
            "that stands has no inertia",
            {"m_h": self._stands_without_inertia()},
        )

    def _knee_without_inertia(self) -> bool:
        """Whether the knee of a straight leg can move while all masses rest."""
        thigh = self.m_t * (abs(self.thigh_centre) + self.r_t)
        across = (self.knee * self.shank_centre.conjugate()).imag
        return not (thigh or self.r_s or across)

    def _stands_without_inertia(self) -> bool:
        """Whether a walker with its legs together can turn while all masses rest."""
        foot = -1j * self.leg
        thigh = self.m_t * (abs(self.thigh_centre - foot) + self.r_t)
        shank = self.m_s * (abs(self.knee + self.shank_centre - foot) + self.r_s)
        return not (self.m_h or self.R or thigh or shank)

    @property
    def total_mass(self) -> float:
        """Mass of both legs and the hip."""
        return 2 * (self.m_t + self.m_s) + self.m_h

    @property
    def eps_S(self) -> float:
        """Angle between the shank and the hip-foot-centre line at full extension [rad]."""
        d = self.l_s - self.R
        return math.asin(self.l_t * math.sin(self.eps_T) / d) if d else 0.0

    @property
    def l(self) -> float:
        """Length from hip to foot centre, with the knee extended."""
        return self.l_t * self._math.cos(self.eps_T) + (
            self.l_s - self.R
        ) * self._math.cos(self.eps_S)

    @property
    def leg(self) -> float:
        """Leg length l + R, the unit of length inside the solver."""
        return self.l + self.R

    @property
    def time_unit(self) -> float:
        """Unit of time inside the solver, sqrt(leg/g)."""
        return self._math.sqrt(self.leg / self.g)

    @property
    def knee(self) -> complex:
        """Position of the knee from the hip, in the frame of the extended leg: x
        forward, y up.
        """
        return -self.l_t * (
            self._math.sin(self.eps_T) + 1j * self._math.cos(self.eps_T)
        )

    @property
    def thigh_centre(self) -> complex:
        """Position of the thigh's centre of mass from the hip, in the frame of the
        extended leg.
        """
        return -self._turn(-self.eps_T) * (self.w_t + 1j * self.c_t)

    @property
    def shank_centre(self) -> complex:
        """Position of the shank's centre of mass from the knee, in the frame of the
        extended leg.
        """
        return -self._turn(self.eps_S) * (self.w_s + 1j * self.c_s)

    def _turn(self, angle: float) -> complex:
        """The complex number that turns by an angle."""
        return self._math.cos(angle) + 1j * self._math.sin(angle)

    @property
    def shank_inertia(self) -> float:
        """Moment of inertia of the shank about its knee."""
        return self.m_s * (self.r_s**2 + abs(self.shank_centre) ** 2)

    @property
    def leg_inertia(self) -> float:
        """Moment of inertia of the extended leg about the hip."""
        thigh = self.m_t * (self.r_t**2 + abs(self.thigh_centre) ** 2)
        return thigh + self.m_s * (
            self.r_s**2 + abs(self.knee + self.shank_centre) ** 2
        )

    @property
    def massless_leg(self) -> bool:
        """Whether the swing leg has no inertia about the hip: the limit in which the
        mass of its shank vanishes.
        """
        return not (
            _any(self.m_s) or _any(self.m_t * (self.r_t**2 + self.c_t**2 + self.w_t**2))
        )

    @property
    def point_foot(self) -> bool:
        """Whether the leg's mass is one point at a foot of zero radius (the step map is
        then two-dimensional).
        """
        hip_thigh = not _any(self.m_t) or not any(
            map(_any, (self.c_t, self.w_t, self.r_t))
        )
        foot = not any(map(_any, (self.c_s - self.l_s, self.w_s, self.r_s)))
        return (
            hip_thigh and foot and not (_any(self.R) or _any(self.eps_T) or self.knees)
        )

    @property
    def si(self) -> bool:
        """Whether the parameters are in SI units."""
        return self.units == "SI"

    @property
    def locks_trailing_knee(self) -> bool:
        """Whether the knee of the leg that leaves the ground is locked during
        heelstrike.
        """
        return self.trailing_knee == "locked"

    @property
    def frees_trailing_knee(self) -> bool:
        """Whether the leg that leaves the ground bends during heelstrike already."""
        return self.knees and not self.locks_trailing_knee

    def having(self, key: str, value: float) -> Walker:
        """Return the walker with another value of a number."""
        changes: dict[str, Any] = {key: value}
        return replace(self, **changes)

    def some(self, lanes: Any) -> Walker:
        """Return the walker of some lanes, which all share it."""
        return self

    @property
    def has_hip_torque(self) -> bool:
        """Whether anything acts between the thighs."""
        return any(_any(getattr(self, key)) for key in OF_HIP)

    @property
    def pushes_off(self) -> bool:
        """Whether the trailing leg pushes just before heelstrike."""
        return _any(self.push_off)

    @property
    def driving_keys(self) -> tuple[str, ...]:
        """Keys of what drives or brakes it that are not 0."""
        return tuple(key for key in OF_DRIVE if _any(getattr(self, key)))

    @property
    def is_passive(self) -> bool:
        """Whether nothing but gravity acts."""
        return not (self.has_hip_torque or self.pushes_off)

    @property
    def forward_torque(self) -> float:
        """The constant torque between the thighs: a spring that rests at an angle is one
        that rests with the legs together, and such a torque.
        """
        return self.hip_torque + self.hip_stiffness * self.hip_rest

    @property
    def is_driven(self) -> bool:
        """Whether more than gravity drives, so that it may walk on level ground: a
        push-off, or a forward torque between legs with mass.
        """
        turns = _any(self.forward_torque > 0) and not self.massless_leg
        return self.pushes_off or turns

    @property
    def features(self) -> tuple[str, ...]:
        """What some variables are of: "knees", "locked_knee", "push_off", "hip_torque",
        and "drive" for either of the last two.
        """
        return features_of(
            self.knees,
            self.locks_trailing_knee,
            self.pushes_off,
            self.has_hip_torque,
        )

    def table(self) -> dict[str, Any]:
        """All keys and values, as written in TOML; of those that passive walkers of the
        paper lack only what differs from them.
        """
        table = {
            key: getattr(self, key)
            for key in KEYS
            if key not in OF_DRIVE or _any(getattr(self, key))
        }
        if not self.locks_trailing_knee:
            del table["trailing_knee"]
        return table


def features_of(
    knees: bool, locks_trailing_knee: bool, pushes_off: bool, has_hip_torque: bool
) -> tuple[str, ...]:
    """Return the names of what a walker has."""
    has = {
        "knees": knees,
        "locked_knee": locks_trailing_knee,
        "push_off": pushes_off,
        "hip_torque": has_hip_torque,
        "drive": pushes_off or has_hip_torque,
    }
    return tuple(name for name, has_it in has.items() if has_it)


def _any(x: Any) -> bool:
    """Whether a number, or any of an array, is not 0."""
    return bool(x.any() if hasattr(x, "any") else x)
