"""The order of strikes: a solution of a gait's equations is a step if its strikes come
first and its legs pass once.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

from flint import arb

from gaitsweep.tasks.proofs.enclosed_step import Step
from gaitsweep.tasks.proofs.enclosure import NotProvedError
from gaitsweep.tasks.proofs.signs import Stretch, zeros

HEEL, KNEE, LEGS = (1, 1), (0, 1, -1), (1, -1)


@dataclass(frozen=True)
class Events:
    """Names of the events of a step in order, and the gait's label, `long` or `short`."""

    names: list[str]
    label: str


def events(step: Step, times: Sequence[arb]) -> Events:
    """Show that the strikes solved for are the first of their kind, for every start in
    the step's box.

    Parameters
    ----------
    step : Step
    times : sequence of arb
        Brackets of the strikes.

    Returns
    -------
    Events

    Raises
    ------
    NotProvedError
        If another strike comes earlier, the legs do not pass exactly once, or a guard
        grazes.
    """
    kneed = len(times) == 2
    phases = list(
        zip([arb(0), *times[:-1]], [p.pieces for p in step.phases], strict=True)
    )
    order: list[tuple[str, arb, arb]] = []
    if kneed:
        order += _knee(phases[:1], times[0], 2 if step.released_at_rest else 1)
    order += _heel(phases, times[-1])
    order += _legs(phases)
    order.sort(key=lambda event: float(event[1].mid()))
    for (one, _, end), (other, begin, _) in itertools.pairwise(order):
        if not end < begin:
            raise NotProvedError(
                f"Which comes first, {one} or {other}, is not decided."
            )

    return Events([name for name, _, _ in order], _label(step))


def _knee(phases: Sequence, time: arb, order: int) -> list[tuple[str, arb, arb]]:
    """The knee flexes, at once or after hyperextension, and its first return is the
    kneestrike; `order` is that of its zero at the start.
    """
    sign, crossings = zeros(phases, KNEE, "knee", order)
    rises = [z.rises for z in crossings]
    if rises != ([False] if sign == "+" else [True, False]):
        raise NotProvedError(
            f"The kneestrike is not the first return of the flexion, which has {len(crossings)} zeros before it."
        )

    _ends(crossings, time, "kneestrike")

    return [
        *(("knee_flexes", z.low, z.high) for z in crossings[:-1]),
        ("kneestrike", time, time),
    ]


def _heel(phases: Sequence, time: arb) -> list[tuple[str, arb, arb]]:
    """The heelstrike is the first fall of the guard to zero behind the stance foot."""
    _, crossings = zeros(phases, HEEL, "heelstrike", 1)
    if not crossings or crossings[-1].rises or not crossings[-1].stance < 0:
        raise NotProvedError("The step does not end with a heelstrike.")

    for zero in crossings[:-1]:
        if not zero.rises and not zero.stance > 0:
            raise NotProvedError("A heelstrike comes earlier than the one solved for.")

    _ends(crossings, time, "heelstrike")
    return [("heelstrike", time, time)]


def _legs(phases: Sequence) -> list[tuple[str, arb, arb]]:
    """The swing leg passes the stance leg exactly once."""
    sign, crossings = zeros(phases, LEGS, "leg passage", 0)
    if sign != "+" or len(crossings) != 1:
        raise NotProvedError(
            f"Not anthropomorphic: the legs pass {len(crossings)} times."
        )
    return [("legs_pass", crossings[0].low, crossings[0].high)]


def _ends(crossings: Sequence[Stretch], time: arb, name: str) -> None:
    """Require that the strike's bracket meets the last zero alone: the strike solved
    for is a zero inside it.
    """
    if any(not zero.high < time for zero in crossings[:-1]):
        raise NotProvedError(
            f"The bracket of the {name} meets another zero of its guard."
        )


def _label(step: Step) -> str:
    """`long` where the swing leg is less than half as fast again as the stance leg just
    before heelstrike.
    """
    _, _, stance, swing = step.ends[-1]
    if not (stance < 0 or stance > 0):
        raise NotProvedError(
            "The stance leg's rate at heelstrike is not told from zero."
        )

    ratio = (swing - stance) / abs(stance)
    if ratio < arb("0.5"):
        return "long"
    if ratio >= arb("0.5"):
        return "short"

    raise NotProvedError("The gait lies between a long and a short step.")
