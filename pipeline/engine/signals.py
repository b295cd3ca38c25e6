"""What a run does at a signal."""

import os
import signal
import threading
import time
from types import FrameType
from typing import Any

from gaitsweep.pipeline.engine import worker_process
from gaitsweep.pipeline.errors import StoppedError

# Signals within this time count once: `timeout` sends it to its command and again to
# the group [s].
_ONE = 1.0


class Signals:
    """INT, TERM or HUP end the workers, so that results come at once, and set
    `received`; a second one kills.

    The run looks at it between results. Signals that were ignored at the start, as
    under `nohup`, stay ignored.
    """

    def __init__(self) -> None:
        self.received, self._when = 0, 0.0
        self._handlers: dict[int, Any] = {}

    def handle(self) -> None:
        """Handle signals until `restore`, so that a repeat does not keep a run from
        reporting how it ended.

        Only the main thread can.
        """
        if threading.current_thread() is threading.main_thread():
            self._handlers = {
                s: signal.signal(s, self._receive)
                for s in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
                if signal.getsignal(s) not in (signal.SIG_IGN, None)
            }

    def restore(self) -> None:
        """Leave signals to their earlier handlers; after one, another run may have
        workers.
        """
        if self.received:
            worker_process.close_all()
        for signum, handler in self._handlers.items():
            signal.signal(signum, handler)

    def check(self) -> None:
        """Stop if there was a signal.

        Raises
        ------
        StoppedError
            With the signal.
        """
        if self.received:
            name = signal.Signals(self.received).name
            raise StoppedError(
                self.received, f"Stopped by {name}; finished results are kept."
            ) from None

    def _receive(self, signum: int, frame: FrameType | None) -> None:
        if self.received:
            if time.monotonic() - self._when > _ONE:
                worker_process.stop()
                os._exit(128 + signum)
            return
        self.received, self._when = signum, time.monotonic()
        worker_process.stop()
