"""The task graph of a study as plain data, restricted to what the study requests.

The graph has a few layers, each one task over every line or over the whole study, so a grid of a million points
needs no object per point. `expand` writes it in Dask's form: key -> (task, parameters, keys of inputs).
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from pipeline.store.rows import TaskKey
from pipeline.study.model import Study
from tasks import accuracy
from tasks.registry import GAITS, LOSS_WINDOWS, READ_BY_CLAIMS, READS, SHORT_LINE, TASKS, VARIABLES, Task


@dataclass(frozen=True)
class Layer:
    """One task over each line, or once over the study; `needs` names the layers it reads."""

    task: Task
    per_line: bool
    needs: tuple[str, ...]


def layers(study: Study) -> dict[str, Layer]:
    """Layers that a study needs, inputs first."""
    needed: dict[str, Layer] = {}

    def add(name: str, per_line: bool) -> None:
        if name in needed:
            return
        task = TASKS[name]
        needs = tuple(need for need in task.needs if need in TASKS)
        for need in needs:
            add(need, per_line or need == "points" or _over_lines(need))
        needed[name] = Layer(task, per_line, needs)

    add("points" if study.kind == "grid" else study.kind, True)
    for name in (*study.figures, *study.claims):
        for read in READS.get(name, ()):
            if read in TASKS:
                add(read, _over_lines(read))
    for name in study.fits:
        add(name, False)
    if study.claims and "claims" in TASKS:
        # Claims read the main results of the study, its points or the tables of its task, and their atlas.
        own = "points" if study.kind == "grid" else study.kind
        others = tuple(dict.fromkeys(name for claim in study.claims for name in READ_BY_CLAIMS.get(claim, ())))
        for name in others:
            add(name, True)
        needed["claims"] = Layer(TASKS["claims"], False, (own, *TASKS[own].needs, *others))
    return needed


def depths(graph: dict[str, Layer]) -> dict[str, int]:
    """Longest chain of inputs of each layer."""
    depth: dict[str, int] = {}
    for name, layer in graph.items():  # inputs come first
        # Atlases run first; all other tasks over lines follow together, whether they need one or not.
        depth[name] = max((1 + depth[need] for need in layer.needs), default=int(name != "atlas"))
    return depth


def _over_lines(name: str) -> bool:
    return not any(need == "points" or not _over_lines(need) for need in TASKS[name].needs) or name == "points"


def variables(study: Study) -> tuple[str, ...]:
    """Point variables to compute: those requested, and those that requested fits, figures and claims read."""
    names = {*study.variables, *accuracy.always(study.accuracy)}
    readers = (*study.fits, *study.figures, *study.claims, *(("claims",) if study.claims else ()))
    names.update(read for reader in readers for read in READS.get(reader, ()))
    return tuple(name for name in VARIABLES if name in names)


def is_short(study: Study) -> bool:
    """Whether the lines of a study are short: its atlases are coarse, and lines are computed side by side.

    Claims read the nodes of atlases: theirs are those that `gaitsweep claims` computes, whatever the study's slopes.
    """
    is_grid = study.kind == "grid" and study.steps == 1 and not study.claims
    return is_grid and len(study.slope) <= SHORT_LINE and bool(TASKS["atlas"].side_by_side)


def over_plane(study: Study) -> bool:
    """Whether gaits are interpolated over a plane of keys: where points alone are wanted of many short lines."""
    readers = (*study.fits, *study.figures, *study.claims, *(("claims",) if study.claims else ()))
    reads_atlas = any("atlas" in TASKS[name].needs for name in readers if name in TASKS)
    reads_atlas |= any(read in TASKS and read != "points" for name in readers for read in READS.get(name, ()))
    has_proofs = any(VARIABLES[name].group == "proofs" for name in study.variables)
    can = is_short(study) and bool(TASKS["atlas"].over_plane)
    return can and not (reads_atlas or has_proofs) and study.plane is not None


def is_interpolated(study: Study) -> bool:
    """Whether the gaits of long lines come from polynomials where these are accurate enough."""
    is_grid = study.kind == "grid" and study.steps == 1 and not study.claims
    return is_grid and not is_short(study) and accuracy.is_interpolated(variables(study), study.accuracy)


def point_params(study: Study) -> dict[str, Any]:
    """Parameters of points on which their values depend, besides their line and slopes."""
    accuracy_params = {"accuracy": study.accuracy, "interpolated": is_interpolated(study)} if study.accuracy else {}
    return {**study.options, **accuracy_params}


def line_params(study: Study, name: str, line: Mapping[str, Any]) -> dict[str, Any]:
    """Parameters of a task over one line, except the slopes of a block of points."""
    if name == "atlas":
        coarse = is_short(study) or is_interpolated(study)
        return {"line": line, "coarse": coarse, **({"steps": study.steps} if study.steps > 1 else {})}
    if name == "points":
        return {"line": line, **point_params(study)}
    if name == "corners":
        return {"line": line}
    if name == "cascade" != study.kind:  # for the fit `crises`
        named = isinstance(line["walker"], str) and not line["set"]
        slopes = np.array(LOSS_WINDOWS.get(line["walker"], ()) if named else (), float)
        return {"line": line, "slope": slopes, "gaits": GAITS}
    if name == "branch":
        slopes = study.slope
        window = {"slope_from": float(slopes.min()), "slope_to": float(slopes.max()), "n": len(slopes)}
        return {"line": line, **window, **study.options}
    own = {} if name == "trace" else study.options  # whose `steps` may be those of orbits
    params = {"line": line, "slope": study.slope, "gaits": study.gaits, **own}
    if name == "design" and study.plane:
        params["cell"] = study.plane.cell({key: float(values[0]) for key, values in line["set"].items()})
    return params


def study_params(study: Study, name: str) -> dict[str, Any]:
    """Parameters of a task over the whole study."""
    params: dict[str, Any] = {"lines": [{**study.line(i), "name": study.name_of(i)} for i in range(study.lines)]}
    if name == "claims":
        params["ids"] = list(study.claims)
    return params


def key(task: Task, params: Mapping[str, Any], inputs: Iterable[str] = ()) -> TaskKey:
    """Key of a task with these parameters and the keys of its inputs."""
    plain = _canonical(params)
    versioned = json.dumps([task.name, task.version, plain, list(inputs)], separators=(",", ":"))
    # Results to another accuracy are those of a changed study, as of another version.
    kept = {name: value for name, value in plain.items() if name != "accuracy"}
    unversioned = json.dumps([task.name, kept], separators=(",", ":"))
    return TaskKey(*(f"{task.name}-{_hash(text.encode())}" for text in (versioned, unversioned)))


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


def line_keys(study: Study, graph: Mapping[str, Layer], line: Mapping[str, Any]) -> dict[str, TaskKey]:
    """Keys of every task over one line."""
    keys: dict[str, TaskKey] = {}
    for name, layer in graph.items():
        if layer.per_line:
            keys[name] = key(layer.task, line_params(study, name, line), [keys[need].key for need in layer.needs])
    return keys


def study_keys(study: Study, graph: Mapping[str, Layer], lines: Iterable[str]) -> dict[str, TaskKey]:
    """Keys of every task over the study; `lines` are the joined keys of its lines."""
    keys: dict[str, TaskKey] = {}
    study_inputs = [_hash("".join(lines).encode()), _hash(study.slope.tobytes()), *study.gaits]
    for name, layer in graph.items():
        if not layer.per_line:
            inputs = [keys[need].key for need in layer.needs if need in keys]
            keys[name] = key(layer.task, study_params(study, name), [*study_inputs, *inputs])
    return keys


def expand(study: Study) -> dict[str, tuple[str, dict[str, Any], list[str]]]:
    """The whole graph in Dask's form, for inspecting small studies."""
    graph = layers(study)
    nodes: dict[str, tuple[str, dict[str, Any], list[str]]] = {}
    by_line = []
    for i in range(study.batches):
        line = study.batch_line(i)
        keys = line_keys(study, graph, line)
        by_line.append(keys)
        for name, (node, _) in keys.items():
            nodes[node] = (name, line_params(study, name, line), [keys[need].key for need in graph[name].needs])
    over_study = study_keys(study, graph, ("".join(k for k, _ in keys.values()) for keys in by_line))
    for name, (node, _) in over_study.items():
        sources = {need: by_line if graph[need].per_line else [over_study] for need in graph[name].needs}
        inputs = [keys[need].key for need, all_keys in sources.items() for keys in all_keys]
        nodes[node] = (name, study_params(study, name), inputs)
    return nodes
