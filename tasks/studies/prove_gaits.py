"""Proofs of every gait of a walker at one slope: for `gaitsweep prove --walker`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from gaitsweep.tasks.proofs.gait import Setting, prove
from gaitsweep.tasks.proofs.keys import (
    check_written,
    decimal,
    exact,
    in_doubles,
    trailing_knee,
)
from gaitsweep.tasks.proofs.records import guess, record
from gaitsweep.tasks.studies.solve_at_slope import solve_one


def prove_one(params: Mapping[str, Any]) -> dict[str, Any]:
    """Prove every gait of a walker at one slope, or the one of a label.

    Parameters
    ----------
    params : mapping
        `walker` (name or table), `slope` [rad] and the values of `set`, as strings or
        numbers that mean the decimals written; `gait`, a label, or None; `accuracy`,
        the largest relative radius.

    Returns
    -------
    dict
        `gaits`, a list with one dict a gait; `search`, sentences on how they were
        sought; and `others`, which gaits there are if none has the label, else empty.

    Raises
    ------
    WalkerError
        If the walker is invalid.
    """
    walker, slope = params["walker"], params["slope"]
    overrides = params.get("set") or {}
    table = walker if isinstance(walker, Mapping) else {}
    check_written({**table, **overrides, "slope": slope})
    solved = solve_one(
        {
            "walker": in_doubles(table) or walker,
            "slope": float(slope),
            "set": in_doubles(overrides),
        }
    )
    rule = trailing_knee(walker, overrides)
    setting = Setting(*exact(walker, overrides), decimal(slope), rule)
    label = params.get("gait")
    proved = []
    for gait in solved["gaits"]:
        name = gait["gait"]
        if label in (None, name):
            proof = prove(setting, guess(gait), params["accuracy"], name)
            proved.append(record(setting, name, gait, proof))

    labels = [gait["gait"] for gait in solved["gaits"]]
    others = ""
    if labels and not proved:
        are = "are" if len(labels) > 1 else "is"
        others = (
            f"There is no {label} gait at slope {float(slope):g}; "
            f"there {are} {', '.join(labels)}."
        )

    return {"gaits": proved, "search": solved["search"], "others": others}
