"""`gaitsweep status`: progress of the current or last run."""

import argparse
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from gaitsweep.pipeline.cli import kinds, studies
from gaitsweep.pipeline.cli.errors import gravest, say
from gaitsweep.pipeline.companions import Companions
from gaitsweep.pipeline.engine import locks
from gaitsweep.pipeline.engine.progress import last_state, sentence
from gaitsweep.pipeline.errors import GaitsweepError
from gaitsweep.pipeline.terminal import counted, duration


def run(options: argparse.Namespace) -> int:
    """Print the state of every run; returns the gravest exit code."""
    archives, codes = studies.archives(options.names, options.debug)
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
