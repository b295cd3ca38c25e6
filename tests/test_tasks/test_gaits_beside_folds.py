"""Gaits of two and more steps beside the folds and flips of their branches: none is
lost.
"""

from collections import Counter

import numpy as np
import pytest

from gaitsweep.tasks.branches import atlas
from gaitsweep.tasks.branches.refine import FINE
from gaitsweep.tasks.branches.special_points import flips, special_points
from gaitsweep.tasks.contract.registry import GAITS, STATUSES
from gaitsweep.tasks.step.problem import Problem
from gaitsweep.tasks.studies.follow_cycles import cycle_branches
from gaitsweep.tasks.studies.request import Request
from gaitsweep.tasks.studies.solve_points import _solve_branches
from gaitsweep.tasks.walkers.resolve import WalkerError, resolve

WANT = ("stance_angle", "branch", "piece", "error_bound")
#: Relative distances of slopes from those of folds and flips.
NEAREST, FARTHEST = 1e-9, 1e-3
#: Slopes beside each, and walkers of the long test: they have 500 gaits and more.
SLOPES, WALKERS = 6, 60


def followed(walker, steps, **keys):
    problem = Problem(resolve(walker, keys))
    return problem.of_steps(steps), cycle_branches(
        problem, atlas.survey(problem, FINE), steps
    )


def points(problem, branches, slopes, **params):
    """Gaits of several steps at slopes."""
    request = Request.of({"slope": slopes, "want": WANT, **params})
    (found,) = _solve_branches(problem, [{}], [branches], request)
    return found


def special(problem, branch):
    """Folds and flips of a branch: kinds, ln slopes, the side of the gaits, their
    pieces, and the room there.
    """
    turns = [0, *branch.turns(), len(branch.q) - 1]
    q = branch.q[turns]

    def piece(segment):
        return int(branch.piece(np.array([segment]))[0])

    for j, k in enumerate(turns[1:-1], 1):
        room = min(abs(q[j] - q[j - 1]), abs(q[j + 1] - q[j]))
        yield (
            "fold",
            q[j],
            np.sign(branch.q[k + 1] - q[j]),
            (piece(k - 1), piece(k)),
            room,
        )
    for end, neighbour, why in ((0, 1, branch.why[0]), (-1, -2, branch.why[1])):
        if why == "branch_point":
            side = np.sign(branch.q[neighbour] - branch.q[end])
            yield (
                "birth",
                q[end],
                side,
                (piece(0 if end == 0 else len(branch.q) - 2),),
                abs(q[neighbour] - q[end]),
            )
    for flip in flips(problem, branch):
        at = float(flip.q[0])
        segment = min(
            branch.guesses(flip.q), key=lambda guess: np.abs(guess[1] - flip.Z).max()
        )[2][0]
        room = min(abs(at - each) for each in q)
        for side in (-1, 1):
            yield "flip", at, side, (piece(segment),), room


def lost(problem, branches, random):
    """What is wrong beside the folds and flips of branches, and how many gaits were
    asked for, by kind.
    """
    wrong, asked = [], Counter()
    for number, branch in enumerate(branches):
        for kind, q, side, pieces, room in special(problem, branch):
            if not room > 4 * NEAREST:
                continue
            beyond = np.exp(
                random.uniform(np.log(NEAREST), np.log(min(FARTHEST, room / 2)), SLOPES)
            )
            slopes = np.exp(q + side * beyond)
            found = points(problem, branches, slopes)
            for i, slope in enumerate(slopes.tolist()):
                # Archives have labels for so many gaits that none is left out.
                if sum(
                    len(other.guesses(np.log([slope]))) for other in branches
                ) >= len(GAITS):
                    continue
                at = {name: found[name][i] for name in (*WANT, "status")}
                own = [
                    np.flatnonzero((at["branch"] == number) & (at["piece"] == piece))
                    for piece in pieces
                ]
                asked[kind] += len(pieces)
                if any(
                    len(each) != 1 or at["status"][each[0]] != STATUSES["converged"]
                    for each in own
                ):
                    wrong.append(
                        (
                            kind,
                            slope,
                            beyond[i],
                            at["status"].tolist(),
                            at["piece"].tolist(),
                        )
                    )
                elif len(own) == 2:
                    angle, bound = (
                        at[name][np.concatenate(own)]
                        for name in ("stance_angle", "error_bound")
                    )
                    if not abs(angle[1] - angle[0]) > bound @ angle:
                        wrong.append(
                            (
                                kind,
                                slope,
                                beyond[i],
                                "the two gaits are not told apart",
                                bound.tolist(),
                            )
                        )
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
    return (
        walker,
        {key: float(value) for key, value in keys.items()},
        2 + seed // 10 % 3,
        random,
    )


def test_no_gait_is_lost_beside_a_fold_or_a_flip():
    """The two gaits of three steps of the simplest walker vanished within 3e-8 of their
    fold.
    """
    problem, branches = followed("D", 3)
    wrong, asked = lost(problem, branches, np.random.default_rng(1))
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
        wrong, asked = lost(problem, branches, random)
        resumed.found.update(asked)
        tell(f"{resumed.state}: {resumed.found.total()} gaits, {dict(resumed.found)}")
        assert not wrong, (seed, walker, keys, steps, wrong)
    if resumed.state.startswith(str(WALKERS)):
        assert resumed.found.total() >= 500


def test_within_the_error_of_a_fold_no_gait_is_claimed_but_within_its_bound():
    problem, branches = followed("D", 3)
    (fold,) = [
        each for each in special_points(problem, branches[0]) if each["kind"] == "fold"
    ]
    assert 0 < fold["error_bound"] < 1e-12
    slopes = fold["slope"] * (
        1 + fold["error_bound"] * np.array([0.0, 0.9, -0.9, -10.0])
    )
    found = points(problem, branches, slopes)
    assert (found["status"][2:] == STATUSES["no_gait"]).all()
    # More digits tell the two gaits apart, or show that there is none; where both
    # guesses lead to one, it is claimed once.
    for k in (0, 1):
        solved = found["status"][k] == STATUSES["converged"]
        angle, bound = found["stance_angle"][k, solved], found["error_bound"][k, solved]
        assert len(angle) < 2 or angle[0] - angle[1] > bound @ angle
