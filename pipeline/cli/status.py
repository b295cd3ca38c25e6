"""`gaitsweep status`: progress of the current or last run."""

import argparse
import contextlib
import os
import signal
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gaitsweep.pipeline import paths, terminal
from gaitsweep.pipeline.cli import kinds, studies
from gaitsweep.pipeline.cli.errors import gravest, say
from gaitsweep.pipeline.companions import Companions
from gaitsweep.pipeline.engine import locks
from gaitsweep.pipeline.engine.progress import last_state, sentence, stages
from gaitsweep.pipeline.errors import GaitsweepError
from gaitsweep.pipeline.terminal import PAUSE, counted, duration, processor_time

if TYPE_CHECKING:
    from gaitsweep.pipeline.report.progress_page import ProgressPage

#: Least interval at which a page is written, that of the states that runs log [s].
_EVERY = 5


def run(options: argparse.Namespace) -> int:
    """Print the state of every run; returns the gravest exit code."""
    archives, codes = studies.archives(options.names, options.debug)
    if options.page and (archives or not codes):
        keep_page(archives, options.page)
    records, lines = [], list[str]()
    for path in archives:
        try:
            state = state_of(path)
        except GaitsweepError as error:
            codes.append(say(error, options.debug))
            continue
        records.append({"archive": str(path), **(state or {})})
        lines += _lines(path, state)

    if records or not codes:
        nothing = "There is no record of a run in data/archive."
        kinds.show(options, records, lines or [nothing])

    return gravest(codes)


def keep_page(
    archives: Sequence[Path],
    page: Path,
    sleep: Callable[[float], object] = time.sleep,
) -> None:
    """Write the page of some runs, again and again until none is in flight.

    Runs know nothing of it. Once it has started, its processor time is about a
    hundredth of the time that passes, and it yields to everything else.

    Raises
    ------
    GaitsweepError
        If a log cannot be read, or the page cannot be written.
    """
    from gaitsweep.pipeline.report.progress_page import ProgressPage

    paths.check_page(page, "status")
    os.nice(10)
    drawn = ProgressPage()
    is_running = _is_running(archives)
    if is_running:
        terminal.say(f"{page} is kept until no run is in flight.")
    try:
        with _interrupted_by_any_signal():
            while is_running:
                drawn.update(archives)
                began = processor_time()
                _write_page(page, drawn, archives, _EVERY)
                sleep(max(_EVERY, PAUSE * (processor_time() - began)))
                is_running = _is_running(archives)
            drawn.update(archives, at_once=True)
    finally:
        _write_page(page, drawn, archives, 0)


def _is_running(archives: Sequence[Path]) -> bool:
    """Whether a run of some archives is in flight."""
    states = map(state_of, archives)
    return any(state["running"] for state in states if state)


@contextlib.contextmanager
def _interrupted_by_any_signal() -> Iterator[None]:
    """Let TERM and HUP end the program as INT does, if they are not ignored."""

    def interrupt(number: int, frame: object) -> None:
        raise KeyboardInterrupt

    handlers = {
        number: signal.signal(number, interrupt)
        for number in (signal.SIGTERM, signal.SIGHUP)
        if signal.getsignal(number) not in (signal.SIG_IGN, None)
    }
    try:
        yield
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)


def _write_page(
    page: Path, drawn: "ProgressPage", archives: Sequence[Path], refresh: int
) -> None:
    """Write the page of some runs once."""
    states = {path: state_of(path) for path in archives}
    said = {path: list(_lines(path, state)) for path, state in states.items()}
    of_runs = {path: stages(state or {}) for path, state in states.items()}
    running = [path for path, state in states.items() if state and state["running"]]
    began = {
        path: state["began"]
        for path, state in states.items()
        if state and not state["over"]
    }
    text = drawn.text(of_runs, said, running, refresh, began)
    paths.publish_page(page, "status", text)


def state_of(path: Path) -> dict[str, Any] | None:
    """State of the run of an archive, with `running` and, if so, its `holder`; None
    without a record.
    """
    last = last_state(Companions(path).events)
    if last is None:
        return None

    holder = locks.holder(path)

    return {
        **last,
        "running": holder is not None,
        **({"holder": holder} if holder else {}),
    }


def _lines(path: Path, run_state: dict[str, Any] | None) -> Iterator[str]:
    """Describe the state of a run in a few lines."""
    if run_state is None:
        yield f"{path}: there is no record of a run."
        return

    try:
        yield from list(_described(path, run_state))
    except (
        LookupError,
        TypeError,
        ValueError,
        AttributeError,
    ):  # of another version, or of another program
        yield f"{path}: its record of a run is not one of this version."


def _described(path: Path, run_state: dict[str, Any]) -> Iterator[str]:
    condition = "finished" if run_state.get("over") else "stopped"
    if run_state["running"]:
        holder = run_state.get("holder", {})
        condition = "running"
        if holder:
            condition += f" as process {holder['pid']} on {holder['host']}"

    elapsed = duration(run_state["elapsed"])
    done = run_state["cached"] + run_state["done"]
    if condition == "finished":
        points = f"{counted(done, 'point')} in " if done else "in "
        yield f"{path}: finished: {points}{elapsed}"
    else:
        yield f"{path}: {condition}; {sentence(run_state)}"
        yield (
            f"  after {elapsed}; memory {run_state['memory'] / 2**20:.0f} MiB"
            + "".join(
                f"; worker {w['pid']} {w['memory'] / 2**20:.0f} MiB"
                for w in run_state["workers"]
            )
        )

    if run_state["counts"]:
        yield "  " + ", ".join(
            f"{name} {n:,}" for name, n in sorted(run_state["counts"].items())
        )
