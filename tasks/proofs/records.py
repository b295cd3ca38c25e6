"""Proofs as records: of what is stored, how far it lies from the gait, and in the words
of the command line.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from fractions import Fraction
from typing import Any

from flint import arb, ctx

from gaitsweep.tasks.contract.registry import GAITS
from gaitsweep.tasks.proofs.gait import MAX_CORRECTION, Proof, Setting, prove
from gaitsweep.tasks.proofs.keys import (
    KEY_BITS,
    double,
    doubles,
    written,
    written_table,
)
from gaitsweep.tasks.walkers.resolve import walker_of_line

#: Variables that a proof starts from.
STATE = ("stance_angle", "stance_rate", "thigh_rate", "kneestrike_time", "period")
#: A bound is checked only by a box this much smaller, but no smaller than this: doubles
#: come no closer to a gait, and the digits of a box have no other limit.
SHARPER, FINEST = 10.0, 1e-30
#: Archives are of no coarser accuracy.
MAX_BOUND = 1e-2


def prove_stored(params: Mapping[str, Any]) -> dict[str, Any]:
    """Prove one gait of an archive, whose walker, slope and values are the doubles they
    are.

    Parameters
    ----------
    params : mapping
        `walker` (table), `set` (keys to change), `slope` [rad], `gait`, `accuracy`, and
        `values`: the archive's variables at the point, `error_bound` among them if it
        is stored.

    Returns
    -------
    dict
        One gait. It is proved only if the values stored lie within their bound of it.
    """
    setting, proof = proof_of(params)
    values = params["values"]
    return record(
        setting,
        params["gait"],
        values,
        checked(proof, values, float(values.get("error_bound", math.nan))),
    )


def proof_of(params: Mapping[str, Any]) -> tuple[Setting, Proof]:
    """The proof behind `prove_stored`, not yet compared with the values' bound.

    Parameters
    ----------
    params : mapping
        As `prove_stored` takes it.

    Returns
    -------
    Setting, Proof
    """
    values = params["values"]
    walker = walker_of_line(params)
    keys, kneed = doubles(walker.table())
    setting = Setting(keys, kneed, double(params["slope"]), walker.trailing_knee)
    bound = float(values.get("error_bound", math.nan))
    accuracy, reach = params["accuracy"], MAX_CORRECTION
    if bound > 0:
        accuracy = min(accuracy, max(bound / SHARPER, FINEST))
        # Newton's steps overlap: together they may be a little longer than what they
        # correct.
        reach = max(reach, min(2 * bound, MAX_BOUND))

    return setting, prove(setting, guess(values), accuracy, params["gait"], reach)


def guess(values: Mapping[str, Any]) -> list[float]:
    """The numbers a proof starts from; straight legs have no kneestrike.

    Parameters
    ----------
    values : mapping of str to float

    Returns
    -------
    list of float
        Stance angle [rad], stance rate, thigh rate, with knees the time of kneestrike,
        and the period.
    """
    numbers = [values.get(name) for name in STATE]
    return [float(x) for x in numbers if x is not None and not math.isnan(x)]


def distance(proof: Proof, values: Mapping[str, Any]) -> arb:
    """How far values lie from a proved gait, as `error_bound` counts it: all but the
    time of kneestrike.

    Parameters
    ----------
    proof : Proof
    values : mapping of str to float
        Doubles, taken exactly.

    Returns
    -------
    arb
        Of angle and period relative, of rates over the largest rate.
    """
    with ctx.workprec(max(106, proof.bits)):
        rates = [abs(x) for name, x in proof.box.items() if name.endswith("_rate")]
        largest = max(rates, key=float)
        apart = [
            abs(arb(float(values[name])) - x)
            / (largest if name.endswith("_rate") else abs(x))
            for name, x in proof.box.items()
            if name != "kneestrike_time" and values.get(name) is not None
        ]
        # A value that is NaN lies nowhere, which no comparison would show.
        return next(
            (x for x in apart if x.is_nan()), max(apart, key=lambda x: float(x.upper()))
        )


def checked(proof: Proof, values: Mapping[str, Any], bound: float) -> Proof:
    """A proof, or its refusal where the values lie further from the gait than their
    bound says.

    Parameters
    ----------
    proof : Proof
    values : mapping of str to float
    bound : float
        Values without one (nan) are not shown to lie anywhere.

    Returns
    -------
    Proof
    """
    if not proof.proved:
        return proof

    apart = distance(proof, values)
    if apart <= arb(bound):
        return proof

    away = f"{float(apart.mid()):.2g} away from the values stored"

    return replace(
        proof,
        proved=False,
        reason=f"The gait there is {away}, and `error_bound` says {bound:.2g}.",
    )


def record(
    setting: Setting, label: str, values: Mapping[str, Any], proof: Proof
) -> dict[str, Any]:
    """A proof as plain data, as `gaitsweep prove --json` prints it.

    Parameters
    ----------
    setting : Setting
    label : str
        What the gait was called.
    values : mapping of str to float
        The numbers the proof started from.
    proof : Proof

    Returns
    -------
    dict
    """
    angle = proof.box.get("stance_angle")
    return {
        "gait": label if label in GAITS[2:] or not proof.label else proof.label,
        "slope": _plain(setting.slope),
        "exact_slope": written(setting.slope),
        "walker": written_table(setting.keys, setting.kneed, setting.trailing_knee),
        "proved": proof.proved,
        "unique": proof.unique,
        "first_strike": proof.first_strike,
        "stable": proof.stable,
        "stance_angle": _number(values.get("stance_angle"))
        if angle is None
        else float(angle.mid()),
        "radius": _number(proof.radius),
        "box": {name: list(quoted(x)) for name, x in proof.box.items()},
        "multipliers": [
            [list(quoted(x.real)), list(quoted(x.imag))] for x in proof.multipliers
        ],
        "events": proof.events,
        "bits": proof.bits,
        "reason": proof.reason,
    }


def quoted(x: arb) -> tuple[str, str]:
    """Decimal middle and radius of an interval that holds a ball.

    Parameters
    ----------
    x : arb

    Returns
    -------
    str, str
    """
    with ctx.workprec(KEY_BITS):
        size = abs(x).lower()
        spread = float(x.rad() / size) if size > 0 else 1.0
        digits = 60 if spread == 0 else max(3, 4 - math.floor(math.log10(spread)))
        middle = x.mid().str(digits, radius=False, more=True)
        apart = float(abs(x - arb(middle)).upper())

    # Printing takes off half a hundredth at most.
    return middle, f"{1.01 * apart:.2e}" if apart else "0"


def _plain(slope: Any) -> float:
    return float(Fraction(int(slope.p), int(slope.q)))  # either may be beyond doubles


def _number(x: Any) -> float | None:
    return None if x is None or math.isnan(float(x)) else float(x)
