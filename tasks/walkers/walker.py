"""A walker: the paper's parameters (figure 1), checked, and the geometry that follows from them."""

from __future__ import annotations

import cmath
import math
from dataclasses import asdict, dataclass
from typing import Any

#: Kind of quantity of every walker key.
KEYS = {
    "l_t": "length",
    "w_t": "length",
    "m_t": "mass",
    "r_t": "length",
    "c_t": "length",
    "l_s": "length",
    "w_s": "length",
    "m_s": "mass",
    "r_s": "length",
    "c_s": "length",
    "R": "length",
    "eps_T": "angle",
    "m_h": "mass",
    "g": "acceleration",
    "knees": "flag",
    "units": "text",
}
NUMBERS = tuple(k for k, kind in KEYS.items() if kind not in ("flag", "text"))
#: Sizes a number may have beside 0, and a length over the leg: squares and quotients of them stay doubles.
MIN_SIZE, MAX_SIZE, MAX_LEGS = 1e-50, 1e50, 1e4


class WalkerError(ValueError):
    """A walker that cannot be: the key, its value and the bound it breaks."""

    def __init__(self, key: str, value: object, bound: str):
        super().__init__(f"`{key}` {bound}; got {value}.")
        self.key, self.value, self.bound = key, value, bound


@dataclass(frozen=True)
class Walker:
    """Parameters of a walker with two equal legs (paper, figure 1).

    Lengths, masses and `g` are in any consistent units (`units = "1"`) or SI. `r_t` and `r_s` are radii of
    gyration about each link's own centre of mass, `l_s` runs from the knee to the bottom of the foot, `w_t`
    and `w_s` are backward offsets of the centres of mass, `m_h` is a point mass at the hip.

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
    knees: bool = False
    units: str = "1"

    def __post_init__(self) -> None:
        for key in NUMBERS:
            value = getattr(self, key)
            if isinstance(value, bool) or not isinstance(value, (int, float)):
                raise WalkerError(key, repr(value), "must be a number")
            if value != value or (abs(value) == math.inf and key != "m_t"):
                raise WalkerError(key, value, "must be finite")
            if value and not MIN_SIZE <= abs(value) <= MAX_SIZE and abs(value) != math.inf:
                # A whole number may be too long to be shown.
                shown = value if isinstance(value, float) else f"a number of {value.bit_length()} bits"
                raise WalkerError(key, shown, f"must be 0 or of a size from {MIN_SIZE:g} to {MAX_SIZE:g}")
        if self.units not in ("1", "SI"):
            raise WalkerError("units", repr(self.units), 'must be "SI" or "1"')
        if not isinstance(self.knees, bool):
            raise WalkerError("knees", repr(self.knees), "must be true or false")
        for key in ("l_t", "l_s", "g"):
            if getattr(self, key) <= 0:
                raise WalkerError(key, getattr(self, key), "must be > 0")
        for key in ("m_t", "m_s", "m_h", "r_t", "r_s", "R"):
            if getattr(self, key) < 0:
                raise WalkerError(key, getattr(self, key), "must be >= 0")
        if math.isinf(self.m_t):
            # The paper's spelling of walker D: an infinitely heavy hip, so the foot's mass vanishes beside it.
            if self.c_t or self.w_t or self.r_t:
                raise WalkerError("m_t", self.m_t, "may be infinite only as a point at the hip (c_t = w_t = r_t = 0)")
            object.__setattr__(self, "m_t", 0.5)
            object.__setattr__(self, "m_s", 0.0)
        if not abs(self.eps_T) < math.pi / 2:
            raise WalkerError("eps_T", self.eps_T, "must lie in (-pi/2, pi/2) rad")
        if self.total_mass <= 0:
            raise WalkerError("m_t", self.m_t, "must leave the walker some mass (m_t, m_s or m_h > 0)")
        d, sine = self.l_s - self.R, self.l_t * math.sin(self.eps_T)
        if abs(sine) > abs(d) or (d == 0 and self.knees):
            raise WalkerError(
                "eps_T", self.eps_T, f"must satisfy |l_t sin eps_T| <= |l_s - R| = {abs(d):g} or the leg cannot close"
            )
        if self.l <= 0:
            raise WalkerError("R", self.R, "must leave the hip above the foot's centre")
        for key in (k for k, kind in KEYS.items() if kind == "length"):
            if abs(getattr(self, key)) > MAX_LEGS * self.leg:
                raise WalkerError(key, getattr(self, key), f"must be at most {MAX_LEGS:g} legs l + R = {self.leg:g}")
        if self.knees and self.m_s == 0:
            raise WalkerError("m_s", self.m_s, "must be > 0 with a free knee")
        if self.knees and self.shank_inertia == 0:
            raise WalkerError("r_s", self.r_s, "must leave the shank some inertia about its knee")
        if not self.knees and self.massless_leg and not self.point_foot:
            raise WalkerError("m_s", self.m_s, "may vanish only for a point foot: the swing leg has no inertia")
        if not self.massless_leg and self.leg_inertia < 1e-100 * self.total_mass * self.leg**2:
            raise WalkerError("m_s", self.m_s, "must leave the leg some inertia about the hip")

    @property
    def total_mass(self) -> float:
        return 2 * (self.m_t + self.m_s) + self.m_h

    @property
    def eps_S(self) -> float:
        """Angle between the shank and the hip-foot-centre line at full extension [rad]."""
        d = self.l_s - self.R
        return math.asin(self.l_t * math.sin(self.eps_T) / d) if d else 0.0

    @property
    def l(self) -> float:
        """Distance from hip to foot centre."""
        return self.l_t * math.cos(self.eps_T) + (self.l_s - self.R) * math.cos(self.eps_S)

    @property
    def leg(self) -> float:
        """Leg length l + R, the unit of length inside the solver."""
        return self.l + self.R

    @property
    def knee(self) -> complex:
        """Knee from the hip in the frame of the extended leg: x forward, y up."""
        return complex(-self.l_t * math.sin(self.eps_T), -self.l_t * math.cos(self.eps_T))

    @property
    def thigh_centre(self) -> complex:
        """Thigh's centre of mass from the hip, in the frame of the extended leg."""
        return cmath.exp(-1j * self.eps_T) * complex(-self.w_t, -self.c_t)

    @property
    def shank_centre(self) -> complex:
        """Shank's centre of mass from the knee, in the frame of the extended leg."""
        return cmath.exp(1j * self.eps_S) * complex(-self.w_s, -self.c_s)

    @property
    def shank_inertia(self) -> float:
        """Inertia of the shank about its knee."""
        return self.m_s * (self.r_s**2 + abs(self.shank_centre) ** 2)

    @property
    def leg_inertia(self) -> float:
        """Inertia of the extended leg about the hip."""
        thigh = self.m_t * (self.r_t**2 + abs(self.thigh_centre) ** 2)
        return thigh + self.m_s * (self.r_s**2 + abs(self.knee + self.shank_centre) ** 2)

    @property
    def massless_leg(self) -> bool:
        """True where the swing leg has no inertia about the hip: the limit of a vanishing foot mass."""
        thigh = self.m_t * (self.r_t**2 + abs(self.thigh_centre) ** 2)
        return self.m_s == 0 and thigh == 0

    @property
    def point_foot(self) -> bool:
        """True where the leg's mass is one point at a foot of no radius (the stride map is then 2-D)."""
        hip_thigh = self.m_t == 0 or not (self.c_t or self.w_t or self.r_t)
        foot = self.c_s == self.l_s and not (self.w_s or self.r_s)
        return hip_thigh and foot and not (self.R or self.eps_T or self.knees)

    @property
    def si(self) -> bool:
        return self.units == "SI"

    def table(self) -> dict[str, Any]:
        """Plain table of every key, as written in TOML."""
        return asdict(self)
