"""Labels at one slope, and the branches and pieces that curves follow from slope to
slope.
"""

import copy
import itertools
import tomllib
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from conftest import ROOT
from gaitsweep.tasks.branches.branch import Branch
from gaitsweep.tasks.branches.tracking import MIN_SLOPE
from gaitsweep.tasks.contract import status
from gaitsweep.tasks.contract.registry import GAITS
from gaitsweep.tasks.gaits.labels import places
from gaitsweep.tasks.measures.gaits import Part, nothing_solved, store
from gaitsweep.tasks.orbits.initial_states import gaits_at
from gaitsweep.tasks.studies import solve_at_slope
from gaitsweep.tasks.studies.follow_branches import branch as follow
from gaitsweep.tasks.studies.solve_points import atlas, points, solve_line, spans
from gaitsweep.tasks.studies.trace_motion import trace
from lines import WANT, _atlas, branches, gait, solved

#: Slopes of the machine's branches, folds at 0.0191 and 0.0530 and ends on the way
#: included.
SLOPES = np.linspace(0.018, 0.2, 140)


def by_the_words(angle, ratio):
    """Labels of the gaits at one slope, as the docs put it."""
    order = sorted(
        (k for k in range(len(angle)) if np.isfinite(angle[k])), key=lambda k: -angle[k]
    )
    found, taken, others = np.full(len(angle), -1), set(), itertools.count(2)
    for k in order:
        own = 0 if ratio[k] < 0.5 else 1
        found[k] = next(others) if own in taken else own
        taken.add(own)
    return found


@given(
    st.lists(
        st.lists(
            st.tuples(
                st.sampled_from([0.1, 0.2, 0.3, 0.4, np.nan]),
                st.floats(-1, 2) | st.just(np.nan),
            ),
            min_size=5,
            max_size=5,
        ),
        min_size=1,
        max_size=4,
    )
)
def test_the_largest_angle_has_the_label_and_the_others_follow(table):
    angle, ratio = np.array(table).T
    # Equal angles are no case of ours.
    angle = angle + 1e-3 * np.arange(5)[:, None]
    expected = np.array(
        [by_the_words(a, r) for a, r in zip(angle.T, ratio.T, strict=True)]
    ).T
    np.testing.assert_array_equal(places(angle, ratio), expected)


def test_of_two_long_gaits_the_one_with_the_larger_angle_is_long():
    found = solved("physical", SLOPES)
    long, other = (
        found["stance_angle"][:, GAITS.index(label)] for label in ("long", "other1")
    )
    both = np.isfinite(other) & (
        found["heelstrike_rate_ratio"][:, GAITS.index("other1")] < 0.5
    )
    assert both.any() and (long[both] > other[both]).all()


def test_a_gait_keeps_its_label_whichever_are_wanted():
    whole = solved("physical", SLOPES)
    for n in range(1, len(GAITS)):
        for wanted in itertools.combinations(GAITS, n):
            part = points(
                {
                    "line": {"walker": "physical", "set": {}},
                    "slope": SLOPES,
                    "want": WANT,
                    "gaits": wanted,
                },
                [_atlas("physical", ())],
            )
            for g, label in enumerate(GAITS):
                for name in ("branch", "piece", "stance_angle"):
                    expected = (
                        whole[name][:, g]
                        if label in wanted
                        else np.full(len(SLOPES), whole[name][0, 3])
                    )
                    np.testing.assert_array_equal(part[name][:, g], expected)


@pytest.mark.parametrize(
    ("walker", "keys"), [("A", {"detuning": 0.1}), ("physical", {}), ("D", {})]
)
def test_branches_are_ranked_by_their_lowest_slope_then_their_angle(walker, keys):
    _, found = branches(walker, **keys)
    least = np.log(MIN_SLOPE)
    rank = [
        (
            max(b.q.min(), least),
            np.interp(max(b.q.min(), least), *b.Z[[-1, 0], :3])
            if b.q.min() < least
            else b.Z[0, b.q.argmin()],
        )
        for b in found
    ]
    assert len(rank) == 2 and rank == sorted(rank)


def test_a_gait_names_the_branch_and_piece_it_lies_on():
    _, found = branches("physical")
    grid = solved("physical", SLOPES)
    seen = set()
    for number, branch in enumerate(found):
        order = (
            branch.pieces() if branch.q[0] <= branch.q[-1] else branch.pieces()[::-1]
        )
        for piece, (first, last) in enumerate(order):
            mine = (grid["branch"] == number) & (grid["piece"] == piece)
            low, high = np.sort(branch.q[[first, last]])
            inside = (np.log(SLOPES) > low) & (np.log(SLOPES) < high)
            # One gait of each piece at every slope it covers, whatever its label there.
            np.testing.assert_array_equal(mine.sum(axis=1), inside)
            nodes = np.arange(first, last + 1)[np.argsort(branch.q[first : last + 1])]
            near = np.interp(
                np.log(SLOPES[inside]), branch.q[nodes], branch.Z[0, nodes]
            )
            np.testing.assert_allclose(
                np.log(grid["stance_angle"][mine]), near, atol=0.02
            )
            if inside.any():
                seen.add((number, piece))
    assert seen == {(0, 0), (0, 1), (0, 2), (1, 0), (1, 1)}
    nothing = grid["status"] == 1
    assert (grid["branch"][nothing] == -1).all() and (
        grid["piece"][nothing] == -1
    ).all()
    assert grid["branch"].dtype == np.int16


def test_the_stable_gait_of_the_docs_walker_is_one_curve_under_one_label():
    table = tomllib.loads(
        (ROOT / "docs/your-own-walker.md")
        .read_text()
        .split("```toml")[1]
        .split("```")[0]
        .replace("\n   ", "\n")
    )["walker"]
    line = {"line": {"walker": table, "set": {"m_h": 2.0}}}
    slopes = np.linspace(0.005, 0.08, 300)
    found = points({**line, "slope": slopes, "want": WANT}, [atlas(line, [])])
    stable = found["spectral_radius"] < 1
    # The one stable gait is long wherever it is, beside a tiny unstable one too.
    assert stable[:, 0].any() and not stable[:, 1:].any()
    for curve in ((0, 0), (0, 1), (1, 0)):
        row, g = np.nonzero(
            (found["branch"] == curve[0]) & (found["piece"] == curve[1])
        )
        assert len(row) == len(set(row)) > 5
        assert np.abs(np.diff(np.log(found["stance_angle"][row, g]))).max() < 0.5
    assert {
        tuple(p)
        for p in np.stack([found["branch"][:, 0], found["piece"][:, 0]], axis=1)
    } == {(-1, -1), (0, 1)}


@pytest.mark.parametrize("walker", ["A", "C"])
def test_followed_branches_have_the_numbers_and_gaits_of_the_grid(walker):
    found = follow(
        {
            "line": {"walker": walker, "set": {"detuning": 0.1}},
            "slope_from": 0.002,
            "slope_to": 0.1,
            "n": 20,
        },
        [_atlas(walker, (("detuning", 0.1),))],
    )
    slopes = found["branches/slope"]
    inner = (slopes > 0.0051) & (slopes < 0.09)
    grid = solved(walker, slopes[inner], detuning=0.1)
    gap = np.abs(
        np.log(grid["stance_angle"] / found["branches/stance_angle"][inner, None])
    )
    g = np.nanargmin(gap, axis=1)
    rows = np.arange(len(g))
    assert gap[rows, g].max() < 1e-9
    np.testing.assert_array_equal(
        grid["branch"][rows, g], found["branches/branch"][inner]
    )
    assert set(grid["branch"][rows, g].tolist()) == {0, 1}
    for name in (
        "stance_rate",
        "thigh_rate",
        "shank_rate",
        "period",
        "kneestrike_time",
        "spectral_radius",
    ):
        np.testing.assert_allclose(
            found[f"branches/{name}"][inner], grid[name][rows, g], rtol=1e-7
        )
    np.testing.assert_array_equal(
        found["branches/stable"][inner], grid["spectral_radius"][rows, g] < 1
    )
    long = grid["heelstrike_rate_ratio"][rows, g] < 0.5
    np.testing.assert_array_equal(
        found["branches/gait"][inner], np.where(long, "long", "short")
    )


def test_orbits_and_traces_take_the_gaits_that_have_the_labels():
    at = {
        label: gait("physical", 0.0195, label)["stance_angle"]
        for label in ("long", "other1")
    }
    problem, found = branches("physical")
    for label, angle in at.items():
        index, y = gaits_at(problem, found, np.array([0.01, 0.0195]), label)
        assert index.tolist() == [1] and y[0, 0] == pytest.approx(angle, rel=1e-9)
    drawn = trace(
        {
            "line": {"walker": "physical", "set": {}},
            "slope": np.array([0.0195]),
            "gaits": GAITS,
        },
        [_atlas("physical", ())],
    )
    for label, angle in at.items():
        mine = drawn["trace/gait"] == label
        assert drawn["trace/theta_st"][mine][0] == pytest.approx(angle, rel=1e-9)
        assert (np.diff(drawn["trace/time"][mine]) >= 0).all()


def test_solve_counts_the_points_over_which_branches_were_continued():
    nodes = atlas({"line": {"walker": "D", "set": {}}, "coarse": True}, [])["lengths"]
    said = solve_at_slope.solve_one({"walker": "D", "slope": 0.009})["search"]
    assert f"{len(nodes)} branches continued over {nodes.sum()} points" in said


def test_solve_tells_branch_and_piece_and_labels_what_a_search_adds(monkeypatch):
    long, other = solve_at_slope.solve_one({"walker": "physical", "slope": 0.0195})[
        "gaits"
    ]
    assert (long["gait"], long["branch"], long["piece"]) == ("long", 0, 1)
    assert (other["gait"], other["branch"], other["piece"]) == ("other1", 0, 0)
    # A branch that the atlas misses: the search finds its gait, which is on no branch
    # known and has its label.
    survey = solve_at_slope.atlases.survey
    monkeypatch.setattr(
        solve_at_slope.atlases, "survey", lambda *asked: survey(*asked)[:1]
    )
    short, long = sorted(
        solve_at_slope.solve_one({"walker": "D", "slope": 0.009, "all": True})["gaits"],
        key=lambda found: found["stance_angle"],
    )
    assert (short["gait"], short["branch"]) == ("short", 0) and (
        long["gait"],
        long["branch"],
    ) == ("long", None)


@pytest.mark.parametrize(
    ("walker", "slope"),
    [("D", 0.009), ("A", 0.003), ("physical", 0.0195), ("physical", 0.01912294048)],
)
def test_solve_lists_every_gait_once_whatever_the_accuracy(walker, slope):
    """Gaits in few digits were not those that the search found again, and came twice,
    as other1 and other2 too.
    """
    asked = {"walker": walker, "slope": slope, "all": True}

    exact = solve_at_slope.solve_one(asked)["gaits"]
    rounded = solve_at_slope.solve_one({**asked, "accuracy": 1e-3})["gaits"]

    assert len(exact) >= 2
    assert [one["gait"] for one in rounded] == [one["gait"] for one in exact]
    for one, other in zip(rounded, exact, strict=True):
        assert one["error_bound"] <= 1e-3 and one["status"] == "converged"
        within = one["error_bound"] + other["error_bound"]
        assert one["stance_angle"] == pytest.approx(other["stance_angle"], rel=within)
        assert one["period"] == pytest.approx(other["period"], rel=within)


@pytest.mark.parametrize("everything", [False, True])
def test_the_label_of_a_gait_does_not_depend_on_the_accuracy(everything):
    """A ratio of 0.49995 is 0.5 in few digits, which is short."""
    for accuracy in (0.0, 1e-2):
        asked = {
            "walker": "A",
            "slope": 0.4453,
            "accuracy": accuracy,
            "all": everything,
        }

        found = solve_at_slope.solve_one(asked)["gaits"]

        assert [one["gait"] for one in found] == ["long", "short"]


def some_parts(count):
    """Parts of one gait each at the second of three slopes, with falling angles, and of
    one long gait at all.
    """
    names = ("status", "reason", "stance_angle")
    parts = []
    for k in range(count):
        angle = np.array([0.3 - 0.01 * k])
        solved = dict(
            zip(
                names,
                (np.zeros(1, int), np.full(1, status.SETTLED), angle),
                strict=True,
            )
        )
        parts.append(Part(np.array([1]), angle, np.full(1, 0.1), solved))
    angle = np.full(3, 0.2)
    solved = dict(
        zip(names, (np.zeros(3, int), np.full(3, status.SETTLED), angle), strict=True)
    )
    return [*parts, Part(np.arange(3), angle, np.full(3, 0.1), solved)]


@pytest.mark.parametrize(("count", "has_more"), [(2, False), (3, True), (6, True)])
def test_a_point_with_more_gaits_than_labels_says_so(count, has_more):
    out = nothing_solved(("status", "reason", "stance_angle"), 3, kneed=False)
    assert all(values[:, 1].flags.c_contiguous for values in out.values())

    store(out, some_parts(count), set(GAITS))

    sentence = status.reasons("", "")[out["reason"][1, -1]]
    assert ("more gaits than labels" in sentence) is has_more
    assert (out["reason"][[0, 2]] != status.UNLABELLED).all()
    assert (out["reason"][1, :-1] != status.UNLABELLED).all()


def test_solve_says_that_gaits_have_no_label(monkeypatch):
    def crowded(*asked):
        """More gaits than labels, as the points of a line tell it."""
        found = solve_line(*asked)
        found["reason"][0, -1] = status.UNLABELLED
        return found

    monkeypatch.setattr(solve_at_slope, "solve_line", crowded)

    for steps, slope in ((1, 0.009), (2, 0.016)):
        said = solve_at_slope.solve_one(
            {"walker": "D", "slope": slope, "steps": steps}
        )["search"]

        assert sum("left out" in sentence for sentence in said) == 1


@pytest.mark.parametrize("sign", [1, -1])
def test_pieces_are_numbered_from_the_lower_end_whichever_way_a_branch_runs(sign):
    """And whichever way the angle goes."""
    _, found = branches("physical")
    branch = copy.copy(max(found, key=lambda b: len(b.pieces())))
    branch.Z = branch.Z * np.append(sign, np.ones(len(branch.Z) - 1))[:, None]
    turned = Branch(
        branch.m,
        branch.Z[:, ::-1],
        -branch.tangent[:, ::-1],
        branch.lipschitz[::-1],
        branch.why[::-1],
    )
    segments = np.arange(len(branch.q) - 1)
    assert len(branch.pieces()) > 1
    np.testing.assert_array_equal(branch.piece(segments), turned.piece(segments[::-1]))
    assert set(branch.piece(segments)) == set(range(len(branch.pieces())))


@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_a_ratio_beyond_all_bounds_tells_no_label_by_its_sign(sign):
    """Short gaits of the machine end where heelstrike is tangential; whether sentences
    named that slope, or that of the node before, was decided by rounding.
    """
    (branch,) = (b for b in branches("physical")[1] if np.exp(b.q.min()) < 0.02)
    end = branch.why.index("end_tangential_heelstrike")
    ratio = branch.ratio.copy()
    ratio[-end] = 9.0 * sign

    found = spans([replace(branch, ratio=ratio)], "short")

    assert np.exp(branch.q[-end]) in [high for _, high in found]
