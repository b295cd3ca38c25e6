"""Running jobs on a Dask cluster (extra `cluster`)."""

import contextlib
import itertools
import logging
import re
import sys
import time
from collections.abc import Callable, Generator, Iterator
from typing import Any, TypeVar

from gaitsweep.pipeline.errors import StudyError, WorkerError, reached_limit

_Result = TypeVar("_Result")
_RECOUNT = 5.0  # interval of counting the workers [s]
_TIMEOUT = 20  # time to find the scheduler and a first worker [s]


@contextlib.contextmanager
def connect(address: str) -> Iterator[Any]:
    """Connect to the scheduler at `address`, or to N processes on this computer for "local:N".

    Raises
    ------
    StudyError
        If `address` is neither, or the extra is not installed.
    WorkerError
        If no scheduler or no worker answers.
    """
    local = re.fullmatch(r"local:([1-9][0-9]{0,2})", address)
    if not local and not re.fullmatch(r"(tcp|tls|ws|wss)://\S+:[0-9]{1,5}", address):
        raise StudyError(f"`--cluster` must be tcp://HOST:PORT or local:N, N from 1 to 999; got {address}.")
    try:
        import distributed
    except ImportError as error:
        raise StudyError('`--cluster` needs the extra "cluster": pip install "gaitsweep[cluster]".') from error
    # Their messages are replaced by one line of this package.
    for name in list(logging.root.manager.loggerDict):
        if name.startswith(("distributed", "tornado", "asyncio")):
            logging.getLogger(name).setLevel(logging.CRITICAL + 1)
    if address.startswith(("tls:", "wss:")) and not _has_certificates():
        # Without them a client hangs on closing.
        raise StudyError(f"`--cluster` {address} needs certificates in dask's configuration, distributed.comm.tls.")
    with contextlib.ExitStack() as stack:
        hook = sys.unraisablehook
        stack.callback(setattr, sys, "unraisablehook", hook)
        sys.unraisablehook = lambda error: None if _is_of_distributed(error.object) else hook(error)
        try:
            if local:
                address = stack.enter_context(
                    distributed.LocalCluster(n_workers=int(local[1]), threads_per_worker=1, dashboard_address=None)
                ).scheduler_address
            client = stack.enter_context(distributed.Client(address, timeout=_TIMEOUT, set_as_default=False))
            client.wait_for_workers(1, timeout=_TIMEOUT)
        except (OSError, TimeoutError) as error:
            raise WorkerError(f"No cluster with a worker answers at {address}.") from error
        except RuntimeError as error:  # dask's processes import the script that starts them
            if reached_limit(error):
                raise
            guard = 'A script must be a file that calls `run` under `if __name__ == "__main__":`'
            files = "each process needs some 50 open files (`ulimit -n`)"
            raise WorkerError(f"The processes of {address} cannot be started. {guard}; {files}.") from error
        yield client


def _has_certificates() -> bool:
    """Whether dask is configured for encrypted connections of clients."""
    import dask
    from distributed.security import Security

    if dask.config.get("distributed.client.security-loader", None):
        return True
    return bool(Security().get_connection_args("client").get("ssl_context"))


def _is_of_distributed(callback: Any) -> bool:
    return str(getattr(callback, "__module__", "")).startswith("distributed")


def results(
    client: Any, run: Callable[..., _Result], jobs: Iterator[tuple[Any, ...]]
) -> Generator[_Result, None, None]:
    """Run jobs on the cluster and yield their results as they arrive; each worker has a second one waiting.

    Parameters
    ----------
    client : distributed.Client
    run : callable
        Called with the arguments of each job.
    jobs : iterator of tuple
    """
    import distributed

    pending = distributed.as_completed(loop=client.loop, with_results=True)
    slots, counted = workers(client), time.monotonic()

    def submit() -> None:
        # Jobs of workers that leave stay.
        for job in itertools.islice(jobs, max(0, 2 * slots - pending.count())):
            pending.add(client.submit(run, *job, pure=False))

    submit()
    for future, result in pending:
        if future.status != "finished":
            raise ConnectionError("the cluster lost a job")
        if time.monotonic() - counted > _RECOUNT:
            slots, counted = workers(client), time.monotonic()
        submit()
        yield result


def workers(client: Any) -> int:
    """Number of jobs the cluster can run at once."""
    return max(1, sum(info["nthreads"] for info in client.scheduler_info(n_workers=-1)["workers"].values()))
