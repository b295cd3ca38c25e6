"""Patches over planes of keys predict; what is reported comes from the gaits' own
steps, and is what lines give.
"""

import functools
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from gaitsweep.pipeline.graph.graph import boxes
from gaitsweep.tasks.branches.atlas import survey_lines
from gaitsweep.tasks.branches.refine import COARSE
from gaitsweep.tasks.charts import cell as cells
from gaitsweep.tasks.charts import division, pieces, sheet
from gaitsweep.tasks.charts.box import Box, Refused, roots
from gaitsweep.tasks.charts.cell import Cell, Lines, _Maker
from gaitsweep.tasks.charts.chart import Chart
from gaitsweep.tasks.charts.division import Cells, make_cells
from gaitsweep.tasks.charts.family import Family
from gaitsweep.tasks.charts.patch import measured, near_predictions
from gaitsweep.tasks.charts.pieces import Piece
from gaitsweep.tasks.charts.span import along, coordinate
from gaitsweep.tasks.charts.tuning import Tuning
from gaitsweep.tasks.contract.registry import ALWAYS
from gaitsweep.tasks.gaits.newton import curvature
from gaitsweep.tasks.gaits.polish import settle
from gaitsweep.tasks.gaits.rounding import rounding_std
from gaitsweep.tasks.measures.gaits import Wanted, nothing_solved
from gaitsweep.tasks.measures.smooth import Smooth
from gaitsweep.tasks.mechanics.contact import Chain
from gaitsweep.tasks.mechanics.lumped import common_structure, constants_of
from gaitsweep.tasks.step.problem import Lanes, Problem
from gaitsweep.tasks.studies import interpolate, solve_planes
from gaitsweep.tasks.studies.solve_planes import lines
from gaitsweep.tasks.studies.solve_points import lines as lines_side_by_side
from gaitsweep.tasks.walkers.resolve import resolve, resolve_many
from gaitsweep.tasks.walkers.walker import NUMBERS, WalkerError
from gaitsweep.tasks.walkers.walker_array import WalkerArray

WANT = (
    "stance_angle",
    "stance_rate",
    "thigh_rate",
    "period",
    "speed",
    "spectral_radius",
    *ALWAYS,
)
#: The angle alone, to three digits.
ANGLE = Wanted(("stance_angle",), set(), accuracy=1e-3)
#: Walker, keys with their ranges, and slopes; in the last two folds and ends of
#: branches lie inside.
PLANES = {
    "B": ("B", {"m_s": (0.05, 0.15), "R": (0.0, 0.12)}, (0.004, 0.01)),
    "E": ("E", {"foot_mass_ratio": (0.1, 0.2)}, (0.01,)),
    "A": ("A", {"detuning": (0.7, 0.9), "m_h": (1.0, 1.5)}, (0.009, 0.014, 0.03)),
}


@functools.cache
def cell_of(name):
    walker, keys, slope = PLANES[name]
    family = Family.of({"walker": walker, "set": {}}, tuple(keys))
    box = Box(
        tuple(keys),
        *(tuple(side) for side in zip(*keys.values(), strict=True)),
        log=True,
    )
    window = float(np.log(min(slope))), float(np.log(max(slope)))
    (cell,) = make_cells(
        family, box, window, lambda part: 30 ** len(keys) * box.share(part), len(slope)
    ).made
    return family, cell


def maker_of(name):
    """The maker of the cell, with its lines surveyed."""
    (family, cell), slope = cell_of(name), PLANES[name][2]
    maker = _Maker(
        family,
        cell.box,
        (float(np.log(min(slope))), float(np.log(max(slope)))),
        Lines(family),
        10**4,
    )
    maker.begin()
    return maker, cell


def block(name, numbers):
    """Parameters of a job over lines at random keys."""
    walker, keys, slope = PLANES[name]
    draw = np.random.default_rng(1)
    values = {
        key: draw.uniform(low, high, numbers) for key, (low, high) in keys.items()
    }
    low, high = ([side[i] for side in keys.values()] for i in (0, 1))
    return {
        "lines": [
            {"walker": walker, "set": {k: float(v[i]) for k, v in values.items()}}
            for i in range(numbers)
        ],
        "slope": np.array(slope),
        "want": WANT,
        "plane": {
            "keys": list(keys),
            "low": low,
            "high": high,
            "log": [False] * len(keys),
            "lines": 30 ** len(keys),
        },
    }


def charted(params):
    slope = params["slope"]
    window = {"slope_from": slope.min(), "slope_to": slope.max(), "slopes": len(slope)}
    return solve_planes.charts(
        {**params, **window, "line": params["lines"][0], "whole": True}, []
    )


def by_line(params, made=None):
    ((_, joined),) = lines(params, [charted(params) if made is None else made])
    n = len(params["slope"])
    return [
        {k: v[i * n : (i + 1) * n] for k, v in joined.items()}
        for i in range(len(params["lines"]))
    ]


def test_a_polynomial_of_the_nodes_degree_is_reproduced():
    x, y = np.meshgrid(roots(4), roots(3), indexing="ij")
    points = np.column_stack([x.ravel(), y.ravel()])

    def value(p):
        return np.array([2 * p[:, 0] ** 3 - p[:, 0] * p[:, 1] ** 2 + 0.5, p[:, 1]])

    other = np.random.default_rng(0).uniform(-1, 1, (9, 2))
    chart = Chart.through((4, 3), value(points))
    assert chart(other) == pytest.approx(value(other), abs=1e-14)
    assert chart(other, [1]) == pytest.approx(value(other)[1:], abs=1e-14)


@pytest.mark.parametrize(
    "folds", [(False, False), (True, False), (False, True), (True, True)]
)
def test_the_coordinate_along_a_piece_is_the_inverse_of_its_share(folds):
    x = np.linspace(0, 1, 11)
    assert coordinate(along(x, folds), folds) == pytest.approx(x, abs=1e-7)
    rate = np.diff(along(np.array([0.0, 1e-4, 1 - 1e-4, 1.0]), folds))[[0, 2]]
    assert ((rate < 1e-6) == folds).all()


@pytest.mark.parametrize(
    ("walker", "keys"),
    [
        ("C", {"detuning": (-0.2, 1.5), "m_h": (0.0, 3.0)}),
        ("B", {"m_s": (0.05, 0.15), "R": (0.0, 0.3)}),
        ("E", {"foot_mass_ratio": (0.01, 0.4)}),
        ("physical", {"eps_T": (-0.02, 0.2), "w_s": (-0.01, 0.01)}),
    ],
)
def test_an_array_of_walkers_has_the_constants_of_each(walker, keys):
    draw = np.random.default_rng(2)
    values = {key: draw.uniform(low, high, 20) for key, (low, high) in keys.items()}
    many = resolve_many(walker, values)
    structure = common_structure(many)
    for i in range(20):
        one = resolve(walker, {key: float(v[i]) for key, v in values.items()})
        assert many[i] == one
        assert np.array_equal(
            constants_of(many, structure)[:, i],
            constants_of(WalkerArray.of([one]), structure)[:, 0],
        )
        assert many.some(np.array([i])).leg == pytest.approx(one.leg, rel=1e-15)


@pytest.mark.parametrize("walker", ["physical", "physical-straight", "D"])
def test_walkers_may_differ_in_any_one_number(walker):
    """Losses and lengths of each are its own, also where but a radius of gyration
    differs.
    """
    own = resolve(walker)
    for key in NUMBERS:
        values = (getattr(own, key) or 0.01 * (key != "m_s")) * np.array([1.0, 1.01])
        many = resolve_many(walker, {key: values})
        for i, value in enumerate(values.tolist()):
            one = resolve(walker, {key: value})
            assert np.broadcast_to(many.leg, 2)[i] == pytest.approx(one.leg, rel=1e-15)
            K = Chain(many).K
            np.testing.assert_allclose(
                np.broadcast_to(K.T, (2, 4, 4)).T[..., i],
                Chain(one).K,
                rtol=1e-14,
                atol=1e-16,
            )


def test_an_array_of_walkers_may_hold_some_that_stand_out():
    """Feet of the shank's radius have their centre at the knee; legs may be massless;
    some walkers cannot be.
    """
    centred = resolve_many("B", {"R": np.array([0.4, 0.5, 0.6])})
    assert centred.leg == pytest.approx([1.0, 1.0, 1.0]) and not np.any(centred.eps_S)
    assert resolve_many("E", {"m_s": np.array([0.0, 0.1])}).massless_legs.tolist() == [
        True,
        False,
    ]
    some = resolve_many("B", {"m_h": np.array([-1.0, 0.5, -2.0])})
    assert some[1] == resolve("B", {"m_h": 0.5})
    with pytest.raises(WalkerError, match=r"`m_h` must be >= 0; got -2"):
        resolve_many("B", {"m_h": np.array([-1.0, -2.0])})


def test_a_block_has_as_many_sentences_as_its_lines_give_it(monkeypatch):
    """More than 16 bits can number, of lines that are surveyed by themselves: without
    charts all are.
    """
    n = 12_000

    def surveyed(lines, request):
        return [
            (
                [],
                {
                    **nothing_solved(request.wanted.names, 1, kneed=False),
                    "reasons": np.array([f"{i} {k}" for k in range(7)]),
                },
            )
            for i in range(n)
        ]

    monkeypatch.setattr(solve_planes, "solve_lines", surveyed)
    R = np.linspace(0.1, 0.2, n)
    plane = {"keys": ["R"], "low": [0.1], "high": [0.2], "log": [False], "lines": n}
    lines_of_it = [{"walker": "B", "set": {"R": float(r)}} for r in R]
    ((_, out),) = lines(
        {
            "lines": lines_of_it,
            "slope": np.array([0.01]),
            "want": ALWAYS,
            "plane": plane,
        },
        [],
    )
    assert [str(s) for s in out["reasons"][out["reason"][-1]]] == [
        f"{n - 1} {k}" for k in (1, 5, 2, 2)
    ]


@pytest.mark.parametrize(
    "ends",
    [
        ((False, False), (0.0, 4.0)),
        ((True, False), (0.0, 6.0)),
        ((False, True), (5.0, 0.0)),
    ],
)
def test_beside_an_end_at_zero_step_length_the_coordinate_is_a_logarithm(ends):
    x = np.linspace(0, 1, 11)
    share = along(x, *ends)
    assert coordinate(share, *ends) == pytest.approx(x, abs=1e-7)
    assert share[[0, -1]] == pytest.approx([0.0, 1.0])
    # Half as far from the end again and again: what is left, beside what is left at the
    # end, falls evenly.
    left = (1 - share if ends[1][1] else share[::-1]) + 1 / np.expm1(max(ends[1]))
    steps = np.diff(np.log(left))
    assert (
        steps == pytest.approx(np.full(10, steps[0]))
        if not any(ends[0])
        else (np.diff(steps) < 0).all()
    )


@pytest.mark.parametrize(
    ("walker", "keys", "slope", "at"),
    [
        (
            "E",
            {"w_t": (-0.004, 0.004), "m_s": (0.09, 0.1)},
            0.02,
            {"w_t": 0.0, "m_s": 0.092},
        ),
        ("E", {"foot_mass_ratio": (0.0, 0.1)}, 0.01, {"foot_mass_ratio": 0.0}),
        (
            "physical-straight",
            {"m_h": (0.0, 0.5), "w_s": (0.024, 0.026)},
            0.005,
            {"m_h": 0.1, "w_s": 0.025},
        ),
    ],
)
def test_planes_may_touch_a_change_of_structure_or_hold_no_gait(
    walker, keys, slope, at
):
    """At no offset the section has a dimension less, without mass at the foot the leg
    no inertia.
    """
    low, high = ([side[i] for side in keys.values()] for i in (0, 1))
    plane = {
        "keys": list(keys),
        "low": low,
        "high": high,
        "log": [False] * len(keys),
        "lines": 30 ** len(keys),
    }
    params = {"slope": np.array([slope]), "want": (*WANT, "loss_normal")}
    both = [
        {"walker": walker, "set": keys}
        for keys in (at, dict(zip(keys, high, strict=True)))
    ]
    one, _ = by_line({**params, "lines": both, "plane": plane})
    ((_, other),) = lines_side_by_side({**params, "lines": both[:1]}, [])
    # A massless leg is surveyed by itself: its losses are no limit of those of light
    # ones.
    assert int(one["reason"].max()) < 6 or "foot_mass_ratio" in keys
    np.testing.assert_array_equal(
        np.isnan(one["loss_normal"]), np.isnan(other["loss_normal"])
    )
    assert np.array_equal(one["status"], other["status"])
    gaits = other["status"] == 0
    assert gaits.sum() == (0 if walker == "physical-straight" else 2)
    bound = one["error_bound"] + other["error_bound"]
    for variable in ("stance_angle", "period"):
        assert (np.abs(one[variable] / other[variable] - 1) <= bound)[gaits].all()


def test_an_offset_of_point_feet_may_be_a_key():
    """Offsets that differ from walker to walker stand beside zeros that all of them
    share.
    """
    many = resolve_many(
        "E", {"w_t": np.array([0.01, 0.02]), "m_s": np.array([0.1, 0.11])}
    )
    assert not many.point_foot and many[0] == resolve("E", {"w_t": 0.01, "m_s": 0.1})


@pytest.mark.parametrize("name", PLANES)
def test_a_plane_gives_what_its_lines_give(name):
    params = block(name, 24)
    by_patch = 0
    for one, (_, other) in zip(
        by_line(params), lines_side_by_side(params, []), strict=True
    ):
        by_patch += int(one["reason"].max()) < 6
        assert np.array_equal(one["status"], other["status"])
        gaits = other["status"] == 0
        bound = one["error_bound"][gaits] + other["error_bound"][gaits]
        for variable in ("stance_angle", "period"):
            assert (np.abs(one[variable] / other[variable] - 1)[gaits] <= bound).all()
        assert np.abs(one["speed"] / other["speed"] - 1)[gaits].max(initial=0) < 1e-11
        assert np.array_equal(one["branch"], other["branch"])
        assert np.array_equal(one["piece"], other["piece"])
    assert by_patch >= 22


@pytest.mark.parametrize(("name", "accuracy"), [("B", 0.0), ("A", 0.0), ("B", 1e-5)])
def test_a_line_of_a_plane_does_not_depend_on_its_company(name, accuracy):
    """Nor is there need of any: some lines of A alone have no slope on a piece that
    others have there.
    """
    params = {**block(name, 12), "accuracy": accuracy}
    made = charted(params)
    together = by_line(params, made)
    for i in range(12):
        (alone,) = by_line({**params, "lines": params["lines"][i : i + 1]}, made)
        assert all(
            np.array_equal(alone[k], together[i][k], equal_nan=True) for k in WANT
        )
    # Nor on its other slopes.
    few = by_line({**params, "slope": params["slope"][1:]}, made)
    assert all(
        np.array_equal(a[k], b[k][1:], equal_nan=True)
        for a, b in zip(few, together, strict=True)
        for k in WANT
    )


@pytest.fixture(scope="module")
def cell():
    return cell_of("B")


@pytest.mark.parametrize("name", PLANES)
def test_cells_are_what_their_arrays_say(name):
    family, right = cell_of(name)
    (again,) = cells.from_arrays(family, cells.to_arrays([right]))
    unit = np.random.default_rng(0).uniform(-1, 1, (5, len(family.keys)))
    assert (
        again.box == right.box
        and again.structure == right.structure
        and again.why == right.why
    )
    assert len(right.patches) >= 2
    for one, other in zip(again.patches, right.patches, strict=True):
        slope = np.exp(one.span.ends(unit).mean(axis=0))
        for a, b in zip(
            vars(one.guesses(unit, slope)).values(),
            vars(other.guesses(unit, slope)).values(),
            strict=True,
        ):
            np.testing.assert_array_equal(a, b)
        assert (one.kinds, one.side, one.numbers.tolist()) == (
            other.kinds,
            other.side,
            other.numbers.tolist(),
        )
    empty = Cell(
        replace(right.box, origin=(-1.0,) * len(family.keys)),
        right.structure,
        [],
        "few walkers",
    )
    both = cells.from_arrays(family, cells.to_arrays([empty, right]))
    assert [(each.why, each.box) for each in both] == [
        ("few walkers", empty.box),
        ("", right.box),
    ]


def test_pieces_end_where_their_folds_and_steps_do():
    """Of A the long gaits' fold, with both pieces beside it, and the tangential
    heelstrike of short ones.
    """
    _, cell = cell_of("A")
    ends = sorted(patch.kinds for patch in cell.patches)
    assert ends == [("end", "cut"), ("fold", "cut"), ("fold", "end")]
    of = {patch.kinds: patch for patch in cell.patches}
    unit = np.random.default_rng(5).uniform(-1, 1, (4, 2))
    lower, upper = (
        of["fold", "cut"].span.ends(unit)[0],
        of["fold", "end"].span.ends(unit),
    )
    assert lower == pytest.approx(upper[0], abs=1e-9) and (upper[1] > upper[0]).all()
    problem = Lanes(
        Family.of({"walker": "A", "set": {}}, cell.box.keys).walkers(cell.box.at(unit)),
        cell.structure,
    )
    for i, branches in enumerate(survey_lines(problem, COARSE)):
        every = pieces.pieces_of(branches)
        fold = next(
            piece for piece in every if piece.kinds == ("fold", "end_zero_step")
        )
        short = next(
            piece for piece in every if piece.kinds[0] == "end_tangential_heelstrike"
        )
        assert fold.q == pytest.approx(upper[:, i].tolist(), abs=3e-8)
        assert short.q[0] == pytest.approx(
            of["end", "cut"].span.ends(unit)[0, i], abs=3e-8
        )


def test_a_chart_of_corners_is_linear_but_for_squares():
    box = Box(("a", "b"), (0.0, 0.0), (1.0, 1.0))
    x, y = points = box.draw(7, 2, "points").T
    corners = np.vstack([[[0.1, -0.2]], box.corners(0.9)])

    def value(x, y):
        return np.array([3 - x + 2 * y + 5 * x * y + 4 * (x**2 + y**2), x])

    np.testing.assert_allclose(
        Chart.of_corners(corners, value(*corners.T))(points.T), value(x, y), atol=1e-13
    )
    line = np.array([[0.0], [-1.0], [0.5]])
    assert Chart.of_corners(line, 7 * line.T**2)(np.array([[0.25]])) == pytest.approx(
        7 / 16
    )


@pytest.mark.parametrize("name", PLANES)
def test_nodes_begin_between_the_lines(name, monkeypatch):
    """On these lines the guesses are their own gaits, and hardly a node must be carried
    from the centre.
    """
    carried, carry = [], cells._Way.carried

    def counted(way, points, guesses):
        carried.append(len(points))
        return carry(way, points, guesses)

    def checked(way, points):
        for piece, unit in zip(way.group, way.maker.unit, strict=False):
            at = np.column_stack([points[:, 0], np.tile(unit, (len(points), 1))])
            np.testing.assert_allclose(
                between(way, at), piece.gaits(way.span.log_slope(at)), atol=1e-9
            )
        return between(way, points)

    between = cells._Way.between
    monkeypatch.setattr(cells._Way, "carried", counted)
    monkeypatch.setattr(cells._Way, "between", checked)
    maker, right = maker_of(name)
    patches = maker.patches()
    assert len(patches) == len(right.patches)
    assert sum(carried) < 0.1 * sum(np.prod(patch.gaits.sizes) for patch in patches)


def test_a_gait_may_lie_farther_from_its_guess_where_steps_nearly_vanish(monkeypatch):
    """There rates over the angle are large: 0.5 of 12 is as near as 0.125 of 3."""
    way = object.__new__(cells._Way)
    way.maker = SimpleNamespace(
        problem=lambda unit: SimpleNamespace(stride=lambda w, q: (w, None))
    )
    way.span, way.side = SimpleNamespace(log_slope=lambda points: points[:, 0]), 1.0
    guess = np.array([[0.1] * 4, [-3.0, -3.0, -12.0, -12.0], [3.0] * 4])
    moved = guess + np.array([[0.0, 0.0, 0.0, 0.5], [0.2, 0.5, 0.5, 0.0], [0.0] * 4])
    monkeypatch.setattr(cells, "side_of_fold", lambda stride: np.ones(stride.shape[1]))
    monkeypatch.setattr(cells, "newton", lambda *_, **__: (moved, np.ones(4, bool)))
    assert way.newton(np.zeros((4, 2)), guess)[1].tolist() == [True, False, True, False]


def test_an_invented_branch_is_found():
    maker, right = maker_of("B")
    maker.checked(right.patches)
    first, *others = right.patches
    moved = first.gaits.coefficients.copy()
    moved[0] += 0.5
    with pytest.raises(Refused, match="lacks a piece"):
        maker.checked(
            [replace(first, gaits=replace(first.gaits, coefficients=moved)), *others]
        )


def test_an_end_that_is_none_is_found(monkeypatch):
    """A piece that walks on beyond its end, or has ended where it is cut."""
    maker, right = maker_of("B")
    for patch, why in (
        (replace(right.patches[0], kinds=("beyond", "cut")), "goes on beyond its end"),
        (right.patches[0], "ends before it is cut"),
    ):
        verified = cells.verify_steps

        def one_ends(*args, verified=verified):
            stride, check = verified(*args)
            check.step[3] = False
            return stride, check

        if patch.kinds[0] == "cut":
            monkeypatch.setattr(cells, "verify_steps", one_ends)
        with pytest.raises(Refused, match=why):
            maker.check_ends(patch)


def test_patches_whose_predictions_err_by_a_fiftieth_are_refused(monkeypatch):
    maker, _ = maker_of("B")
    (group, *_), usual = maker.groups(), cells.newton_step
    maker.total = 0  # where nothing grows the first chart is the last
    for error in (0.0199, 0.0201, np.nan):
        monkeypatch.setattr(
            cells,
            "newton_step",
            lambda stride, w, e=error: np.sign(usual(stride, w)) * e,
        )
        if error < 0.02:
            assert maker.patch(group).gaits.error == pytest.approx(error)
        else:
            with pytest.raises(Refused, match="err by"):
                maker.patch(group)


def test_a_piece_on_both_sides_of_a_fold_is_refused(monkeypatch):
    maker, _ = maker_of("B")
    (group, *_), usual = maker.groups(), cells.side_of_fold

    def other_side(stride):
        sides = usual(stride)
        return (
            np.where(np.arange(len(sides)) == 5, -sides, sides)
            if len(sides) == cells._DRAWN
            else sides
        )

    monkeypatch.setattr(cells, "side_of_fold", other_side)
    with pytest.raises(Refused, match="a fold lies inside"):
        maker.patch(group)


def test_gaits_that_are_lost_on_their_way_are_refused(monkeypatch):
    maker, _ = maker_of("B")
    (group, *_), usual = maker.groups(), cells.newton

    def lost(problem, w, q, **options):
        w, converged = usual(problem, w, q, **options)
        return w, converged & (q < np.log(0.0099))

    monkeypatch.setattr(cells, "newton", lost)
    with pytest.raises(Refused, match=r"a gait is lost on its way to \d+ nodes"):
        maker.patch(group)
    monkeypatch.setattr(cells, "newton", lambda problem, w, q, **_: (w + 0.31, q < 0))
    with pytest.raises(Refused, match="is lost on its way"):
        maker.patch(group)


def test_gaits_other_than_those_predicted_are_not_accepted(cell):
    family, right = cell
    patch, unit = right.patches[0], np.random.default_rng(0).uniform(-1, 1, (5, 2))
    guesses = patch.guesses(unit, np.full(5, 0.008))
    at = settle(
        Lanes(family.walkers(right.box.at(unit)), right.structure),
        guesses,
        sampled=True,
    )
    error, side = patch.gaits.error, patch.side
    assert near_predictions(at, guesses.w, error, side).all()
    assert not near_predictions(at, guesses.w, error, -side).any()
    third = np.arange(5) == 2
    assert (
        near_predictions(replace(at, converged=~third), guesses.w, error, side).tolist()
        == (~third).tolist()
    )
    moved = np.abs(at.w - guesses.w).max()
    assert not near_predictions(at, guesses.w, 0.9 * moved / 8, side).all()
    assert near_predictions(at, guesses.w, 1.1 * moved / 8, side).all()
    # A gait that is no step is one only where walking may end.
    q = np.full(5, np.log(0.008))
    for reach, fine in ((0.0, ~third), (10.0, third | True)):
        some = replace(patch, reach=np.array([reach, 0.0]))
        judged = some.judge(replace(at, step=~third), guesses.w, q, unit)
        assert (
            judged[0].tolist() == fine.tolist()
            and judged[1].tolist() == (~third).tolist()
        )


def test_a_patch_knows_its_lines_and_what_is_measured_nearby(cell):
    _, right = cell
    patch, p = right.patches[0], len(right.patches[0].measured[0])
    assert len(patch.lines) == 5
    numbered = replace(patch, numbers=np.arange(10).reshape(5, 2))
    assert (
        numbered.numbers_at(0.9 * patch.lines + 0.05).tolist()
        == numbered.numbers.tolist()
    )
    lipschitz, gradient, std = (values.copy() for values in patch.measured)
    lipschitz[:], gradient[0, 0], std[0] = np.arange(p), np.arange(p), 20 - np.arange(p)
    changed, points = (
        replace(patch, measured=(lipschitz, gradient, std)),
        np.column_stack([roots(p), np.zeros((p, 2))]),
    )
    guesses = changed.guesses(points[:, 1:], np.exp(patch.span.log_slope(points)))
    last = p - 1
    assert guesses.lipschitz.tolist() == [4.0 * min(k + 1, last) for k in range(p)]
    assert guesses.gradient[0, 0].tolist() == list(range(p))
    assert guesses.rounding_std[0].tolist() == [20.0 - max(k - 1, 0) for k in range(p)]
    np.testing.assert_allclose(guesses.w, patch.gaits(points), rtol=1e-12)


def test_points_lie_on_a_patch_between_its_ends_and_not_where_these_are_not_known(cell):
    family, right = cell
    patch, unit = right.patches[0], np.zeros((2, 2))
    low, high = patch.span.ends(unit[:1])[:, 0]
    q = np.array([low - 1e-6, low + 1e-6, high - 1e-6, high + 1e-6])
    some = cells.Block(family, right, right.box.at(unit), np.exp(q))
    assert some.on(patch).tolist() == [1, 2, 5, 6]
    assert solve_planes._away_from_ends(some).all()
    # An end is avoided on both of its sides, by eight times its error.
    for kind in ("fold", "end"):
        event = replace(
            right,
            patches=[
                replace(patch, kinds=(kind, "cut"), end_errors=np.array([1e-3, 0.0]))
            ],
        )
        for off, away in ((-9e-3, True), (-7e-3, False), (7e-3, False), (9e-3, True)):
            one = cells.Block(
                family, event, right.box.at(unit), np.exp([low + off, high - 0.1])
            )
            assert solve_planes._away_from_ends(one).tolist() == [away, True] * 2


def test_gaits_are_absent_beyond_an_end_alone_where_the_equations_solution_is_none(
    cell,
):
    """The gaits of B go on beyond where its patches are cut: who says that they end
    there is not believed.
    """
    family, right = cell
    patch, unit = right.patches[0], np.zeros((2, 2))
    low, _ = patch.span.ends(unit[:1])[:, 0]
    wrong = replace(right, patches=[replace(patch, kinds=("beyond", "cut"))])
    block = cells.Block(
        family, wrong, right.box.at(unit), np.exp([low - 0.1, low + 0.1])
    )
    assert solve_planes._known_to_end(block).tolist() == [False, True] * 2
    block = cells.Block(
        family, right, right.box.at(unit), np.exp([low - 0.1, low + 0.1])
    )
    assert solve_planes._known_to_end(block).all()


def test_pieces_with_the_same_gaits_are_not_accepted(cell):
    family, right = cell
    keys, wanted = right.box.at(np.zeros((2, 2))), Wanted(list(WANT), {"long", "short"})
    solve = solve_planes.solve
    assert solve(family, right, keys, np.array([0.008]), wanted)[1].all()
    twice = replace(right, patches=[*right.patches, right.patches[0]])
    assert not solve(family, twice, keys, np.array([0.008]), wanted)[1].any()


def test_what_is_measured_of_groups_is_their_largest_or_mean():
    problem, q = Problem(resolve("A")), np.log(np.geomspace(0.02, 0.03, 6))
    w = settle(problem, branch_guesses(problem, q)).w
    lipschitz, gradient, std = measured(problem, w, q, 3)
    each = curvature(problem, w, q)
    np.testing.assert_array_equal(lipschitz, [each[0][:3].max(), each[0][3:].max()])
    np.testing.assert_allclose(gradient[..., 1], each[1][..., 3:].mean(axis=-1))
    np.testing.assert_allclose(
        std[:, 0] ** 2, (rounding_std(problem, w, q)[:, :3] ** 2).mean(axis=1)
    )


def branch_guesses(problem, q):
    """Guesses of the gaits of a line's first branch."""
    (found,) = survey_lines(Lanes([problem.walker], problem.structure), COARSE)
    return next(
        piece
        for piece in pieces.pieces_of(found)
        if piece.q[0] < q[0] and piece.q[1] > q[-1]
    ).guesses(q)


def test_a_box_of_few_lines_is_left_to_lines():
    walker, keys, _ = PLANES["B"]
    family = Family.of({"walker": walker, "set": {}}, tuple(keys))
    box = Box(tuple(keys), (0.1, 0.1), (0.11, 0.11), log=True)
    (cell,) = make_cells(family, box, (-4.7, -4.6), lambda part: 11, 2).made
    assert cell.why == "few walkers" and not cell.patches


@pytest.mark.parametrize(
    ("each", "tried", "described"), [(20, 6, 0), (30, 13, 0), (20, 19, 1)]
)
def test_a_box_is_not_divided_when_lines_are_surveyed_in_vain(
    each, tried, described, monkeypatch
):
    """A box and each of its parts take five lines here; what is described pays for
    others.
    """
    made = []

    def refusing(family, box, window, lines, points, why=""):
        if not why:
            lines.pieces += [[]] * 5
            made.append(box)
            assert points == pytest.approx(7 * each**2 * whole.share(box), rel=1e-12)
            if not 1 < len(made) <= 1 + described:
                raise Refused("it is made to", len(made) % 2)
        return Cell(box, None, [], why)

    monkeypatch.setattr("gaitsweep.tasks.charts.division.make_cell", refusing)
    family, whole = (
        Family.of({"walker": "B", "set": {}}, ("m_s", "R")),
        Box(("m_s", "R"), (0.0, 0.0), (0.09, 0.09)),
    )
    found = make_cells(
        family, whole, (-4.5, -4.0), lambda part: each**2 * whole.share(part), 7
    ).made
    paid = each**2 * (
        0.1 + 0.5 * sum(whole.share(box) for box in made[1 : 1 + described])
    )
    assert len(made) == tried and 7.5 * (tried - 1) <= paid < 7.5 * tried
    assert [cell.why for cell in found].count("few walkers") == len(
        found
    ) - described and sum(whole.share(cell.box) for cell in found) == pytest.approx(1)


def test_cuts_beside_tuned_walkers_are_no_halvings():
    """A box that was cut along a key may be halved along it as often as others."""
    cuts = [
        Refused("cut", 0, 0.5),
        Refused("cut", 0, 0.25),
        Refused("halve", 0),
        Refused("halve", 0),
    ]
    box = Box(("a", "b"), (0.0, 0.0), (1.0, 1.0))
    for refused in cuts:
        box, _ = division.halves(box, refused)
    assert (box.high, box.halved) == ((0.0625, 1.0), (2, 0))
    low, high = division.halves(box, Refused("halve", 0))
    assert low.high == (0.0625, 0.5) and low.halved == high.halved == (2, 1)


def test_a_box_of_many_lines_is_halved_for_others(monkeypatch):
    """They are told how many lines were surveyed in vain, each by its share of the
    lines.
    """
    asked = []

    def refusing(family, box, window, lines, points, why=""):
        asked.append(why)
        if not why:
            lines.pieces += [[]] * 6
            raise Refused("it is made to", at=0.02)
        return Cell(box, None, [], why)

    monkeypatch.setattr("gaitsweep.tasks.charts.division.make_cell", refusing)
    monkeypatch.setattr(solve_planes, "is_interpolated", lambda *_: False)
    plane = {
        "keys": ["m_s"],
        "low": [0.0],
        "high": [0.08],
        "log": [False],
        "lines": 400,
    }
    params = {
        "line": {"walker": "B", "set": {}},
        "plane": plane,
        "slope_from": 0.01,
        "slope_to": 0.02,
        "slopes": 3,
    }
    low, high = boxes(solve_planes.charts({**params, "want": ()}, []), "halves")
    assert asked == [""] and [low["high"], high["low"]] == [[0.02], [0.02]]
    np.testing.assert_allclose(
        [low["lines"], high["lines"], low["surveyed"], high["surveyed"]],
        [100, 300, 1.5, 4.5],
    )
    # Too few lines are left to survey more of them in vain.
    cells = solve_planes.charts(
        {**params, "want": (), "plane": {**plane, **low, "surveyed": 7.0}}, []
    )
    assert not boxes(cells, "halves") and asked[1:] == ["few walkers"]


def test_lines_are_counted_as_they_are_spread(monkeypatch):
    """Whatever coordinates their gaits are smooth in."""
    counted = []
    monkeypatch.setattr(
        solve_planes, "make_cells", lambda *given: counted.append(given[3]) or Cells([])
    )
    for log in (False, True):
        plane = {
            "keys": ["m_s"],
            "low": [0.001],
            "high": [0.1],
            "log": [log],
            "lines": 100,
        }
        params = {
            "line": {"walker": "B", "set": {}},
            "plane": plane,
            "slope_from": 0.01,
            "slope_to": 0.02,
            "slopes": 3,
        }
        solve_planes.charts({**params, "want": ()}, [])
    half = Box(("m_s",), (0.001,), (0.01,), log=True)
    assert [lines_in(half) for lines_in in counted] == [
        pytest.approx(100 / 11),
        pytest.approx(50),
    ]


def test_a_box_near_tuned_walkers_is_measured_from_them():
    """A is tuned at R = 0.2."""
    family, window = Family.of({"walker": "A", "set": {}}, ("R",)), (-4.5, -4.0)
    sides = [
        (0.21, 0.4),
        (0.1, 0.19),
        (0.24, 0.3),
        (0.3, 0.4),
        (0.5, 0.99),
    ]  # beyond the last one no walker can be
    assert (
        Tuning(
            Family.of({"walker": "A", "set": {}}, ("detuning",)),
            Box(("detuning",), (0.0,), (0.5,)),
            0,
        ).outside()
        is None
    )
    origins = []
    for low, high in sides:
        (cell,) = make_cells(
            family,
            Box(family.keys, (low,), (high,), log=True),
            window,
            lambda _: 1.0,
            1,
        ).made
        origins.append(cell.box.origin[0])
    assert origins == [pytest.approx(0.2), pytest.approx(0.2), 0.0, 0.0, 0.0]


def test_a_box_is_divided_where_its_walkers_are_tuned():
    family = Family.of({"walker": "A", "set": {}}, ("detuning",))

    def refused(low, high):
        box = Box(family.keys, (low,), (high,), log=True)
        with pytest.raises(Refused, match="tuned walkers") as why:
            _Maker(family, box, (-5.0, -4.0), Lines(family), 100).check_tuning()
        return str(why.value), why.value.at, why.value.origin

    assert refused(0.0, 0.5) == (
        "tuned walkers at a face",
        pytest.approx(0.5 / 64),
        0.0,
    )
    assert refused(-0.5, 0.0) == (
        "tuned walkers at a face",
        pytest.approx(-0.5 / 64),
        0.0,
    )
    assert refused(-0.5, 0.3) == (
        "tuned walkers inside",
        pytest.approx(0.0, abs=1e-12),
        None,
    )
    _Maker(
        family,
        Box(family.keys, (0.1,), (0.5,), log=True),
        (-5.0, -4.0),
        Lines(family),
        100,
    ).check_tuning()
    low, high = Box(("a", "b"), (1.0, 2.0), (3.0, 4.0)).parts(1, 2.5)
    assert (low.high, high.low) == ((3.0, 2.5), (1.0, 2.5))


@pytest.mark.parametrize(
    ("low", "high", "origin"), [(2.1, 3.0, 2.0), (1.0, 1.9, 2.0), (0.1, 1.0, 0.0)]
)
def test_a_box_beside_its_origin_is_measured_by_the_logarithm_of_the_distance(
    low, high, origin
):
    """Of the second key; the first, whose faces are about as far from its own, is
    measured as it is.
    """
    sides, far = np.log(np.abs(np.array([low, high]) - origin)), 0.03
    box = Box(("a", "b"), (1.0, low - far), (2.0, high), log=True).parts(
        1, low, origin
    )[1]
    unit = np.array([[-1.0, -1.0], [0.0, 0.0], [0.5, 1.0]])
    middle = origin + np.sign(low - origin) * np.exp(sides.mean())
    np.testing.assert_allclose(
        box.at(unit), [[1.0, low], [1.5, middle], [1.75, high]], rtol=1e-14
    )
    np.testing.assert_allclose(box.unit(box.at(unit)), unit, atol=1e-13)
    assert box.parts(1)[0].high[1] == pytest.approx(middle) and box.parts(0)[
        1
    ].origin == (0.0, origin)


def test_a_plane_beside_tuned_walkers_needs_few_boxes():
    """A is tuned at R = 0.2 whatever its hip mass; measured from there, its branches
    are smooth over the keys.
    """
    family = Family.of({"walker": "A", "set": {}}, ("m_h", "R"))
    window = float(np.log(0.001)), float(np.log(0.2))
    whole = Box(family.keys, (0.0, 0.02), (5.0, 0.2), log=True)
    made = make_cells(
        family, whole, window, lambda part: 400 * whole.share(part), 12
    ).made
    described, whole = (
        [cell.box for cell in made if not cell.why],
        Box(family.keys, (0.0, 0.02), (5.0, 0.2)),
    )
    assert 1 <= len(described) <= 3 and sum(map(whole.share, described)) > 0.95
    assert {cell.box.origin[1] for cell in made} == {0.2}


def test_lines_without_charts_are_followed_by_themselves():
    params = block("B", 6)
    ((_, found),) = lines(params, [])
    alone = [
        points
        for _, points in lines_side_by_side(
            {k: v for k, v in params.items() if k != "plane"}, []
        )
    ]
    for name in set(WANT) - {"reason"}:
        assert np.array_equal(
            found[name], np.concatenate([each[name] for each in alone]), equal_nan=True
        )


def test_a_point_whose_prediction_is_not_accepted_is_solved_alone(monkeypatch):
    params, asked = block("B", 6), []
    made, usual, judge = charted(params), solve_planes.solve_lines, cells.Patch.judge
    right = by_line(params, made)

    def one_is_off(self, at, w, q, unit):
        fine, is_step = judge(self, at, w, q, unit)
        return fine & (q != q[3]) | (np.abs(unit - unit[3]).max(axis=1) > 1e-9), is_step

    monkeypatch.setattr(cells.Patch, "judge", one_is_off)

    def counted(lines, request):
        asked.append((lines, request.slope.tolist()))
        return usual(lines, request)

    monkeypatch.setattr(solve_planes, "solve_lines", counted)
    found = by_line(params, made)
    (((line,), slopes),) = asked
    assert slopes == [params["slope"][1]]
    changed = params["lines"].index(line)
    for i, (one, other) in enumerate(zip(found, right, strict=True)):
        same = [
            np.array_equal(one[k][j], other[k][j], equal_nan=True)
            for j in (0, 1)
            for k in WANT
        ]
        assert all(same[: len(WANT)]) and all(same) == (i != changed)
        np.testing.assert_allclose(one["period"], other["period"], rtol=1e-12)


def test_polynomials_of_more_gaits_than_points_are_not_fitted():
    family, cell = cell_of("B")
    made = interpolate.sheets(family, cell, ANGLE, 10**6)[0]
    needed = int(np.prod(made.chart.sizes)) + 64
    cell = replace(cell, patches=cell.patches[:1])
    assert not interpolate.sheets(family, cell, ANGLE, needed)
    assert interpolate.sheets(family, cell, ANGLE, needed + 1)


#: Variables of a plane that polynomials may give.
SMOOTH = tuple(
    name
    for name in (*WANT, "multiplier_error_bound", "loss_normal")
    if name != "residual"
)


def test_polynomials_are_not_fitted_to_gaits_that_are_not_those_predicted(monkeypatch):
    family, cell = cell_of("B")
    assert interpolate.sheets(family, cell, ANGLE, 10**6)
    monkeypatch.setattr(
        "gaitsweep.tasks.charts.patch.near_predictions",
        lambda at, *_: np.arange(len(at.bound)) != 3,
    )
    assert not interpolate.sheets(family, cell, ANGLE, 10**6)


def test_polynomials_are_fitted_for_all_points_of_a_cell(monkeypatch):
    """At its 30 by 30 lines, at three slopes."""
    fitted = []
    monkeypatch.setattr(solve_planes, "sheets", lambda *a: fitted.append(a[-1]) or [])
    charted(
        {
            **block("B", 2),
            "slope": np.array([0.004, 0.01, 0.0101]),
            "want": SMOOTH,
            "accuracy": 1e-3,
        }
    )
    assert fitted == [2700]


@pytest.mark.parametrize("name", PLANES)
@pytest.mark.parametrize("accuracy", [1e-3, 1e-7])
def test_a_plane_to_an_accuracy_gives_what_its_lines_give(name, accuracy):
    params = {**block(name, 24), "want": SMOOTH}
    best = lines_side_by_side({k: v for k, v in params.items() if k != "plane"}, [])
    for (_, exact), one in zip(
        best, by_line({**params, "accuracy": accuracy}), strict=True
    ):
        assert one["status"].tolist() == exact["status"].tolist()
        there = exact["status"] == 0
        assert (one["error_bound"][there] <= accuracy).all()
        bound = (one["error_bound"] + exact["error_bound"])[there]
        for key in ("stance_angle", "period"):
            assert (np.abs(one[key] / exact[key] - 1)[there] <= bound).all()
        off = np.abs(one["spectral_radius"] - exact["spectral_radius"])[there]
        assert (
            off
            <= (one["multiplier_error_bound"] + exact["multiplier_error_bound"])[there]
        ).all()
        assert ((one["spectral_radius"] < 1) == (exact["spectral_radius"] < 1))[
            there
        ].all()
        assert one["loss_normal"][there] == pytest.approx(
            exact["loss_normal"][there], rel=4 * accuracy
        )


def test_gaits_of_a_plane_to_an_accuracy_are_not_integrated(monkeypatch):
    params = {**block("B", 24), "want": ("stance_angle",), "accuracy": 1e-5}
    made, integrated = charted(params), []
    usual = by_line(params, made)

    def solve_block(*args):
        integrated.append(args[-1].sum())
        return np.ones(48, bool)

    monkeypatch.setattr(solve_planes, "_solve_block", solve_block)
    again = by_line(params, made)
    for one, other in zip(usual, again, strict=True):
        np.testing.assert_array_equal(one["stance_angle"], other["stance_angle"])
    assert set(integrated) == {0}


def test_lines_of_a_plane_whose_stability_errors_could_change_are_integrated(
    monkeypatch,
):
    params = {
        **block("B", 12),
        "want": ("stance_angle", "spectral_radius"),
        "accuracy": 1e-3,
    }
    integrated, original = [], Smooth.multipliers

    def beside_the_unit_circle(self, columns, error):
        found = original(self, columns, error)
        found["spectral_radius"][3] = 1 + 0.9 * found["multiplier_error_bound"][3]
        return found

    monkeypatch.setattr(Smooth, "multipliers", beside_the_unit_circle)
    usual = solve_planes._solve_block
    monkeypatch.setattr(
        solve_planes,
        "_solve_block",
        lambda *args: (integrated.append(args[-1].sum()), usual(*args))[1],
    )
    by_line(params)
    assert 0 < sum(integrated) < 24


def place_of(quantity):
    smooth = Smooth.of(Problem(resolve("B")), ("stance_angle",))
    return smooth.names.index(quantity)


def test_lines_of_a_plane_whose_labels_errors_could_change_are_integrated():
    family, cell = cell_of("B")
    made = interpolate.sheets(family, cell, ANGLE, 10**6)
    ratio = place_of("heelstrike_rate_ratio")
    coefficients = made[0].chart.coefficients.copy()
    coefficients[:, ratio] = 0.0
    sizes = made[0].chart.sizes
    coefficients[[0, np.prod(sizes[1:]) // sizes[1]], ratio] = (
        0.5,
        0.1,
    )  # 1/2 in the middle of the first key
    made[0] = replace(
        made[0], chart=replace(made[0].chart, coefficients=coefficients, error=1e-3)
    )
    unit = np.column_stack([[-0.9, -0.03, 0.03, 0.9], np.zeros(4)])
    some = cells.Block(family, cell, cell.box.at(unit), np.array([0.006]))
    parts, sure = interpolate.interpolate(some, made, ANGLE)
    assert sure.tolist() == [True, False, False, True]
    # Nor are those where errors are not known.
    made[0] = replace(made[0], unmeasured=(2.0, -1.0))
    assert not interpolate.interpolate(some, made, ANGLE)[1].any()
    # Or where two gaits of a label have the same angle; those whose legs pass more
    # often have no label.
    one = replace(made[1], unmeasured=(-1.0, -1.0))
    parts_of, sure_of = interpolate.interpolate(some, [one, one], ANGLE)
    assert not sure_of.any() and not any(len(part.index) for part in parts_of)
    parts_of, sure_of = interpolate.interpolate(
        some, [replace(one, passes=3), one], ANGLE
    )
    assert sure_of.all() and len(parts_of) == 1
    assert parts[0].index.tolist() == [0, 3] and (parts[0].ratio < 0.5).tolist() == [
        True,
        False,
    ]


def test_polynomials_of_a_plane_that_err_are_not_used(monkeypatch):
    params = {**block("B", 12), "want": ("stance_angle",), "accuracy": 1e-5}
    right = by_line(params)

    def spoiled(sizes, values, size):
        values = values.copy()
        values[0, 5] += 1e-3
        return Chart.through(sizes, values, size)

    integrated, usual = [], solve_planes._solve_block

    def solve_block(*args):
        integrated.append(args[-1].sum())
        return usual(*args)

    monkeypatch.setattr(sheet, "Chart", SimpleNamespace(through=spoiled))
    monkeypatch.setattr(solve_planes, "_solve_block", solve_block)
    for one, other in zip(right, by_line(params), strict=True):
        np.testing.assert_allclose(
            one["stance_angle"], other["stance_angle"], rtol=1e-5
        )
    assert set(integrated) == {24}


def test_points_that_a_box_holds_out_fill_its_cube_and_depend_on_their_purpose():
    box = Box(("a", "b"), (0.0, 1.0), (1.0, 2.0))
    points = box.draw(4000, 3, "one")
    np.testing.assert_array_equal(points, box.draw(4000, 3, "one"))
    assert np.abs(points).max() <= 1 and np.abs(points.mean(axis=0)).max() < 0.05
    np.testing.assert_allclose(points.var(axis=0), 1 / 3, rtol=0.05)
    for other in (
        box.draw(4000, 3, "other"),
        Box(("a", "b"), (0.0, 1.0), (1.0, 2.5)).draw(4000, 3, "one"),
    ):
        assert np.abs(np.corrcoef(points.T, other.T)[:3, 3:]).max() < 0.06


class _Straight(Piece):
    """A piece whose angle and one event time are linear in ln slope."""

    def gaits(self, q):
        clipped = np.clip(q, *self.q)
        return np.vstack([self.number + 2 * clipped, 3 * clipped])


def test_pieces_of_neighbouring_lines_are_matched_by_what_lies_between_their_ends():
    def piece(angle, low, high, kinds=("fold", "fold")):
        return _Straight(SimpleNamespace(m=1), angle, 0, 0, 1, kinds, (low, high))

    def distance(a, b):
        return pieces._distance(a, b, -5.0, -3.0)

    one = piece(1.0, -4.5, -3.5)
    # The angle is off by 0.25; both ends by 0.1, and with them the angle by 0.2 and the
    # time by 0.3.
    assert distance(one, piece(1.25, -4.5, -3.5)) == pytest.approx(0.25)
    assert distance(one, piece(1.0, -4.4, -3.4)) == pytest.approx(0.3 + 0.1)
    # A shorter piece is compared at its own shares, of which the last lies 0.425 above
    # -4.5 instead of 0.85.
    assert distance(one, piece(1.0, -4.5, -4.0)) == pytest.approx(
        3 * (0.85 - 0.425) + 0.5
    )
    assert distance(one, piece(1.0, -4.5, -3.5, ("fold", "end_fall"))) == pieces._FAR
    assert distance(one, piece(1.0, -4.5, -3.5, ("end_fall", "fold"))) == pieces._FAR
    # Beyond the range neither kinds nor, farther than 1, places count.
    long, longer = piece(1.0, -7.0, -1.0), piece(1.0, -9.0, -1.0, ("end_fall", "fold"))
    assert distance(long, longer) == distance(longer, long) == 0.0
    # Ends of walking of different kinds may be one's.
    grazing, early = (
        piece(1.0, -4.5, -3.5, ("fold", kind))
        for kind in ("end_tangential_heelstrike", "end_earlier_strike")
    )
    assert distance(grazing, early) == 0.0 and distance(grazing, one) == pieces._FAR
    matched = pieces.match([[one, long], [longer, piece(1.25, -4.5, -3.5)]], -5.0, -3.0)
    assert [[p.number for p in group] for group in matched] == [[1.0, 1.25], [1.0, 1.0]]
    other = piece(1.0, -4.5, -3.5, ("fold", "end_fall"))
    assert pieces.match([[one], [other]], -5.0, -3.0) == [[one, None], [None, other]]
    # Both of the first line are nearest to the same piece of the second: it continues
    # the nearer one.
    near, far = piece(1.1, -4.5, -3.5), piece(3.0, -4.5, -3.5)
    assert pieces.match([[piece(1.3, -4.5, -3.5), one], [near, far]], -5.0, -3.0)[
        1
    ] == [one, near]


@pytest.mark.parametrize(("beyond", "off"), [(0.035, 0.0175), (1.0, 0.06)])
def test_a_piece_is_cut_before_its_end(beyond, off):
    """Well beyond the window, but not where the piece has ended; one that ends beside
    it is not cut.
    """
    maker = object.__new__(_Maker)
    maker.d, maker.window = 1, (-4.0, -3.0)
    group = [
        SimpleNamespace(
            q=(-5.0 - k, -2.0),
            kinds=("end_fall", "end_fall"),
            vanishes=lambda side: False,
        )
        for k in (0, 1)
    ]
    group[1].q = (-4.0 - beyond, -2.0)
    low, high = maker.both_ends(group)
    assert (low.kind, high.kind) == ("cut", "cut")
    assert low.at(np.zeros((1, 1))) == pytest.approx([-4.0 - off]) and high.at(
        np.zeros((1, 1))
    ) == [-2.94]
    group[1].q = (-4.02, -2.0)
    group.append(group[0])
    for piece in group:
        piece.rate_beside = lambda k: 1.0
    with pytest.raises(Refused, match="a piece ends at end_fall"):
        maker.both_ends(group)
