"""Program of a worker process: it reads requests from standard input and answers on standard output.

Started as `python -m pipeline.execution.worker_main PARENT` by `pipeline.execution.worker_process`.
"""

from __future__ import annotations

import ctypes
import os
import re
import resource
import signal
import struct
import sys
import time
from collections.abc import Callable
from typing import Any

from pipeline.dispatch import resolve
from pipeline.execution.wire import receive, send
from tasks.registry import CLOCK, STATUSES, VARIABLES

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
    requests, answers = os.fdopen(os.dup(0), "rb"), os.fdopen(os.dup(1), "wb")
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
        if request["divided"] == "slope" and line not in warm:
            # The time to load compiled code does not count for the first point.
            _try(function, {**params, "slope": params["slope"][:0]}, trees)
            warm.add(line)
        send(answers, b"started", struct.pack("<QQ", _pages(1), threads))
        outcome, result = _try(function, params, trees)
        if outcome == b"ok":
            try:
                parts = _parts(request, result)
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


def _parts(request: dict[str, Any], result: Any) -> list[bytes]:
    """Pack the result of a request."""
    from pipeline import serialize

    params = request["params"]
    if request["divided"] == "lines":
        atlases = [serialize.dump(atlas) for atlas, _ in result] if params["atlases"] else []
        return [*_rows(params, _join([row for _, row in result])), *atlases]
    if request["chunk"]:
        return _chunks(params, result, *request["chunk"])
    return _rows(params, result) if request["divided"] else [serialize.dump(result)]


def _rows(params: dict[str, Any], result: dict[str, Any]) -> list[bytes]:
    """Pack a block of points for the journal: states, then variables, without trailing gaits that do not exist."""
    import numpy as np

    from pipeline import serialize

    digests = {"lines": np.asarray(params["digests"])} if "digests" in params else {}
    columns = _columns(params, result, len(params["slope"]) * len(params.get("lines", "1")))
    reason, sentences = _sentences(result["reason"], result["reasons"])
    status = columns.pop("status")
    states = {"status": status, "reason": reason, "reasons": np.array(sentences, "U"), **digests}
    return [serialize.dump(states), serialize.dump(_without_empty(status, columns))]


def _chunks(params: dict[str, Any], result: dict[str, Any], extent: int, multipliers: int) -> list[bytes]:
    """Finish chunks of points: head and payload of each."""
    import numpy as np

    from pipeline.store.finished import finish

    slopes, parts = np.asarray(params["slope"]), list[bytes]()
    columns = _columns(params, result, len(slopes))
    for k in range(0, len(slopes), extent):
        chunk = {name: a[k : k + extent] for name, a in columns.items()}
        status = chunk.pop("status")
        reason, sentences = _sentences(result["reason"][k : k + extent], result["reasons"])
        values = {"status": status, "reason": reason, **_without_empty(status, chunk)}
        parts += finish(slopes[k : k + extent], values, sentences, extent, multipliers)
    return parts


def _columns(params: dict[str, Any], result: dict[str, Any], n: int) -> dict[str, Any]:
    """Variables of `n` points but the reason, each of its own type."""
    import numpy as np

    names = [name for name in params["want"] if name not in ("status", "reason")]
    columns = {name: np.asarray(result[name], VARIABLES[name].dtype) for name in ("status", *names)}
    for name, a in columns.items():
        if a.shape[:2] != columns["status"].shape or len(a) != n:
            raise ValueError(f"`{name}` has shape {a.shape} for {n} points")
    return columns


def _sentences(reason: Any, sentences: Any) -> tuple[Any, list[str]]:
    """Reasons renumbered over the sentences that occur, and these."""
    import numpy as np

    if not len(sentences):
        return np.zeros(np.shape(reason), np.int16), []
    occurs = np.bincount(np.ravel(reason), minlength=len(sentences)) > 0
    numbers = (np.cumsum(occurs) - 1).astype(np.int16)
    return numbers[reason], [str(sentences[k]) for k in np.flatnonzero(occurs)]


def _without_empty(status: Any, columns: dict[str, Any]) -> dict[str, Any]:
    """Variables without trailing gaits that do not exist."""
    import numpy as np

    def is_empty(g: int) -> bool:
        return bool(np.all(status[:, g] == STATUSES["no_gait"])) and all(
            np.array_equal(a[:, g], np.full_like(a[:, g], VARIABLES[name].absent), equal_nan=a.dtype.kind == "f")
            for name, a in columns.items()
        )

    n_gaits = status.shape[1]
    while n_gaits and is_empty(n_gaits - 1):
        n_gaits -= 1
    return {name: a[:, :n_gaits] for name, a in columns.items()}


def _join(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Join the points of lines, with one table of sentences; multipliers are as many as the widest has."""
    import numpy as np

    sentences: dict[str, int] = {}
    tables = [np.array([sentences.setdefault(str(s), len(sentences)) for s in row["reasons"]] or [0]) for row in rows]
    reason = [table[row["reason"]] for table, row in zip(tables, rows, strict=True)]
    joined = {"reasons": list(sentences), "reason": np.concatenate(reason)}
    for name in set(rows[0]) - set(joined):
        parts = [np.asarray(row[name]) for row in rows]
        width = max(part.shape[2:] for part in parts)
        wide = [np.full((*part.shape[:2], *width), VARIABLES[name].absent, part.dtype) for part in parts]
        for whole, part in zip(wide, parts, strict=True):
            whole[tuple(map(slice, part.shape))] = part
        joined[name] = np.concatenate(wide)
    return joined


if __name__ == "__main__":
    serve(int(sys.argv[1]))
