"""What is shown of a run: one bar for all studies of a command, on a terminal or in a
notebook; elsewhere a line now and then.
"""

import threading
import time
from typing import Any

from gaitsweep.pipeline import terminal
from gaitsweep.pipeline.engine.progress import Progress, sentence, total

#: Intervals of states in the event logs, of lines in a file, and of the bar [s].
_LOG, _LINE, _BAR = 5.0, 60.0, 0.5
#: Of the bar; what is left and how fast stand in the sentence behind it.
_FORMAT = "{percentage:3.0f}%|{bar:20}| {elapsed}{postfix}"
#: Of a terminal: one may not know its size.
_ROWS = 20


class Display:
    """Shows the progress of all studies of a command, and logs their states.

    Parameters
    ----------
    points : list of int
        Points of each study.
    quiet : bool
    """

    def __init__(self, points: list[int], quiet: bool):
        self.number, self.points, self.quiet = len(points), sum(points), quiet
        self.open: list[Progress] = []
        #: Number of studies that are over, and their states together.
        self.over, self.past = 0, total([])
        self.start, self.lock = time.monotonic(), threading.Lock()
        self.bar = None if quiet else _bar()
        self.stopped = threading.Event()
        self.thread = threading.Thread(target=self._tick, daemon=True)

    def __enter__(self) -> "Display":
        self.thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.stopped.set()
        self.thread.join()
        if self.bar is not None:
            self._show()
            self.bar.close()

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
            state = total([self.past, *now])
            if self.number == 1:
                return self._counted_down(state)

            elapsed = time.monotonic() - self.start
            state["studies"] = f"{self.over:,} of {self.number:,}"
            state["rate"] = state["done"] / elapsed
            waiting = self.number - self.over - len(now)
            if waiting:
                eta = state["eta"] + waiting * self._seconds_of_one(state, len(now))
                state |= {"points": self.points, "eta": eta, "overdue": False}

            return self._counted_down(state)

    def _latest(self) -> float:
        """When the latest result of the studies came; now where none is open."""
        return max((study.changed for study in self.open), default=time.monotonic())

    def _counted_down(self, state: dict[str, Any]) -> dict[str, Any]:
        """A state whose time to go falls while jobs run, too: it was estimated when a
        result came last.
        """
        left = state["eta"] - (time.monotonic() - self._latest())
        is_late = left < 0 < state["eta"]

        overdue = state["overdue"] or is_late
        return {**state, "eta": max(0.0, left), "overdue": overdue}

    def _seconds_of_one(self, state: dict[str, Any], running: int) -> float:
        """Seconds that a study which waits will take: those that are over took the time
        until now; before any is, it is as those that run.
        """
        if self.over > running:
            return (self._latest() - self.start) / self.over
        return float(state["eta"]) / max(1, running)

    def _tick(self) -> None:
        last_log = last_shown = time.monotonic()  # the time of day may be set back
        interval = _LINE if self.bar is None else _BAR
        while not self.stopped.wait(_BAR):
            clock = time.monotonic()
            if not self.open:
                continue

            if clock - last_log >= _LOG:
                last_log = clock
                for study in list(self.open):
                    study.log_state()

            if not self.quiet and clock - last_shown >= interval:
                last_shown = clock
                self._show()

    def _show(self) -> None:
        """Show the state: on the bar, or in a line of its own."""
        state = self._state()
        if self.bar is None:
            terminal.say(sentence(state))
            return

        stages = state["stages"].values()
        done = state["cached"] + sum(stage["done"] for stage in stages)
        left = sum(max(0, stage["todo"] - stage["done"]) for stage in stages)
        self.bar.total, self.bar.n = done + left, done
        self.bar.ncols = terminal.columns() - 1
        self.bar.set_postfix_str(sentence(state))


def _bar() -> Any:
    """A bar of tqdm; None where there is neither a terminal nor a notebook."""
    if not terminal.is_terminal() and not terminal.is_notebook():
        return None
    from tqdm.auto import tqdm

    leave = not terminal.is_terminal()
    return tqdm(bar_format=_FORMAT, leave=leave, total=1, nrows=_ROWS)
