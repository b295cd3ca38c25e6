"""Proofs of every gait of a walker at one slope: for `gaitsweep prove --walker`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from gaitsweep.tasks.proofs.gait import Setting, prove
from gaitsweep.tasks.proofs.keys import check_written, decimal, exact, in_doubles
from gaitsweep.tasks.proofs.records import guess, record
from gaitsweep.tasks.solve_at_slope import solve_one


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
    table = params["walker"] if isinstance(params["walker"], Mapping) else {}
    check_written({**table, **(params.get("set") or {}), "slope": params["slope"]})
    walker, numbers = (
        in_doubles(table) or params["walker"],
        in_doubles(params.get("set") or {}),
    )
    solved = solve_one(
        {"walker": walker, "slope": float(params["slope"]), "set": numbers}
    )
    keys, kneed = exact(params["walker"], params.get("set"))
    setting = Setting(keys, kneed, decimal(params["slope"]))
    wanted, labels = params.get("gait"), [g["gait"] for g in solved["gaits"]]
    gaits = [g for g in solved["gaits"] if wanted in (None, g["gait"])]
    others = ""
    if labels and not gaits:
        are = "are" if len(labels) > 1 else "is"
        others = f"There is no {wanted} gait at slope {float(params['slope']):g}; there {are} {', '.join(labels)}."
    return {
        "gaits": [
            record(
                setting,
                g["gait"],
                g,
                prove(setting, guess(g), params["accuracy"], g["gait"]),
            )
            for g in gaits
        ],
        "search": solved["search"],
        "others": others,
    }
