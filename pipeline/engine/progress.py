"""Progress of a run: a line on the terminal, an event log beside the journal, and
`status`, which reads it.

Progress only listens; nothing waits for it.
"""

import contextlib
import json
import sys
import threading
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from gaitsweep.pipeline import terminal
from gaitsweep.pipeline.engine import worker_process
from gaitsweep.pipeline.engine.executors import Engine
from gaitsweep.pipeline.errors import unread
from gaitsweep.pipeline.graph.plan import Plan, Summary
from gaitsweep.pipeline.grid import costs
from gaitsweep.pipeline.grid.method import Method
from gaitsweep.pipeline.outcomes import ANSWERS
from gaitsweep.pipeline.study.model import Study

_CLEAR = "\r\033[K"  # clears the line of a terminal
_SUMMED = ("points", "cached", "done", "todo", "rate", "eta")
_LOG, _SLOW, _FAST = (
    5.0,
    60.0,
    0.5,
)  # intervals of states in the log, of lines without a terminal, and with one [s]


class Progress:
    """Counts events of one study, writes them to `FILE.events.jsonl` and, unless
    `quiet`, shows some on stderr.
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
        self.start = time.monotonic()
        self.todo = {name: sum(why.values()) for name, why in todo.todo.items()}
        self.costs = {
            name: plan.graph.seconds(name) for name, n in self.todo.items() if n
        }
        self.lines_alone: _LinesAlone | None = None
        if plan.graph.method is Method.PLANE and plan.study.plane:
            self.lines_alone = _LinesAlone(plan.study, plan.study.plane.lines // 2)
        self.total, self.cached = (
            plan.study.points if "points" in self.todo else 0,
            todo.cached.get("points", 0),
        )
        self.remote_workers: dict[tuple[str, int], tuple[float, dict[str, Any]]] = {}
        self.done: Counter[str] = Counter()
        self.seconds: Counter[str] = Counter()
        self.counts: Counter[str] = Counter()
        self.measured: dict[
            int, np.ndarray
        ] = {}  # points and seconds by the first slope of their chunks
        self.file = open(log, "a", encoding="utf-8")  # noqa: SIM115 - open as long as the run
        self.lock = threading.Lock()

    def begin(self) -> None:
        """Write the first events."""
        self(
            "begin",
            {
                "study": self.plan.study.name,
                "points": self.total,
                "cached": self.cached,
            },
        )
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

    def __call__(self, event: str, details: dict[str, Any]) -> None:
        """Record an event."""
        worker = details.pop("worker", None)
        if worker and self.engine.address:
            self.remote_workers[worker["host"], worker["pid"]] = (
                time.monotonic(),
                worker,
            )
        if event in ("chunk", "task") and "seconds" in details:
            n = details.get("points", details.get("charted", 1))
            self.done[details["task"]] += n
            self.seconds[details["task"]] += details["seconds"]
            if self.lines_alone:
                self.lines_alone.add(details)
            if event == "chunk":
                self.done["atlas"] += details.get("alone", details.get("lines", 0))
                place = details.pop("place")
                self.measured[place] = self.measured.get(place, np.zeros(2)) + np.array(
                    [n, details["seconds"]]
                )
            self.counts.update(details.get("counts", {}))
            if details.get("lost"):
                self.done["points"] += details["lost"]
                self.counts[details["outcome"]] += details["lost"]
        self._log(event, details)
        if event == "engine":
            self.say(f"engine: {', '.join(details.values())}")
        elif self.verbose:
            shown = (
                f"{key} {_format(value)}"
                for key, value in details.items()
                if value not in ("", 0, None)
            )
            self.say(f"{event}: " + ", ".join(shown))

    def say(self, text: str) -> None:
        """Print a line on stderr."""
        if not self.quiet:
            terminal.say((_CLEAR if terminal.is_terminal() else "") + text)

    def state(self) -> dict[str, Any]:
        """State of the run: counts, rate [1/s], remaining time `eta` [s] or `overdue`,
        memory [byte] and workers.
        """
        elapsed, stages = time.monotonic() - self.start, self._stages()
        # On a cluster, those that answered in the last minute.
        remote = [
            worker
            for when, worker in list(self.remote_workers.values())
            if time.monotonic() - when < _SLOW
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
            "eta": round(sum(stage["eta"] for stage in stages.values()), 1),
            # Nothing is measured yet, and the plan's estimate has passed.
            "overdue": not any(self.done.values())
            and elapsed > sum(stage["eta"] for stage in stages.values()) > 0,
            "memory": worker_process.resident("self"),
            "workers": worker_process.members() or remote,
        }

    def _stages(self) -> dict[str, dict[str, float]]:
        """Progress of each task, and its remaining time on all workers [s]."""
        stages = {}
        for name, cost in self.costs.items():
            done, todo = self.done[name], self.todo[name]
            if self.lines_alone and name == "atlas":
                todo = self.lines_alone.expected(todo)
            if self.lines_alone and name in ("points", "atlas"):
                mean_seconds = self.lines_alone.seconds(name)
            elif name == "points" and self.measured:
                mean_seconds = self._seconds_of_a_point()
            else:
                # How many count as measured at their planned cost: the first charts may
                # be unlike the others.
                expected = (
                    self.lines_alone.half
                    if self.lines_alone and name == "charts"
                    else int(not done)
                )
                mean_seconds = (self.seconds[name] + expected * cost) / (
                    done + expected
                )
            seconds_left = mean_seconds * max(0, todo - done)
            stages[name] = {
                "done": round(done),
                "todo": todo,
                "eta": round(seconds_left / self.engine.jobs, 1),
            }
        return stages

    def _seconds_of_a_point(self) -> float:
        """Mean time of the points that are left [s]; near slopes where none was
        measured, as at those beside them.
        """
        grid, slopes = self.plan.graph.grid, len(self.plan.study.slope)
        starts = np.arange(0, slopes, grid.extent[list(grid.sizes).index("slope")])
        places = sorted(self.measured)
        points, seconds = np.array([self.measured[k] for k in places]).T
        left = np.diff(starts, append=slopes) * self.plan.study.lines
        left[np.isin(starts, places)] -= points.astype(int)
        weights = np.maximum(left, 0) if (left > 0).any() else np.ones(len(starts))
        # By its logarithm: a peak is narrow, and towards vanishing slopes times grow by
        # powers.
        time_of_each = np.exp(
            np.interp(starts, places, np.log(np.maximum(seconds, 1e-9) / points))
        )
        return float(np.average(time_of_each, weights=weights))

    def _log(self, event: str, details: dict[str, Any]) -> None:
        # On a full disk the run goes on as long as its results find room.
        with self.lock, contextlib.suppress(OSError):
            if self.file.closed:
                return
            self.file.write(
                json.dumps({"time": round(time.time(), 3), "event": event, **details})
                + "\n"
            )
            self.file.flush()


class _LinesAlone:
    """What is known of the lines that charts leave alone: how many they are, and their
    time beside that of points.

    Parameters
    ----------
    study : Study
    half : int
        Lines that count as seen, a usual share of them alone.
    """

    def __init__(self, study: Study, half: int):
        self.half = half
        self.charted, self.computed = (
            np.zeros(2),
            np.zeros(2),
        )  # lines, and how many of them are alone
        # Least squares over chunks for the times of a point and of a line alone, which
        # begin with one of each.
        planned = np.array(
            [costs.of_point(study, Method.PLANE), costs.of_line_alone(study)]
        )
        self.usual = costs.seconds(study, "atlas", Method.PLANE) / planned[1]
        weights = np.array([float(len(study.slope)), 1.0]) ** 2
        self.least, self.matrix, self.moment = (
            planned / 4,
            np.diag(weights),
            weights * planned,
        )

    def add(self, event: dict[str, Any]) -> None:
        """Add the event of a chunk, or of charts."""
        if "charted" in event:
            self.charted += event["charted"], event["alone"]
        elif "alone" in event:
            self.computed += event["lines"], event["alone"]
            of_each = np.array([event["points"], event["alone"]])
            self.matrix += np.outer(of_each, of_each)
            self.moment += of_each * event["seconds"]

    def expected(self, lines: int) -> int:
        """About how many of some lines are alone."""
        seen, alone = np.maximum(self.charted, self.computed)
        share = (self.usual * self.half + alone) / (self.half + seen)
        return min(lines, round(float(alone + share * max(0.0, lines - seen))))

    def seconds(self, name: str) -> float:
        """Mean time of a point, or of a line alone [s]."""
        points, lines = np.maximum(
            np.linalg.solve(self.matrix, self.moment), self.least
        ).tolist()
        return float(lines if name == "atlas" else points)


class Display:
    """Shows the progress of all studies of a command on one line, or in a notebook, and
    logs their states.

    Parameters
    ----------
    points : list of int
        Points of each study.
    quiet : bool
    """

    def __init__(self, points: list[int], quiet: bool):
        self.number, self.points, self.quiet = len(points), sum(points), quiet
        self.open: list[Progress] = []
        self.over, self.past = (
            0,
            total([]),
        )  # number of studies that are over, and their states together
        self.start, self.lock = time.monotonic(), threading.Lock()
        self.is_terminal = terminal.is_terminal()
        self.bar = None if quiet else notebook_bar()
        self.stopped = threading.Event()
        self.thread = threading.Thread(target=self._tick, daemon=True)

    def __enter__(self) -> "Display":
        self.thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.stopped.set()
        self.thread.join()
        if self.bar:
            self.bar(self._state())
        if self.is_terminal and not self.quiet:
            terminal.say(_CLEAR, end="")

    def begin(self, study: Progress) -> None:
        """Show a study."""
        with self.lock:
            self.open.append(study)

    def end(self, study: Progress, is_over: bool) -> None:
        """Count a study that is over; one that is not will begin again."""
        with self.lock:
            self.open.remove(study)
            if is_over:
                self.over += 1
                self.past = {**total([self.past, study.state()]), "eta": 0.0}

    def _state(self) -> dict[str, Any]:
        """State of all studies together, also of those that have not begun."""
        with self.lock:
            now = [study.state() for study in self.open]
            waiting = self.number - self.over - len(now)
            state = total([self.past, *now])
            if self.number == 1:
                return state

            elapsed = time.monotonic() - self.start
            state |= {
                "studies": f"{self.over:,} of {self.number:,}",
                "rate": state["done"] / elapsed,
            }
            if waiting:
                # Those that are over took the time until now; before any is, those that
                # wait are as those that run.
                each = (
                    elapsed / self.over
                    if self.over > len(now)
                    else state["eta"] / max(1, len(now))
                )
                state |= {
                    "points": self.points,
                    "eta": round(state["eta"] + each * waiting, 1),
                    "overdue": False,
                }
            return state

    def _tick(self) -> None:
        last_log = last_shown = time.monotonic()  # the time of day may be set back
        while not self.stopped.wait(_FAST):
            clock = time.monotonic()
            if not self.open:
                continue
            if clock - last_log >= _LOG:
                last_log = clock
                for study in list(self.open):
                    study.log_state()
            if not self.quiet and clock - last_shown >= (
                _FAST if self.is_terminal or self.bar else _SLOW
            ):
                last_shown = clock
                state = self._state()
                if self.bar:
                    self.bar(state)
                elif (
                    self.is_terminal
                ):  # of a line that wraps, only the last part would be cleared
                    terminal.say(
                        f"{_CLEAR}{sentence(state)[: terminal.columns() - 1]}", end=""
                    )
                else:
                    terminal.say(sentence(state))


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


def notebook_bar() -> Callable[[dict[str, Any]], None] | None:
    """Show a bar under the cell of a notebook; returns its update by a state, None
    outside notebooks.
    """
    shell = sys.modules["IPython"].get_ipython() if "IPython" in sys.modules else None
    if not hasattr(shell, "kernel"):
        return None
    from IPython.display import display

    def content(state: dict[str, Any]) -> dict[str, str]:
        done, todo = (
            sum(stage[k] for stage in state["stages"].values())
            for k in ("done", "todo")
        )
        part = (
            min(1.0, (state["cached"] + done) / (state["cached"] + todo or 1))
            if todo
            else 1.0
        )
        text = sentence(state)
        return {
            "text/plain": text,
            "text/html": f'<progress value="{part:.4f}" max="1"></progress> {text}',
        }

    empty = {"text/plain": "", "text/html": '<progress max="1"></progress>'}
    handle = display(empty, raw=True, display_id=True)
    return lambda state: handle.update(content(state), raw=True)


def _format(value: Any) -> str:
    if isinstance(value, dict):
        return " ".join(f"{k} {v}" for k, v in value.items())
    return f"{value:.3g}" if isinstance(value, float) else str(value)


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
        f"{name} {stage['done']:,} of {stage['todo']:,}"
        for name, stage in state["stages"].items()
        if name != "points"
    ]
    parts += [f"{name} {n:,}" for name, n in sorted(failed.items())]
    parts.append(
        "longer than planned"
        if state.get("overdue")
        else f"{terminal.duration(state['eta'])} to go"
    )
    return ", ".join(parts)


def last_state(log: Path) -> dict[str, Any] | None:
    """Last state in an event log, with `over` if the run ended; None if there is none.

    Raises
    ------
    ArchiveError
        If the log cannot be read.
    """
    state = None
    try:
        if not log.is_file():  # another one might be waited for
            return None
        with open(log, encoding="utf-8", errors="replace") as file:
            for line in file:
                with contextlib.suppress(ValueError, KeyError, TypeError):
                    # Thousands of other events a second may lie between two states.
                    if '"event": "state"' in line:
                        state = {**json.loads(line), "over": False}
                    elif '"event": "end"' in line and state:
                        state["over"] = True
    except OSError as error:
        raise unread(log, error) from error
    return state
