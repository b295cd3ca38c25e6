"""Program of a worker process: it reads requests from standard input and answers on standard output.

Started as `python -m pipeline.engine.worker_main PARENT` by `pipeline.engine.worker_process`.
"""

from __future__ import annotations

import ctypes
import functools
import os
import re
import resource
import signal
import struct
import sys
import time
from collections.abc import Callable
from multiprocessing.connection import Connection
from typing import Any

from pipeline.dispatch import resolve
from pipeline.engine.messages import receive, send
from tasks.registry import CLOCK

_PR_SET_PDEATHSIG = 1
_SLACK = 256 << 20  # growth above the limit that the kernel allows [byte]


def serve(parent: int) -> None:
    """Answer requests of the process `parent` until it closes the pipe or ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    ctypes.CDLL(None, use_errno=True).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    if os.getppid() != parent:
        return
    # Output of tasks and libraries must not mix with the answers.
    requests, answers = Connection(os.dup(0), writable=False), Connection(os.dup(1), readable=False)
    os.dup2(2, 1)
    os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
    from pipeline import serialize

    warm: set[bytes] = set()
    modules, threads, used = 0, 1, (0.0, 0.0)
    while True:
        try:
            head, *inputs = receive(requests)
        except EOFError:
            return
        request = serialize.load(head)
        try:
            function = resolve(request["function"])
        except Exception as error:
            send(answers, b"broken", _sentence(error).encode())
            continue
        if len(sys.modules) != modules:  # a newly loaded library may have its own thread pool
            threads, modules = _limit_to_one_thread(), len(sys.modules)
        _limit_memory(request["memory"])
        params, trees = request["params"], [serialize.load(i) for i in inputs]
        for key in ("want", "gaits"):
            if key in params:
                params[key] = tuple(params[key])
        line = serialize.dump(params.get("line"))
        if "line" in params and request["packing"] and line not in warm:
            # The time to load compiled code does not count for the first point.
            _try(function, {**params, "slope": params["slope"][:0]}, trees)
            warm.add(line)
        if "lines" in params and request["packing"]:
            function = functools.partial(_side_by_side, function)
        send(answers, b"started", struct.pack("<QQ", _pages(1), threads))
        outcome, result = _try(function, params, trees)
        if outcome == b"ok":
            try:
                parts = _packed(request, result)
            except Exception as error:
                outcome, parts = b"raised", [_sentence(error).encode()]
        else:
            parts = [result.encode()]
        before, used = used, (time.process_time(), _integrating())
        send(
            answers, outcome, struct.pack("<2d", *(now - then for now, then in zip(used, before, strict=True))), *parts
        )


def _integrating() -> float:
    """Processor time that this process has spent in compiled integrators [s]."""
    return float(resolve(CLOCK)()) if CLOCK.partition(":")[0] in sys.modules else 0.0


def _limit_memory(growth: int) -> None:
    """Limit the growth of this process [byte]; the parent, which samples its memory, ends it well before."""
    _, hard = resource.getrlimit(resource.RLIMIT_DATA)
    limit = _pages(5) + growth + _SLACK
    resource.setrlimit(resource.RLIMIT_DATA, (limit if hard == resource.RLIM_INFINITY else min(limit, hard), hard))


def _pages(field: int) -> int:
    """Memory of this process [byte]: field 1 of `/proc/self/statm` is resident memory, 5 is data."""
    with open("/proc/self/statm") as file:
        return int(file.read().split()[field]) * resource.getpagesize()


def _limit_to_one_thread() -> int:
    """Limit every numerical library of this process to one thread; returns the largest number still in use."""
    import threadpoolctl

    threadpoolctl.threadpool_limits(1)
    return max((pool["num_threads"] for pool in threadpoolctl.threadpool_info()), default=1)


def _try(function: Callable[..., Any], params: dict[str, Any], inputs: list[Any]) -> tuple[bytes, Any]:
    try:
        return b"ok", function(params, inputs)
    except MemoryError:
        return b"out_of_memory", ""
    except BaseException as error:  # sys.exit and KeyboardInterrupt too: no task ends the worker
        return b"raised", _sentence(error)


def _sentence(error: BaseException) -> str:
    """Message of an exception on one line without a full stop, the same in every process."""
    try:
        text = " ".join(str(error).split())
    except Exception:
        text = ""
    text = re.sub(r"0x[0-9a-f]{6,}", "0x...", text)[:300].removesuffix(".")
    return f"{type(error).__name__}: {text}" if text else type(error).__name__


def _packed(request: dict[str, Any], result: Any) -> list[bytes]:
    """Pack the result of a request: head and payload of points, and the atlases of their lines."""
    from pipeline import serialize

    packing, params = request["packing"], request["params"]
    if not packing:
        return [serialize.dump(result)]
    from pipeline.grid.grid import Shape
    from pipeline.store.record import pack

    points, atlases = result if "lines" in params else (_points(params, result, len(params["slope"])), [])
    record = pack(points, Shape.of(*packing["shape"]), packing["multipliers"], params["gaits"], packing.get("digests"))
    return [*record, *(serialize.dump(atlas) for atlas in atlases if params["atlases"])]


def _points(params: dict[str, Any], result: dict[str, Any], n: int) -> Any:
    from pipeline.store.record import Points

    return Points.of_result(result, params["want"], n)


def _side_by_side(function: Callable[..., Any], params: dict[str, Any], inputs: list[Any]) -> Any:
    """Points of lines, and the atlas of each; those of a plane are computed cell by cell."""
    import numpy as np

    from pipeline.store.record import joined

    cells: dict[int, list[int]] = {}
    for k, line in enumerate(params["lines"]):
        cells.setdefault(line.get("cell", 0), []).append(k)
    parts, n = [], len(params["slope"])
    atlases: list[dict[str, Any]] = [{}] * len(params["lines"])
    for cell, places in cells.items():
        lines = [{key: params["lines"][k][key] for key in ("walker", "set")} for k in places]
        own = {"cell": params["cells"][cell]} if "cells" in params else {}
        pairs = function({**params, "lines": lines, **own}, inputs)
        parts += [_points(params, points, len(points["status"])) for _, points in pairs]
        for k, (atlas, _) in zip(places, pairs, strict=False):
            atlases[k] = atlas
    order = np.argsort(np.concatenate(list(cells.values())))
    points = joined(parts)
    if len(points) != n * len(order):
        raise ValueError(f"{len(points)} points are returned of {len(order)} lines of {n}")
    return points.take(order, n), atlases


if __name__ == "__main__":
    serve(int(sys.argv[1]))
