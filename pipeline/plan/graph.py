"""The graph of a study: plain data, culled to what is wanted.

A study's graph is a few layers, each one task over every line or over the whole study, so a grid of a million
points costs no object a point. `expand` writes it out as Dask does: key -> (task, parameters, keys of inputs).
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from pipeline.study.model import Study
from tasks.registry import ALWAYS, READS, TASKS, VARIABLES, Task


@dataclass(frozen=True)
class Layer:
    """One task over each line, or once over the study; `needs` are other layers."""

    task: Task
    per_line: bool
    needs: tuple[str, ...]


def layers(study: Study) -> dict[str, Layer]:
    """The layers a study needs, inputs first."""
    found: dict[str, Layer] = {}

    def add(name: str, per_line: bool) -> None:
        if name in found:
            return
        task = TASKS[name]
        needs = tuple(need for need in task.needs if need in TASKS)
        for need in needs:
            add(need, per_line or need == "points" or _over_lines(need))
        found[name] = Layer(task, per_line, needs)

    add("points" if study.kind == "grid" else study.kind, True)
    for name in (*study.figures, *study.claims):
        for read in READS.get(name, ()):
            if read in TASKS:
                add(read, _over_lines(read))
    for name in study.fits:
        add(name, False)
    if study.claims and "claims" in TASKS:
        # Claims read what the study is about: its points or the tables of its own task, and their atlas.
        own = "points" if study.kind == "grid" else study.kind
        found["claims"] = Layer(TASKS["claims"], False, (own, *TASKS[own].needs))
    return found


def _over_lines(name: str) -> bool:
    return not any(need == "points" or not _over_lines(need) for need in TASKS[name].needs) or name == "points"


def variables(study: Study) -> tuple[str, ...]:
    """Point variables to compute: what is wanted, and what the wanted fits, figures and claims read."""
    names = {*study.variables, *ALWAYS}
    readers = (*study.fits, *study.figures, *study.claims, *(("claims",) if study.claims else ()))
    names.update(read for reader in readers for read in READS.get(reader, ()))
    return tuple(name for name in VARIABLES if name in names)


def line_params(study: Study, name: str, line: Mapping[str, Any]) -> dict[str, Any]:
    """Parameters of a task over one line. A block of points is told its own slopes besides."""
    if name == "atlas":
        return {"line": line}
    if name == "points":
        return {"line": line, **study.options}
    if name == "branch":
        slopes = study.slope
        window = {"slope_from": float(slopes.min()), "slope_to": float(slopes.max()), "n": len(slopes)}
        return {"line": line, **window, **study.options}
    return {"line": line, "slope": study.slope, "gaits": study.gaits, **study.options}


def study_params(study: Study, name: str) -> dict[str, Any]:
    """Parameters of a task over the whole study."""
    params: dict[str, Any] = {"lines": [{**study.line(i), "name": study.name_of(i)} for i in range(study.lines)]}
    if name == "claims":
        params["ids"] = list(study.claims)
    return params


def key(task: Task, params: Mapping[str, Any], inputs: Iterable[str] = ()) -> tuple[str, str]:
    """Key of a task with those parameters and inputs, and its kin: the same whatever the versions."""
    plain = _canonical(params)
    whole = json.dumps([task.name, task.version, plain, list(inputs)], separators=(",", ":"))
    unversioned_key = json.dumps([task.name, plain], separators=(",", ":"))
    return f"{task.name}-{_hash(whole.encode())}", f"{task.name}-{_hash(unversioned_key.encode())}"


def _hash(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()


def _canonical(x: Any) -> Any:
    if isinstance(x, float):
        return x.hex()
    if isinstance(x, Mapping):
        return {k: _canonical(x[k]) for k in sorted(x)}
    if isinstance(x, list | tuple):
        return [_canonical(v) for v in x]
    if isinstance(x, np.ndarray):
        return [x.dtype.str, list(x.shape), _hash(x.tobytes())]
    return x


def line_keys(study: Study, graph: Mapping[str, Layer], line: Mapping[str, Any]) -> dict[str, tuple[str, str]]:
    """Key and kin of every task over that line."""
    keys: dict[str, tuple[str, str]] = {}
    for name, layer in graph.items():
        if layer.per_line:
            keys[name] = key(layer.task, line_params(study, name, line), [keys[need][0] for need in layer.needs])
    return keys


def study_keys(study: Study, graph: Mapping[str, Layer], lines: Iterable[str]) -> dict[str, tuple[str, str]]:
    """Key and kin of every task over the study, whose lines' keys are given."""
    keys: dict[str, tuple[str, str]] = {}
    over = [_hash("".join(lines).encode()), _hash(study.slope.tobytes()), *study.gaits]
    for name, layer in graph.items():
        if not layer.per_line:
            inputs = [keys[need][0] for need in layer.needs if need in keys]
            keys[name] = key(layer.task, study_params(study, name), [*over, *inputs])
    return keys


def expand(study: Study) -> dict[str, tuple[str, dict[str, Any], list[str]]]:
    """The whole graph in Dask's shape, for small studies and curious eyes."""
    graph = layers(study)
    nodes: dict[str, tuple[str, dict[str, Any], list[str]]] = {}
    by_line = []
    for i in range(study.lines):
        line = study.line(i)
        keys = line_keys(study, graph, line)
        by_line.append(keys)
        for name, (node, _) in keys.items():
            nodes[node] = (name, line_params(study, name, line), [keys[need][0] for need in graph[name].needs])
    over = study_keys(study, graph, ("".join(k for k, _ in keys.values()) for keys in by_line))
    for name, (node, _) in over.items():
        inputs = [keys[need][0] for need in graph[name].needs for keys in (by_line if graph[need].per_line else [over])]
        nodes[node] = (name, study_params(study, name), inputs)
    return nodes
