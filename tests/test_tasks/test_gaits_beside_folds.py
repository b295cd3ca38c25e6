"""Gaits of two and more steps beside the folds and flips of their branches: none is lost."""

from collections import Counter

import numpy as np
import pytest

from tasks.continuation import atlas
from tasks.continuation.refine import FINE
from tasks.follow_cycles import cycle_branches
from tasks.registry import GAITS, STATUSES
from tasks.solve_cycles import _beside_fold, cycle_points
from tasks.step.problem import Problem
from tasks.walkers.resolve import WalkerError, resolve

WANT = ("stance_angle", "branch", "piece", "error_bound")
#: Relative distances of slopes from those of folds and flips.
NEAREST, FARTHEST = 1e-9, 1e-3
#: Slopes beside each, and walkers of the long test: they have 500 gaits and more.
SLOPES, WALKERS = 6, 60


def followed(walker, steps, **keys):
    problem = Problem(resolve(walker, keys))
    return problem, cycle_branches(problem, atlas.survey(problem, FINE), steps)


def special(branch):
    """Folds and flips of a branch: kinds, ln slopes, the side of the gaits, their pieces, and the room there."""
    bounds = [0, *sorted(branch.folds), len(branch.cycles) - 1]
    q = [branch.cycles[k].q for k in bounds]
    for j, k in enumerate(bounds[1:-1], 1):
        room = min(abs(q[j] - q[j - 1]), abs(q[j + 1] - q[j]))
        yield "fold", q[j], np.sign(branch.cycles[k + 1].q - q[j]), (j - 1, j), room
    for end, neighbour, piece, why in ((0, 1, 0, branch.ends[0]), (-1, -2, len(bounds) - 2, branch.ends[1])):
        if why == "branch_point":
            yield "birth", q[end], np.sign(q[neighbour] - q[end]), (piece,), abs(q[neighbour] - q[end])
    for flip in branch.flips:
        near = min(branch.guesses(flip.q), key=lambda guess: np.abs(guess.Y - flip.Y).max(), default=None)
        if near is not None:
            room = min(abs(flip.q - each) for each in (q[near.piece], q[near.piece + 1]))
            for side in (-1, 1):
                yield "flip", flip.q, side, (near.piece,), room


def lost(problem, branches, steps, random):
    """What is wrong beside the folds and flips of branches, and how many gaits were asked for, by kind."""
    wrong, asked = [], Counter()
    for number, branch in enumerate(branches):
        for kind, q, side, pieces, room in special(branch):
            if not room > 4 * NEAREST:
                continue
            beyond = np.exp(random.uniform(np.log(NEAREST), np.log(min(FARTHEST, room / 2)), SLOPES))
            slopes = np.exp(q + side * beyond)
            found = cycle_points(problem, branches, {"steps": steps, "slope": slopes, "want": WANT})
            for i, slope in enumerate(slopes.tolist()):
                # Archives have labels for so many gaits that none is left out.
                if sum(1 for other in branches for _ in other.guesses(np.log(slope))) >= len(GAITS):
                    continue
                at = {name: found[name][i] for name in (*WANT, "status")}
                own = [np.flatnonzero((at["branch"] == number) & (at["piece"] == piece)) for piece in pieces]
                asked[kind] += len(pieces)
                if any(len(each) != 1 or at["status"][each[0]] != STATUSES["converged"] for each in own):
                    wrong.append((kind, slope, beyond[i], at["status"].tolist(), at["piece"].tolist()))
                elif len(own) == 2:
                    angle, bound = (at[name][np.concatenate(own)] for name in ("stance_angle", "error_bound"))
                    if not abs(angle[1] - angle[0]) > bound @ angle:
                        wrong.append((kind, slope, beyond[i], "the two gaits are not told apart", bound.tolist()))
    return wrong, asked


def drawn(seed):
    """A walker of the catalogue with other keys, and a number of steps."""
    random = np.random.default_rng(seed)
    walker, keys = [
        ("D", {}),
        ("D", {"R": random.uniform(0, 0.4)}),
        ("E", {"foot_mass_ratio": np.exp(random.uniform(np.log(1e-3), np.log(0.2)))}),
        ("A", {"m_h": random.uniform(0, 3)}),
        ("A", {"detuning": random.uniform(0, 1)}),
        ("C", {"m_h": random.uniform(0, 3)}),
        ("C", {"detuning": random.uniform(0, 1), "m_h": random.uniform(0, 1)}),
        ("physical", {"m_h": random.uniform(0, 2)}),
        ("physical-straight", {"m_h": random.uniform(0, 2)}),
        ("B", {"m_h": random.uniform(0, 2), "R": random.uniform(0.1, 0.5)}),
    ][seed % 10]
    return walker, {key: float(value) for key, value in keys.items()}, 2 + seed // 10 % 3, random


def test_no_gait_is_lost_beside_a_fold_or_a_flip():
    """The two gaits of three steps of the simplest walker vanished within 3e-8 of their fold."""
    problem, branches = followed("D", 3)
    wrong, asked = lost(problem, branches, 3, np.random.default_rng(1))
    assert not wrong and asked == {"fold": 2 * SLOPES, "flip": 2 * SLOPES}


@pytest.mark.soak
@pytest.mark.timeout(7200)
def test_no_gait_of_random_walkers_is_lost_beside_folds_and_flips(tell, resumed):
    for seed in resumed(WALKERS):
        walker, keys, steps, random = drawn(seed)
        try:
            problem, branches = followed(walker, steps, **keys)
        except WalkerError:
            continue
        wrong, asked = lost(problem, branches, steps, random)
        resumed.found.update(asked)
        tell(f"{resumed.state}: {resumed.found.total()} gaits, {dict(resumed.found)}")
        assert not wrong, (seed, walker, keys, steps, wrong)
    if resumed.state.startswith(str(WALKERS)):
        assert resumed.found.total() >= 500


def test_within_the_error_of_a_fold_its_gaits_are_left_open():
    problem, branches = followed("D", 3)
    ((_, fold),) = [(k, branches[0].cycles[k]) for k in branches[0].folds]
    assert 0 < fold.error < 1e-12
    slopes = np.exp(fold.q + fold.error * np.array([0.0, 0.9, -0.9, -10.0]))
    found = cycle_points(problem, branches, {"steps": 3, "slope": slopes, "want": WANT})
    for status, reason in zip(found["status"][:3], found["reason"][:3], strict=True):
        assert sorted(status.tolist()) == sorted([STATUSES["not_converged"]] * 2 + [STATUSES["no_gait"]] * 2)
        (open_,) = {found["reasons"][reason[k]] for k in np.flatnonzero(status == STATUSES["not_converged"])}
        assert open_.startswith("Whether there is a gait is open: the slope is that of a fold")
    assert (found["status"][3] == STATUSES["no_gait"]).all()


def test_a_gait_beside_a_fold_moves_by_the_square_not_by_its_linearisation():
    for x in (1e-7, 0.01, 0.4, 0.5):
        reach = [a for a in np.linspace(0, 3, 300001) if abs(1 - a * a) <= 2 * x]
        farthest = max(1 - min(reach), max(reach) - 1)
        assert _beside_fold(0.1, np.array([0.1 * x, 0.0])) * x == pytest.approx(farthest, rel=1e-3, abs=2e-5)
    # So near that rounding may leave no gait.
    assert _beside_fold(0.1, np.array([0.0501])) == np.inf
