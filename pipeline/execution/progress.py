"""Progress of a run: a line on the terminal, an event log beside the journal, and `status`, which reads it.

Progress only listens; nothing waits for it.
"""

from __future__ import annotations

import json
import sys
import threading
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, TextIO

from pipeline.execution import worker_process
from pipeline.plan import costs
from pipeline.plan.missing import Plan, Summary

if TYPE_CHECKING:
    from pipeline.execution.scheduler import Scheduler

_LOG, _SLOW, _FAST = 5.0, 60.0, 0.5  # intervals of states in the log, of lines without a terminal, and with one [s]


class Progress:
    """Counts events, writes them to `FILE.events.jsonl` and, unless `quiet`, shows progress on stderr."""

    def __init__(
        self,
        plan: Plan,
        todo: Summary,
        log: Path,
        quiet: bool = False,
        verbose: bool = False,
        stream: TextIO | None = None,
    ):
        self.plan, self.log, self.quiet, self.verbose = plan, log, quiet, verbose
        self.stream = stream or sys.stderr
        self.is_terminal = self.stream.isatty()
        self.bar = None if quiet else notebook_bar()
        self.start = self.last_log = self.last_shown = time.time()
        self.todo = {name: sum(why.values()) for name, why in todo.todo.items()}
        self.total, self.cached = plan.study.points if "points" in self.todo else 0, todo.cached.get("points", 0)
        self.cached_tasks = [name for name, n in todo.cached.items() if n]
        self.scheduler: Scheduler | None = None
        self.remote_workers: dict[tuple[str, int], tuple[float, dict[str, Any]]] = {}
        self.done: Counter[str] = Counter()
        self.seconds: Counter[str] = Counter()
        self.counts: Counter[str] = Counter()
        self.file = open(log, "a", encoding="utf-8")  # noqa: SIM115 - open as long as the run
        self.lock, self.stopped = threading.Lock(), threading.Event()
        self.thread = threading.Thread(target=self._tick, daemon=True)

    def __enter__(self) -> Progress:
        self("begin", {"study": self.plan.study.name, "points": self.total, "cached": self.cached})
        self._log("state", self.state())
        self.thread.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        self.stopped.set()
        self.thread.join()
        self._log("state", self.state())
        if kind is None:
            self._log("end", {})
        if self.bar:
            self.bar(self.state())
        if self.is_terminal and not self.quiet:
            self.stream.write("\r\033[K")
        self.file.close()

    def __call__(self, event: str, details: dict[str, Any]) -> None:
        """Record an event."""
        worker = details.pop("worker", None)
        if worker and self.scheduler and self.scheduler.engine.address:
            self.remote_workers[worker["host"], worker["pid"]] = time.time(), worker
        if event in ("chunk", "task") and "seconds" in details:
            n = details.get("points", 1)
            self.done[details["task"]] += n
            self.seconds[details["task"]] += details["seconds"]
            self.counts.update(details.get("counts", {}))
            if details.get("lost"):
                self.done["points"] += details["lost"]
                self.counts[details["outcome"]] += details["lost"]
        self._log(event, details)
        if self.verbose or event == "engine":
            shown = (f"{key} {_format(value)}" for key, value in details.items() if value not in ("", 0, None))
            self.say(f"{event}: " + ", ".join(shown))

    def say(self, text: str) -> None:
        """Print a line on stderr."""
        if not self.quiet:
            self.stream.write(("\r\033[K" if self.is_terminal else "") + text + "\n")
            self.stream.flush()

    def state(self) -> dict[str, Any]:
        """State of the run: counts, rate [1/s], remaining time `eta` [s], memory [byte] and workers."""
        elapsed, stages = time.time() - self.start, self._stages()
        with open("/proc/self/statm") as file:
            memory = int(file.read().split()[1]) * 4096
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
            "eta": round(sum(stage["eta"] for stage in stages.values()), 1),
            "memory": memory,
            "workers": worker_process.members() or self._recent_remote_workers(),
        }

    def _recent_remote_workers(self) -> list[dict[str, Any]]:
        """Workers of other processes that answered in the last minute."""
        return [worker for when, worker in list(self.remote_workers.values()) if time.time() - when < _SLOW]

    def _stages(self) -> dict[str, dict[str, float]]:
        """Progress of each task, and its remaining time on all workers [s]."""
        at_once, stages = self.scheduler.engine.jobs if self.scheduler else 1, {}
        for name, count in self.todo.items():
            done = self.done[name]
            if name == "points":
                seconds_left = self.scheduler.costs.seconds_left() if self.scheduler else 0.0
            else:
                mean_seconds = self.seconds[name] / done if done else costs.seconds(self.plan.study, name)
                seconds_left = mean_seconds * max(0, count - done)
            if count:
                stages[name] = {"done": done, "todo": count, "eta": round(seconds_left / at_once, 1)}
        return stages

    def _log(self, event: str, details: dict[str, Any]) -> None:
        with self.lock:
            self.file.write(json.dumps({"time": round(time.time(), 3), "event": event, **details}) + "\n")
            self.file.flush()

    def _tick(self) -> None:
        while not self.stopped.wait(_FAST):
            clock = time.time()
            if clock - self.last_log >= _LOG:
                self.last_log = clock
                self._log("state", self.state())
            if not self.quiet and clock - self.last_shown >= (_FAST if self.is_terminal or self.bar else _SLOW):
                self.last_shown = clock
                state = self.state()
                if self.bar:
                    self.bar(state)
                    continue
                text = sentence(state)
                self.stream.write(f"\r\033[K{text[:118]}" if self.is_terminal else text + "\n")
                self.stream.flush()


def notebook_bar() -> Callable[[dict[str, Any]], None] | None:
    """Show a bar under the cell of a notebook; returns its update by a state, None outside notebooks."""
    shell = sys.modules["IPython"].get_ipython() if "IPython" in sys.modules else None
    if not hasattr(shell, "kernel"):
        return None
    from IPython.display import display

    def content(state: dict[str, Any]) -> dict[str, str]:
        done, todo = (sum(stage[k] for stage in state["stages"].values()) for k in ("done", "todo"))
        part = min(1.0, (state["cached"] + done) / (state["cached"] + todo or 1)) if todo else 1.0
        text = sentence(state)
        return {"text/plain": text, "text/html": f'<progress value="{part:.4f}" max="1"></progress> {text}'}

    empty = {"text/plain": "", "text/html": '<progress max="1"></progress>'}
    handle = display(empty, raw=True, display_id=True)
    return lambda state: handle.update(content(state), raw=True)


def _format(value: Any) -> str:
    if isinstance(value, dict):
        return " ".join(f"{k} {v}" for k, v in value.items())
    return f"{value:.3g}" if isinstance(value, float) else str(value)


def sentence(state: dict[str, Any]) -> str:
    """State of a run in one line."""
    failed = {k: n for k, n in state["counts"].items() if k not in ("converged", "no_gait", "fell")}
    parts = []
    if state["points"]:
        done = state["cached"] + state["done"]
        parts.append(f"{done:,} of {state['points']:,} points ({100 * done / state['points']:.0f} %)")
        parts.append(f"{state['rate']:,.0f} a second")
    parts += [
        f"{name} {stage['done']:,} of {stage['todo']:,}" for name, stage in state["stages"].items() if name != "points"
    ]
    parts += [f"{name} {n:,}" for name, n in sorted(failed.items())]
    parts.append(f"{duration(state['eta'])} to go")
    return ", ".join(parts)


def duration(seconds: float) -> str:
    """Format a time, given in seconds."""
    if seconds < 120:
        return f"{seconds:.3g} s"
    if seconds < 7200:
        return f"{seconds / 60:.3g} min"
    return f"{seconds / 3600:.3g} h"


def last_state(log: Path) -> dict[str, Any] | None:
    """Last state in an event log, with `over` if the run ended; None if there is none."""
    try:
        with open(log, "rb") as file:
            file.seek(0, 2)
            file.seek(max(0, file.tell() - (1 << 18)))
            lines = file.read().splitlines()
    except OSError:
        return None
    state, is_over = None, False
    for line in lines:
        try:
            event = json.loads(line)
            if event["event"] == "state":
                state = event
            is_over = event["event"] == "end"
        except (ValueError, KeyError, TypeError):
            continue
    return {**state, "over": is_over} if state else None
