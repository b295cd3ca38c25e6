"""Places and studies of tests in which no worker computes."""

import contextlib
from collections import deque
from pathlib import Path

from gaitsweep.pipeline.engine.engine import Engine
from gaitsweep.pipeline.engine.request import Answer
from gaitsweep.pipeline.engine.work import Work
from gaitsweep.pipeline.graph.plan import Plan
from gaitsweep.pipeline.store.memory import Memory
from gaitsweep.pipeline.study import parse, toml
from gaitsweep.pipeline.study.model import Study


class Answering(Engine):
    """A place where a function answers each request, in the order of their submission.

    Attributes
    ----------
    asked : list of Request
    """

    def __init__(self, answer, slots=2):
        super().__init__(slots)
        self.answer, self.slots = answer, slots
        self.asked = []
        self._submitted = deque()

    @contextlib.contextmanager
    def open(self, say):
        yield self

    def has_room(self, seconds=0.0):
        return len(self._submitted) < self.slots

    def submit(self, request):
        self.asked.append(request)
        self._submitted.append((len(self.asked), request))
        return len(self.asked)

    def completed(self, timeout):
        ticket, request = self._submitted.popleft()
        yield ticket, self.answer(request)


def ok(request):
    """Answer that a task which is no chunk has no columns."""
    return Answer()


def study_of(text: str) -> Study:
    """Study of a text."""
    return parse.parse(toml.read(text), text, Path("s.toml"))


def work_of(text, store=None, **options) -> Work:
    """Work of a study in memory."""
    store = Memory() if store is None else store
    return Work(Plan(study_of(text), store, **options))
