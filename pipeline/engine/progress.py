"""Progress of a study: its state, an event log beside the journal, and `status`, which
reads it.

Progress only listens; nothing waits for it.
"""

import contextlib
import json
import threading
import time
from collections import Counter, defaultdict
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from gaitsweep.pipeline import terminal
from gaitsweep.pipeline.engine import worker_process
from gaitsweep.pipeline.engine.engine import Engine
from gaitsweep.pipeline.engine.listener import Finished, Listener
from gaitsweep.pipeline.errors import unread
from gaitsweep.pipeline.graph.graph import Node
from gaitsweep.pipeline.graph.plan import Plan, Summary
from gaitsweep.pipeline.outcomes import ANSWERS

_CLEAR = "\r\033[K"  # clears the line of a terminal
_SUMMED = ("points", "cached", "done", "todo", "rate", "eta")
#: Time for which a remote worker that answered counts as there [s].
_ANSWERED = 60.0
#: What users read of tasks that no study names.
_STAGES = {"atlas": "searches"}


class Progress(Listener):
    """Counts the nodes of one study, writes what becomes of them to `FILE.events.jsonl`
    and, unless `quiet`, shows some on stderr.
    """

    def __init__(
        self,
        plan: Plan,
        todo: Summary,
        log: Path,
        engine: Engine,
        quiet: bool,
        verbose: bool = False,
    ):
        self.plan, self.engine, self.quiet, self.verbose = plan, engine, quiet, verbose
        self.start = self.changed = time.monotonic()  # and when a result came last
        self.todo = {name: sum(why.values()) for name, why in todo.todo.items()}
        self.costs = {
            name: plan.graph.seconds(name) for name, n in self.todo.items() if n
        }
        self.total = plan.study.points if "points" in self.todo else 0
        self.cached = todo.cached.get("points", 0)
        self.remote_workers: dict[tuple[str, int], tuple[float, Mapping[str, Any]]] = {}
        self.done: Counter[str] = Counter()
        self.seconds: dict[str, float] = defaultdict(float)
        self.counts: Counter[str] = Counter()
        self.file = open(log, "a", encoding="utf-8")  # noqa: SIM115 - open as long as the run
        self.lock = threading.Lock()

    def begin(self) -> None:
        """Write the first events."""
        study = {"study": self.plan.study.name}
        self._tell("begin", {**study, "points": self.total, "cached": self.cached})
        self.log_state()

    def close(self, is_over: bool) -> None:
        """Write the last state, and whether the study is finished."""
        self.log_state()
        if is_over:
            self._log("end", {})
        with self.lock, contextlib.suppress(OSError):
            self.file.close()

    def log_state(self) -> None:
        """Write the state to the event log."""
        self._log("state", self.state())

    def finished(self, done: Finished) -> None:
        """Count a node whose result is stored."""
        node = done.node
        self.changed = time.monotonic()
        if done.worker and self.engine.address:
            member = done.worker["host"], done.worker["pid"]
            self.remote_workers[member] = time.monotonic(), done.worker

        self.done[node.task] += done.size
        self.done["atlas"] += node.lines
        self.seconds[node.task] += done.seconds
        self.counts.update(done.counts)

        said: dict[str, Any] = {
            "task": node.task,
            "line": node.line,
            "seconds": done.seconds,
        }
        if node.chunk:
            said["line"] = node.chunk.line
            more: dict[str, Any] = {"lines": node.lines, "points": node.points}
            self._tell(
                "chunk", {**said, "pid": done.pid, **more, "counts": done.counts}
            )
            return

        more = {"outcome": done.status, "reason": done.reason}
        if node.task == "charts":
            more["charted"] = done.size
        self._tell("task", {**said, "pid": done.pid, **more})

    def dropped(self, node: Node, status: str) -> None:
        """Count a node that is not computed."""
        if node.points:
            self.done["points"] += node.points
            self.counts[status] += node.points
        lost = {"task": node.task, "outcome": status, "lost": node.points}
        self._tell("task", lost)

    def said(self, kind: str, sentence: str) -> None:
        """Show what concerns the workers."""
        self._log("engine", {kind: sentence})
        self.say(f"engine: {sentence}")

    def say(self, text: str) -> None:
        """Print a line on stderr."""
        if not self.quiet:
            terminal.say((_CLEAR if terminal.is_terminal() else "") + text)

    def state(self) -> dict[str, Any]:
        """State of the run: counts, rate [1/s], remaining time `eta` [s] or `overdue`,
        memory [byte] and workers.
        """
        elapsed, stages = time.monotonic() - self.start, self._stages()
        eta = sum(stage["eta"] for stage in stages.values())
        # On a cluster, those that answered in the last minute.
        remote = [
            worker
            for when, worker in list(self.remote_workers.values())
            if time.monotonic() - when < _ANSWERED
        ]

        return {
            "elapsed": round(elapsed, 1),
            "points": self.total,
            "cached": self.cached,
            "done": self.done["points"],
            "todo": self.todo.get("points", 0),
            "tasks": dict(self.done),
            "counts": dict(self.counts),
            "stages": stages,
            "rate": round(self.done["points"] / elapsed, 1) if elapsed > 0 else 0.0,
            "eta": round(eta, 1),
            # Nothing is measured yet, and the plan's estimate has passed.
            "overdue": not any(self.done.values()) and elapsed > eta > 0,
            "memory": worker_process.resident("self"),
            "workers": worker_process.members() or remote,
        }

    def _stages(self) -> dict[str, dict[str, float]]:
        """Progress of each task, and its remaining time on all workers [s]: what is
        left takes as long as what was measured, before that as was planned.

        Nodes sample a study evenly. Of charts, of which the first may be unlike the
        others, half count as measured at their planned cost.
        """
        stages = {}
        for name, cost in self.costs.items():
            done, todo = self.done[name], self.todo[name]
            planned = todo / 2 if name == "charts" else int(not done)
            mean = (self.seconds[name] + planned * cost) / (done + planned)
            number = max(0, todo - done)
            # Of few, which are no longer divided among workers, some wait.
            left = mean * number / min(self.engine.jobs, max(1, number))
            stages[name] = {"done": round(done), "todo": todo, "eta": round(left, 1)}

        return stages

    def _tell(self, event: str, details: dict[str, Any]) -> None:
        """Log an event, and show it if all are to be shown."""
        self._log(event, details)
        if self.verbose:
            shown = (
                f"{key} {_format(value)}"
                for key, value in details.items()
                if value not in ("", 0, None)
            )
            self.say(f"{event}: " + ", ".join(shown))

    def _log(self, event: str, details: dict[str, Any]) -> None:
        entry = {"time": round(time.time(), 3), "event": event, **details}
        # On a full disk the run goes on as long as its results find room.
        with self.lock, contextlib.suppress(OSError):
            if self.file.closed:
                return
            self.file.write(json.dumps(entry) + "\n")
            self.file.flush()


def total(states: list[dict[str, Any]]) -> dict[str, Any]:
    """State of several studies together, as `sentence` reads it."""
    summed = {key: sum(state[key] for state in states) for key in _SUMMED}
    counts = sum((Counter(state["counts"]) for state in states), Counter())
    stages: dict[str, Counter[str]] = {}
    for state in states:
        for name, stage in state["stages"].items():
            stages.setdefault(name, Counter()).update(stage)

    return {
        **summed,
        "counts": counts,
        "stages": stages,
        "overdue": all(state["overdue"] for state in states),
    }


def _format(value: Any) -> str:
    if isinstance(value, dict):
        return " ".join(f"{k} {v}" for k, v in value.items())
    return f"{value:.3g}" if isinstance(value, float) else str(value)


def stages(state: dict[str, Any]) -> list[tuple[str, int, int, float]]:
    """Name of each stage of a run as users read it, how many of how many are done, and
    the time to go [s]; none where its record is of another version.
    """
    found = []
    try:
        for name, stage in state["stages"].items():
            done, todo = int(stage["done"]), int(stage["todo"])
            found.append((_STAGES.get(name, name), done, todo, float(stage["eta"])))
    except (LookupError, TypeError, ValueError, AttributeError):
        return []

    return found


def sentence(state: dict[str, Any]) -> str:
    """State of a run in one line."""
    failed = {k: n for k, n in state["counts"].items() if k not in ANSWERS}
    parts = [f"studies {state['studies']}"] if "studies" in state else []
    if state["points"]:
        done = state["cached"] + state["done"]
        parts.append(
            f"{done:,} of {state['points']:,} points ({100 * done / state['points']:.0f} %)"
        )
        parts.append(f"{state['rate']:,.0f} a second")

    parts += [
        f"{_STAGES.get(name, name)} {stage['done']:,} of {stage['todo']:,}"
        for name, stage in state["stages"].items()
        if name != "points"
    ]
    parts += [f"{name} {n:,}" for name, n in sorted(failed.items())]
    if state.get("overdue"):
        parts.append("longer than planned")
    else:
        parts.append(f"{terminal.duration(state['eta'])} to go")

    return ", ".join(parts)


def last_state(log: Path) -> dict[str, Any] | None:
    """Last state in an event log, with when its run `began` [s since 1970] and whether
    it is `over`; None if there is none.

    Raises
    ------
    ArchiveError
        If the log cannot be read.
    """
    state = None
    began = 0.0
    try:
        if not log.is_file():  # another one might be waited for
            return None
        with open(log, encoding="utf-8", errors="replace") as file:
            for line in file:
                with contextlib.suppress(ValueError, KeyError, TypeError):
                    # Thousands of other events a second may lie between two states.
                    if '"event": "begin"' in line:
                        began = float(json.loads(line)["time"])
                    elif '"event": "state"' in line:
                        state = {**json.loads(line), "began": began, "over": False}
                    elif '"event": "end"' in line and state:
                        state["over"] = True
    except OSError as error:
        raise unread(log, error) from error

    return state
