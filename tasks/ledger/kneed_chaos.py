"""Beyond period one: period doublings, chaos, counts of gaits, re-pairing (sections 3,
5.2, 7 and 8 of the paper).

A claim reads the tables of the study that wants it, and computes those that the study
lacks.
"""

from __future__ import annotations

import functools
from dataclasses import asdict

import numpy as np

from gaitsweep.tasks.contract.registry import LOSS_WINDOWS
from gaitsweep.tasks.contract.tables import table
from gaitsweep.tasks.ledger.claim import (
    NOT_REPRODUCED,
    PRINTED,
    REPRODUCED,
    Found,
    claim,
    found,
    verdict,
)
from gaitsweep.tasks.ledger.lines import WALKERS, Arrays, Paper, coarse_lines, memoize
from gaitsweep.tasks.ledger.rounding_intervals import HALF_UNITS, changed, interval
from gaitsweep.tasks.studies.count_gaits import census
from gaitsweep.tasks.studies.follow_curves import curve
from gaitsweep.tasks.studies.iterate_orbits import orbit
from gaitsweep.tasks.studies.locate_cascade import cascade
from gaitsweep.tasks.walkers.catalogue import CATALOGUE

#: Where each walker's period doublings are sought: window of slopes [rad], number of
#: slopes searched, first periods.
WINDOWS: dict[str, tuple[float, float, int, tuple[int, ...]]] = {
    "A": (0.05, 0.1, 2, (1,)),
    "B": (3e-4, 0.03, 2, (1,)),
    "E": (5e-3, 0.01, 2, (2,)),
    "F": (5e-3, 0.05, 2, (1,)),
    "C": (*LOSS_WINDOWS["C"], 2, (1,)),
    "C-printed": (*LOSS_WINDOWS["C-printed"], 2, (1,)),
    "D": (*LOSS_WINDOWS["D"], 20, (1, 3, 4)),
}
#: How near a slope folds are beside it, in ln slope.
_BESIDE = 0.3
#: What curve of folds the branches of C touch on.
FOLDS_OF_C = {
    "slope": np.array([1e-3, 0.3]),
    "key": "detuning",
    "from": 0.0,
    "to": 1.2,
    "kinds": ["fold"],
}
#: Window of slopes [rad] that holds the doublings and the loss of walking of kneed
#: walkers within their rounding.
CORNER = (0.06, 0.12)


def _compute_cascade(
    paper: Paper, walker: str, families: tuple[int, ...], **options: int
) -> Arrays:
    low, high, n, _ = WINDOWS[walker]
    own = paper.line(walker)
    slopes = np.round(np.linspace(low, high, n), 12)  # as a study's axis has them
    return cascade(
        {**own.params, "slope": slopes, "families": families, **options}, [own.arrays]
    )


def _doublings(
    paper: Paper, walker: str, family: str, group: str = "cascade"
) -> Arrays:
    """Rows of one family in a table of a walker's cascade (columns as in task
    `cascade`).
    """
    columns = paper.table(
        group, walker, lambda: _compute_cascade(paper, walker, WINDOWS[walker][3])
    )
    rows = columns["family"] == family
    return {name: column[rows] for name, column in columns.items()}


def _flips(paper: Paper, walker: str, family: str) -> np.ndarray:
    """Slopes of a family's flips, shape (n,) [rad]."""
    events = _doublings(paper, walker, family)
    return events["slope"][events["kind"] == "flip"]


def crisis(paper: Paper, walker: str, family: str) -> tuple[float, float]:
    """Bracket the slope at which a family's last attractor is lost.

    Parameters
    ----------
    walker, family : str
        Name in the catalogue, and the first period of the family.

    Returns
    -------
    low, high : float [rad]
    """
    bracket = _doublings(paper, walker, family, "lost")
    return float(bracket["low"][0]), float(bracket["high"][0])


def exponent(
    paper: Paper, walker: str, slopes: np.ndarray, starts: int
) -> tuple[float, float, float]:
    """Find the largest Lyapunov exponent per step of a walker's attractors.

    Parameters
    ----------
    walker : str
        Name in the catalogue.
    slopes : ndarray, shape (n,) [rad]
    starts : int
        Initial conditions at each slope.

    Returns
    -------
    exponent, standard_error, slope : float [1/step, 1/step, rad]
    """
    own = paper.line(walker)
    tables = orbit(
        {
            **own.params,
            "slope": slopes,
            "starts": starts,
            "transient": 100,
            "steps": 176,
            "shown": 1,
        },
        [own.arrays],
    )
    most = int(np.argmax(tables["lyapunov/exponent"]))
    value, error, slope = (
        float(tables[f"lyapunov/{k}"][most])
        for k in ("exponent", "standard_error", "slope")
    )
    return value, error, slope


@claim("D8")
def doublings_to_chaos(paper: Paper) -> Found:
    """Follow the period doublings of D from period one to chaos and the loss of
    walking.
    """
    at, end = _flips(paper, "D", "1"), crisis(paper, "D", "1")
    value, error, _ = exponent(paper, "D", np.array([0.0189]), 64)
    begins, last = PRINTED["D2"].compare(at[0]) == REPRODUCED, 0.5 * sum(end)
    holds = (
        PRINTED["D8"].compare(last) if value > 4 * error and begins else NOT_REPRODUCED
    )
    limit = _doublings(paper, "D", "1", "accumulation")
    return found(holds, last, at=at, limit=limit, exponent=value, error=error, end=end)


@claim("D9")
def period_three(paper: Paper) -> Found:
    """Follow the period-three family of D from its fold through its doublings to the
    end of its chaos.
    """
    events, limit = (
        _doublings(paper, "D", "3"),
        _doublings(paper, "D", "3", "accumulation"),
    )
    fold, at, end = (
        events["slope"][events["kind"] == "fold"][0],
        _flips(paper, "D", "3"),
        crisis(paper, "D", "3"),
    )
    chaos_1 = (
        _doublings(paper, "D", "1", "accumulation")["slope"][0],
        crisis(paper, "D", "1")[0],
    )
    coexists = at[0] < _flips(paper, "D", "1")[0]
    separate = limit["slope"][0] < end[1] < chaos_1[0] < chaos_1[1]
    holds = verdict(
        fold < PRINTED["D9"].number < at[0] and coexists and separate and len(at) > 2
    )
    told = {
        "fold": fold,
        "at": at,
        "further": at[1:],
        "limit": limit,
        "end": end,
        "chaos_1": chaos_1,
        "more": _period_four(paper),
    }
    return found(holds, 0.5 * (fold + at[0]), **told)


def _period_four(paper: Paper) -> str:
    """Where D has a gait of period four that is stable, in words."""
    events, flips = _doublings(paper, "D", "4"), _flips(paper, "D", "4")
    if not len(flips):
        return ""

    fold = events["slope"][events["kind"] == "fold"][0]
    return (
        f"; likewise a period-four gait (Li & Yang 2012), from its fold at {fold:.8f} rad "
        f"to its flip at {flips[0]:.8f} rad"
    )


@claim("K1")
def kneed_doublings(paper: Paper) -> Found:
    """Follow the period doublings of C, exactly tuned and as printed."""
    exact, printed = interval(paper, "C flip"), interval(paper, "C-printed flip")
    at = {w: _flips(paper, w, "1") for w in ("C", "C-printed")}
    limit = {w: _doublings(paper, w, "1", "accumulation") for w in at}
    continues = all(each["flips"][0] >= 3 for each in limit.values())
    holds = PRINTED["K1"].compare(*printed.bounds) if continues else NOT_REPRODUCED

    return found(
        holds, *printed.bounds, at=at, limit=limit, exact=exact, printed=printed
    )


def corner_crises(
    paper: Paper, walker: str
) -> tuple[tuple[float, float], tuple[float, float]]:
    """Bracket the loss of walking at the two corners of a walker's rounding.

    Parameters
    ----------
    walker : str
        Name in the catalogue.

    Returns
    -------
    lower, upper : tuple of float [rad]
        Brackets (low, high).

    Notes
    -----
    The loss has no derivative, so it is computed for two walkers whose keys are all off by their half units, each in
    the direction that moves the flip down, or up.
    """
    rows = paper.table("corners", walker, lambda: _compute_corners(paper, walker))
    lower, upper = zip(rows["low"].tolist(), rows["high"].tolist(), strict=True)
    return lower, upper


def _compute_corners(paper: Paper, walker: str) -> Arrays:
    sensitivity = interval(paper, f"{walker} flip").sensitivity
    brackets = []
    for direction in (-1, 1):
        changes = {
            key: direction * float(np.sign(sensitivity[key])) * half
            for key, half in HALF_UNITS[walker].items()
        }
        corner = changed(walker, CATALOGUE[walker], changes)
        params = {
            "line": {"walker": asdict(corner), "set": {}},
            "near": paper.line(walker).params["line"],
        }
        ends = cascade(
            {**params, "slope": np.array(CORNER), "periods": 8, "steps": 40},
            [paper.line(walker).arrays],
        )
        brackets.append((float(ends["lost/low"][0]), float(ends["lost/high"][0])))

    return table("corners", brackets, ("low", "high"))


@claim("K2")
def kneed_end(paper: Paper) -> Found:
    """Bracket the slope at which C's persistent walking ends."""
    ends = {w: crisis(paper, w, "1") for w in ("C", "C-printed")}
    (low, _), (_, high) = corner_crises(paper, "C-printed")
    loss = 0.5 * sum(ends["C-printed"])
    return found(PRINTED["K2"].compare(loss, low, high), loss, low, high, ends=ends)


@claim("K3")
def unstable_beyond(paper: Paper) -> Found:
    """Follow both gaits of C beyond the loss of walking."""
    loss = crisis(paper, "C", "1")[1]
    curves = paper.line("C").curves
    top = {
        ("short" if c["short"][len(c["slope"]) // 2] else "long"): c["slope"].max()
        for c in curves
    }
    least = min(c["spectral_radius"][c["slope"] > loss].min() for c in curves)

    return found(
        verdict(min(top.values()) > loss and least > 1),
        min(top.values()),
        top=top,
        least=least,
    )


@claim("T6")
def re_pairing(paper: Paper) -> Found:
    """Locate the detuning at which the branches of C touch, a turning point of its
    curve of folds.
    """

    def compute_curve() -> Arrays:
        own = paper.line("C", detuning=1.0)
        return curve({**own.params, **FOLDS_OF_C}, [own.arrays])

    turns = paper.table("turnings", "C", compute_curve, detuning=1.0)
    touch = np.nonzero((turns["turn"] == "key") & (turns["kind"] == "fold"))[0]
    if not len(touch):
        raise ValueError("the curve of folds has no turning point in the detuning")

    at = {name: values[touch[0]] for name, values in turns.items()}
    beside = (at["value"] - 0.004, at["value"] + 0.004)
    near = [
        [
            fold["slope"]
            for fold in gaits.special_of("fold")[::-1]
            if abs(np.log(fold["slope"] / at["slope"])) < _BESIDE
        ]
        for gaits in coarse_lines(
            [("C", {"detuning": float(detuning)}) for detuning in beside]
        )
    ]
    neighbours = "; ".join(
        f"at detuning {d:.4f} neighbouring folds at {', '.join(f'{s:.4f} rad' for s in folds) or 'no slope'}"
        for d, folds in zip(beside, near, strict=True)
    )

    return found(
        verdict(sorted(map(len, near)) == [0, 2]),
        at["value"],
        **{**at, "neighbours": neighbours},
    )


@claim("G1")
def never_more(paper: Paper) -> Found:
    """Count the anthropomorphic period-one gaits that searches over the whole section
    find.
    """
    slopes = np.array([1e-3, 0.01, 0.03, 0.1])
    each = {w: {"line": {"walker": w, "set": {}}, "slope": slopes} for w in WALKERS}
    coverage = {
        w: paper.table("coverage", w, functools.partial(census, each[w], []))
        for w in WALKERS
    }
    whole = {
        name: np.concatenate([c[name] for c in coverage.values()])
        for name in coverage[WALKERS[0]]
    }
    most = whole["anthropomorphic"].max()

    return found(
        verdict(most <= PRINTED["G1"].number),
        most,
        most=most,
        starts=whole["starts"].sum(),
        searches=len(whole["starts"]),
        unseen=100 * whole["unseen"][whole["converged"] > 0].max(),
        deflated=whole["found_deflated"].sum(),
        others={
            w: c["non_anthropomorphic"].sum()
            for w, c in coverage.items()
            if c["non_anthropomorphic"].any()
        },
    )


@memoize
def chaos(paper: Paper, walker: str) -> tuple[int, str]:
    """Whether a walker's period doublings lead to chaos, and where (last column of
    figure 10).

    Notes
    -----
    The exponent is the largest of those at three slopes beyond the accumulation, at fractions of its distance from the
    second flip: within the chaotic range, where some slopes lie in windows of stable
    gaits of long periods.
    """
    family = str(WINDOWS[walker][3][0])
    tables = _compute_cascade(paper, walker, (int(family),), periods=8, steps=0)
    at, limit = (
        tables["cascade/slope"][tables["cascade/kind"] == "flip"],
        float(tables["accumulation/slope"][0]),
    )
    value, error, slope = exponent(
        paper, walker, limit + np.array([0.3, 0.5, 0.7]) * (limit - at[1]), 12
    )

    return int(value > 4 * error), (
        f"doublings of period {family} from {at[0]:.6g}, accumulating at {limit:.6g}; "
        f"Lyapunov exponent {value:.3f} ({error:.3f}) at {slope:.5g}"
    )
