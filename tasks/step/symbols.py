"""The section and small matrices as symbols, from which the step map is compiled."""

from __future__ import annotations

import functools

import heyoka as hy

from gaitsweep.tasks.mechanics.equations import ZERO, Sym, Symbols
from gaitsweep.tasks.mechanics.impacts import heelstrike, kneestrike
from gaitsweep.tasks.mechanics.lumped import Structure


def start_of_step(structure: Structure, p: Symbols, y: list[Sym]) -> list[Sym]:
    """State just after heelstrike at section coordinates y, as symbols."""
    if structure.kneed:
        return [y[0], -y[0], -y[0], *heelstrike(p, y[0], y[1], y[2], True)]
    if structure.point_foot:
        # The impulse has no moment about the hip of a leg whose mass is at the foot
        # that leaves the ground.
        return [y[0], -y[0], y[1], y[1] * hy.cos(2.0 * p.scale * y[0])]
    return [y[0], -y[0], y[1], y[2]]


def lock_knee(p: Symbols, x: list[Sym]) -> list[Sym]:
    """State of two links after kneestrike from that of three before it, as symbols."""
    return [x[0], x[1], *kneestrike(p, x[:3], x[3:])]


def end_of_step(structure: Structure, p: Symbols, x: list[Sym]) -> list[Sym]:
    """Section coordinates of two links' state x just before heelstrike, as symbols."""
    if structure.kneed:
        return [x[1], x[2], x[3]]
    return [x[1], *heelstrike(p, x[1], x[2], x[3], False)[: structure.dimension - 1]]


def matrix(name: str, n: int, m: int) -> list[list[Sym]]:
    """Variables of an n x m matrix."""
    entries = hy.make_vars(*(f"{name}{i}_{j}" for i in range(n) for j in range(m)))
    return [list(entries[i * m : (i + 1) * m]) for i in range(n)]


def flat(matrix: list[list[Sym]]) -> list[Sym]:
    """Entries of a matrix, row by row."""
    return [x for row in matrix for x in row]


def inverse(J: list[list[Sym]]) -> list[list[Sym]]:
    """Inverse of a square matrix of symbols by its adjugate, whose minors are written
    once each.
    """
    every = tuple(range(len(J)))

    @functools.cache
    def minor(rows: tuple[int, ...], columns: tuple[int, ...]) -> Sym:
        if not rows:
            return hy.expression(1.0)
        first, rest = rows[0], rows[1:]
        terms = (
            (-1.0) ** k
            * J[first][column]
            * minor(rest, (*columns[:k], *columns[k + 1 :]))
            for k, column in enumerate(columns)
        )
        return sum(terms, ZERO)

    def without(k: int) -> tuple[int, ...]:
        return (*every[:k], *every[k + 1 :])

    det = minor(every, every)
    return [
        [(-1.0) ** (i + j) * minor(without(j), without(i)) / det for j in every]
        for i in every
    ]


def derivatives_along(
    values: list[Sym], x: list[Sym], D: list[list[Sym]]
) -> list[list[Sym]]:
    """Derivative of each value by x along the directions D."""
    gradients = [[hy.diff(v, coordinate) for coordinate in x] for v in values]
    return [
        [sum((g * D[i][d] for i, g in enumerate(row)), ZERO) for d in range(len(D[0]))]
        for row in gradients
    ]
