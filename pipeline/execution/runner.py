"""One study from its file to its archive: lock, journal, plan, execution, archive, and the record of the run."""

from __future__ import annotations

import contextlib
import fcntl
import json
import os
import platform
import signal
import sys
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from types import FrameType
from typing import Any

from pipeline import paths
from pipeline.archive import read, write
from pipeline.archive.provenance import code_digest, cpu_features, version
from pipeline.errors import ArchiveError, BusyError, GaitsweepError, StoppedError, unwritten
from pipeline.execution import worker_process
from pipeline.execution.executors import Engine
from pipeline.execution.progress import Progress, duration
from pipeline.execution.scheduler import Loop
from pipeline.paths import sidecar_path
from pipeline.plan.missing import Plan, summary
from pipeline.store.compact import compact
from pipeline.store.journal import CorruptJournalError, Journal, forget, repair
from pipeline.study.model import Study

_SNAPSHOT = 60.0  # s at least between published snapshots
_LISTED = 10  # reasons told at the end of a run
_SHARE = 20  # and as many times as long as writing one takes


@dataclass(frozen=True)
class Options:
    """How to run, never what."""

    jobs: int = 2
    cluster: str | None = None
    fresh: bool = False
    retry_failed: bool = False
    chunk: int | None = None
    quiet: bool = False
    verbose: bool = False
    snapshot: float = _SNAPSHOT


@contextlib.contextmanager
def locked(path: Path) -> Iterator[None]:
    """Hold an archive; a lock dies with its process, and what it left half done is removed.

    Raises
    ------
    BusyError
        If another run holds it.
    """
    with open(sidecar_path(path, ".lock"), "a+", encoding="utf-8") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            who = _holder(file)
            known = {"pid", "host", "started"} <= who.keys()
            raise BusyError(
                f"{path} is held by another run: "
                + (
                    f"process {who['pid']} on {who['host']}, started {who['started']}."
                    if known
                    else "its name is not known yet."
                )
            ) from error
        for place in (path.resolve(), sidecar_path(path, ".journal"), sidecar_path(path, ".run.json")):
            paths.discard(place, _holder(file).get("drafts"))
        file.seek(0)
        file.truncate()
        started = time.strftime("%Y-%m-%d %H:%M:%S")
        json.dump({"pid": os.getpid(), "host": platform.node(), "started": started, "drafts": paths.SECRET}, file)
        file.flush()
        yield


def _holder(file: Any) -> dict[str, Any]:
    """Who holds a lock, or held it last, as far as is known."""
    try:
        file.seek(0)
        who = json.load(file)
        return who if isinstance(who, dict) else {}
    except (ValueError, RecursionError):
        return {}


class Signals:
    """INT, TERM and HUP stop a run at once, but not between a result and its journal; a second one is hard.

    One that was ignored when the run began, as `nohup` has it, stays ignored.
    """

    def __init__(self) -> None:
        self.held, self.got = False, 0

    @contextlib.contextmanager
    def caught(self) -> Iterator[None]:
        """Handle signals inside; only a main thread can."""
        if threading.current_thread() is not threading.main_thread():
            yield
            return
        kept = {
            s: signal.signal(s, self._handle)
            for s in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
            if signal.getsignal(s) not in (signal.SIG_IGN, None)
        }
        try:
            yield
        except StoppedError:
            raise
        except Exception:
            if self.got:  # what a library makes of being stopped amid its work
                self._stop()
            raise
        finally:
            for signum, handler in kept.items():
                signal.signal(signum, handler)

    def _handle(self, signum: int, frame: FrameType | None) -> None:
        worker_process.stop()
        if self.got:
            os._exit(128 + signum)
        self.got = signum
        if not self.held:
            self._stop()

    def _stop(self) -> None:
        name = signal.Signals(self.got).name
        raise StoppedError(self.got, f"Stopped by {name}; what was finished is kept.") from None

    def __enter__(self) -> None:
        self.held = True

    def __exit__(self, *_: object) -> None:
        self.held = False
        if self.got:
            self._stop()


def run(study: Study, path: Path, options: Options) -> int:
    """Run a study into the archive at `path`; the exit code.

    Raises
    ------
    GaitsweepError
        If the run cannot begin or cannot go on; what was finished is kept.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        lock = locked(path)
        with lock:
            if path.exists():
                read.ours(path)
            return _run(study, path, options)
    except OSError as error:
        raise unwritten(path.parent, error) from error


def _run(study: Study, path: Path, options: Options) -> int:
    place = sidecar_path(path, ".journal")
    if options.fresh:
        forget(place)
    record: dict[str, Any] = {
        "study": study.name,
        "archive": path.name,
        "began": time.strftime("%Y-%m-%dT%H:%M:%S%z"),
        "host": platform.node(),
        "jobs": options.jobs,
        "cluster": options.cluster,
        "cpu": cpu_features(),
        "version": version("gaitsweep"),
    }
    clock, code = time.monotonic(), 1
    try:
        code = _attempts(study, path, place, options, record)
        return code
    except GaitsweepError as error:
        code = error.exit_code
        record["error"] = str(error)
        raise
    finally:
        record |= {"exit_code": code, "seconds": round(time.monotonic() - clock, 3)}
        with contextlib.suppress(OSError):
            _write_record(sidecar_path(path, ".run.json"), record)


def _attempts(study: Study, path: Path, place: Path, options: Options, record: dict[str, Any]) -> int:
    for _ in range(3):
        try:
            with contextlib.closing(Journal(place, points=study.points)) as journal:
                return _once(Plan(study, journal, options.retry_failed), path, options, record)
        except CorruptJournalError:
            repair(place)
            if not options.quiet:
                print(f"{place} was damaged; it is mended, and what is lost is computed again.", file=sys.stderr)
    raise ArchiveError(f"{place} cannot be mended; run again with --fresh.")


def _once(plan: Plan, path: Path, options: Options, record: dict[str, Any]) -> int:
    todo = summary(plan)
    engine, signals = Engine(options.jobs, options.cluster), Signals()
    log = sidecar_path(path, ".events.jsonl")
    with signals.caught(), Progress(plan, todo, log, options.quiet, options.verbose) as progress:
        _warn_of_moved_code(plan, progress)
        listen = _Snapshots(plan, path, options.snapshot, progress)
        try:
            if any(todo.todo.values()):
                points = sum(todo.todo.get("points", {}).values())
                progress.loop = Loop(plan, engine, listen, points, options.chunk, signals)
                progress.loop.run()
            record["solved"] = time.strftime("%Y-%m-%dT%H:%M:%S%z")
            written = write.write(plan, path, min(options.jobs, os.cpu_count() or 1))
            if written.counts["not_attempted"]:  # what was kept is not found again
                raise CorruptJournalError(plan.journal.path)
            compact(plan.journal)
        finally:
            record |= {"state": progress.state()}
            worker_process.close_all()
    failed = tasks_failed(plan)
    record |= {
        "points": sum(written.counts.values()),
        "counts": dict(written.counts),
        "failed": sum(written.failures.values()),
        "failures": dict(written.failures),
        "failed_tasks": failed,
    }
    _summarise(plan, progress, written, failed, path)
    return 1 if written.failures or failed else 0


def _warn_of_moved_code(plan: Plan, progress: Progress) -> None:
    """Say when `tasks` changed since results were kept and no version did; comments do not count."""
    note, now = plan.journal.note("code"), code_digest()
    versions = json.dumps({name: layer.task.version for name, layer in plan.layers.items()}, sort_keys=True)
    if note and note != now and plan.journal.note("versions") == versions and any(progress.cached_tasks):
        progress.say(
            "The code of `tasks` has changed since some of these results were kept, its versions have not; "
            "if numbers may change, bump the task's version or run with --fresh."
        )
    plan.journal.set_note("code", now)
    plan.journal.set_note("versions", versions)


class _Snapshots:
    """Listens for the progress, and publishes the archive of a long run now and then."""

    def __init__(self, plan: Plan, path: Path, every: float, progress: Progress):
        self.plan, self.path, self.progress = plan, path, progress
        self.every, self.next = every, time.monotonic() + every

    def __call__(self, event: str, about: dict[str, Any]) -> None:
        self.progress(event, about)
        if event != "chunk" or time.monotonic() < self.next:
            return
        began = time.monotonic()
        # A whole archive is not replaced by part of one.
        if read.not_attempted(self.path) != 0:
            write.write(self.plan, self.path)
        took = time.monotonic() - began
        self.next = time.monotonic() + max(self.every, _SHARE * took)


def tasks_failed(plan: Plan) -> list[str]:
    """Tasks that are no points and failed, one sentence each."""
    found = []
    for name, layer in plan.layers.items():
        if name not in ("atlas", "points", plan.study.kind):
            for keys in map(plan.line_keys, range(plan.study.lines)) if layer.per_line else [plan.study_keys()]:
                outcome, reason, _ = plan.journal.outcome(keys[name][0]) or ("ok", "", 0)
                if outcome != "ok":
                    found.append(f"{name}: {outcome}; {reason}")
    return found


def _summarise(plan: Plan, progress: Progress, written: write.Written, failed: list[str], path: Path) -> None:
    total = "points" if plan.study.kind == "grid" else "lines"
    by_status = ", ".join(f"{name} {n:,}" for name, n in written.counts.items())
    seconds = time.time() - progress.began
    n = sum(written.counts.values())
    progress.say(f"{plan.study.name}: {n:,} {total} ({by_status}) in {duration(seconds)}; {path}")
    for reason, n in written.failures.most_common(_LISTED):
        progress.say(f"  {n:,} x {reason} First: {written.examples[reason]}")
    if len(written.failures) > _LISTED:
        progress.say(f"  ... and {len(written.failures) - _LISTED:,} more reasons: see reason_text in the archive")
    for sentence in failed:
        progress.say(f"  {sentence}")


def _write_record(path: Path, record: dict[str, Any]) -> None:
    try:
        paths.of(path).write_text(json.dumps(record, indent=1) + "\n", encoding="utf-8")
        os.replace(paths.of(path), path)
    finally:
        paths.discard(path)
