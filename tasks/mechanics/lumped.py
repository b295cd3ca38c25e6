"""A walker's lumped constants, through which all its masses and lengths enter, and
which of them it has.

With A and B the arms of the stance leg and of the swing links as complex numbers in the
leg's frame (x + iy, the leg along y), in units of the leg l + R and of the whole
walker's mass,

    S_a = sum m A,  C_aa = sum m (R^2 + |A|^2) + I,  S_b, S_c = sum m B,  C_bb, C_cc, H
    = conj(knee) S_c.

What acts between the thighs has three more, the torque on the swing leg being bias - k
(b - a) - c (b' - a'), and a push-off its impulse and, where the knee bends under it,
the place of the knee.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any

import numpy as np
from heyoka import real128
from numpy import ndarray

from gaitsweep.tasks.mechanics.arrays import Marks, PerLane
from gaitsweep.tasks.mechanics.vector import Vector
from gaitsweep.tasks.walkers.statics import lies_on_line
from gaitsweep.tasks.walkers.walker import NUMBERS, Walker, features_of
from gaitsweep.tasks.walkers.walker_array import WalkerArray

#: Lumped constants of every walker, and the further ones of those with knees, in the
#: order of `lump`.
_CONSTANTS = ("R", "l", "eps", "S_a_re", "S_a_im", "C_aa", "S_b_re", "S_b_im", "C_bb")
_OF_KNEES = ("S_c_re", "S_c_im", "C_cc", "H_re", "H_im")
#: Those of what acts between the thighs, divided by `eps`; and of a push-off, and of the
#: knee that bends under it.
_OF_HIP = ("hip_stiffness", "hip_damping", "hip_bias")
_OF_PUSH, _OF_PUSHED_KNEE = ("push",), ("knee_re", "knee_im")
#: Constants that come last, since only the strikes need them.
_AT_STRIKES = (*_OF_PUSH, *_OF_PUSHED_KNEE)
#: Offset of a centre of mass, over its distance, below which it is computed in 128
#: bits.
_NEARLY_TUNED = 1e-2


def lump(walker: Walker, number: type = float) -> dict[str, Any]:
    """Lumped constants of a walker in units of its leg, its mass and g.

    Parameters
    ----------
    walker : Walker
        Its table of masses and lengths, in any units.
    number : type
        `float`, or a wider type for constants to more digits: numpy's long double or
        heyoka's real128.

    Returns
    -------
    dict
        `R, l, eps, C_aa, S_a, S_b, C_bb` with complex constants split into `_re` and
        `_im`; kneed walkers also `S_c, C_cc, H`. Swing constants are divided by `eps`,
        the swing leg's inertia about the hip, as are `hip_stiffness, hip_damping,
        hip_bias`; `push` is the impulse of the push-off, and `knee` where the knee is.
    """
    constants = _lump_all(WalkerArray.of([walker]), number)
    return {name: values[0] for name, values in constants.items()}


# Constants of invalid walkers, which an array may hold, are NaN.
@np.errstate(divide="ignore", invalid="ignore")
def _lump_all(walkers: WalkerArray, number: type) -> dict[str, PerLane]:
    """Lumped constants of several walkers, all with or all without knees, as `lump` has
    them, in arrays (n,).
    """
    leg = _Leg(walkers, number)
    massless = walkers.massless_legs
    eps, m_t, m_s = _masses(leg, massless)
    swing = _of_links(leg, m_t, m_s)
    if walkers.knees:
        swing["S_b"] = _aligned(swing["S_b"])
        swing["S_c"] = _aligned(swing["S_c"])

    # H = conj(knee) S_c.
    knee = leg.knee
    S_c = swing["S_c"]
    across = knee.x * S_c.y - knee.y * S_c.x
    H = Vector(knee.dot(S_c), across)

    # Of the whole leg, its knee straight.
    S = _aligned(swing["S_b"] + S_c)
    inertia = swing["C_bb"] + swing["C_cc"] + leg.two * H.x
    if walkers.knees:
        swing["H"] = _aligned(H)
        over_inertia = {name: value / inertia for name, value in swing.items()}
    else:
        over_inertia = {"S_b": S / inertia, "C_bb": leg.one}

    of_stance = _of_stance(leg, S, eps, inertia)
    of_drive = _of_drive(leg, inertia, massless)
    return _in_parts(of_stance | over_inertia | of_drive)


def _of_links(leg: _Leg, m_t: PerLane, m_s: PerLane) -> dict[str, Any]:
    """First and second moments of the swing leg's links, by the masses of thigh and shank:
    `S_b` and `C_bb` of the thigh, with the shank's mass at the knee, about the hip; `S_c`
    and `C_cc` of the shank about the knee.
    """
    of_thigh = m_t * _square(leg, leg.thigh, leg.key.r_t)
    return {
        "S_b": leg.thigh * m_t + leg.knee * m_s,
        "C_bb": of_thigh + m_s * leg.knee.dot(leg.knee),
        "S_c": leg.shank * m_s,
        "C_cc": m_s * _square(leg, leg.shank, leg.key.r_s),
    }


def _masses(leg: _Leg, massless: Marks) -> tuple[PerLane, PerLane, PerLane]:
    """1 where the swing leg acts on the stance leg and 0 where it has no mass; and masses
    of thigh and shank.

    For a massless leg only ratios of the swing leg's constants remain: a unit mass where
    the shank's was.
    """
    eps = np.where(massless, leg.zero, leg.one)
    m_t = np.where(massless, leg.zero, leg.key.m_t / leg.mass)
    m_s = np.where(massless, leg.one, leg.key.m_s / leg.mass)
    return eps, m_t, m_s


def _of_drive(leg: _Leg, inertia: PerLane, massless: Marks) -> dict[str, Any]:
    """Constants of the push-off, and of what acts between the thighs, over the swing
    leg's inertia: of legs without mass they are given so.
    """
    key = leg.key
    speed = _power(key.g * leg.length, leg.one / leg.two)
    time = _power(leg.length / key.g, leg.one / leg.two)
    torque = leg.mass * key.g * leg.length * inertia
    torque, time = (np.where(massless, leg.one, unit) for unit in (torque, time))

    return {
        "hip_stiffness": key.hip_stiffness / torque,
        "hip_damping": key.hip_damping / (torque * time),
        "hip_bias": (key.hip_stiffness * key.hip_rest + key.hip_torque) / torque,
        "push": key.push_off / (leg.mass * speed),
        "knee": leg.knee,
    }


def _of_stance(leg: _Leg, S: Vector, eps: PerLane, inertia: PerLane) -> dict[str, Any]:
    """Constants of the stance leg, m|il + p|^2 + I, and of hip and swing leg (the rest
    of the unit mass) at |il|.
    """
    R, l = leg.R, leg.l
    hips = R * R + l * l + leg.two * l * eps * S.y
    return {
        "R": R,
        "l": l,
        "eps": eps * inertia,
        "S_a": S * eps + Vector(leg.zero, l),
        "C_aa": hips + eps * inertia,
    }


def _in_parts(constants: dict[str, Any]) -> dict[str, PerLane]:
    """Constants, complex ones as `_re` and `_im`."""
    parts = {}
    for name, value in constants.items():
        if isinstance(value, Vector):
            parts[f"{name}_re"] = value.x
            parts[f"{name}_im"] = value.y
        else:
            parts[name] = value

    return parts


def _square(leg: _Leg, centre: Vector, radius: PerLane) -> PerLane:
    """Square of a link's radius of gyration about the hip, by that about its centre."""
    about_centre = radius / leg.length
    return centre.dot(centre) + _power(about_centre, leg.two)


class _Leg:
    """The legs of several walkers: their keys; whole lengths and masses; and over the
    leg's length R, l and, in the frame of the leg, knee and centres of thigh and shank.
    """

    def __init__(self, walkers: WalkerArray, number: type):
        n = len(walkers)
        self.zero = np.full(n, number(0.0))
        self.one = np.full(n, number(1.0))
        self.two = np.full(n, number(2.0))
        self.key = key = _keys(walkers, number)
        below_knee = key.l_s - key.R
        thigh_bend = np.sin(key.eps_T), np.cos(key.eps_T)
        sine, cosine = self._bend_of_shank(thigh_bend[0], below_knee)
        l = key.l_t * thigh_bend[1] + below_knee * cosine
        length = l + key.R
        self.length = length
        self.mass = self.two * (key.m_t + key.m_s) + key.m_h
        self.R = key.R / length
        self.l = l / length

        self.knee = _hanging(key.l_t, self.zero, *thigh_bend) / length
        self.thigh = _hanging(key.c_t, key.w_t, *thigh_bend) / length
        self.shank = _hanging(key.c_s, key.w_s, -sine, cosine) / length

    def _bend_of_shank(
        self, thigh_sine: PerLane, below_knee: PerLane
    ) -> tuple[PerLane, PerLane]:
        """Sine and cosine of eps_S: l_t sin eps_T = (l_s - R) sin eps_S closes the leg."""
        is_bent = self.key.eps_T != 0
        divisor = np.where(is_bent, below_knee, self.one)
        bent = self.key.l_t * thigh_sine / divisor
        sine = np.where(is_bent, bent, self.zero)
        half = self.one / self.two
        cosine = _power(self.one - sine * sine, half)
        return sine, cosine


def _keys(walkers: WalkerArray, number: type) -> SimpleNamespace:
    """The keys of walkers as arrays (n,) of a type."""
    key = SimpleNamespace()
    for name in NUMBERS:
        values: Any = np.asarray(getattr(walkers, name), number)
        setattr(key, name, np.broadcast_to(values, len(walkers)))
    return key


def _hanging(along: PerLane, across: PerLane, sine: PerLane, cosine: PerLane) -> Vector:
    """A point of a link at an angle to the leg, by its distances from the joint."""
    x = -along * sine - across * cosine
    y = -along * cosine + across * sine
    return Vector(x, y)


def _power(x: ndarray, exponent: ndarray) -> ndarray:
    """Powers; of doubles as C has them, which numpy's own may miss by a bit."""
    if x.dtype != float:
        return np.power(x, exponent)
    powers = map(pow, x.tolist(), exponent.tolist())
    return np.array(list(powers))


def _aligned(v: Vector) -> Vector:
    """Vector with parts that are only rounding set to zero: tuned to within doubles is
    tuned.
    """
    is_along_y = lies_on_line(v.x, v.y)
    is_along_x = lies_on_line(v.y, v.x)
    x = np.where(is_along_y, v.x - v.x, v.x)
    y = np.where(is_along_x, v.y - v.y, v.y)
    return Vector(x, y)


@dataclass(frozen=True)
class Structure:
    """Which constants a walker has as parameters; code is compiled once per structure,
    never per value.
    """

    kneed: bool
    point_foot: bool
    constants: tuple[str, ...]
    units: tuple[tuple[str, float], ...]
    #: Whether the knee of the leg that leaves the ground is locked during heelstrike.
    locks_trailing_knee: bool = False
    #: Whether anything acts between the thighs, and whether the trailing leg pushes.
    has_hip_torque: bool = False
    pushes_off: bool = False
    #: What the step map is differentiated by beside its state: `slope`, `push_off` or
    #: `hip_torque`.
    drive: str = "slope"

    @property
    def parameters(self) -> tuple[str, ...]:
        """Order of the runtime parameters: slope, scale, then the constants."""
        return ("slope", "scale", *self.constants)

    @property
    def dimension(self) -> int:
        """Dimension of the stride map."""
        return 2 if self.point_foot else 3

    @property
    def phases(self) -> tuple[bool, ...]:
        """Whether the swing knee is free in each phase of a step: to kneestrike, then
        to heelstrike.
        """
        return (True, False) if self.kneed else (False,)

    @property
    def features(self) -> tuple[str, ...]:
        """What some variables are of, as `Walker.features` has it."""
        return features_of(
            self.kneed,
            self.locks_trailing_knee,
            self.pushes_off,
            self.has_hip_torque,
        )

    def between_strikes(self) -> Structure:
        """Return the structure of the motion, on which what happens at heelstrike has no
        bearing.
        """
        at_strikes = self.locks_trailing_knee, self.pushes_off, self.drive == "push_off"
        if not any(at_strikes):
            return self

        constants = tuple(name for name in self.constants if name not in _AT_STRIKES)
        units = tuple(unit for unit in self.units if unit[0] not in _AT_STRIKES)

        return replace(
            self,
            constants=constants,
            units=units,
            locks_trailing_knee=False,
            pushes_off=False,
            drive="slope" if self.drive == "push_off" else self.drive,
        )


def _general_structure(
    kneed: bool,
    locks_trailing_knee: bool = False,
    has_hip_torque: bool = False,
    pushes_off: bool = False,
) -> Structure:
    """Return the structure of all walkers with or without knees, of one rule at
    heelstrike and of what drives them: every constant is a parameter.
    """
    frees_knee = kneed and not locks_trailing_knee
    constants = (
        *_CONSTANTS,
        *(_OF_KNEES if kneed else ()),
        *(_OF_HIP if has_hip_torque else ()),
        *(_OF_PUSH if pushes_off else ()),
        *(_OF_PUSHED_KNEE if pushes_off and frees_knee else ()),
    )
    rules = locks_trailing_knee, has_hip_torque, pushes_off
    return Structure(kneed, False, constants, (), *rules)


def general_structure_of(walker: Walker) -> Structure:
    """Return the general structure of a walker, or of an array of them."""
    return _general_structure(
        walker.knees,
        walker.locks_trailing_knee,
        walker.has_hip_torque,
        walker.pushes_off,
    )


def locked(structure: Structure, parameters: ndarray) -> tuple[Structure, ndarray]:
    """Return the structure of straight legs as which walkers with knees move while
    these are locked, and its parameters.

    Parameters
    ----------
    structure : Structure
        The general one of knees.
    parameters : ndarray, shape (n_parameters, ...)
        Slope, scale and its constants.

    Returns
    -------
    Structure
    ndarray, shape (slope, scale and the constants of straight legs, ...)
    """
    of_knees = slice(8, 8 + 3 + len(_OF_KNEES))
    S_b_re, S_b_im, C_bb, S_c_re, S_c_im, C_cc, H_re, _ = parameters[of_knees]
    inertia = C_bb + C_cc + 2 * H_re
    of_leg = np.stack([S_b_re + S_c_re, S_b_im + S_c_im, inertia])
    rows = [parameters[:8], of_leg]
    if structure.has_hip_torque:
        rows.append(parameters[of_knees.stop :][: len(_OF_HIP)])
    straight = _general_structure(False, has_hip_torque=structure.has_hip_torque)
    drive = structure.between_strikes().drive
    straight = replace(straight, drive=drive)
    return straight, np.concatenate(rows)


def structure_of(walker: Walker) -> Structure:
    """Return a walker's structure, the general one except for point feet and massless
    straight legs.

    With these the motion loses whole terms, as the constants that are 0 or +-1 become
    code. Other walkers gain little from a zero, less than another structure takes to
    compile.
    """
    return structures_of([walker])[0]


def structures_of(walkers: Sequence[Walker]) -> list[Structure]:
    """Return the structures of several walkers, as `structure_of` does."""
    structures = [general_structure_of(walker) for walker in walkers]
    special = [i for i, walker in enumerate(walkers) if _is_special(walker)]
    if not special:
        return structures

    of_special = WalkerArray.of([walkers[i] for i in special])
    constants = _lump_all(of_special, float)
    for row, i in enumerate(special):
        of_walker = {name: float(values[row]) for name, values in constants.items()}
        structures[i] = _structure(walkers[i], of_walker)

    return structures


def alike(walkers: Sequence[Walker]) -> dict[Structure, list[int]]:
    """Return the numbers of the walkers of each structure."""
    numbers: dict[Structure, list[int]] = {}
    for i, structure in enumerate(structures_of(walkers)):
        numbers.setdefault(structure, []).append(i)
    return numbers


def common_structure(walkers: WalkerArray) -> Structure:
    """Return a structure for all of an array of walkers: only what is 0 or +-1 for each
    of them becomes code.
    """
    if not _is_special(walkers):
        return general_structure_of(walkers)
    shared = {}
    for name, values in _lump_all(walkers, float).items():
        is_one = (values == values[0]).all()
        shared[name] = values[0] if is_one else np.nan
    return _structure(walkers, shared)


def _is_special(walker: Walker | WalkerArray) -> bool:
    """Whether constants that are 0 or +-1 become code."""
    return not walker.knees and (walker.point_foot or walker.massless_leg)


def _structure(walker: Walker | WalkerArray, constants: dict[str, float]) -> Structure:
    """Structure in which constants that are 0 or +-1 are code, all others parameters."""
    general = general_structure_of(walker)
    units = {}
    for name in general.constants:
        if constants[name] in (0.0, 1.0, -1.0):
            units[name] = float(constants[name])

    others = tuple(name for name in general.constants if name not in units)

    return replace(
        general,
        point_foot=walker.point_foot,
        constants=others,
        units=tuple(units.items()),
    )


def constants_of(walkers: WalkerArray, structure: Structure) -> ndarray:
    """Values of the structure's runtime constants, each rounded only once.

    Parameters
    ----------
    walkers : WalkerArray
        Of that structure.
    structure : Structure
        Names the constants and their order.

    Returns
    -------
    ndarray, shape (len(structure.constants), n)
        In units of each walker's leg, its mass and g.
    """
    constants = _lump_all(walkers, np.longdouble)
    values = np.empty((len(structure.constants), len(walkers)))
    for row, name in enumerate(structure.constants):
        values[row] = constants[name]

    # Offsets of nearly tuned legs are differences, of which long double leaves too few
    # digits.
    near = np.zeros(len(walkers), bool)
    names = ("S_a", "S_b", "S_c", "H") if walkers.knees else ("S_a", "S_b")
    for name in names:
        parts = np.abs([constants[f"{name}_re"], constants[f"{name}_im"]])
        small, large = np.sort(parts, axis=0)
        near |= (small > 0) & (small < _NEARLY_TUNED * large)

    if near.any():
        lanes = np.flatnonzero(near)
        constants = _lump_all(walkers.some(lanes), real128)
        for row, name in enumerate(structure.constants):
            values[row, near] = constants[name].astype(float)

    return values
