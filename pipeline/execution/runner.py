"""Run one study from its lock to its archive: journal, plan, execution, archive and the record of the run."""

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
from pipeline.execution.scheduler import Scheduler
from pipeline.paths import sidecar_path
from pipeline.plan.missing import Plan, summary
from pipeline.store.compact import compact
from pipeline.store.journal import CorruptJournalError, Journal, forget, repair
from pipeline.study.model import Study

_SNAPSHOT = 60.0  # minimum interval of published snapshots [s]
_MAX_REASONS = 10  # reasons listed at the end of a run
_SNAPSHOT_PAUSE = 20  # minimum interval, in multiples of the time of writing one


@dataclass(frozen=True)
class Options:
    """How a study is run; results do not depend on it."""

    jobs: int = 2
    cluster: str | None = None
    fresh: bool = False
    retry_failed: bool = False
    chunk: int | None = None
    quiet: bool = False
    verbose: bool = False
    snapshot: float = _SNAPSHOT


@contextlib.contextmanager
def lock_archive(path: Path) -> Iterator[None]:
    """Lock an archive. A lock ends with its process; drafts it left behind are removed.

    Raises
    ------
    BusyError
        If another run holds it.
    """
    with open(sidecar_path(path, ".lock"), "a+", encoding="utf-8") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            holder = _holder(file)
            name = "its process is not known yet."
            if {"pid", "host", "started"} <= holder.keys():
                name = f"process {holder['pid']} on {holder['host']}, started {holder['started']}."
            raise BusyError(f"{path} is held by another run: {name}") from error
        for file_path in (path.resolve(), sidecar_path(path, ".journal"), sidecar_path(path, ".run.json")):
            paths.discard(file_path, _holder(file).get("drafts"))
        file.seek(0)
        file.truncate()
        started = time.strftime("%Y-%m-%d %H:%M:%S")
        json.dump({"pid": os.getpid(), "host": platform.node(), "started": started, "drafts": paths.SECRET}, file)
        file.flush()
        yield


def _holder(file: Any) -> dict[str, Any]:
    """Holder of a lock, or the last one, as far as is known."""
    try:
        file.seek(0)
        holder = json.load(file)
        return holder if isinstance(holder, dict) else {}
    except (ValueError, RecursionError):
        return {}


class Signals:
    """Stop a run at INT, TERM or HUP, but never while a result is written; a second signal kills.

    Signals that were ignored at the start, as under `nohup`, stay ignored.
    """

    def __init__(self) -> None:
        self.postponed, self.received = False, 0

    @contextlib.contextmanager
    def handle(self) -> Iterator[None]:
        """Handle signals inside; only the main thread can."""
        if threading.current_thread() is not threading.main_thread():
            yield
            return
        handlers = {
            s: signal.signal(s, self._receive)
            for s in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
            if signal.getsignal(s) not in (signal.SIG_IGN, None)
        }
        try:
            yield
        except StoppedError:
            raise
        except Exception:
            if self.received:  # an error of a library that was interrupted
                self._stop()
            raise
        finally:
            for signum, handler in handlers.items():
                signal.signal(signum, handler)

    def _receive(self, signum: int, frame: FrameType | None) -> None:
        worker_process.stop()
        if self.received:
            os._exit(128 + signum)
        self.received = signum
        if not self.postponed:
            self._stop()

    def _stop(self) -> None:
        name = signal.Signals(self.received).name
        raise StoppedError(self.received, f"Stopped by {name}; finished results are kept.") from None

    def __enter__(self) -> None:
        self.postponed = True

    def __exit__(self, *_: object) -> None:
        self.postponed = False
        if self.received:
            self._stop()


def run(study: Study, path: Path, options: Options) -> int:
    """Run a study into the archive at `path` and return the exit code.

    Raises
    ------
    GaitsweepError
        If the run cannot start or continue; finished results are kept.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        lock = lock_archive(path)
        with lock:
            if path.exists():
                read.check_replaceable(path)
            return _run(study, path, options)
    except OSError as error:
        raise unwritten(path.parent, error) from error


def _run(study: Study, path: Path, options: Options) -> int:
    journal = sidecar_path(path, ".journal")
    if options.fresh:
        forget(journal)
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
        code = _run_repairing(study, path, journal, options, record)
        return code
    except GaitsweepError as error:
        code = error.exit_code
        record["error"] = str(error)
        raise
    finally:
        record |= {"exit_code": code, "seconds": round(time.monotonic() - clock, 3)}
        with contextlib.suppress(OSError):
            _write_record(sidecar_path(path, ".run.json"), record)


def _run_repairing(study: Study, path: Path, journal_path: Path, options: Options, record: dict[str, Any]) -> int:
    for _ in range(3):
        try:
            with contextlib.closing(Journal(journal_path, points=study.points)) as journal:
                return _attempt(Plan(study, journal, options.retry_failed), path, options, record)
        except CorruptJournalError:
            repair(journal_path)
            if not options.quiet:
                print(
                    f"{journal_path} was damaged; it is repaired, and lost results are computed again.", file=sys.stderr
                )
    raise ArchiveError(f"{journal_path} cannot be repaired; run again with --fresh.")


def _attempt(plan: Plan, path: Path, options: Options, record: dict[str, Any]) -> int:
    todo = summary(plan)
    engine, signals = Engine(options.jobs, options.cluster), Signals()
    log = sidecar_path(path, ".events.jsonl")
    with signals.handle(), Progress(plan, todo, log, options.quiet, options.verbose) as progress:
        _warn_of_changed_code(plan, progress)
        listen = _Snapshots(plan, path, options.snapshot, progress)
        try:
            if any(todo.todo.values()):
                points = sum(todo.todo.get("points", {}).values())
                progress.scheduler = Scheduler(plan, engine, listen, points, options.chunk, signals)
                progress.scheduler.run()
            record["solved"] = time.strftime("%Y-%m-%dT%H:%M:%S%z")
            written = write.write(plan, path, min(options.jobs, os.cpu_count() or 1))
            if written.counts["not_attempted"]:  # stored results are missing
                raise CorruptJournalError(plan.journal.path)
            compact(plan.journal)
        finally:
            record |= {"state": progress.state()}
            worker_process.close_all()
    failed = _failed_tasks(plan)
    record |= {
        "points": sum(written.counts.values()),
        "counts": dict(written.counts),
        "failed": sum(written.failures.values()),
        "failures": dict(written.failures),
        "failed_tasks": failed,
    }
    _summarise(plan, progress, written, failed, path)
    return 1 if written.failures or failed else 0


def _warn_of_changed_code(plan: Plan, progress: Progress) -> None:
    """Warn if the code of `tasks` changed since results were stored and no version did."""
    stored_digest, digest = plan.journal.note("code"), code_digest()
    versions = json.dumps({name: layer.task.version for name, layer in plan.layers.items()}, sort_keys=True)
    has_changed = stored_digest not in (None, digest) and plan.journal.note("versions") == versions
    if has_changed and progress.cached_tasks:
        progress.say(
            "The code of `tasks` has changed since some of these results were stored, its versions have not; "
            "if numbers may change, increase the task's version or run with --fresh."
        )
    plan.journal.set_note("code", digest)
    plan.journal.set_note("versions", versions)


class _Snapshots:
    """Passes events on to the progress, and publishes the archive of a long run from time to time."""

    def __init__(self, plan: Plan, path: Path, every: float, progress: Progress):
        self.plan, self.path, self.progress = plan, path, progress
        self.every, self.next = every, time.monotonic() + every

    def __call__(self, event: str, details: dict[str, Any]) -> None:
        self.progress(event, details)
        if event != "chunk" or time.monotonic() < self.next:
            return
        began = time.monotonic()
        # A partial archive does not replace a complete one.
        if read.not_attempted(self.path) != 0:
            write.write(self.plan, self.path)
        duration = time.monotonic() - began
        self.next = time.monotonic() + max(self.every, _SNAPSHOT_PAUSE * duration)


def _failed_tasks(plan: Plan) -> list[str]:
    """Failed tasks other than points, one sentence each."""
    failures = []
    for name, layer in plan.layers.items():
        if name not in ("atlas", "points", plan.study.kind):
            for keys in map(plan.line_keys, range(plan.study.lines)) if layer.per_line else [plan.study_keys()]:
                outcome, reason, _ = plan.journal.outcome(keys[name].key) or ("ok", "", 0)
                if outcome != "ok":
                    failures.append(f"{name}: {outcome}; {reason}")
    return failures


def _summarise(plan: Plan, progress: Progress, written: write.Written, failed: list[str], path: Path) -> None:
    total = "points" if plan.study.kind == "grid" else "lines"
    by_status = ", ".join(f"{name} {n:,}" for name, n in written.counts.items())
    seconds = time.time() - progress.start
    n = sum(written.counts.values())
    progress.say(f"{plan.study.name}: {n:,} {total} ({by_status}) in {duration(seconds)}; {path}")
    for reason, n in written.failures.most_common(_MAX_REASONS):
        progress.say(f"  {n:,} x {reason} First: {written.examples[reason]}")
    if len(written.failures) > _MAX_REASONS:
        progress.say(f"  ... and {len(written.failures) - _MAX_REASONS:,} more reasons: see reason_text in the archive")
    for sentence in failed:
        progress.say(f"  {sentence}")


def _write_record(path: Path, record: dict[str, Any]) -> None:
    try:
        paths.of(path).write_text(json.dumps(record, indent=1) + "\n", encoding="utf-8")
        os.replace(paths.of(path), path)
    finally:
        paths.discard(path)
