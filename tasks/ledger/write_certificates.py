"""Certificates: what is proved once and kept in `data/reference/proofs`, each made
again from its name.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from flint import arb, ctx

from gaitsweep.tasks.proofs import covers, crossings, tubes
from gaitsweep.tasks.proofs.body import body
from gaitsweep.tasks.proofs.enclosed_step import dimensions
from gaitsweep.tasks.proofs.gait import named
from gaitsweep.tasks.proofs.keys import (
    decimal,
    exact,
    in_doubles,
    trailing_knee,
    written_table,
)
from gaitsweep.tasks.proofs.records import STATE, guess, quoted
from gaitsweep.tasks.proofs.stability import multipliers
from gaitsweep.tasks.studies.prove_gaits import prove_one
from gaitsweep.tasks.studies.solve_at_slope import solve_one

#: What each certificate proves, by its name.
_STATEMENTS: dict[str, dict[str, Any]] = tomllib.loads(
    Path(__file__).with_suffix(".toml").read_text(encoding="utf-8")
)


def names(params: Mapping[str, Any] | None = None) -> list[str]:
    """Every certificate's name, the longest work first.

    Parameters
    ----------
    params : mapping, optional
        Nothing.

    Returns
    -------
    list of str
    """
    return list(_STATEMENTS)


def certify(params: Mapping[str, Any]) -> dict[str, Any]:
    """Prove one statement.

    Parameters
    ----------
    params : mapping
        `name`, one of `names`.

    Returns
    -------
    dict
        `name`, `kind`, `statement`, `walker`, `bits` and what goes with the kind, all
        plain data.

    Raises
    ------
    NotProvedError
        If it is not proved.
    """
    name = params["name"]
    if name not in _STATEMENTS:
        raise ValueError(f"there is no statement {name}")
    about = _STATEMENTS[name]
    return {"name": name, **_KINDS[about["kind"]](about)}


def _gait(about: Mapping[str, Any]) -> dict[str, Any]:
    walker, label, slope = about["walker"], about["gait"], about["slope"]
    (proof,) = prove_one({**about, "accuracy": 1e-12})["gaits"]
    if not proof["proved"]:
        raise tubes.NotProvedError(proof["reason"])

    stable = {True: "stable", False: "unstable", None: "of a stability not shown"}[
        proof["stable"]
    ]
    statement = (
        f"On the slope {slope} the walker has exactly one period-one gait in the box. It is a {label} step: its"
        f" strikes are the first of their kind and its legs pass once. It is {stable}."
    )

    return {
        "kind": "gait",
        "statement": statement,
        "walker": proof["walker"],
        "slope": slope,
        "gait": label,
        "stable": proof["stable"],
        "events": proof["events"],
        "box": proof["box"],
        "bits": proof["bits"],
        "zero_multipliers": (4 if "kneestrike_time" in proof["box"] else 3)
        - _dimension(walker),
    }


def _dimension(walker: str | Mapping[str, Any]) -> int:
    with ctx.workprec(106):
        return dimensions(body(*exact(walker), trailing_knee(walker)))[0]


def _family(walker: str | Mapping[str, Any], parameter: int) -> tubes.Family:
    """Gaits of a walker, followed along a coordinate."""
    return tubes.Family(*exact(walker), parameter, trailing_knee(walker))


def _written(family: tubes.Family) -> dict[str, str]:
    """The table of a family's walker as a certificate quotes it."""
    return written_table(family.keys, family.kneed, family.trailing_knee)


def _start(walker: str | Mapping[str, Any], label: str, slope: float) -> list[arb]:
    """Section state, event times and slope of a gait, approximately."""
    gaits = solve_one(
        {
            "walker": walker if isinstance(walker, str) else in_doubles(walker),
            "slope": slope,
        }
    )["gaits"]
    values = next(g for g in gaits if g["gait"] == label)
    # Of fewer digits than machines agree on, so that the proof is the same on all.
    state = [float(f"{x:.9e}") for x in guess(values)]
    return [arb(x) for x in (*state[: _dimension(walker)], *state[3:], slope)]


def enclose_special(params: Mapping[str, Any]) -> dict[str, Any]:
    """Enclose a flip or fold.

    Parameters
    ----------
    params : mapping
        `kind`, `walker` (name, or table whose numbers are strings), `slope` [rad] and
        `gait` of a gait near it, and `half` the interval of slope or of stance angle
        around it [rad].

    Returns
    -------
    dict
        What its certificate says, with the dependent rates in `box`, and `multipliers`.

    Raises
    ------
    NotProvedError
        If it is not proved.
    """
    parameter, function = crossings.KINDS[params["kind"]]
    family = _family(params["walker"], parameter)
    start = _start(params["walker"], params["gait"], float(params["slope"]))
    interval = crossings.bracketed(family, start, params["half"], function)
    what = (
        "a multiplier of the gait passes -1"
        if params["kind"] == "flip"
        else "the branch of gaits turns back: the slope as a function of the stance angle has an extremum"
    )
    tube = interval.tube
    order = tube.events()
    statement = (
        f"In the interval of slopes {what}. "
        f"Around it there is one branch of gaits, each of them a {order.label} step."
    )
    with ctx.workprec(interval.bits):
        box = {**named(tube.body, tube.whole[:-1]), "slope": interval.slope}
        values = multipliers(tube.step_derivative())

    return {
        "kind": params["kind"],
        "statement": statement,
        "walker": _written(family),
        "gait": order.label,
        "slope": list(quoted(interval.slope)),
        "box": {name: list(quoted(x)) for name, x in box.items()},
        "events": order.names,
        "test_function": [list(quoted(v)) for v in interval.values],
        "bits": interval.bits,
        "multipliers": [[list(quoted(x.real)), list(quoted(x.imag))] for x in values],
    }


def _special(about: Mapping[str, Any]) -> dict[str, Any]:
    """A flip or fold, without the multipliers and rates that follow."""
    found = enclose_special(about)
    del found["multipliers"]
    m = _dimension(about["walker"])
    box = {
        name: x
        for name, x in found["box"].items()
        if name in (*STATE[:m], *STATE[3:], "slope")
    }
    return {**found, "box": box}


def _tube(about: Mapping[str, Any]) -> dict[str, Any]:
    walker, label, low, high = (
        about[name] for name in ("walker", "gait", "slope", "to")
    )
    family = _family(walker, tubes.BY_SLOPE)
    cover = covers.stable_over(
        family, _start(walker, label, float(low)), (decimal(low), decimal(high))
    )
    statement = (
        f"For every slope from {low} to {high} the walker has a {label} step that is stable, its strikes the first"
        " of their kind and its legs passing once; along the interval it is one continuous branch."
    )

    return {
        "kind": "tube",
        "statement": statement,
        "walker": _written(family),
        "gait": label,
        "slope": [low, high],
        "events": cover[0].events().names,
        "tubes": [[float(t.middle[-1]), float(t.half)] for t in cover],
        "bits": covers.BITS,
    }


#: What proves a statement of each kind.
_KINDS = {"gait": _gait, "flip": _special, "fold": _special, "tube": _tube}
