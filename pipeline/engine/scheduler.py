"""The order in which the jobs of all studies of a command run.

The ready jobs of all studies are one finite iterator, which joblib or a cluster runs;
it is made anew while there are ready jobs. Results are recorded as they arrive, and
between them a signal is looked for.
"""

import contextlib
import itertools
import threading
import time
from collections import OrderedDict
from collections.abc import Callable, Sequence
from typing import Any

from gaitsweep.pipeline.engine.executors import Engine
from gaitsweep.pipeline.engine.jobs import Jobs
from gaitsweep.pipeline.engine.request import Request
from gaitsweep.pipeline.engine.signals import Signals
from gaitsweep.pipeline.errors import GaitsweepError, WorkerError, described
from gaitsweep.pipeline.graph.graph import Node

#: Studies whose files are open at a time, five each.
MOST_OPEN = 32
_MOST_KEPT, _KEPT_BYTES = (
    64,
    1 << 20,
)  # results that studies which begin later may want, and the largest [byte]
_JOBS_PER_WORKER = 16  # jobs submitted or not yet read, for each worker
_PATIENCE = (
    1.0  # longest time for which a thread waits until its result is recorded [s]
)
_MAX_RETRIES = 3  # consecutive restarts of a broken engine
_Begin = Callable[[], Jobs | None]
_Finish = Callable[[Jobs], None]


class Scheduler:
    """Runs the jobs of several studies.

    Parameters
    ----------
    studies : sequence of Jobs
    engine : Engine
    signals : Signals
    finish : callable, optional
        Called with each study when no job of it is left, while the others go on.
    begin : callable, optional
        Called while fewer than `MOST_OPEN` studies are open; returns the jobs of
        another, None if none is left.
    """

    def __init__(
        self,
        studies: Sequence[Jobs],
        engine: Engine,
        signals: Signals,
        finish: _Finish = lambda study: None,
        begin: _Begin = lambda: None,
    ):
        self.studies, self.engine, self.signals = list(studies), engine, signals
        self.finish, self.begin = finish, begin
        self.running: dict[int, tuple[Jobs, Node]] = {}
        self._numbers = itertools.count()
        self._wanted: dict[
            Jobs, set[str]
        ] = {}  # by open study, if there is more than one in the command
        self._kept: OrderedDict[str, tuple[str, Node, bytes]] = (
            OrderedDict()
        )  # results, and the keys that want them
        self._are_several, self._are_left = (
            len(studies) > 1,
            False,
        )  # studies; some that are to begin
        self._held: dict[
            str, list[tuple[Jobs, Node]]
        ] = {}  # jobs whose result another study is computing
        self._compiling: int | None = None  # number of the first job with knees
        # Jobs are taken by a thread of the executor, and their results recorded by
        # ours.
        self._lock = threading.RLock()
        self._recorded = threading.Condition(self._lock)
        self._latest: dict[
            int, int
        ] = {}  # number of the job that each other thread has taken
        self._thread = threading.get_ident()  # which records
        self._welcome()

    def run(self) -> None:
        """Run everything the studies request.

        Raises
        ------
        StoppedError
            At a signal.
        WorkerError
            If workers or the cluster cannot be kept alive.
        """
        broken = 0
        while True:
            self.signals.check()
            self._fill()
            if not self.studies:
                return
            try:
                with self.engine.parallel() as parallel:
                    while self._has_jobs():
                        self.signals.check()
                        with contextlib.closing(
                            parallel(self._has_jobs, self._next)
                        ) as results:
                            for answer in results:
                                self.signals.check()
                                if isinstance(answer, str):
                                    self._tell({"note": answer})
                                    continue
                                broken = 0
                                self._record(*answer)
                        self._fill()
            except Exception as error:
                self.signals.check()
                if self.engine.address is None or isinstance(error, GaitsweepError):
                    raise
                broken += 1
                message = described(error)
                if broken > _MAX_RETRIES:
                    raise WorkerError(
                        f"Workers cannot be kept alive: {message}."
                    ) from error
                self._tell({"error": message})
                time.sleep(broken)
                with self._lock:
                    held = itertools.chain.from_iterable(self._held.values())
                    for study, node in (*self.running.values(), *held):
                        study.put_back(node)
                    self.running, self._held = {}, {}

    def _tell(self, details: dict[str, Any]) -> None:
        """Tell of what concerns all studies, once."""
        for study in self.studies[:1]:
            study.listen("engine", details)

    def _ready(self) -> list[tuple[Jobs, Node]]:
        """The next job of each study; none if results are read more slowly than they
        arrive: joblib would keep all.
        """
        with self._lock:
            if (
                len(self.running) >= _JOBS_PER_WORKER * self.engine.jobs
                or self.signals.received
            ):
                return []
            return [(study, node) for study in self.studies if (node := study.peek())]

    def _has_jobs(self) -> bool:
        return bool(self._ready())

    def _next(self) -> tuple[int, Request] | None:
        """Number and request of the most urgent job; None if there is none.

        The most urgent job of a thread may be one that waits for the result that it has
        just brought.
        """
        with self._lock:
            me = threading.get_ident()
            self._recorded.wait_for(
                lambda: not self._is_awaited(self._latest.get(me, -1)), _PATIENCE
            )
            while ready := self._ready():
                study, _ = max(
                    ready,
                    key=lambda pair: (
                        not self._waits(pair[0]),
                        pair[0].seconds(pair[1]),
                    ),
                )
                taken = study.take()
                if taken is None:
                    continue
                node, request = taken
                if node.key.key in self._held:
                    self._held[node.key.key].append((study, node))
                    continue
                if node.chunk is None:
                    self._held[node.key.key] = []
                number = next(self._numbers)
                self.running[number] = study, node
                if me != self._thread:
                    self._latest[me] = number
                if study.has_knees and self._compiling is None:
                    self._compiling = number
                return number, request
        return None

    def _is_awaited(self, number: int) -> bool:
        """Whether a job is not recorded, and others wait for its result."""
        if number not in self.running:
            return False
        study, node = self.running[number]
        return study.awaits(node)

    def _waits(self, study: Jobs) -> bool:
        """Whether other studies go first, until one worker has compiled the equations
        of knees, and all may load them.

        Where there is no cached code it takes a quarter of a minute; other equations
        take a few seconds.
        """
        return study.has_knees and self._compiling in self.running

    def _record(self, number: int, result: dict[str, Any]) -> None:
        with self._lock:
            study, node = self.running.pop(number)
            study.record(node, result)
            for other, held in self._held.pop(node.key.key, ()):
                other.put_back(
                    held
                )  # limits of studies differ; a result that is copied is not computed again
            if self._are_several and result.get("outcome") == "ok":
                self._share(study, node, result["data"])
            self._recorded.notify_all()
        self._fill()

    def _share(self, study: Jobs, node: Node, data: bytes) -> None:
        """Copy a result to the other studies that want it, and keep it for those that
        are to begin.
        """
        # Who wants the charts of a plane wants those of its boxes.
        wanting = (
            study.graph.line_keys(node.line)["charts"]
            if node.line is not None and node.box
            else node.key
        )
        for other, wanted in self._wanted.items():
            if wanting.key in wanted and other is not study:
                other.copy(node, data)
        if self._are_left and len(data) <= _KEPT_BYTES:
            self._kept[node.key.key] = wanting.key, node, data
        if len(self._kept) > _MOST_KEPT:
            self._kept.popitem(last=False)

    def _fill(self) -> None:
        """Finish studies of which no job is left, and begin others in their place."""
        self._finish()
        while len(self.studies) < MOST_OPEN:
            study = self.begin()
            self._are_left = study is not None
            if study is None:
                break
            with self._lock:
                self.studies.append(study)
                self._are_several |= len(self.studies) > 1
            self._finish()
        self._welcome()

    def _welcome(self) -> None:
        """Note what new studies want, and copy to them what is kept."""
        with self._lock:
            for study in self.studies if self._are_several else ():
                if study in self._wanted:
                    continue
                self._wanted[study] = set(study.wanted())
                for key, (wanting, node, data) in list(self._kept.items()):
                    if wanting in self._wanted[study]:
                        study.copy(node, data)
                        self._kept.move_to_end(key)

    def _finish(self) -> None:
        """Finish studies of which no job is left."""
        with self._lock:
            over = [study for study in self.studies if study.is_over]
            for study in over:
                self.studies.remove(study)
                self._wanted.pop(study, None)
        for study in over:
            self.finish(study)
