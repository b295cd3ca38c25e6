"""Run studies from their locks to their archives: journal, plan, execution, archive and
the record of the run.
"""

import contextlib
import json
import platform
import shutil
import time
from collections import Counter, deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from gaitsweep.pipeline import dispatch, paths, terminal
from gaitsweep.pipeline.archive import read, result_tables, write
from gaitsweep.pipeline.archive.provenance import (
    check_same_study,
    code_digest,
    cpu_features,
    version,
)
from gaitsweep.pipeline.companions import Companions
from gaitsweep.pipeline.engine import worker_process
from gaitsweep.pipeline.engine.display import Display
from gaitsweep.pipeline.engine.engine import Engine
from gaitsweep.pipeline.engine.listener import Finished, Listener
from gaitsweep.pipeline.engine.locks import lock_archive
from gaitsweep.pipeline.engine.loop import Loop
from gaitsweep.pipeline.engine.progress import Progress
from gaitsweep.pipeline.engine.signals import Signals
from gaitsweep.pipeline.engine.work import Work
from gaitsweep.pipeline.errors import (
    ArchiveError,
    DiskFullError,
    StoppedError,
    StudyError,
    reached_limit,
    unwritten,
)
from gaitsweep.pipeline.graph.plan import Plan, Summary, summary
from gaitsweep.pipeline.grid.method import variables
from gaitsweep.pipeline.store.file import CorruptStoreError, forget, repair
from gaitsweep.pipeline.store.journal import Journal
from gaitsweep.pipeline.study.model import Study

_SNAPSHOT = 60.0  # minimum interval of published snapshots [s]
_MAX_REPAIRS = 3  # damages of a journal in one run before it is given up
_MIN_BYTES = (
    0.005  # per packed number in an archive: 16,384 equal ones take 104 bytes at best
)
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


def run(
    targets: Sequence[tuple[Study, Path]],
    options: Options,
    report: Callable[[Exception], object] | None = None,
) -> list["StudyRun"]:
    """Run studies into archives, all as one graph; one that fails does not end the
    others.

    Parameters
    ----------
    targets : sequence of (Study, Path)
        Studies and the paths of their archives.
    options : Options
    report : callable, optional
        Receives the error of each study that ends with one; a signal is reported once.
        By default the first is raised.

    Returns
    -------
    list of StudyRun
        Each study's, with its exit code and the outcomes of its points.

    Raises
    ------
    GaitsweepError
        If a study cannot start or continue, and `report` is not given; finished results
        are kept.
    """
    dispatch.resolve(
        "gaitsweep.tasks.mechanics.compile_cache:usable_folder"
    )()  # here it can say why it is not used
    errors: list[Exception] = []
    studies = [
        StudyRun(study, path, options, report or errors.append)
        for study, path in targets
    ]
    signals = Signals()
    with contextlib.ExitStack() as stack:
        stack.callback(signals.restore)
        for study in studies:
            stack.callback(study.close)
        try:
            signals.handle()
            _run(studies, options, signals)
        except Exception as error:
            stopped = [study for study in studies if not study.is_over]
            for study in stopped:
                study.end(error, quietly=study is not stopped[0])

    if errors:
        raise errors[0]

    return studies


def _run(studies: list["StudyRun"], options: Options, signals: Signals) -> None:
    """Run what the studies lack, each opened when there is room for its jobs."""
    engine = Engine(options.jobs, options.cluster, signals.check)
    waiting, by_work = deque(studies), dict[Work, StudyRun]()
    points = [
        study.study.points if study.study.kind == "grid" else 0 for study in studies
    ]
    with contextlib.ExitStack() as stack:
        stack.callback(worker_process.close_all)
        display = stack.enter_context(Display(points, options.quiet))

        def begin() -> Work | None:
            while waiting:
                study = waiting.popleft()
                work = study.begin(engine, signals)
                if work and study.progress:
                    by_work[work] = study
                    display.begin(study.progress)
                    return work

                if not study.is_over:  # its journal is repaired
                    waiting.append(study)

            return None

        def finish(work: Work) -> None:
            study = by_work.pop(work)
            progress = study.progress
            study.finish(work, engine, signals)
            if progress:
                display.end(progress, study.is_over)
            if not study.is_over:
                waiting.append(study)

        Loop(engine, signals.check, begin, finish).run()


def _check_room(study: Study, path: Path) -> None:
    """Refuse a grid whose archive the disk cannot hold, however few gaits exist and
    however well they are packed.
    """
    needed, free = (
        _MIN_BYTES * study.points * len(variables(study)),
        shutil.disk_usage(path.parent).free,
    )
    if study.kind == "grid" and needed > free:
        room = f"in {path.parent} {free / 1e9:,.1f} are free"
        raise DiskFullError(
            f"{study.points:,} points need {needed / 1e9:,.1f} GB at least; {room}."
        )


class StudyRun:
    """One study of a command, from its lock to its archive and the record of the run.

    Parameters
    ----------
    study : Study
    path : Path
        Of the archive.
    options : Options
    report : callable
        Receives the error that ends it, if any.

    Attributes
    ----------
    is_open : bool
        Whether it is locked and not finished.
    is_over : bool
        Whether it is finished, or has ended with an error.
    code : int
        Exit code.
    counts : Counter
        Points, or lines, by outcome, once it is finished.
    """

    def __init__(
        self,
        study: Study,
        path: Path,
        options: Options,
        report: Callable[[Exception], object],
    ):
        self.study, self.path, self.options, self.report = study, path, options, report
        self.companions = Companions(path)
        self.is_open, self.is_over = False, False
        self.code, self.counts = 1, Counter[str]()
        self.progress: Progress | None = None
        self._store: Journal | None = None
        self._resources = contextlib.ExitStack()
        self._repairs, self._clock = 0, 0.0
        self._record: dict[str, Any] = {
            "study": study.name,
            "archive": path.name,
            "began": "",
            "host": platform.node(),
            "jobs": options.jobs,
            "cluster": options.cluster,
            "cpu": [],
            "version": version("gaitsweep"),
        }

    def _open(self) -> None:
        """Lock the archive, and with `fresh` forget earlier results."""
        self._clock = time.monotonic()
        self._record |= {
            "began": time.strftime("%Y-%m-%dT%H:%M:%S%z"),
            "cpu": cpu_features(),
        }
        self.path.parent.mkdir(parents=True, exist_ok=True)
        _check_room(self.study, self.path)
        read.check_replaceable(self.path)
        write.check_path(self.path)
        self.companions.check()
        self.companions.make_folder()
        self._resources.enter_context(lock_archive(self.path))
        if not self.options.fresh:
            check_same_study(self.path, self.study)
        self.is_open = True
        if self.options.fresh:
            forget(self.companions.journal)

    def begin(self, engine: Engine, signals: Signals) -> Work | None:
        """Open the study, compare it with its journal, and lay out what is missing.

        None if this ends it, or its journal was damaged and is repaired.
        """
        signals.check()
        with self._guarded():
            if not self.is_open:
                self._open()
            self._store = Journal(self.companions.journal)
            plan = Plan(
                self.study, self._store, self.options.retry_failed, signals.check
            )
            todo = summary(plan)
            log = self.companions.events
            self.progress = progress = Progress(
                plan, todo, log, engine, self.options.quiet, self.options.verbose
            )
            progress.begin()
            _warn_of_changed_code(plan, todo, progress)
            snapshots = _Snapshots(plan, self.path, self.options.snapshot, progress)
            return Work(plan, [progress, snapshots], self.options.chunk)

        return None

    def finish(self, work: Work, engine: Engine, signals: Signals) -> None:
        """Write the archive of a study of which nothing is left, or report what ended
        it.
        """
        plan = work.plan
        with self._guarded():
            signals.check()
            if work.error:
                raise work.error

            self._record["solved"] = time.strftime("%Y-%m-%dT%H:%M:%S%z")
            written = write.update(plan, self.path)
            self.counts = written.counts
            if written.counts["not_attempted"]:  # stored results are missing
                raise plan.store.damage()

            failures = result_tables.failed(plan)
            failed = [
                f"{name}: {outcome}; {reason}"
                for name, outcome, reason in failures
                if name != self.study.kind
            ]
            self._record |= {
                "account": work.account.record(engine.account, engine.jobs),
                "points": sum(written.counts.values()),
                "counts": dict(written.counts),
                "failed": sum(written.failures.values()),
                "failures": dict(written.failures),
                "failed_tasks": failed,
            }
            if self.progress:
                _summarise(plan, self.progress, written, failed, self.path)
            self.code = 1 if written.failures or failed else 0
            self.pause(is_over=True)
            self.end(None)

    def pause(self, is_over: bool = False) -> None:
        """Close the journal and the event log."""
        if self.progress:
            self._record["state"] = self.progress.state()
            self.progress.close(is_over)
        if self._store:
            self._store.close()
        self.progress = self._store = None

    @contextlib.contextmanager
    def _guarded(self) -> Iterator[None]:
        """End the study with an error raised inside, unless it repairs its journal, and
        is to be planned again.
        """
        try:
            try:
                yield
            except CorruptStoreError as error:
                self.pause()
                self._repair(error.path)
        except StoppedError:
            raise
        except Exception as error:
            self.end(error)

    def _repair(self, journal: Path) -> None:
        self._repairs += 1
        if self._repairs == _MAX_REPAIRS:
            raise ArchiveError(f"{journal} cannot be repaired; run again with --fresh.")

        repair(journal)
        if not self.options.quiet:
            terminal.say(
                f"{journal} was damaged; it is repaired, and lost results are computed again."
            )

    def end(self, error: Exception | None, quietly: bool = False) -> None:
        """Write the record of the run and unlock the archive."""
        self.pause()
        if error and (
            system := error if isinstance(error, OSError) else reached_limit(error)
        ):
            error = unwritten(self.path, system)

        if error:
            self.code = getattr(error, "exit_code", StudyError.exit_code)
            self._record["error"] = str(error)

        if self.is_open:
            self._record |= {
                "exit_code": self.code,
                "seconds": round(time.monotonic() - self._clock, 3),
            }
            record = self.companions.record
            try:
                _write_record(record, self._record)
            except OSError as failure:
                if not error:  # one line is enough, and this error matters less
                    terminal.say(f"gaitsweep: {unwritten(record, failure)}")

        self.is_open, self.is_over = False, True
        self._resources.close()
        if error and not quietly:
            self.report(error)

    def close(self) -> None:
        """Unlock the archive, whatever happened."""
        self.pause()
        self._resources.close()


def _warn_of_changed_code(plan: Plan, todo: Summary, progress: Progress) -> None:
    """Warn if the code of `tasks` changed since results were stored and no version did."""
    stored_digest, digest = plan.store.note("code"), code_digest("tasks")
    is_same_version = plan.store.note("versions") == plan.versions
    has_changed = stored_digest not in (None, digest) and is_same_version
    if has_changed and any(todo.cached.values()):
        progress.say(
            "The code of `tasks` has changed since some of these results were stored, its versions have not; "
            "if numbers may change, increase the task's version or run with --fresh."
        )

    plan.store.set_note("code", digest)
    plan.set_notes()


class _Snapshots(Listener):
    """Publishes the archive of a long run from time to time."""

    def __init__(self, plan: Plan, path: Path, every: float, progress: Progress):
        self.plan, self.path, self.progress = plan, path, progress
        self.every, self.next = every, time.monotonic() + every

    def finished(self, done: Finished) -> None:
        """Publish the archive, if it is time."""
        if not done.node.chunk or time.monotonic() < self.next:
            return

        began = time.monotonic()
        # A partial archive does not replace a complete one.
        if read.not_attempted(self.path) != 0:
            try:
                write.write(self.plan, self.path)
            except DiskFullError as error:  # the journal may grow yet
                self.progress.say(
                    f"The archive is not published before the end: {error}"
                )

        ended = time.monotonic()
        self.next = ended + max(self.every, _SNAPSHOT_PAUSE * (ended - began))


def _summarise(
    plan: Plan,
    progress: Progress,
    written: write.Written,
    failed: list[str],
    path: Path,
) -> None:
    what = "point" if plan.study.kind == "grid" else "line"
    by_status = ", ".join(f"{name} {n:,}" for name, n in written.counts.items())
    took, n = (
        terminal.duration(time.monotonic() - progress.start),
        sum(written.counts.values()),
    )
    progress.say(
        f"{plan.study.name}: {terminal.counted(n, what)} ({by_status}) in {took}; {path}"
    )
    for reason, n in written.failures.most_common(_MAX_REASONS):
        progress.say(f"  {n:,} x {reason} First: {written.examples[reason]}")
    if len(written.failures) > _MAX_REASONS:
        progress.say(
            f"  ... and {len(written.failures) - _MAX_REASONS:,} more reasons: see reason_text in the archive"
        )

    for sentence in failed:
        progress.say(f"  {sentence}")


def _write_record(path: Path, record: dict[str, Any]) -> None:
    paths.publish(path, (json.dumps(record, indent=1) + "\n").encode())
