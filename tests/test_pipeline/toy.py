"""Toy tasks with known answers and every way to go wrong, in place of the real ones."""

import builtins
import logging
import os
import signal
import time
from pathlib import Path

import numpy as np

from gaitsweep.tasks.contract.registry import GAITS, VARIABLES

_open, _hidden = open, os.environ.get("TOY_WITHOUT")


def _open_what_is_there(file, *arguments, **options):
    """Open a file, unless it lies where the environment says that nothing is."""
    if Path(str(file)).is_relative_to(_hidden):
        raise FileNotFoundError(2, os.strerror(2), file)
    return _open(file, *arguments, **options)


if _hidden:
    builtins.open = _open_what_is_there


def atlas(params, inputs):
    """A scale that every point of the line leans on."""
    line = params["line"]
    if line["set"].get("w_t") == 13.0:
        raise ValueError("no atlas here.")
    return {"scale": np.array([1.0 + sum(line["set"].values())])}


def points(params, inputs):
    """Long gaits everywhere, short ones below 0.1; trouble at slopes that ask for it."""
    (source,) = inputs
    slope, scale = params["slope"], float(source["scale"][0])
    for s in slope:
        _trouble(float(s), os.environ.get("TOY_TROUBLE", ""))
    low, high, dear = map(float, os.environ.get("TOY_COSTLY", "0 0 0").split())
    time.sleep(
        len(slope) * float(os.environ.get("TOY_SECONDS", "0"))
        + dear * np.sum((slope > low) & (slope < high))
    )
    values_of_long, digits = np.cbrt(slope) * scale, os.environ.get("TOY_DIGITS")
    if digits:  # so that much fits on a disk
        values_of_long = np.round(values_of_long, int(digits))
    n, g = len(slope), len(GAITS)
    status = np.full((n, g), 1, np.int8)
    status[:, 0] = 0
    status[slope < 0.1, 1] = 0
    reason = status.astype(np.int16)
    found = {
        "status": status,
        "reason": reason,
        "reasons": np.array(["It converged.", "The branch ends below this slope."]),
    }
    for name in params["want"]:
        about = VARIABLES[name]
        if name in found:
            continue
        shape = (n, g) + ((3,) if "multiplier" in about.dims else ())
        values = np.full(shape, about.absent, about.dtype)
        if about.dtype == "f8":
            for k in range(2):
                there = status[:, k] == 0
                values[there, k] = (values_of_long * (k + 1))[there].reshape(
                    (-1,) + (1,) * (values.ndim - 2)
                )
        if name == "branch":
            values[:] = np.where(status == 0, np.arange(g), -1)
        found[name] = values
    return found


def lines(params, inputs):
    """Atlas and points of several lines."""
    results = []
    for line in params["lines"]:
        one = {**params, "line": line}
        source = atlas(one, [])
        results.append((source, points(one, [source])))
    return results


def _trouble(slope, kinds):
    for kind in kinds.split():
        name, _, place = kind.partition("@")
        if abs(slope - float(place)) < 1e-9:
            if name == "log":
                logging.getLogger("gaitsweep").info("Trouble is in sight.")
            if name == "raise":
                raise RuntimeError(f"trouble at {slope:.3f}")
            if name == "exit":
                raise SystemExit(3)
            if name == "unpicklable":
                raise type("Local", (Exception,), {"lock": None})(lambda: 0)
            if name == "segfault":
                os.kill(os.getpid(), signal.SIGSEGV)
            if name == "kill":
                os.kill(os.getpid(), signal.SIGKILL)
            if name == "hang":
                time.sleep(1000)
            if name == "once" and not os.path.exists(
                "hung"
            ):  # as on a machine that stalls
                open("hung", "x").close()
                time.sleep(1000)
            if name == "eat":
                _eat()


def _eat():
    hoard = []
    while True:
        hoard.append(np.ones(1 << 22))


def fit(params, inputs):
    """Mean angle of the long gait of every line."""
    means = [float(np.nanmean(i["stance_angle"][:, 0])) for i in inputs]
    names = [line["name"] for line in params["lines"]]
    return {
        "fits/scaling/walker": np.array(names),
        "fits/scaling/exponent": np.array(means),
    }


def fit_atlas(params, inputs):
    """What every line's atlas says."""
    return {
        "fits/transition/walker": np.array([line["name"] for line in params["lines"]]),
        "fits/transition/exponent": np.concatenate([i["scale"] for i in inputs]),
    }


def orbit(params, inputs):
    """A table per line, that of walker F with a number and a word more."""
    slope = params["slope"]
    more = {"orbits/swing_rate": -slope, "orbits/gait": np.full(len(slope), "long")}
    own = more if params["line"]["walker"] == "F" else {}
    return {"orbits/slope": slope, "orbits/period": slope * 2, **own}
