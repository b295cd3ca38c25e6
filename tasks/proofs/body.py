"""A walker's keys as exact numbers or balls, and the constants of the equations of
motion that follow from them.

A vector is a pair (x, y) in the frame of the extended leg: x forward, y up along the
hip-foot-centre line.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple, TypeAlias

from flint import arb, fmpq

#: A key's value: a rational number, exact, or a ball that contains what a formula
#: gives.
Number: TypeAlias = fmpq | arb


@dataclass(frozen=True)
class Vector:
    """A vector, or a complex number x + iy; its parts are of any type of number."""

    x: Any
    y: Any

    def __add__(self, other: Vector) -> Vector:
        return Vector(self.x + other.x, self.y + other.y)

    def __mul__(self, factor: Any) -> Vector:
        return Vector(self.x * factor, self.y * factor)

    def dot(self, other: Vector) -> Any:
        """Scalar product."""
        return self.x * other.x + self.y * other.y

    def cross(self, other: Vector) -> Any:
        """The product's component along the axis."""
        return self.x * other.y - self.y * other.x

    def times_conjugate(self, other: Vector) -> Vector:
        """The conjugate complex number times another one."""
        return Vector(self.dot(other), self.cross(other))

    def turned(self, cos: Any, sin: Any) -> Vector:
        """The vector turned counter-clockwise by an angle."""
        return Vector(self.x * cos - self.y * sin, self.x * sin + self.y * cos)

    def normal(self) -> Vector:
        """The vector turned by a right angle: the derivative by the angle."""
        return Vector(-self.y, self.x)


@dataclass(frozen=True)
class Drive:
    """What drives a walker beside gravity, in its units; of a light leg over its mass.

    Attributes
    ----------
    push : arb
        Impulse of the push-off.
    knee : Vector
        Of the extended leg, from the hip.
    stiffness, damping, bias : arb
        The torque on the swing leg is bias - stiffness (b - a) - damping (b' - a').
    """

    push: arb
    knee: Vector
    stiffness: arb
    damping: arb
    bias: arb


@dataclass(frozen=True)
class Body:
    """Constants of the equations of motion, in the walker's units.

    Attributes
    ----------
    R, l, g, mass : arb
        Foot radius, hip to foot centre, gravity, mass of the whole walker.
    stance_first : Vector
        First moment about the stance foot's centre of everything the stance leg
        carries.
    stance_second : arb
        The same, of second order, foot centre's own motion included.
    thigh, shank, leg : (Vector, arb)
        First moment and inertia about the hip (shank: about the knee) of the swing
        links; of the whole leg with the knee locked. What hangs at the knee counts with
        the thigh.
    coupling : Vector
        conj(knee) times the shank's first moment.
    heavy : bool
        False in the limit of a vanishing foot mass: the swing leg, scaled by its mass,
        does not act on the stance leg.
    kneed, point_foot : bool
    locks_trailing_knee : bool
        Whether the knee of the leg that leaves the ground is locked during heelstrike.
    drive : Drive
        What drives the walker beside gravity.
    """

    R: arb
    l: arb
    g: arb
    mass: arb
    stance_first: Vector
    stance_second: arb
    thigh: tuple[Vector, arb]
    shank: tuple[Vector, arb]
    leg: tuple[Vector, arb]
    coupling: Vector
    heavy: bool
    kneed: bool
    point_foot: bool
    locks_trailing_knee: bool = False
    drive: Drive | None = None

    @property
    def frees_trailing_knee(self) -> bool:
        """Whether the leg that leaves the ground bends during heelstrike already."""
        return self.kneed and not self.locks_trailing_knee

    @property
    def time_unit(self) -> float:
        """sqrt((l + R)/g), roughly."""
        return float(((self.l + self.R) / self.g).sqrt().mid())

    @property
    def dimension(self) -> int:
        """Dimension of the section: multipliers beyond it vanish by construction."""
        return 2 if self.point_foot else 3


def body(keys: Mapping[str, Number], kneed: bool, trailing_knee: str = "free") -> Body:
    """Constants of a walker, enclosed at the present precision.

    Parameters
    ----------
    keys : mapping of str to fmpq or arb
        Every numeric walker key.
    kneed : bool
        Whether the knees bend.
    trailing_knee : str
        "free", or "locked" where that of the leg that leaves the ground is locked
        during heelstrike.

    Returns
    -------
    Body

    Raises
    ------
    ZeroDivisionError
        If the leg cannot be shown to close.
    """
    k = {name: arb(value) for name, value in keys.items()}
    is_light = not kneed and _is_zero(keys["m_s"]) and _hangs_at_hip(keys)
    l, knee, thigh_centre, shank_centre = _shape(keys, k)
    links = _swing_links(k, knee, thigh_centre, shank_centre, is_light)
    moment, inertia = links.leg

    mass = 2 * (k["m_t"] + k["m_s"]) + k["m_h"]
    first, second = _of_stance(mass, l, k["R"])
    if not is_light:
        first = first + moment
        second = second + 2 * l * moment.y + inertia

    return Body(
        R=k["R"],
        l=l,
        g=k["g"],
        mass=mass,
        stance_first=first,
        stance_second=second,
        thigh=links.thigh,
        shank=links.shank,
        leg=links.leg,
        coupling=links.coupling,
        heavy=not is_light,
        kneed=kneed,
        point_foot=_is_point_foot(keys, kneed),
        locks_trailing_knee=trailing_knee == "locked",
        drive=_drive(k, knee, l, inertia if is_light else None),
    )


class _SwingLinks(NamedTuple):
    """First moments and inertias of the swing links, as a `Body` has them."""

    thigh: tuple[Vector, arb]
    shank: tuple[Vector, arb]
    leg: tuple[Vector, arb]
    coupling: Vector


def _swing_links(
    k: Mapping[str, arb],
    knee: Vector,
    thigh_centre: Vector,
    shank_centre: Vector,
    is_light: bool,
) -> _SwingLinks:
    """Links of a leg; of one without mass those of a foot of mass one."""
    m_t, m_s = (arb(0), arb(1)) if is_light else (k["m_t"], k["m_s"])
    thigh = thigh_centre * m_t + knee * m_s
    shank = shank_centre * m_s
    about_hip = thigh_centre.dot(thigh_centre) + k["r_t"] ** 2
    about_knee = shank_centre.dot(shank_centre) + k["r_s"] ** 2
    thigh_inertia = m_t * about_hip + m_s * knee.dot(knee)
    shank_inertia = m_s * about_knee

    coupling = knee.times_conjugate(shank)
    leg_inertia = thigh_inertia + shank_inertia + 2 * coupling.x

    return _SwingLinks(
        (thigh, thigh_inertia),
        (shank, shank_inertia),
        (thigh + shank, leg_inertia),
        coupling,
    )


def _of_stance(mass: arb, l: arb, R: arb) -> tuple[Vector, arb]:
    """First moment and inertia of a mass at the hip about the stance foot's centre."""
    return Vector(arb(0), mass * l), mass * (l * l + R**2)


#: Keys by which a walker is driven.
_OF_DRIVE = ("push_off", "hip_stiffness", "hip_damping", "hip_torque")


def _drive(
    k: Mapping[str, arb], knee: Vector, l: arb, light: arb | None
) -> Drive | None:
    """What drives a walker; None where nothing does. Of legs without mass torques are
    given over their inertia `light`, g and the leg.
    """
    none = arb(0)
    if all(_is_zero(k.get(key, none)) for key in _OF_DRIVE):
        return None

    torque = time = arb(1)
    if light is not None:
        length = l + k["R"]
        torque = light * k["g"] / length
        time = (length / k["g"]).sqrt()

    stiffness = k.get("hip_stiffness", none)
    bias = stiffness * k.get("hip_rest", none) + k.get("hip_torque", none)

    return Drive(
        push=k.get("push_off", none),
        knee=knee,
        stiffness=stiffness * torque,
        damping=k.get("hip_damping", none) * torque * time,
        bias=bias * torque,
    )


def _shape(
    keys: Mapping[str, Number], k: dict[str, arb]
) -> tuple[arb, Vector, Vector, Vector]:
    """Distance from the hip to the foot's centre, knee and centre of the thigh from the
    hip, and centre of the shank from the knee.
    """
    zero = arb(0)
    d = k["l_s"] - k["R"]
    sin_T, cos_T = k["eps_T"].sin_cos()
    # The foot's centre lies below the hip: sin eps_S = l_t sin eps_T / d.
    sin_S = zero if _is_zero(keys["eps_T"]) else k["l_t"] * sin_T / d
    cos_S = (1 - sin_S * sin_S).sqrt()
    # The thigh leans back by eps_T, so the knee is behind the line; the shank leans
    # forward by eps_S.
    knee = Vector(zero, -k["l_t"]).turned(cos_T, -sin_T)
    thigh_centre = Vector(-k["w_t"], -k["c_t"]).turned(cos_T, -sin_T)
    shank_centre = Vector(-k["w_s"], -k["c_s"]).turned(cos_S, sin_S)
    return k["l_t"] * cos_T + d * cos_S, knee, thigh_centre, shank_centre


def _is_zero(value: Number) -> bool:
    return bool(value == 0)


def _hangs_at_hip(keys: Mapping[str, Number]) -> bool:
    """True where the thigh has no mass or is a point at the hip."""
    return _is_zero(keys["m_t"]) or all(
        _is_zero(keys[k]) for k in ("c_t", "w_t", "r_t")
    )


def _is_point_foot(keys: Mapping[str, Number], kneed: bool) -> bool:
    """True where the leg's mass is one point at a foot of no radius; decided on exact
    numbers alone.
    """
    exact = isinstance(keys["c_s"], fmpq) and isinstance(keys["l_s"], fmpq)
    foot = (
        exact
        and keys["c_s"] == keys["l_s"]
        and all(_is_zero(keys[k]) for k in ("w_s", "r_s", "R", "eps_T"))
    )
    return _hangs_at_hip(keys) and foot and not kneed
