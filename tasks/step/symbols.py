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
    stance = y[0]
    stance_rate = y[1]
    if structure.kneed:
        rates = release(structure, p, stance, stance_rate, y[2])
        return [stance, -stance, -stance, *rates]

    if structure.point_foot:
        # The impulse has no moment about the hip of a leg whose mass is at the foot
        # that leaves the ground.
        between_legs = 2.0 * p.scale * stance
        swing_rate = stance_rate * hy.cos(between_legs)
        return [stance, -stance, stance_rate, swing_rate]

    return [stance, -stance, stance_rate, y[2]]


def lock_knee(p: Symbols, x: list[Sym]) -> list[Sym]:
    """State of two links after kneestrike from that of three before it, as symbols."""
    angles = x[:3]
    rates_before = x[3:]
    rates = kneestrike(p, angles, rates_before)
    return [*angles[:2], *rates]


def end_of_step(structure: Structure, p: Symbols, x: list[Sym]) -> list[Sym]:
    """Section coordinates of two links' state x just before heelstrike, as symbols."""
    _, swing, stance_rate, swing_rate = x
    if structure.kneed:
        return [swing, stance_rate, swing_rate]

    rates = heelstrike(p, swing, stance_rate, swing_rate, False)
    coordinates = [swing, *rates]
    return coordinates[: structure.dimension]


def field(p: Symbols, x: list[Sym], free_knee: bool) -> list[Sym]:
    """Rates at which a state x changes, as symbols."""
    links = len(x) // 2
    q = x[:links]
    rate = x[links:]
    M, f = rows(p, q, rate, free_knee)
    solve = Solver(M)
    accelerations = solve(f)
    return [*rate, *accelerations]


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
    value = start
    for x, y in zip(a, b, strict=True):
        value = value + x * y
    return value


def inverse(J: list[list[Sym]]) -> list[list[Sym]]:
    """Inverse of a square matrix of symbols by its adjugate, whose minors are written
    once each.
    """

    @functools.cache
    def minor(rows: tuple[int, ...], columns: tuple[int, ...]) -> Sym:
        """Determinant of some rows and columns, expanded along the first row."""
        if not rows:
            return hy.expression(1.0)

        first, *below = rows
        sign = 1.0
        value = ZERO
        for column in columns:
            smaller = minor(tuple(below), _without(columns, column))
            value = value + sign * J[first][column] * smaller
            sign = -sign

        return value

    every = tuple(range(len(J)))
    determinant = minor(every, every)
    rows = []
    for i in every:
        row = []
        for j in every:
            sign = (-1.0) ** (i + j)
            transposed = minor(_without(every, j), _without(every, i))
            row.append(sign * transposed / determinant)
        rows.append(row)

    return rows


def _without(numbers: tuple[int, ...], one: int) -> tuple[int, ...]:
    """All numbers but one."""
    return tuple(number for number in numbers if number != one)


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
