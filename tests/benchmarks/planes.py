"""Processor time of planes of keys: the cost of making a cell, and of every further walker."""

import functools
import time
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.harness import what_more_take
from pipeline.study.parse import parse
from tasks.registry import ALWAYS
from tasks.solve_planes import lines

#: Walkers, a slope, and the two keys with their ranges.
PLANES: dict[str, tuple[float, dict[str, tuple[float, float]]]] = {
    "B": (0.01, {"m_s": (0.05, 0.15), "R": (0.0, 0.25)}),
    "C": (0.04, {"detuning": (0.0, 1.0), "m_h": (0.0, 1.5)}),
}
#: Walkers along each key in the smaller and in the larger study of a full and of a quick run.
_ACROSS = {False: (40, 120), True: (32, 48)}
_BEYOND = 1e-9  # relative enlargement of a cell


def table(quick: bool) -> list[dict[str, float | str]]:
    """Measure planes of walkers at one slope.

    Two studies have the same cells and differ in their number of walkers; the difference is what further gaits take,
    with multipliers, error bounds, journal and archive.
    """
    rows: list[dict[str, float | str]] = []
    for name, (slope, keys) in list(PLANES.items())[: 1 if quick else None]:
        study = functools.partial(_study, name, slope, keys)
        further = what_more_take(study, *_ACROSS[quick])
        cells, surveyed = _made(study(_ACROSS[quick][0]))
        rows.append(
            {
                "walker": name,
                "keys": " × ".join(keys),
                "gaits": float(further.gaits + further.gaits_of_fewer),
                "s a further gait": further.seconds / further.gaits,
                "s a cell": float(np.mean(cells)),
                "cells": float(len(cells)),
                "share of walkers surveyed one by one": surveyed,
            }
        )
    return rows


def _study(walker: str, slope: float, keys: dict[str, tuple[float, float]], n: int) -> dict[str, Any]:
    axes = {key: np.linspace(low, high, n).tolist() for key, (low, high) in keys.items()}
    return {"name": "plane", "walker": walker, "axes": {"slope": [slope], **axes}}


def _made(table: dict[str, Any]) -> tuple[list[float], float]:
    """Processor time that each cell of a plane takes to make [s], and the share of its walkers surveyed one by one."""
    study = parse(table, "", Path("plane.toml"))
    assert study.plane
    seconds, surveyed = [], 0
    cells: dict[tuple[float, ...], list[dict[str, Any]]] = {}
    for line in map(study.line, range(study.lines)):
        cells.setdefault(tuple(study.plane.cell(line["set"])["low"]), []).append(line)
    for block in cells.values():
        cell = study.plane.cell(block[0]["set"])
        took = []
        # A slightly larger cell is made anew by code already loaded; the second time it is cached.
        for beyond in (0.0, _BEYOND, _BEYOND):
            larger = cell | {"high": [high * (1 + beyond) for high in cell["high"]]}
            params = {"lines": block, "slope": study.slope, "want": ALWAYS, "cell": larger}
            begin = time.process_time()
            ((_, points),) = lines(params, [])
            took.append(time.process_time() - begin)
        seconds.append(took[1] - took[2])
        # Sentences of the cell come first; every line that was surveyed has its own.
        surveyed += int((points["reason"].max(axis=1) > 5).sum())
    return seconds, surveyed / study.lines
