"""Zeros of a guard along a motion: where its sign is certain, and that it passes each
zero once, transversally.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

from flint import arb

from gaitsweep.tasks.proofs.enclosure import NotProvedError, Piece
from gaitsweep.tasks.proofs.motion import Series, evaluate

#: Bisections of a Taylor step until a zero is pinned down, and until a guard counts as
#: grazing.
ZERO_DEPTH, MAX_DEPTH = 10, 24
SIGNS = ("+", "-")


@dataclass(frozen=True)
class Stretch:
    """A stretch of time: the guard is `+` or `-` on it, or strictly `rises` or `falls`
    through it.

    `stance` holds the stance angle meanwhile [rad]. A zero is simple and the only one
    of its stretch.
    """

    kind: str
    low: arb
    high: arb
    stance: arb

    @property
    def rises(self) -> bool:
        """Whether the guard rises through it."""
        return self.kind == "rises"


#: A guard is a linear form of the angles.
Guard = tuple[int, ...]


def zeros(
    phases: Sequence[tuple[arb, Sequence[Piece]]],
    guard: Guard,
    name: str,
    order: int,
) -> tuple[str, list[Stretch]]:
    """Sign just after the start, and in order the stretches that hold the zeros after
    it, one each.

    Parameters
    ----------
    phases : sequence of (arb, pieces)
        When each phase starts, and its motion.
    guard : tuple of int
        Coefficients of the angles (stance, thigh, shank).
    name : str
        What the guard is called in a refusal.
    order : int
        Of the zero with which the guard of a strike begins: it vanishes identically at
        the start of the step, where its sign is that of guard / t^order, and again
        somewhere on the last stretch. It is 2 where the guard's rate vanishes there
        too, and 0 for the guard of no strike.

    Returns
    -------
    str, list of Stretch

    Raises
    ------
    NotProvedError
        If the guard cannot be told from a grazing one, or no strike's from zero at the
        end.
    """
    stretches = _joined(_stretches(phases, guard, name, order))
    befores = [None, *stretches[:-1]]
    afters = [*stretches[1:], None]
    crossings = []
    for before, current, after in zip(befores, stretches, afters, strict=True):
        if current.kind not in SIGNS:
            if _is_crossed(before, current, after, name, order):
                crossings.append(current)
        elif after is not None and after.kind in SIGNS:
            raise NotProvedError(
                f"Grazing: the {name} guard changes sign between phases."
            )

    return stretches[0].kind, crossings


def _joined(stretches: Iterable[Stretch]) -> list[Stretch]:
    """Stretches in order, those of one kind that follow each other as one."""
    joined: list[Stretch] = []
    for stretch in stretches:
        if joined and joined[-1].kind == stretch.kind:
            last = joined.pop()
            stance = last.stance.union(stretch.stance)
            stretch = Stretch(stretch.kind, last.low, stretch.high, stance)
        joined.append(stretch)

    return joined


def _is_crossed(
    before: Stretch | None,
    current: Stretch,
    after: Stretch | None,
    name: str,
    order: int,
) -> bool:
    """Whether the guard changes its sign on a stretch on which it rises or falls, by
    those before and after it; at the end of the step that of a strike vanishes.
    """
    is_signed = before is not None and before.kind in SIGNS
    if not is_signed or (after is not None and after.kind not in SIGNS):
        raise NotProvedError(
            f"Grazing: the {name} guard and its rate are not told from zero at the same time."
        )

    assert before is not None
    from_sign = "-" if current.rises else "+"
    if after is not None:
        changes = after.kind != before.kind
        if changes and before.kind != from_sign:
            raise NotProvedError(
                f"Grazing: the {name} guard changes sign against its rate."
            )
        return changes

    if not order and before.kind == from_sign:
        raise NotProvedError(
            f"Whether the {name} guard vanishes at the end of the step is not decided."
        )

    return bool(order and before.kind == from_sign)


def _stretches(
    phases: Sequence[tuple[arb, Sequence[Piece]]], guard: Guard, name: str, order: int
) -> Iterator[Stretch]:
    for number, (begin, pieces) in enumerate(phases):
        for piece in pieces:
            is_first = number == 0 and piece is pieces[0]
            own_order = order if is_first else 0
            yield from _classified(piece, begin, guard, name, own_order)


def _classified(
    piece: Piece, begin: arb, guard: Guard, name: str, order: int
) -> Iterator[Stretch]:
    """Stretches of one Taylor step, in order; at its start the guard may have a zero of
    an order.
    """
    links = len(piece.series) // 2
    value, rate = (_form(guard, piece.series[first:]) for first in (0, links))
    quotient, clock = value[order:], begin + piece.start
    waiting: list[tuple[arb, arb, int]] = [(arb(0), piece.h, 0)]
    while waiting:
        low, high, depth = waiting.pop()
        span = low.union(high)
        if order and low == 0:
            kind = _sign(evaluate(quotient, span))
        else:
            kind = _kind(value, rate, low, high, span)

        if kind in SIGNS or (kind and depth >= ZERO_DEPTH):
            yield Stretch(
                kind, clock + low, clock + high, evaluate(piece.series[0], span)
            )
            continue

        if depth == MAX_DEPTH:
            raise NotProvedError(
                f"Grazing: the {name} guard and its rate cannot be told from zero together."
            )

        middle = ((low + high) / 2).mid()
        waiting += [(middle, high, depth + 1), (low, middle, depth + 1)]


def _kind(value: Series, rate: Series, low: arb, high: arb, span: arb) -> str:
    middle = ((low + high) / 2).mid()
    speed = evaluate(rate, span)
    return _sign(evaluate(value, middle) + speed * (span - middle)) or {
        "+": "rises",
        "-": "falls",
    }.get(_sign(speed), "")


def _sign(x: arb) -> str:
    return "+" if x > 0 else "-" if x < 0 else ""


def _form(guard: Guard, series: Sequence[Series]) -> Series:
    """Series of a linear form of angles or rates."""
    terms = [[g * x for x in s] for g, s in zip(guard, series, strict=False) if g]
    return [sum(column[1:], column[0]) for column in zip(*terms, strict=True)]
