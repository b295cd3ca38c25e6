"""Charts: where nodes are added, what bounds their errors, and where gaits of sheets
are known.
"""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from gaitsweep.tasks.charts.box import Refused, roots
from gaitsweep.tasks.charts.chart import Chart, fit
from gaitsweep.tasks.charts.sheet import Asked, Sampled, Sheet, fit_sheets
from gaitsweep.tasks.charts.span import Span
from gaitsweep.tasks.studies.interpolate import _away_from_ends, panels_over


def growing(
    error,
    tails,
    good=1e-6,
    fair=1.0,
    most=(9, 9),
    keys=1,
    first=(4, 3),
    total=10**9,
    enough=np.inf,
):
    """Sizes of the charts that `fit` tries, whose errors and last coefficients are
    functions of their sizes.
    """
    tried = []

    def attempt(sizes, before):
        assert not tried or before.sizes == tried[-1]
        tried.append(sizes)
        coefficients = np.zeros((*sizes, 1))
        for k, tail in enumerate(tails(sizes)):
            coefficients[tuple(-1 if i == k else 0 for i in range(len(sizes)))] = tail
        return Chart(sizes, coefficients.reshape(-1, 1), error(sizes))

    return fit(
        attempt(first, None),
        attempt,
        most,
        total,
        good,
        fair,
        keys,
        enough,
    ), tried


def test_a_chart_of_enough_nodes_need_only_be_useful():
    def tried(error, enough):
        return growing(lambda n: error, lambda n: (0, 1e-3), fair=1e-2, enough=enough)[
            1
        ]

    assert tried(1e-3, 12) == [(4, 3)] and tried(1e-3, 13) == [(4, 3), (4, 5)]
    with pytest.raises(Refused):
        tried(0.1, 12)


def test_nodes_are_added_where_the_last_coefficients_exceed_a_tenth_of_the_error_wanted():
    chart, tried = growing(
        lambda n: 1e-3 if n[1] < 7 else 1e-7, lambda n: (0.9e-7, 1e-6)
    )
    assert tried == [(4, 3), (4, 5), (4, 7)] and chart.sizes == (4, 7)
    # Or a tenth of the largest; no more than there may be, and then the chart is fair,
    # or refused.
    chart, tried = growing(
        lambda n: 1e-3 if n[1] < 7 else 1e-7, lambda n: (0.9e-10, 1e-9)
    )
    assert tried == [(4, 3), (4, 5), (4, 7)]
    _, tried = growing(lambda n: 1e-3, lambda n: (1e-3, 0.0))
    assert tried == [(4, 3), (7, 3), (9, 3)]
    # By as many as the coefficients' falling lets expect, and at most 1.6 times as
    # many, until there are enough in all.
    _, tried = growing(lambda n: 1e-3, lambda n: (1e-3, 1e-3), most=(13, 33))
    assert tried[-1] == (13, 33)
    _, tried = growing(
        lambda n: 1e-3,
        lambda n: (0.0, 10.0 ** -(n[1] / 2)),
        most=(4, 99),
        first=(4, 10),
    )
    assert tried[1] == (4, 15)
    assert growing(lambda n: 1e-3, lambda n: (1e-3, 1e-3), total=35)[1][-1] == (7, 5)
    for tails in ((1e-3, 0.0), (0.0, 1e-3)):
        with pytest.raises(Refused, match="err by 0.001") as refused:
            growing(lambda n: 1.001e-3, lambda n, tails=tails: tails, fair=1e-3)
        assert refused.value.axis == 0  # of the keys, of which there is one
    with pytest.raises(Refused) as refused:
        growing(
            lambda n: 2.0,
            lambda n: (9.0, 1.0, 5.0),
            most=(4, 3, 3),
            keys=2,
            first=(4, 3, 3),
        )
    assert refused.value.axis == 1
    # What is not a number is not good, and neither fair.
    _, tried = growing(lambda n: np.nan if n[1] < 5 else 1e-7, lambda n: (0.0, 1e-3))
    assert tried == [(4, 3), (4, 5)]
    with pytest.raises(Refused):
        growing(lambda n: np.nan, lambda n: (0.0, 0.0))
    # A tenth of the error wanted, however large the largest.
    assert growing(lambda n: 1e-3, lambda n: (1.5e-7, 1e-3))[1][1] == (6, 5)
    assert growing(lambda n: 1e-3, lambda n: (0.9e-7, 1e-3))[1][1] == (4, 5)


def test_last_coefficients_count_over_the_sizes_of_their_values():
    chart = Chart((2, 3), np.arange(12.0).reshape(6, 2), size=np.array([1.0, 2.0]))
    assert chart.tails().tolist() == [
        [6 + 8 + 10, (7 + 9 + 11) / 2],
        [4 + 10, (5 + 11) / 2],
    ]
    assert chart.tails(2)[1].tolist() == [2 + 4 + 8 + 10, (3 + 5 + 9 + 11) / 2]
    signs = replace(
        chart,
        coefficients=chart.coefficients
        * [
            [1],
            [-1],
            [1],
            [1],
            [-1],
            [1],
        ],
    )
    assert signs.tails().tolist() == chart.tails().tolist()
    assert signs.range_of(1) == (1 - 3 - 5 - 7 - 9 - 11, 1 + 3 + 5 + 7 + 9 + 11)


def test_a_value_at_a_point_has_the_same_bits_in_any_company():
    draw = np.random.default_rng(0)
    chart, points = (
        Chart((7, 5), draw.normal(size=(35, 4))),
        draw.uniform(-1, 1, (200, 2)),
    )
    whole = chart(points)
    for some in (slice(0, 1), slice(50, 193), slice(199, None)):
        np.testing.assert_array_equal(chart(points[some]), whole[:, some])


def test_a_bound_counts_errors_over_the_sizes_at_their_points_and_coefficients_over_the_least():
    x, drawn = roots(4), np.array([0.2, -0.6])
    values = np.concatenate([1e-3 * x**3, 1e-3 * drawn**3 + [0.0, 1e-4]])[None]
    sampled = Sampled(
        values,
        np.array(
            [
                [
                    2.0,
                    1.0,
                    2.0,
                    2.0,
                    2.0,
                    4.0,
                ]
            ]
        ),
        1e-9,
        1,
    )
    error = sampled.chart((4,), np.concatenate([x, drawn])[:, None]).error
    assert error == pytest.approx(8 * 1e-4 / 4 + 1e-3 / 4 / 1.0 + 1e-9)
    lost = replace(sampled, bound=np.inf)
    assert lost.chart((4,), np.concatenate([x, drawn])[:, None]) is None


def test_nothing_is_known_nearer_to_a_fold_than_a_quarter_of_the_way_to_the_nearest_point_drawn():
    ends, drawn, x = (
        np.array([-3.0, -2.0]),
        np.array([-0.9, 0.0, 0.8]),
        np.array(
            [
                [-0.98],
                [-0.97],
                [0.94],
                [0.96],
                [1.0],
            ]
        ),
    )

    def known(span):
        return Sheet.of(span, None, 1, drawn).is_measured(x).tolist()

    both = Span.between(ends, 0, (True, True))
    assert known(both) == [
        False,
        True,
        True,
        False,
        False,
    ]
    assert known(replace(both, part=(0.0, 0.5))) == [
        False,
        True,
        True,
        True,
        True,
    ]
    assert known(replace(both, part=(0.5, 1.0))) == [
        True,
        True,
        True,
        False,
        False,
    ]
    assert known(Span.between(ends, 0)) == [True] * 5
    # Steps that vanish are described up to the end of the span.
    assert known(Span(Chart((), ends[None]), vanishing=(0.0, 5.0))) == [
        True,
        True,
        True,
        True,
        False,
    ]


def test_panels_begin_and_end_at_folds_where_their_pieces_do():
    asked = np.array([-4.2, -3.5, -2.5, -1.3])
    panels = panels_over(
        3,
        -4.3,
        -1.2,
        (True, True),
        asked,
        6,
    )
    assert [panel.number for panel in panels] == [3] * 4
    assert [panel.span.folds for panel in panels] == [
        (True, False),
        (False, False),
        (False, False),
        (False, True),
    ]
    assert [panel.span.bounds for panel in panels] == [
        (-4.3, -4.0),
        (-4.0, -3.0),
        (-3.0, -2.0),
        (-2.0, -1.2),
    ]


@pytest.mark.parametrize("at_fold", [False, True])
def test_gaits_whose_own_bound_is_too_large_are_sought_in_halves_beside_folds_alone(
    at_fold,
):
    tried = []

    def solve(panels, points):
        for panel in panels:
            part = panel.span.part
            tried.append(part)
            bound = 1.0 if part[1] > 0.25 else 1e-9
            yield Sampled(np.ones((1, 13)), np.ones((1, 13)), bound, 1)

    asked = panels_over(
        0,
        -2.9,
        -2.5,
        (at_fold, False),
        np.array([-2.899]),
        6,
    )
    done = fit_sheets(asked, solve, 1e-6, lambda half: half.part[0] == 0)
    assert tried == ([(0.0, 1.0), (0.0, 0.5), (0.0, 0.25)] if at_fold else [(0.0, 1.0)])
    assert [sheet.chart is not None for _, sheet in done] == [at_fold]


def test_a_sheet_has_more_nodes_where_it_may_before_its_halves_are_tried():
    tried = []

    def solve(asked, points):
        tried.append((asked[0].sizes, asked[0].span.part))
        x = points[0][:, 0]
        return [Sampled((x**9)[None], np.ones((1, len(x))), 0.0, 1)]

    span = Span.between(np.array([-3.0, -2.0]), 0)
    asked = Asked(
        2,
        span,
        (6,),
        (9,),
        np.linspace(-0.9, 0.9, 8)[:, None],
    )
    assert not fit_sheets([asked], solve, 1e-9, lambda half: False)
    assert tried == [((6,), (0.0, 1.0)), ((9,), (0.0, 1.0))]
    ((number, sheet),) = fit_sheets(
        [replace(asked, most=(12,))], solve, 1e-9, lambda half: False
    )
    assert number == 2 and sheet.chart.error <= 1e-9 and tried[-1][0] > (9,)


def test_polynomials_give_no_gait_that_an_end_or_its_error_reaches():
    ends = {"q": (-4.0, -2.0), "folds": (True, False), "end_errors": (1e-3, 1e-5)}
    margin = 1e-9 + 8e-5
    q = np.array([-4.0, -4.0 + 1e-12, -2.0 - 1.01 * margin, -2.0 - 0.99 * margin])

    away = _away_from_ends(SimpleNamespace(**ends), q)

    assert away.tolist() == [False, True, True, False]
