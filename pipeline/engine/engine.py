"""Where a run computes its jobs, and what it used."""

import contextlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

from gaitsweep.pipeline.engine.account import Account
from gaitsweep.pipeline.engine.places import Inline, Place, Workers


@dataclass
class Engine:
    """Opens the place of a run: `jobs` worker processes, or the cluster at `address`
    ("local:4" starts one).

    `check` is called while nothing comes from a cluster; what it raises ends the wait.
    `account` is of all studies, and `jobs` follows the number of workers.
    """

    jobs: int = 2
    address: str | None = None
    check: Callable[[], None] = lambda: None
    account: Account = field(default_factory=Account)

    @contextlib.contextmanager
    def open(self, say: Callable[[str], None]) -> Iterator[Place]:
        """Open the place; `say` receives sentences for who waits."""
        if self.address is None:
            with Workers(self.jobs, say) as workers:
                yield workers
            return

        from gaitsweep.pipeline.engine import cluster

        with cluster.connect(self.address, self.check) as client:
            yield cluster.Cluster(cluster.Team(client, self.check), say)


class InProcess(Engine):
    """Computes in this process.

    Parameters
    ----------
    room : int
        Requests that are taken at a time.
    """

    def __init__(self, room: int):
        super().__init__(jobs=1)
        self.room = room

    @contextlib.contextmanager
    def open(self, say: Callable[[str], None]) -> Iterator[Place]:
        """Open the place."""
        yield Inline(self.room)
