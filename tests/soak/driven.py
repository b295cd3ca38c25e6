"""Gaits of random driven walkers against two others: the step of the independent
derivation by constraints and impulses, and the same equations in 113 bits.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from gaitsweep.tasks.step.extended_precision import Start, solved
from gaitsweep.tasks.step.problem import Problem, scale_of
from gaitsweep.tasks.studies.solve_at_slope import solve_one
from gaitsweep.tasks.studies.solve_driven import driven
from gaitsweep.tasks.walkers.catalogue import CATALOGUE
from gaitsweep.tasks.walkers.resolve import resolve
from gaitsweep.tasks.walkers.walker import Walker
from oracle import Oracle, Step, StepFailed

#: Walkers whose neighbours are drawn, and the keys of which they differ.
WALKERS = ("A", "B", "C", "E", "F")
_KEYS, _SPREAD = ("m_t", "c_t", "r_t", "R"), 0.1
#: Ranges of the slopes: level, uphill and downhill [rad].
_UPHILL, _DOWNHILL = (-0.01, -1e-4), (1e-3, 0.04)
#: Largest push-off over m sqrt(g leg), torque and stiffness over m g leg, and damping
#: over m leg sqrt(g leg).
_PUSH, _TORQUE, _STIFFNESS, _DAMPING = 0.15, 0.01, 0.05, 0.001
#: Share of the walkers that have a key.
_SHARES = {
    "push_off": 0.7,
    "hip_stiffness": 0.5,
    "hip_damping": 0.3,
    "hip_torque": 0.5,
}
#: A walker's name, its keys, and a slope [rad].
Case = tuple[str, dict[str, float], float]


@dataclass
class Compared:
    """Numbers of gaits that were compared, and how far they are off.

    Attributes
    ----------
    off : list of float
        Differences over what is allowed.
    wrong : list
        The walker, keys and slope of those above 1.
    """

    off: list[float] = field(default_factory=list)
    wrong: list[Case] = field(default_factory=list)

    def add(self, case: Case, off: float) -> None:
        """Count one more."""
        self.off.append(off)
        if not off <= 1:
            self.wrong.append(case)


def case(number: int) -> Case:
    """Return a random driven walker: its name, its keys, and a slope [rad]."""
    rng = np.random.default_rng([number, 32])
    name = WALKERS[number % len(WALKERS)]
    walker = CATALOGUE[name]
    keys = {
        key: float(getattr(walker, key) * rng.uniform(1 - _SPREAD, 1 + _SPREAD))
        for key in _KEYS
        if rng.random() < 0.3 and getattr(walker, key)
    }
    # Legs of a light foot swing by torques of its size.
    light = 0.01 if name in ("E", "F") else 1.0
    keys |= _driving(rng, walker, light)
    ground = rng.integers(3)
    slope = (0.0, float(rng.uniform(*_UPHILL)), float(rng.uniform(*_DOWNHILL)))
    return name, keys, slope[ground]


def _driving(
    rng: np.random.Generator, walker: Walker, light: float
) -> dict[str, float]:
    """Random keys that drive a walker whose legs are so light."""
    torque = walker.total_mass * walker.g * walker.leg * light
    sizes = {
        "push_off": _PUSH * walker.total_mass * (walker.g * walker.leg) ** 0.5,
        "hip_stiffness": _STIFFNESS * torque,
        "hip_damping": _DAMPING * torque * walker.time_unit,
        "hip_torque": _TORQUE * torque,
    }
    keys = {}
    for key, share in _SHARES.items():
        is_needed = key == "hip_torque" and "push_off" not in keys
        if rng.random() < share or is_needed:
            keys[key] = float(sizes[key] * rng.random())
    return keys


def gaits(numbers: Iterable[int]) -> Iterator[tuple[Case, dict[str, Any]]]:
    """Yield the gaits of random driven walkers, each with its walker, keys and slope."""
    for number in numbers:
        one = case(number)
        name, keys, slope = one
        asked = {"walker": name, "set": keys, "slope": slope}
        for gait in solve_one(asked)["gaits"]:
            yield one, gait


def by_derivation(numbers: Iterable[int], most: int | None = None) -> Compared:
    """Fly the gaits of random driven walkers by the independent derivation: they must
    come back within 1e-10 of their sizes times the largest multiplier, take as long
    and lose as much.
    """
    compared = Compared()
    for one, gait in gaits(numbers):
        name, keys, slope = one
        oracle = Oracle(resolve(name, keys).table())
        rates = [gait["stance_rate"], gait["thigh_rate"], gait["shank_rate"]]
        step = _flown(oracle, gait["stance_angle"], rates[: 2 + oracle.knees], slope)

        size = max(map(abs, rates))
        off = max(
            abs(step.theta / gait["stance_angle"] - 1),
            abs(step.period / gait["period"] - 1),
            float(np.abs(np.subtract(step.rates, rates)).max()) / size,
            abs(step.loss_heelstrike / _heelstrike_loss(gait) - 1),
        )
        # The derivation's integrator errs by some 1e-13, which unstable gaits enlarge.
        compared.add(one, off / (1e-10 * max(1.0, gait["spectral_radius"])))
        if most and len(compared.off) >= most:
            break
    return compared


def _flown(oracle: Oracle, angle: float, rates: list[float], slope: float) -> Step:
    """A step of the derivation; closer together where its legs pass and strike within
    one of its longest steps.
    """
    try:
        return oracle.step(angle, rates, slope)
    except StepFailed:
        oracle.longest_step /= 5
        return oracle.step(angle, rates, slope)


def _heelstrike_loss(gait: dict[str, Any]) -> float:
    return float(gait["loss_normal"] + gait["loss_tangential"])


def in_113_bits(numbers: Iterable[int], most: int | None = None) -> Compared:
    """Solve the gaits of random driven walkers in 113 bits: angle and period must lie
    within the bounds.
    """
    compared = Compared()
    for one, gait in gaits(numbers):
        name, keys, slope = one
        angle, period = exact(resolve(name, keys), slope, gait)
        off = max(
            abs(angle / gait["stance_angle"] - 1), abs(period / gait["period"] - 1)
        )
        compared.add(one, off / gait["error_bound"])
        if most and len(compared.off) >= most:
            break
    return compared


def exact(walker: Walker, slope: float, gait: dict[str, Any]) -> tuple[float, float]:
    """Return stance angle and period of a gait solved in 113 bits, from its own."""
    problem, drive = Problem(walker), slope
    if slope <= 0:
        problem, drive = driven(walker, slope)
    time, at = problem.walker.time_unit, np.array([drive])
    rates = np.array([gait["stance_rate"], gait["thigh_rate"]]) * time
    state = np.array([[gait["stance_angle"]], *rates[:, None]])
    y = problem.section_of(state, at)
    scale = scale_of(y[0])
    ends = [gait["kneestrike_time"] or np.nan, gait["period"]]
    times = np.array(ends)[-problem.phases :, None] / time

    stride = problem.map(y / scale, times, problem.parameters(at, scale), by_drive=True)
    start = Start(problem, 0, stride, y[:, 0] / scale, times[:, 0], drive, scale[0])
    found = solved(start, 1)
    return float(found.y[0]) * scale[0], float(found.times[-1]) * time
