"""Variables of gaits: every name, unit and meaning, and what the other modules need to know of each.

Like the registry, this module imports no solver.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from typing import Any

from gaitsweep import extensions

#: Labels of the gait dimension. `other1`, ... hold the further gaits of a label, by falling angle.
GAITS = ("long", "short", "other1", "other2")

#: What can become of a solve (CF flag values). How a run ended for a worker is added by the pipeline.
STATUSES = {"converged": 0, "no_gait": 1, "not_converged": 2, "fell": 3, "less_accurate": 9}

#: SI units of each kind of quantity; every one is "1" for a walker in consistent units.
SI_UNITS = {
    "angle": "rad",
    "rate": "rad s-1",
    "angle_rate": "rad2 s-1",
    "time": "s",
    "frequency": "s-1",
    "length": "m",
    "mass": "kg",
    "speed": "m s-1",
    "energy": "J",
    "power": "W",
    "impulse": "N s",
    "angular_impulse": "N m s",
    "torque": "N m",
    "acceleration": "m s-2",
    "inertia": "kg m2",
    "number": "1",
}


@dataclass(frozen=True)
class Variable:
    """One archive variable: name, dimensions after the axes, kind of quantity, meaning, value without a gait.

    `over_steps` is what a gait of n steps has of its steps' values: that of the `first`, which begins with the largest
    stance angle, their `sum` or `mean`, the `greatest`, the `least`, or the flags of `any`; others follow from them.
    `is_smooth` is whether polynomials give it along a branch (`tasks.measures.smooth`): gaits are otherwise integrated.
    `is_of_knees` is whether straight-legged walkers have none.

    A variable of another package has a `measure`, called with the steps (`tasks.measures.gaits.Steps`) and what is
    measured of them already, arrays by name; it returns a value of each step. Its `version` is bumped by hand when its
    values change.
    """

    name: str
    dims: tuple[str, ...]
    kind: str
    long_name: str
    group: str = ""
    dtype: str = "f8"
    absent: float = float("nan")
    over_steps: str = "first"
    is_smooth: bool = False
    is_of_knees: bool = False
    measure: Callable[[Any, dict[str, Any]], Any] | None = None
    version: int = 1

    def units(self, si: bool) -> str:
        """CF units of this variable for a walker in SI (`si`) or in consistent units."""
        return SI_UNITS[self.kind] if si or self.kind == "angle" else "1"


_G, _M = ("gait",), ("gait", "multiplier")
_OF_KNEES: dict[str, Any] = {"is_of_knees": True}
_GREATEST: dict[str, Any] = {"group": "violations", "over_steps": "greatest"}
_LEAST: dict[str, Any] = {"group": "violations", "over_steps": "least"}
_MULTIPLIERS: dict[str, Any] = {"group": "multipliers", "is_smooth": True}
_SUM: dict[str, Any] = {"over_steps": "sum", "is_smooth": True}
_SMOOTH: dict[str, Any] = {"is_smooth": True}

#: Variables of a grid study in the order they are archived.
VARIABLES = {
    v.name: v
    for v in (
        Variable("stance_angle", _G, "angle", "stance angle just after heelstrike", **_SMOOTH),
        Variable("stance_rate", _G, "rate", "stance leg rate just after heelstrike", **_SMOOTH),
        Variable("thigh_rate", _G, "rate", "swing thigh rate just after heelstrike", **_SMOOTH),
        Variable("shank_rate", _G, "rate", "swing shank rate just after heelstrike", **_SMOOTH),
        Variable("period", _G, "time", "duration of one step", **_SUM),
        Variable(
            "kneestrike_time", _G, "time", "time of kneestrike after the start of the step", **_SMOOTH, **_OF_KNEES
        ),
        Variable("multiplier_real", _M, "number", "real part of the step map's eigenvalues", **_MULTIPLIERS),
        Variable("multiplier_imag", _M, "number", "imaginary part of the step map's eigenvalues", **_MULTIPLIERS),
        Variable("spectral_radius", _G, "number", "largest magnitude of the step map's eigenvalues", **_MULTIPLIERS),
        Variable(
            "multiplier_error_bound", _G, "number", "bound on the absolute errors of the multipliers", **_MULTIPLIERS
        ),
        Variable(
            "step_length", _G, "length", "distance along the slope between footprints", over_steps="mean", **_SMOOTH
        ),
        Variable("step_frequency", _G, "frequency", "steps in a unit of time", **_SMOOTH),
        Variable("speed", _G, "speed", "mean speed along the slope", **_SMOOTH),
        Variable(
            "froude_speed",
            _G,
            "number",
            "mean speed over sqrt(g (l + R)), the square root of the Froude number",
            **_SMOOTH,
        ),
        Variable("cost_of_transport", _G, "number", "energy lost over weight and distance", **_SMOOTH),
        Variable("power", _G, "power", "mean power drawn from gravity", **_SMOOTH),
        Variable(
            "loss_normal", _G, "energy", "heelstrike loss on the eigenvector nearer the ground normal", "energy", **_SUM
        ),
        Variable(
            "loss_tangential", _G, "energy", "heelstrike loss on the eigenvector nearer the slope", "energy", **_SUM
        ),
        Variable("loss_kneestrike", _G, "energy", "loss at kneestrike", "energy", **_SUM, **_OF_KNEES),
        Variable("energy_imbalance", _G, "number", "losses minus drop of potential energy, over that drop", "energy"),
        Variable(
            "heelstrike_rate_ratio",
            _G,
            "number",
            "(thigh rate - stance rate)/|stance rate| just before heelstrike; below 1/2 a gait is long",
            **_SMOOTH,
        ),
        Variable(
            "velocity_ratio",
            _G,
            "number",
            "tangential over normal velocity of the swing foot, down the slope and upwards, just before heelstrike",
            **_SMOOTH,
        ),
        Variable(
            "violations",
            _G,
            "number",
            "physical assumptions that a gait violates beyond their limits",
            "violations",
            "i4",
            0,
            "any",
        ),
        Variable("scuff_depth", _G, "length", "greatest depth of the swing foot below the ground", **_GREATEST),
        Variable(
            "foot_clearance",
            _G,
            "length",
            "least height of the swing foot above the ground where it is lowest in mid-swing (negative: it scuffs)",
            **_LEAST,
        ),
        Variable(
            "unlocking_torque",
            _G,
            "torque",
            "worst torque that would flex the stance knee (negative: its stop holds)",
            **_GREATEST,
            **_OF_KNEES,
        ),
        Variable("unlocking_torque_time", _G, "time", "when the unlocking torque is worst", "violations", **_OF_KNEES),
        Variable(
            "unlocking_impulse_kneestrike",
            _G,
            "angular_impulse",
            "angular impulse that would flex the stance knee at kneestrike",
            **_GREATEST,
            **_OF_KNEES,
        ),
        Variable(
            "unlocking_impulse_heelstrike",
            _G,
            "angular_impulse",
            "angular impulse that would flex the stance knee at heelstrike",
            **_GREATEST,
            **_OF_KNEES,
        ),
        Variable("least_normal_force", _G, "number", "least ground normal force over weight", **_LEAST),
        Variable(
            "least_normal_impulse", _G, "impulse", "least ground normal impulse at heelstrike and kneestrike", **_LEAST
        ),
        Variable(
            "friction_demand",
            _G,
            "number",
            "largest |tangential|/normal ground force (infinite: the contact would pull)",
            **_GREATEST,
        ),
        Variable(
            "friction_demand_heelstrike",
            _G,
            "number",
            "|tangential|/normal impulse at heelstrike (infinite: the contact would pull)",
            **_GREATEST,
        ),
        Variable(
            "friction_demand_kneestrike",
            _G,
            "number",
            "|tangential|/normal impulse at kneestrike (infinite: the contact would pull)",
            **_GREATEST,
            **_OF_KNEES,
        ),
        Variable("hyperextension", _G, "angle", "largest hyperextension of the swing knee", **_GREATEST, **_OF_KNEES),
        Variable("penetration_depth", _G, "length", "depth the released foot sinks just after heelstrike", **_GREATEST),
        Variable(
            "trailing_impulse", _G, "impulse", "impulse two contacts would need at the trailing foot", **_GREATEST
        ),
        Variable("residual", _G, "number", "largest residual of the fixed-point equations"),
        Variable(
            "error_bound",
            _G,
            "number",
            "bound on the relative errors of angle and period and on the rates' errors over the largest rate",
            **_SMOOTH,
        ),
        Variable(
            "branch",
            _G,
            "number",
            "branch of its line a gait lies on, by rank; -1 where there is no gait",
            dtype="i2",
            absent=-1,
            **_SMOOTH,
        ),
        Variable(
            "piece",
            _G,
            "number",
            "piece of its branch between folds; -1 where there is no gait",
            dtype="i2",
            absent=-1,
            **_SMOOTH,
        ),
        Variable(
            "proved", _G, "number", "whether the gait is proved to exist, alone in a box, as a step", "proofs", "i1", 0
        ),
        Variable("proved_radius", _G, "number", "relative radius of the box of the proof", "proofs"),
        Variable("status", _G, "number", "outcome of the solve", dtype="i1", absent=STATUSES["no_gait"], **_SMOOTH),
        Variable("reason", _G, "number", "index into the table of reasons", dtype="i2", absent=0, **_SMOOTH),
    )
}


@dataclass(frozen=True)
class Violation:
    """A physical assumption of the model (appendix A of the paper), and how far a gait may go beyond it.

    A gait is flagged where one of its `amounts`, in `unit`, exceeds the `limit`; where `is_least`, where one lies below
    its negative. Quantities in the walker's units are over those of its leg l + R, its mass and g.
    """

    name: str
    amounts: tuple[str, ...]
    limit: float
    unit: str
    reason: str
    is_least: bool = False


#: Every assumption with its limit, in the order of the bits of `violations`. A thousandth is what the soles, stops and
#: latches of a real machine give: what is less tells no walkers apart, since straight legs always scuff by an amount.
VIOLATIONS = {
    v.name: v
    for v in (
        Violation(
            "scuff",
            ("scuff_depth",),
            1e-3,
            "leg",
            "a sole, or an uneven floor, gives a millimetre under a leg of one metre",
        ),
        Violation(
            "stance_knee_unlocks",
            ("unlocking_torque", "unlocking_impulse_kneestrike", "unlocking_impulse_heelstrike"),
            1e-3,
            "weight leg, or mass leg sqrt(g leg)",
            "a knee's friction or latch holds a thousandth of what the weight exerts at the length of the leg",
        ),
        Violation(
            "contact_tension",
            ("least_normal_force", "least_normal_impulse"),
            0.0,
            "weight, or mass sqrt(g leg)",
            "no ground pulls",
            is_least=True,
        ),
        Violation(
            "friction",
            ("friction_demand", "friction_demand_heelstrike", "friction_demand_kneestrike"),
            1.0,
            "1",
            "rubber on a dry floor",
        ),
        Violation(
            "release_hyperextends", ("hyperextension",), 1e-3, "rad", "a knee's stop gives a thousandth of a radian"
        ),
        Violation("release_penetrates", ("penetration_depth",), 1e-3, "leg", "as for scuffing"),
        Violation(
            "trailing_foot_pulls",
            ("trailing_impulse",),
            1e-3,
            "mass sqrt(g leg)",
            "it would change the walker's speed by a thousandth of sqrt(g leg)",
        ),
    )
}

#: Values of `proved` (CF flags).
PROVED = {"not_attempted": 0, "proved": 1, "not_proved": 2}

#: Groups of variables that cost much: only a study that names them has them.
COSTLY = ("violations", "proofs")

#: Always archived, whatever a study wants.
ALWAYS = ("residual", "error_bound", "branch", "piece", "status", "reason")


def admit(names: Iterable[str]) -> None:
    """Add those of some variables that another package measures.

    Raises
    ------
    ExtensionError
        If one cannot be loaded, or is none.
    """
    for name in {*names} - VARIABLES.keys():
        added = extensions.find("measures", name, Variable)
        if added is None:
            continue
        like = Variable(name, _G, added.kind, added.long_name, over_steps=added.over_steps)
        if replace(added, measure=None, version=1) != like or added.kind not in SI_UNITS or added.measure is None:
            raise extensions.ExtensionError(f"`{name}` has another name, kind or group than a measure of a package may")
        VARIABLES[name] = added
    for name in sorted(v.name for v in VARIABLES.values() if v.measure):  # in whatever order they came
        VARIABLES[name] = VARIABLES.pop(name)
