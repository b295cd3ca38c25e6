"""The section and small matrices as symbols, from which the step map is compiled."""

from __future__ import annotations

import functools
from collections.abc import Iterable

import heyoka as hy

from gaitsweep.tasks.mechanics.equations import ZERO, Solver, Sym, Symbols, rows
from gaitsweep.tasks.mechanics.impacts import heelstrike, kneestrike, release
from gaitsweep.tasks.mechanics.lumped import Structure


def start_of_step(structure: Structure, p: Symbols, y: list[Sym]) -> list[Sym]:
    """State just after heelstrike at section coordinates y, as symbols."""
    if structure.kneed:
        return [y[0], -y[0], -y[0], *release(structure, p, y[0], y[1], y[2])]
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


def field(p: Symbols, x: list[Sym], free_knee: bool) -> list[Sym]:
    """Rates at which a state x changes, as symbols."""
    n = len(x) // 2
    M, f = rows(p, x[:n], x[n:], free_knee)
    return [*x[n:], *Solver(M)(f)]


def vector(name: str, n: int) -> list[Sym]:
    """Variables of a vector."""
    names = [f"{name}{i}" for i in range(n)]
    return list(hy.make_vars(*names))


def matrix(name: str, n: int, m: int) -> list[list[Sym]]:
    """Variables of an n x m matrix."""
    rows = []
    for i in range(n):
        names = [f"{name}{i}_{j}" for j in range(m)]
        rows.append(list(hy.make_vars(*names)))
    return rows


def flat(matrix: list[list[Sym]]) -> list[Sym]:
    """Entries of a matrix, row by row."""
    return [x for row in matrix for x in row]


def dot(a: Iterable[Sym], b: Iterable[Sym], start: Sym = ZERO) -> Sym:
    """Sum of the products of two vectors' entries, added to a start."""
    return sum((x * y for x, y in zip(a, b, strict=True)), start)


def inverse(J: list[list[Sym]]) -> list[list[Sym]]:
    """Inverse of a square matrix of symbols by its adjugate, whose minors are written
    once each.
    """
    n = len(J)

    @functools.cache
    def minor(rows: tuple[int, ...], columns: tuple[int, ...]) -> Sym:
        if not rows:
            return hy.expression(1.0)
        value = ZERO
        for k, column in enumerate(columns):
            others = (*columns[:k], *columns[k + 1 :])
            value = value + (-1.0) ** k * J[rows[0]][column] * minor(rows[1:], others)
        return value

    every = tuple(range(n))
    without = [(*every[:k], *every[k + 1 :]) for k in every]
    determinant = minor(every, every)
    rows = []
    for i in range(n):
        row = []
        for j in range(n):
            cofactor = (-1.0) ** (i + j) * minor(without[j], without[i])
            row.append(cofactor / determinant)
        rows.append(row)

    return rows


def derivatives_along(
    values: list[Sym], x: list[Sym], D: list[list[Sym]]
) -> list[list[Sym]]:
    """Derivative of each value by x along the directions D."""
    columns = list(zip(*D, strict=True))
    along = []
    for value in values:
        gradient = [hy.diff(value, coordinate) for coordinate in x]
        along.append([dot(gradient, column) for column in columns])
    return along
