"""Patches and lines give the same gaits, and those of 113 bits, in six families and in
random cells.
"""

import copy
from dataclasses import dataclass, field, replace
from types import MappingProxyType

import mpmath as mp
import numpy as np
import pytest

import extended
from gaitsweep.tasks.branches.atlas import from_arrays
from gaitsweep.tasks.charts.box import Box, Refused
from gaitsweep.tasks.charts.cell import Lines, _Maker
from gaitsweep.tasks.charts.division import make_cells
from gaitsweep.tasks.charts.family import Family
from gaitsweep.tasks.contract import status
from gaitsweep.tasks.contract.registry import ALWAYS, GAITS, VARIABLES
from gaitsweep.tasks.measures.gaits import Wanted
from gaitsweep.tasks.step.problem import Lanes
from gaitsweep.tasks.studies import solve_planes
from gaitsweep.tasks.studies.solve_planes import lines, solve
from gaitsweep.tasks.studies.solve_points import lines as lines_side_by_side
from gaitsweep.tasks.studies.solve_points import points
from gaitsweep.tasks.walkers.resolve import resolve
from gaitsweep.tasks.walkers.walker import DIFFERENTIATED, KEYS, WalkerError
from lines import FAILURES
from soak.missed import neighbour

RATES = ("stance_rate", "thigh_rate", "shank_rate")
VALUES = ("stance_angle", *RATES, "period")
WANT = (
    *VALUES,
    "kneestrike_time",
    "spectral_radius",
    "multiplier_error_bound",
    *ALWAYS,
)
#: Walker, keys with their ranges, and the window of slopes [rad]. Folds and ends of all
#: kinds lie inside, in the last families tuned walkers too, and branches that touch.
FAMILIES = {
    "B": ("B", {"m_s": (0.05, 0.15), "R": (0.0, 0.12)}, (0.003, 0.03)),
    "E": ("E", {"foot_mass_ratio": (0.001, 0.2)}, (0.001, 0.08)),
    "E with offset": ("E", {"w_t": (0.01, 0.013), "m_s": (0.09, 0.11)}, (0.0042, 0.02)),
    "A": ("A", {"detuning": (0.75, 0.9), "m_h": (1.0, 1.5)}, (0.008, 0.03)),
    "A detuned": ("A", {"detuning": (0.0, 0.5)}, (0.0005, 0.08)),
    "A to both sides": ("A", {"detuning": (-0.3, 0.3)}, (0.002, 0.05)),
    "C": ("C", {"detuning": (0.3, 0.4), "m_h": (0.0, 0.5)}, (0.0045, 0.03)),
    "C detuned": ("C", {"detuning": (0.0, 0.5)}, (0.001, 0.08)),
    "C with hip mass": ("C", {"m_h": (0.0, 6.0)}, (0.001, 0.2)),
    "C where branches part": ("C", {"m_h": (0.0, 6.0)}, (0.004, 0.08)),
    "physical": (
        "physical",
        {"w_s": (0.024, 0.026), "R": (0.195, 0.205)},
        (0.018, 0.055),
    ),
    "straight": ("physical-straight", {"R": (0.05, 0.4)}, (0.001, 0.08)),
}
#: Keys of families that have another value than their walker's.
FIXED = {"C where branches part": {"detuning": 5 / 6}}
#: Slopes of a line, and how many of them lie near its folds and ends, at distances from
#: 1e-9 to 1e-2 in ln slope.
EACH, NEAR = 20, 3


@dataclass
class Outcome:
    """Points compared by both roads, their gaits, those of lines that patches gave, and
    what differs.
    """

    points: int = 0
    gaits: int = 0
    by_patch: int = 0
    near: int = 0
    checked: int = 0
    worst: float = 0.0
    worst_exact: float = 0.0
    wrong: list = field(default_factory=list)

    def __str__(self):
        return (
            f"{self.points} points, {self.gaits} gaits; {self.by_patch} points by patches, of these {self.near}"
            f" near folds and ends; {self.checked} checked with 113 bits; differences up to {self.worst:.2f} of the"
            f" sum of both bounds, errors up to {self.worst_exact:.2f} of their bound; {len(self.wrong)} wrong"
        )


def slopes(random, branches, window):
    """Slopes of a line: in a window, and near folds and ends of its branches that lie
    in it; the number of these.
    """
    low, high = np.log(window)
    places = [b.q[at] for b in branches for at in b.turns()]
    places += [b.q[-k] for b in branches for k in (0, 1)]
    places = [q for q in places if low < q < high]
    near = [
        random.choice(places) + random.choice([-1, 1]) * 10 ** random.uniform(-9, -2)
        for _ in places and range(NEAR)
    ]
    near = np.clip(near, low, high)
    return np.exp(np.sort([*near, *random.uniform(low, high, EACH - len(near))])), len(
        near
    )


def plane_of(keys, lines=900):
    """A plane of keys with their ranges, of so many lines that charts are not made in
    vain.
    """
    low, high = ([side[i] for side in keys.values()] for i in (0, 1))
    return {
        "keys": list(keys),
        "low": low,
        "high": high,
        "log": [False] * len(keys),
        "lines": lines,
    }


def charted(line, keys, window, many=900, **params):
    """Parameters of lines over a plane, and its charts for a window of slopes."""
    asked = {"plane": plane_of(keys, many), "want": WANT, **params}
    ends = dict(zip(("slope_from", "slope_to"), window, strict=True))
    return asked, solve_planes.charts(
        {**asked, "line": line, **ends, "slopes": EACH, "whole": True}, []
    )


def off(one, other, bounded_by):
    """Differences of values over the sum of both bounds; rates over the largest rate."""
    fastest = np.max([np.abs(other[name]) for name in RATES], axis=0)
    sizes = {name: fastest if name in RATES else np.abs(other[name]) for name in VALUES}
    each = [np.abs(one[name] - other[name]) / sizes[name] for name in VALUES]
    return np.max(each, axis=0) / bounded_by


def compare(
    outcome, family, count, exact, fixed=MappingProxyType({}), seed=0, many=900
):
    """Compare both roads on some lines of a family, and some of their gaits with those
    of 113 bits.

    Charts are made as for so `many` lines, and other keys are `fixed`. Every fourth
    line is a corner of the plane. Charts are made for a window of slopes, whatever
    slopes the lines have.
    """
    walker, keys, window = family
    random = np.random.default_rng(seed)
    drawn = [
        {key: float(random.uniform(*side)) for key, side in keys.items()}
        for _ in range(count)
    ]
    drawn[3::4] = [
        {key: float(random.choice(side)) for key, side in keys.items()}
        for _ in drawn[3::4]
    ]
    every = [{"walker": walker, "set": {**fixed, **one}} for one in drawn]
    asked, made = charted(every[0], keys, window, many)
    surveyed = []
    for k in range(0, count, 24):
        surveyed += lines_side_by_side(
            {"lines": every[k : k + 24], "slope": [window[0]], "want": ALWAYS}, []
        )
    found = []
    for line, (atlas, _) in zip(every, surveyed, strict=True):
        slope, near = slopes(random, from_arrays(atlas), window)
        other = points({"line": line, "slope": slope, "want": WANT}, [atlas])
        ((_, one),) = lines({**asked, "lines": [line], "slope": slope}, [made])
        by_patch = int(one["reason"].max()) < 6
        outcome.points += EACH
        outcome.near += near * by_patch
        outcome.by_patch += EACH * by_patch
        if np.isin([one["status"], other["status"]], FAILURES).any():
            outcome.wrong.append(("a point fails", line, by_patch, slope))
        if not np.array_equal(one["status"], other["status"]):
            at = np.argwhere(one["status"] != other["status"]).tolist()
            said = [
                (
                    slope[i],
                    GAITS[g],
                    int(one["status"][i, g]),
                    int(other["status"][i, g]),
                )
                for i, g in at
            ]
            outcome.wrong.append((walker, line["set"], by_patch, said))
            continue
        there = other["status"] == 0
        outcome.gaits += there.sum()
        one, other = (
            {key: v[there] for key, v in each.items() if key in WANT}
            for each in (one, other)
        )
        share = off(one, other, one["error_bound"] + other["error_bound"])
        bound = one["multiplier_error_bound"] + other["multiplier_error_bound"]
        share = np.maximum(
            share, np.abs(one["spectral_radius"] - other["spectral_radius"]) / bound
        )
        outcome.worst = max(outcome.worst, share.max(initial=0))
        if share.max(initial=0) > 1 or not np.array_equal(
            np.isnan(one["period"]), np.isnan(other["period"])
        ):
            outcome.wrong.append((walker, line["set"], by_patch, share.max()))
        at_slope = np.nonzero(there)[0]
        found += [
            (line, slope[at_slope[i]], {key: float(v[i]) for key, v in one.items()})
            for i in range(len(share))
            if by_patch
        ]
    for k in random.permutation(len(found))[:exact].tolist():
        line, slope, gait = found[k]
        outcome.worst_exact = max(outcome.worst_exact, error_of(line, slope, gait))
        outcome.checked += 1
    return outcome


def error_of(line, slope, gait):
    """Error of a gait, over its bound, against Lagrange's equations and impacts in 113
    bits.
    """
    # Exactly these doubles: beside a fold, what their shortest decimals differ by moves
    # gaits by more than bounds.
    table = {
        k: mp.mpf(v) if type(v) is float else v
        for k, v in resolve(line["walker"], line["set"]).table().items()
    }
    names = VALUES[:4] if table["knees"] else VALUES[:3]
    times = ("kneestrike_time", "period") if table["knees"] else ("period",)
    _, exact, _ = extended.solve(
        table, mp.mpf(float(slope)), [gait[name] for name in (*names, *times)]
    )
    fastest = max(abs(gait[name]) for name in RATES)
    errors = [
        abs(mp.mpf(gait[name]) - value) / (fastest if name in RATES else value)
        for name, value in zip((*names, *times), exact, strict=True)
        if name != "kneestrike_time"
    ]
    return float(max(errors)) / gait["error_bound"]


@pytest.mark.parametrize("count", [3, pytest.param(84, marks=pytest.mark.soak)])
def test_both_roads_agree(count, tell):
    """The short test takes the families whose lines are cheap, the long one 20,160
    points and 600 references.
    """
    outcome = Outcome()
    for name in FAMILIES if count > 3 else ("B", "E", "E with offset", "A detuned"):
        compare(
            outcome,
            FAMILIES[name],
            count,
            50 if count > 3 else 1,
            FIXED.get(name, {}),
            many=3600,
        )
    tell(str(outcome))
    assert not outcome.wrong
    assert outcome.by_patch > 0.6 * outcome.points and outcome.near >= 5 * (count > 3)
    assert outcome.worst_exact <= 1 and outcome.checked == (600 if count > 3 else 4)


def drawn_cell(seed):
    """A walker off by up to 30 %, or detuned, with one or two keys free over part of a
    cell: its family, other keys.
    """
    random, (walker, fixed, slope) = np.random.default_rng(seed), neighbour(seed)
    table = resolve(walker, fixed).table()
    sizes = {
        "mass": resolve(walker, fixed).total_mass,
        "length": resolve(walker, fixed).leg,
    }
    derived = [key for key in fixed if key in WIDEST]
    # What a derived key does not own, and is not at the border of its range.
    others = [
        key
        for key in OTHERS
        if table[key] and not (derived == ["foot_mass_ratio"] and KEYS[key] == "mass")
    ]
    others += ["m_h"] * ("foot_mass_ratio" not in fixed)
    keys = {}
    for key in (derived + random.permutation(others).tolist())[
        : int(random.integers(1, 3))
    ]:
        low = fixed.get(key, table.get(key))
        widest = WIDEST[key] if key in WIDEST else sizes[KEYS[key]] / 8
        keys[key] = (low, low + widest * float(random.uniform(0.05, 1.0)))
    window = np.minimum(
        slope * np.exp([-random.uniform(0, 2), random.uniform(0, 1)]), [0.2, 0.4]
    )
    return (walker, keys, tuple(window.tolist())), {
        key: value for key, value in fixed.items() if key not in keys
    }


#: Width of the widest cell of derived keys, and keys that no derived key owns where
#: they are not masses.
WIDEST, OTHERS = (
    {"detuning": 0.5, "foot_mass_ratio": 0.125},
    ("m_t", "m_s", "R", "l_t", "l_s"),
)
CELLS = [range(k, k + 50) for k in range(0, 1000, 50)]


def test_bounds_hold_where_steps_nearly_vanish():
    """Rounding grows over the size of the steps, by orders of magnitude between the
    nodes of a patch.
    """
    walker, keys, window = FAMILIES["A"]
    line = {
        "walker": walker,
        "set": {"detuning": 0.8915702140413136, "m_h": 1.063408551130624},
    }
    asked, made = charted(line, keys, window)
    slope = 0.01527403951198892
    ((_, one),) = lines({**asked, "lines": [line], "slope": np.array([slope])}, [made])
    shortest = int(np.nanargmin(one["stance_angle"][0]))
    gait = {key: float(value[0, shortest]) for key, value in one.items() if key in WANT}
    assert int(one["reason"].max()) < 6 and gait["stance_angle"] < 3e-4
    assert error_of(line, slope, gait) < 0.5
    # Where steps vanish for good, at 0.0155325, both roads end at the same gait.
    for slope in (0.0155275, 0.01553, 0.015535):
        own = {"lines": [line], "slope": np.array([slope])}
        ((_, one),) = lines({**asked, **own}, [made])
        ((_, other),) = lines_side_by_side({**own, "want": WANT}, [])
        assert one["status"].tolist() == other["status"].tolist()
        np.testing.assert_allclose(
            one["stance_angle"], other["stance_angle"], rtol=1e-9
        )
    assert np.nanmin(one["stance_angle"]) > 0.1


#: What is measured of gaits that are solved, at rest or in motion.
MEASURED = [
    variable.name
    for variable in VARIABLES.values()
    if variable.group in ("violations", "energy")
]


@pytest.mark.parametrize(
    ("walker", "key", "values"),
    [
        ("B", "m_s", (0.08, 0.12)),
        ("C", "m_h", (0.3, 0.8)),
        ("D", "foot_mass_ratio", (0.0, 0.2)),
    ],
)
def test_gaits_of_a_plane_are_measured_side_by_side_as_those_of_its_lines(
    walker, key, values
):
    window = (0.004, 0.02)
    slope = np.geomspace(*window, 3)
    every = [
        {"walker": walker, "set": {key: float(value)}}
        for value in np.linspace(*values, 4)
    ]
    asked, made = charted(every[0], {key: values}, window)
    want = [*ALWAYS, *MEASURED]
    asked |= {"slope": slope, "want": want, "lines": every}

    ((_, plane),) = lines(asked, [made])

    alone = lines_side_by_side({"lines": every, "slope": slope, "want": want}, [])
    for name in MEASURED:
        of_plane = plane[name].reshape(len(every), len(slope), -1)
        of_lines = np.array([points[name] for _, points in alone])
        if name == "violations":
            np.testing.assert_array_equal(of_plane, of_lines)
            continue

        sizes = np.abs(of_lines[np.isfinite(of_lines)])
        off = 1e-11 * sizes.max(initial=1.0)
        np.testing.assert_allclose(of_plane, of_lines, rtol=1e-8, atol=off)


def test_gaits_of_a_plane_over_a_drive_are_measured_with_what_drives_each():
    """Each point has a push-off of its own."""
    pushes = np.array([0.05, 0.08, 0.12])
    every = [
        {"walker": "B", "set": {"m_h": mass}, "slope": 0.0} for mass in (0.9, 1.0, 1.2)
    ]
    window = (0.04, 0.15)
    over = {"along": "push_off"}
    asked, made = charted(every[0], {"m_h": (0.8, 1.4)}, window, **over)
    names = (
        "friction_demand_push_off",
        "strike_velocity",
        "least_normal_impulse",
        "push_off_work",
    )
    want = [*ALWAYS, *names]
    asked |= {"slope": pushes, "want": want, "lines": every}

    ((_, plane),) = lines(asked, [made])

    request = {"lines": every, "slope": pushes, "want": want, **over}
    alone = lines_side_by_side(request, [])
    is_gait = plane["status"] == status.CONVERGED
    assert is_gait.any(axis=1).all()
    assert (plane["push_off_work"][is_gait] > 0).all()
    for name in names:
        of_lines = np.vstack([points[name] for _, points in alone])
        of_plane = plane[name][is_gait]
        assert np.isfinite(of_plane).all()
        np.testing.assert_allclose(of_plane, of_lines[is_gait], rtol=1e-8)


def test_gaits_of_a_walker_in_a_plane_are_differentiated_at_once(monkeypatch):
    """Each walker takes longer than a gait."""
    asked_of = []
    alone = Lanes.alone

    def counted(problem, lane):
        asked_of.append(lane)
        return alone(problem, lane)

    window = (0.004, 0.02)
    every = [{"walker": "D", "set": {"m_h": m_h}} for m_h in (0.4, 0.5, 0.6)]
    asked, made = charted(every[0], {"m_h": (0.3, 0.8)}, window)
    asked |= {"lines": every, "slope": np.geomspace(*window, 5)}
    monkeypatch.setattr(Lanes, "alone", counted)

    ((_, plane),) = lines({**asked, "want": ["period", "period_by_key"]}, [made])

    assert np.isin(plane["status"][:, :2], status.CONVERGED).all()
    of_mass = plane["period_by_key"][:, :2, DIFFERENTIATED.index("m_h")]
    assert np.isfinite(of_mass).all()
    assert len(asked_of) == 2 * len(every)  # of long and of short gaits


def test_gaits_of_the_first_value_of_an_axis_are_not_missed():
    """The smallest slope of the lowest surveyed line says little of that at the border,
    0.00098.
    """
    line = {"walker": "A", "set": {"detuning": 0.1}}
    asked, made = charted(line, {"detuning": (0.1, 0.5)}, (1e-3, 1e-3))
    own = {"lines": [line], "slope": np.array([1e-3])}
    ((_, one),) = lines({**asked, **own}, [made])
    ((_, other),) = lines_side_by_side({**own, "want": WANT}, [])
    assert one["status"].tolist() == other["status"].tolist() == [[0, 1, 0, 1]]


@pytest.mark.parametrize(
    "seeds",
    [range(2, 3), *(pytest.param(each, marks=pytest.mark.soak) for each in CELLS)],
)
def test_nothing_is_wrong_in_random_cells(seeds, tell):
    """Lines of cells of 64, with points near folds and ends; one gait of every tenth
    cell in 113 bits.
    """
    outcome, drawn = Outcome(), 0
    for seed in seeds:
        try:
            family, fixed = drawn_cell(seed)
            compare(
                outcome,
                family,
                4,
                int(seed % 10 == 0),
                fixed,
                seed,
                300 if len(family[1]) == 1 else 900,
            )
        except WalkerError:  # some walker of the cell cannot be
            continue
        drawn += 1
    tell(f"{drawn} cells: {outcome}")
    assert not outcome.wrong, outcome.wrong[:3]
    assert outcome.worst_exact <= 1 and drawn > 0.9 * len(seeds)


LONG = [
    pytest.param(name, marks=pytest.mark.soak)
    for name in FAMILIES
    if name not in ("B", "E")
]


@pytest.mark.parametrize("name", ["B", "E", *LONG])
def test_wrong_patches_change_no_accepted_value(name):
    walker, keys, window = FAMILIES[name]
    family = Family.of({"walker": walker, "set": FIXED.get(name, {})}, tuple(keys))
    box = Box(
        tuple(keys),
        *(tuple(side) for side in zip(*keys.values(), strict=True)),
        log=True,
    )
    cells = make_cells(
        family, box, tuple(np.log(window)), lambda part: 3600 * box.share(part), EACH
    ).made
    right = max(cells, key=lambda cell: len(cell.patches) * box.share(cell.box))
    at = right.box.at(np.random.default_rng(3).uniform(-1, 1, (30, len(keys))))
    slope = np.exp(
        np.log(window[0]) + np.log(window[1] / window[0]) * np.array([0.2, 0.7])
    )

    def solved(cell):
        return solve(family, cell, at, slope, Wanted(WANT, set(GAITS)))

    out, accepted = solved(right)
    assert accepted.mean() > 0.8

    def assert_unchanged(other, still):
        """Every gait of an accepted point is one of the right gaits there."""
        for line, k in np.argwhere(accepted & still):
            for g in np.flatnonzero(other["status"][line, k] == 0):
                period, bound = (
                    other["period"][line, k, g],
                    other["error_bound"][line, k, g],
                )
                bounds = bound + np.nan_to_num(out["error_bound"][line, k])
                assert (np.abs(out["period"][line, k] / period - 1) <= bounds).any()

    wrong = copy.deepcopy(right)
    wrong.patches = [
        replace(
            p, gaits=replace(p.gaits, coefficients=p.gaits.coefficients * (1 + 1e-3))
        )
        for p in right.patches
    ]
    other, still = solved(wrong)
    assert_unchanged(other, still)
    assert not still.all()  # farther from their predictions than any that was measured
    wrong.patches = [
        replace(patch, gaits=replace(patch.gaits, error=1.0)) for patch in wrong.patches
    ]
    other, still = solved(wrong)
    assert_unchanged(other, still)
    assert still[accepted].mean() > 0.7
    a, b, *others = wrong.patches
    wrong.patches = [
        replace(a, gaits=b.gaits, span=b.span),
        replace(b, gaits=a.gaits, span=a.span),
        *others,
    ]
    assert_unchanged(*solved(wrong))
    maker = _Maker(family, right.box, tuple(np.log(window)), Lines(family), 10**4)
    maker.begin()
    maker.checked(right.patches)
    for k in range(len(right.patches)):
        fewer = copy.deepcopy(right)
        del fewer.patches[k]
        assert_unchanged(*solved(fewer))
        with pytest.raises(Refused, match="further piece"):
            maker.checked(fewer.patches)
