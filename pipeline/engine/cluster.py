"""Running jobs on a Dask cluster (extra `cluster`)."""

import contextlib
import itertools
import logging
import platform
import re
import sys
import threading
import time
import warnings
from collections.abc import Callable, Iterator
from concurrent import futures
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeVar

from gaitsweep.pipeline.archive.provenance import software
from gaitsweep.pipeline.engine import worker_process
from gaitsweep.pipeline.engine.places import LONG
from gaitsweep.pipeline.engine.request import Answer, Request
from gaitsweep.pipeline.errors import (
    StudyError,
    WorkerError,
    described,
    reached_limit,
    unwritten,
)

#: Interval of counting the workers [s].
RECOUNT = 5.0
#: Time for which a run waits for a worker when none is left [s].
PATIENCE = 300.0
_Result = TypeVar("_Result")
_LOOK = 0.1  # interval of looking for a signal [s]
# A worker process on a cluster ends after waiting this long [s]: it cannot see the end
# of a run.
_IDLE_TIMEOUT = 2.0
# Time to find the scheduler and a first worker, and for which workers may take to load
# gaitsweep [s].
_TIMEOUT = 20
_ANSWER = 5.0  # time for a scheduler to count its workers [s]
_CLOSING = 2  # time for it to take leave of a client [s]


def _never() -> None:
    """Do nothing: nobody stops the run."""


@contextlib.contextmanager
def connect(address: str, check: Callable[[], None] = _never) -> Iterator[Any]:
    """Connect to the scheduler at `address`, or to N workers in this process for
    "local:N".

    Parameters
    ----------
    address : str
    check : callable
        Called ten times a second while nothing answers; what it raises ends the wait.

    Raises
    ------
    StudyError
        If `address` is neither, or the extra is not installed.
    WorkerError
        If no scheduler or no worker answers.
    """
    local = re.fullmatch(r"local:([1-9][0-9]{0,2})", address)
    if not local and not re.fullmatch(r"(tcp|tls|ws|wss)://\S+:[0-9]{1,5}", address):
        raise StudyError(
            f"`--cluster` must be tcp://HOST:PORT or local:N, N from 1 to 999; got {address}."
        )

    try:
        import distributed
    except ImportError as error:
        raise StudyError(
            '`--cluster` needs the extra "cluster": pip install "gaitsweep[cluster]".'
        ) from error

    _silence_loggers()
    if address.startswith(("tls:", "wss:")) and not _has_certificates():
        # Without them a client hangs on closing.
        raise StudyError(
            f"`--cluster` {address} needs certificates in dask's configuration, distributed.comm.tls."
        )

    with contextlib.ExitStack() as stack:
        stack.enter_context(_silent_hook())
        try:
            place: Any = address
            if local:
                place = stack.enter_context(_in_process(int(local[1])))
            options: dict[str, Any] = {"timeout": _TIMEOUT, "set_as_default": False}
            client: Any = _patiently(
                lambda: distributed.Client(place, **options), check
            )
            stack.callback(client.close, _CLOSING)
            _patiently(lambda: client.wait_for_workers(1, timeout=_TIMEOUT), check)
        except (OSError, TimeoutError, RuntimeError) as error:
            raise _no_cluster(address, bool(local), error) from error

        yield client


def _silence_loggers() -> None:
    """Silence dask's loggers: their messages are replaced by one line of this package."""
    for name in list(logging.root.manager.loggerDict):
        if name.startswith(("distributed", "tornado", "asyncio")):
            logging.getLogger(name).setLevel(logging.CRITICAL + 1)


@contextlib.contextmanager
def _silent_hook() -> Iterator[None]:
    """Say nothing of what dask's objects raise as they are collected."""
    hook = sys.unraisablehook
    sys.unraisablehook = lambda error: (
        None if _is_of_distributed(error.object) else hook(error)
    )
    try:
        yield
    finally:
        sys.unraisablehook = hook


def _no_cluster(address: str, is_local: bool, error: Exception) -> Exception:
    """What is said of a cluster that cannot be used."""
    limit = reached_limit(error)
    if limit:
        return unwritten(Path(), limit)
    if is_local:
        return WorkerError(
            f"The workers of {address} cannot be started: {described(error)}."
        )

    return WorkerError(f"No cluster with a worker answers at {address}.")


@contextlib.contextmanager
def _in_process(n: int) -> Iterator[Any]:
    """A scheduler and `n` workers of one thread in this process, which open no port.

    Whoever reached one could run code as this user. Each worker's jobs run in a process
    of their own as elsewhere.
    """
    import distributed

    class Scheduler(distributed.Scheduler):
        def start_http_server(self, *_: Any, **__: Any) -> None:
            """Serve no pages."""

    class Worker(distributed.Worker):
        def start_http_server(self, *_: Any, **__: Any) -> None:
            """Serve no pages."""

    shared = {"protocol": "inproc://", "dashboard": False}
    # Each worker would measure the memory of the whole process.
    worker = {"cls": Worker, "options": {**shared, "nthreads": 1, "memory_limit": 0}}
    with warnings.catch_warnings():
        # There may be no network.
        warnings.filterwarnings("ignore", "Couldn't detect a suitable IP address")
        cluster = distributed.SpecCluster(
            workers=dict.fromkeys(range(n), worker),
            scheduler={"cls": Scheduler, "options": shared},
            silence_logs=logging.CRITICAL,
        )

    with cluster:
        yield cluster


def _patiently(
    call: Callable[[], _Result], check: Callable[[], None], most: float = float("inf")
) -> _Result | None:
    """Result of a call that may never return, made in another thread while `check` is
    called; None after `most` s.
    """
    answer: futures.Future[_Result] = futures.Future()

    def run() -> None:
        try:
            answer.set_result(call())
        except BaseException as error:
            answer.set_exception(error)

    threading.Thread(target=run, daemon=True).start()
    end = time.monotonic() + most
    while time.monotonic() < end:
        if futures.wait([answer], _LOOK).done:
            return answer.result()
        check()

    return None


def _has_certificates() -> bool:
    """Whether dask is configured for encrypted connections of clients."""
    import dask
    from distributed.security import Security

    if dask.config.get("distributed.client.security-loader", None):
        return True
    return bool(Security().get_connection_args("client").get("ssl_context"))


def _is_of_distributed(callback: Any) -> bool:
    return str(getattr(callback, "__module__", "")).startswith("distributed")


class Team:
    """The workers of a cluster, counted from time to time.

    Parameters
    ----------
    client : distributed.Client
    check : callable
        Called while the scheduler does not answer; what it raises ends the wait.

    Attributes
    ----------
    slots : int
        Number of jobs the cluster can run at once.
    """

    def __init__(self, client: Any, check: Callable[[], None] = _never):
        self.client, self.check, self.slots = client, check, 1
        self._tried: set[str] = set()  # addresses of workers that have loaded gaitsweep
        self._counted, self._seen = -RECOUNT, time.monotonic()
        self._is_told = False

    def count(self) -> str:
        """Count the workers if it is time; a sentence if none is left and the run
        waits.

        Raises
        ------
        WorkerError
            If none has been there for `PATIENCE`, or one cannot load gaitsweep.
        """
        if time.monotonic() - self._counted < RECOUNT:
            return ""

        threads = _patiently(self.client.nthreads, self.check, _ANSWER)
        self._counted = time.monotonic()
        if threads:
            self.slots = max(1, sum(threads.values()))
            self._seen, self._is_told = self._counted, False
            self._try([address for address in threads if address not in self._tried])
            return ""

        if self._counted - self._seen > PATIENCE:
            raise WorkerError(f"The cluster has had no worker for {PATIENCE:g} s.")
        if self._is_told:
            return ""

        self._is_told = True
        return f"The cluster has no worker; the run waits {PATIENCE:g} s for one."

    def _try(self, addresses: list[str]) -> None:
        """Have new workers load gaitsweep: one that cannot would end at its first job
        without a word.
        """
        if not addresses:
            return

        def answers() -> dict[str, Any]:
            return dict(self.client.run(software, workers=addresses, on_error="return"))

        for address, answer in (
            _patiently(answers, self.check, _TIMEOUT) or {}
        ).items():
            if isinstance(answer, OSError):  # it has left meanwhile
                continue
            if isinstance(answer, Exception):
                raise WorkerError(
                    f"The cluster's worker at {address} cannot load gaitsweep: {described(answer)}."
                )
            self._tried.add(address)


class Cluster:
    """The guards of worker processes on the nodes of a cluster; each has a second
    request waiting.

    Parameters
    ----------
    team : Team
    say : callable
        Receives sentences for who waits.
    run : callable
        Called with each request, on a node.
    """

    def __init__(
        self,
        team: Team,
        say: Callable[[str], None] = lambda sentence: None,
        run: Callable[[dict[str, str], Any], Any] | None = None,
    ):
        import distributed

        self.team, self._say, self._run = team, say, run or _run_here
        self._tickets = itertools.count()
        self._by_future: dict[str, int] = {}
        self._pending = distributed.as_completed(
            loop=team.client.loop, with_results=True
        )

    @property
    def slots(self) -> int:
        """Jobs that the cluster runs at once."""
        return self.team.slots

    def has_room(self, seconds: float = 0.0) -> bool:
        """Whether a worker waits, or would wait for its second request, which takes so
        long; jobs of workers that leave stay.
        """
        if sentence := self.team.count():
            self._say(sentence)
        each = 2 if seconds < LONG else 1
        return bool(self._pending.count() < each * self.team.slots)

    def submit(self, request: Any) -> int:
        """Send a request to the cluster."""
        ticket = next(self._tickets)
        future = self.team.client.submit(self._run, software(), request, pure=False)
        self._by_future[future.key] = ticket
        self._pending.add(future)
        return ticket

    def completed(self, timeout: float) -> Iterator[tuple[int, Any]]:
        """Answers that have come.

        Raises
        ------
        ConnectionError
            If the cluster has lost a job.
        """
        with self._pending.thread_condition:
            if not self._pending.has_ready():
                self._pending.thread_condition.wait(timeout)

        self.team.check()
        for future, answer in self._pending.next_batch(block=False):
            if future.status == "error":
                raise answer[1]
            if future.status != "finished":
                raise ConnectionError("the cluster lost a job")
            yield self._by_future.pop(future.key), answer


def _run_here(software_of_run: dict[str, str], request: Request) -> Answer:
    """Run a request on a cluster node; numbers of other software must not be archived
    as the run's own.

    Raises
    ------
    WorkerError
        If the node has other versions than the run.
    """
    for name, version in software().items():
        if version != (wanted := software_of_run.get(name)):
            raise WorkerError(
                f"The cluster's worker on {platform.node()} has {name} {version};"
                f" the run has {wanted}."
            )
    return worker_process.run(replace(request, idle=_IDLE_TIMEOUT))
