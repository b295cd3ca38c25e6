"""The proof of one gait: that it exists and is unique in a box, is a step, and is
stable or unstable.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

from flint import acb, arb, arb_mat, ctx

from gaitsweep.tasks.proofs import krawczyk
from gaitsweep.tasks.proofs.body import Body, Number, body
from gaitsweep.tasks.proofs.enclosed_step import Region, Step, dimensions, start, step
from gaitsweep.tasks.proofs.enclosure import Accuracy, NotProvedError
from gaitsweep.tasks.proofs.sequence import Events, events
from gaitsweep.tasks.proofs.stability import is_stable, multipliers, step_derivative

#: Relative radius of the first box, and how far its middle may be corrected before the
#: approximation is refused, unless its own bound is larger.
FIRST_RADIUS, MAX_CORRECTION = 1e-12, 1e-6
#: A step's remainders are this much smaller than the box.
REMAINDER = 1e-9
#: A box that shows nothing is followed by one so much smaller.
_SHRINK = 1e-4
MIN_BITS, MAX_ATTEMPTS = 106, 6
#: A second box, where the first leaves stability open, is this much smaller than asked.
SHARPER = 1e-12
UNDECIDED = "A multiplier is not told from the unit circle."


@dataclass(frozen=True)
class Setting:
    """A walker on a slope: numeric keys, whether its knees bend, the slope [rad], and
    whether the trailing knee is free or locked during heelstrike.
    """

    keys: Mapping[str, Number]
    kneed: bool
    slope: Number
    trailing_knee: str = "free"

    def body(self) -> Body:
        """Return the constants of the walker, enclosed at the present precision."""
        return body(self.keys, self.kneed, self.trailing_knee)


@dataclass(frozen=True)
class Proof:
    """What was proved of a gait, or why not.

    Attributes
    ----------
    proved : bool
        Unique and first strike hold, and the gait is of the label asked for.
    unique : bool
        There is exactly one solution of a gait's equations in the box.
    first_strike : bool
        It is a step: its strikes come first and its legs pass once.
    stable : bool or None
        Every multiplier lies inside the unit circle, one lies outside, or neither was
        shown.
    multipliers : list of acb
        Each of the section's multipliers, or none where two are not told apart.
    label : str
        `long` or `short`.
    box : dict of str to arb
        Section state and event times, in the walker's units.
    radius : float
        Of the box, relative as `error_bound` is.
    events : list of str
    bits : int
        Precision of the balls.
    reason : str
        Why a gait is not proved, or its stability not.
    """

    proved: bool
    unique: bool = False
    first_strike: bool = False
    stable: bool | None = None
    multipliers: list[acb] = field(default_factory=list)
    label: str = ""
    box: dict[str, arb] = field(default_factory=dict)
    radius: float = math.nan
    events: list[str] = field(default_factory=list)
    bits: int = 0
    reason: str = ""


@dataclass(frozen=True)
class Solution:
    """A box with exactly one solution of a gait's equations, and the step enclosed over
    the box it was proved in.
    """

    body: Body
    box: list[arb]
    step: Step
    bits: int


def prove(
    setting: Setting,
    guess: Sequence[float],
    accuracy: float = 1e-12,
    label: str | None = None,
    reach: float = MAX_CORRECTION,
) -> Proof:
    """Prove the gait near an approximation.

    Parameters
    ----------
    setting : Setting
    guess : sequence of float
        Stance angle [rad], stance rate, thigh rate, with knees the time of kneestrike,
        and the period.
    accuracy : float
        Largest relative radius of the box.
    label : str, optional
        `long` or `short` if the gait must be that.
    reach : float
        How far the approximation may be corrected, relative.

    Returns
    -------
    Proof
        Its box is the smaller one; uniqueness holds in it as well.
    """
    proof = _proof(setting, guess, accuracy, label, reach)
    if proof.unique and (
        proof.stable is None or not proof.first_strike
    ):  # a smaller box may decide
        finer = _proof(setting, guess, accuracy * SHARPER, label, reach)
        proof = finer if finer.proved else proof
    return proof


def _proof(
    setting: Setting,
    guess: Sequence[float],
    accuracy: float,
    label: str | None,
    reach: float,
) -> Proof:
    try:
        solution = solve(setting, guess, accuracy, reach)
    except NotProvedError as error:
        return Proof(False, reason=str(error))
    with ctx.workprec(solution.bits):
        return _judged(solution, label)


def _judged(solution: Solution, label: str | None) -> Proof:
    """What holds of the one solution in a box."""
    m, n = dimensions(solution.body)
    stable, values = None, list[acb]()
    try:
        derivative = step_derivative(solution.step.derivative, m, n)
        stable, values = is_stable(derivative), multipliers(derivative)
    except ZeroDivisionError:  # a strike grazes, and the step map has no derivative; the order of strikes says so
        pass

    box = named(solution.body, solution.box)
    known = Proof(
        False,
        True,
        stable=stable,
        multipliers=values,
        box=box,
        radius=_radius(box),
        bits=solution.bits,
    )
    try:
        order: Events = events(solution.step, solution.box[m:])
    except NotProvedError as error:
        return replace(known, reason=str(error))

    known = replace(known, first_strike=True, label=order.label, events=order.names)
    if label in ("long", "short") and label != order.label:
        return replace(
            known, reason=f"The gait is a {order.label} step, not a {label} one."
        )

    return replace(known, proved=True, reason="" if stable is not None else UNDECIDED)


def solve(
    setting: Setting,
    guess: Sequence[float],
    accuracy: float,
    reach: float = MAX_CORRECTION,
) -> Solution:
    """Shrink a box around an approximation until it is small enough and holds exactly
    one solution.

    Parameters
    ----------
    setting, guess, accuracy, reach
        As `prove` takes them.

    Returns
    -------
    Solution

    Raises
    ------
    NotProvedError
        If Krawczyk's operator does not map a box into itself.
    """
    middle = _unknowns(setting, guess)
    corrected = 0.0
    size = FIRST_RADIUS
    bits = MIN_BITS
    for _ in range(MAX_ATTEMPTS):
        tolerance = min(size * REMAINDER, accuracy)
        bits = max(bits, 32 - math.floor(math.log2(tolerance)))
        with ctx.workprec(bits):
            walker = setting.body()
            box = _box(walker, middle, size)
            slope = arb(setting.slope)
            try:
                enclosed_step, K = _attempt(walker, slope, middle, box, tolerance)
            except (NotProvedError, ZeroDivisionError) as error:
                reason = _sentence(error)
                size *= _SHRINK
                continue

            if _holds_with_room(box, K):
                achieved = _radius(named(walker, K))
                if achieved <= accuracy:
                    return Solution(walker, K, enclosed_step, bits)
                reason = f"The radius is {achieved:.1e}, above the accuracy of {accuracy:.1e}."
                size = 16 * achieved
                middle = _middle(K)
                continue

            reason = "Krawczyk's operator does not map the box into itself."
            shift = _distance(walker, middle, K)
            if shift < 0.5 * size:
                size *= _SHRINK
                continue

            corrected += shift
            if not corrected < reach:
                raise NotProvedError(_far(shift))
            middle = _middle(K)

    raise NotProvedError(reason)


def _box(walker: Body, middle: list[arb], size: float) -> list[arb]:
    """A box about a point, of a relative size."""
    scales = sizes(walker, middle)
    return [x + arb(0, size * scale) for x, scale in zip(middle, scales, strict=True)]


def _middle(box: list[arb]) -> list[arb]:
    """The middle of a box."""
    return [x.mid() for x in box]


def _far(shift: float) -> str:
    """Why an approximation is none."""
    return (
        f"No gait is near the approximation: its first correction is {shift:.1e} of it."
    )


def _holds_with_room(box: list[arb], image: list[arb]) -> bool:
    """Whether an image lies in a box with room to spare: the decimals printed hold a
    little more than it.
    """
    return krawczyk.contained([arb(k.mid(), 1.1 * k.rad()) for k in image], box)


def _attempt(
    walker: Body, slope: arb, middle: list[arb], box: list[arb], tolerance: float
) -> tuple[Step, list[arb]]:
    """Enclose the step over a box, and Krawczyk's image of it."""
    offsets = [x - c for x, c in zip(box, middle, strict=True)]
    region = Region([*middle, slope], [*offsets, arb(0)])
    accuracy = Accuracy(order(tolerance), tolerance)
    enclosed_step = step(walker, region, accuracy)
    derivative = defect_derivative(walker, enclosed_step)
    K = krawczyk.image(offsets, enclosed_step.defect, derivative)
    return enclosed_step, [c + k for c, k in zip(middle, K, strict=True)]


def defect_derivative(walker: Body, enclosed_step: Step) -> arb_mat:
    """Derivative of guards and of image minus start by the unknowns.

    Parameters
    ----------
    walker : Body
    enclosed_step : Step

    Returns
    -------
    arb_mat, shape (n, n) or, with the slope, (n, n + 1)
    """
    m, n = dimensions(walker)
    rows = enclosed_step.derivative.tolist()
    for i in range(m):
        rows[n + i][i] -= 1
    return arb_mat(rows)


def order(tolerance: float) -> int:
    """Coefficients of a Taylor step that make the steps' number times their cost small.

    Parameters
    ----------
    tolerance : float
        Remainder over what it is added to.

    Returns
    -------
    int
    """
    return max(12, round(6 - math.log10(tolerance)))


def _unknowns(setting: Setting, guess: Sequence[float]) -> list[arb]:
    """Section state and event times of an approximation, as exact numbers."""
    with ctx.workprec(MIN_BITS):
        m, n = dimensions(setting.body())
    if len(guess) != 3 + n or not all(math.isfinite(x) for x in guess):
        needed = "stance angle, two rates and period"
        if n == 2:
            needed = "stance angle, two rates, kneestrike and period"
        raise NotProvedError(f"The approximation is not made of finite {needed}.")

    if not guess[0] or not any(guess[1:m]) or not guess[-1] > 0:
        raise NotProvedError(
            "The approximation is no gait: its stance angle, rates or period vanish."
        )

    return [arb(x) for x in (*guess[:m], *guess[3:])]


def sizes(walker: Body, middle: Sequence[arb]) -> list[float]:
    """Size of each coordinate: the angle, the largest rate, the period, and that of a
    slope behind them.

    Parameters
    ----------
    walker : Body
    middle : sequence of arb

    Returns
    -------
    list of float
    """
    m, n = dimensions(walker)
    rates, period = (
        max(abs(float(r)) for r in middle[1:m]),
        abs(float(middle[m + n - 1])),
    )
    return [
        abs(float(middle[0])),
        *[rates] * (m - 1),
        *[period] * n,
        *(abs(float(x)) for x in middle[m + n :]),
    ]


def _distance(walker: Body, middle: Sequence[arb], image: Sequence[arb]) -> float:
    scales = sizes(walker, middle)
    return max(
        abs(float((k.mid() - c).mid())) / s
        for c, k, s in zip(middle, image, scales, strict=True)
    )


def named(walker: Body, box: Sequence[arb]) -> dict[str, arb]:
    """A box of unknowns by the names of archives, the dependent rates with it.

    Parameters
    ----------
    walker : Body
    box : sequence of arb
        Section state and event times.

    Returns
    -------
    dict of str to arb
    """
    m, _ = dimensions(walker)
    state, _ = start(walker, box[:m])
    rates = state[len(state) // 2 :]
    times = ("kneestrike_time", "period") if walker.kneed else ("period",)

    return dict(
        zip(
            ("stance_angle", "stance_rate", "thigh_rate", "shank_rate", *times),
            (box[0], rates[0], rates[1], rates[-1], *box[m:]),
            strict=True,
        )
    )


def _radius(box: Mapping[str, arb]) -> float:
    """Largest of the relative radii of angle and times, and of the rates' over the
    largest rate.
    """
    rates = [x for name, x in box.items() if name.endswith("_rate")]
    largest = max(float(x.abs_lower()) for x in rates)
    period = float(box["period"].abs_lower())
    sizes = [float(box["stance_angle"].abs_lower()), *[largest] * len(rates)]
    sizes += [period] * (len(box) - len(sizes))

    return max(
        float(x.rad()) / s if s else math.inf
        for x, s in zip(box.values(), sizes, strict=True)
    )


def _sentence(error: Exception) -> str:
    if isinstance(error, NotProvedError):
        return str(error)
    return "A matrix is not told from a singular one."
