"""Branches of gaits over intervals: proved tubes around them.

A gait's equations F(u, s) = 0 leave one of slope and stance angle as the parameter s,
the others as unknowns u. Around a line c + t (s - s_0), Krawczyk's operator in w = u -
c - t (s - s_0),

    K = -Y F(c, s_0) - Y (F_u t + F_s) [s - s_0] + (1 - Y F_u) W,

with derivatives over the whole tube, proves that every s of an interval has exactly one
gait with w in W. It is continuous in s.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from flint import arb, arb_mat

from gaitsweep.tasks.proofs import krawczyk
from gaitsweep.tasks.proofs.body import Body, Number, body
from gaitsweep.tasks.proofs.enclosed_step import Region, Step, dimensions, step
from gaitsweep.tasks.proofs.enclosure import Accuracy, NotProvedError
from gaitsweep.tasks.proofs.gait import defect_derivative, order, sizes
from gaitsweep.tasks.proofs.sequence import Events, events
from gaitsweep.tasks.proofs.stability import step_derivative

#: Which coordinate of (section state, event times, slope) is the parameter.
BY_ANGLE, BY_SLOPE = 0, -1
#: The middle of a tube's line, its tangent, None where the parameter alone moves along
#: it, and half the parameter's interval.
Line = tuple[list[arb], list[arb] | None, arb]
#: Remainders over a box's radius; corrections of a point, trials of a tube's width.
REMAINDER, MAX_CORRECTIONS, MAX_TRIALS = 1e-6, 12, 4


@dataclass(frozen=True)
class Family:
    """A walker, and the coordinate along which its gaits are followed."""

    keys: Mapping[str, Number]
    kneed: bool
    parameter: int
    trailing_knee: str = "free"


@dataclass(frozen=True)
class Tube:
    """A proved piece of a branch.

    Attributes
    ----------
    body : Body
    middle, tangent : list of arb
        c and t with the parameter among them, (section state, event times, slope).
    half : arb
        Half the parameter's interval.
    box, image : list of arb
        W and K, zero for the parameter.
    step : Step
        Over the whole tube.
    derivative : arb_mat
        Of F by all coordinates, over the whole tube.
    parameter : int
    """

    body: Body
    middle: list[arb]
    tangent: list[arb]
    half: arb
    box: list[arb]
    image: list[arb]
    step: Step
    derivative: arb_mat
    parameter: int

    def at(self, shift: arb, width: Sequence[arb] | None = None) -> list[arb]:
        """Every coordinate where the parameter is `shift` off the middle's."""
        return [
            c + t * shift + w
            for c, t, w in zip(
                self.middle, self.tangent, width or self.image, strict=True
            )
        ]

    @property
    def whole(self) -> list[arb]:
        """Enclosure of every gait in the tube."""
        return self.at(arb(0, self.half))

    def events(self) -> Events:
        """Order of the strikes, the same for every gait in the tube; raises as
        `sequence.events`.
        """
        m, _ = dimensions(self.body)
        return events(self.step, self.at(arb(0, self.half), self.box)[m:-1])

    def step_derivative(self) -> arb_mat:
        """Derivative of the step map at every gait of the tube."""
        return step_derivative(self.step.derivative, *dimensions(self.body))

    def turn(self) -> arb:
        """Derivative of the slope by the stance angle at every gait of the tube, whose
        parameter is the angle.
        """
        unknown, by_parameter = _parted(self.derivative, self.parameter)
        return -unknown.solve(by_parameter)[unknown.ncols() - 1, 0]

    def holds(self, other: Tube, shift: arb | None = None) -> bool:
        """True where another tube's gait, at `shift` off its middle, is this tube's at
        the same parameter.
        """
        shift = arb(0) if shift is None else shift
        own = other.middle[self.parameter] + shift - self.middle[self.parameter]
        # Away from this tube's line; exact radii of W on one side, so that no rounding
        # can help.
        away = [
            x - c - t * own
            for x, c, t in zip(other.at(shift), self.middle, self.tangent, strict=True)
        ]
        return bool(abs(own) <= self.half) and self._is_inside(away)

    def is_proved(self) -> bool:
        """True where the image lies inside: there is exactly one gait for every
        parameter.
        """
        return self._is_inside(self.image)

    def _is_inside(self, away: Sequence[arb]) -> bool:
        return krawczyk.contained(
            _others(away, self.parameter), _others(self.box, self.parameter)
        )


def point(family: Family, guess: Sequence[arb], size: float) -> Tube:
    """The gait near a guess at the guess's own parameter, as a tube of no length.

    Parameters
    ----------
    family : Family
    guess : sequence of arb
        Section state, event times and slope.
    size : float
        Relative radius of the box.

    Returns
    -------
    Tube

    Raises
    ------
    NotProvedError
        If none is found and proved there.
    """
    walker = body(family.keys, family.kneed, family.trailing_knee)
    middle = [x.mid() for x in guess]
    width = max(size, 1e-12)
    for _ in range(MAX_CORRECTIONS):
        radii = [width * s for s in sizes(walker, middle)]
        piece = tube_image(
            walker, family.parameter, (middle, None, arb(0)), radii, width * REMAINDER
        )
        inside = piece.is_proved()
        shift = max(
            abs(float(k.mid())) / s
            for k, s in zip(piece.image, sizes(walker, middle), strict=True)
        )
        if inside and width <= size:
            return piece
        if not shift < 1e-3:
            break

        middle = [(c + k).mid() for c, k in zip(middle, piece.image, strict=True)]
        width = max(size, min(width, shift**1.5)) if inside else width

    raise NotProvedError("No gait is near the guess.")


def tube(family: Family, start: Tube, half: arb) -> Tube:
    """The piece of a branch around a proved point.

    Parameters
    ----------
    family : Family
    start : Tube
        The point.
    half : arb
        Half the parameter's interval.

    Returns
    -------
    Tube

    Raises
    ------
    NotProvedError
        If no width is found in which there is one gait for every parameter.
    """
    tangent = tangent_of(start)
    scales = sizes(start.body, start.middle)
    floor = [float(w.rad()) * 4 for w in start.box]
    radii = [
        f
        + 0.05 * abs(float(t)) * float(half)
        + 1e-3 * s * float(half / abs(start.middle[start.parameter]))
        for f, t, s in zip(floor, tangent, scales, strict=True)
    ]
    for _ in range(MAX_TRIALS):
        piece = tube_image(
            start.body, family.parameter, (start.middle, tangent, half), radii, 1e-20
        )
        if piece.is_proved():
            return piece

        radii = [
            max(f, 1.5 * float(abs(k).upper()))
            for f, k in zip(floor, piece.image, strict=True)
        ]
        if not all(math.isfinite(r) for r in radii):
            break

    raise NotProvedError("Krawczyk's operator does not map the tube into itself.")


def tube_image(
    walker: Body, parameter: int, line: Line, radii: Sequence[float], tolerance: float
) -> Tube:
    """A tube and Krawczyk's image of it, which need not lie inside.

    Parameters
    ----------
    walker : Body
    parameter : int
        Which coordinate is the parameter.
    line : Line
        The tube's.
    radii : sequence of float
        Of W.
    tolerance : float
        Remainder of a Taylor step over what it is added to.

    Returns
    -------
    Tube
    """
    (m, n), (middle, tangent, half) = dimensions(walker), line
    p = parameter % (m + n + 1)
    tangent = tangent or [arb(int(i == p)) for i in range(m + n + 1)]
    W = [arb(0) if i == p else arb(0, r) for i, r in enumerate(radii)]
    region = Region(middle, W, tangent, half)
    enclosed_step = step(walker, region, Accuracy(order(tolerance), tolerance))
    derivative = defect_derivative(walker, enclosed_step)
    unknown, _ = _parted(derivative, p)
    along = [
        a - (tangent[i - n] if i >= n else 0) for i, a in enumerate(enclosed_step.along)
    ]
    shift = [
        d + a * region.span for d, a in zip(enclosed_step.defect, along, strict=True)
    ]
    K = krawczyk.image(_others(W, p), shift, unknown)
    K.insert(p, arb(0))
    return Tube(walker, middle, tangent, half, W, K, enclosed_step, derivative, p)


def tangent_of(point: Tube) -> list[arb]:
    """Approximate tangent of the branch, its parameter's own component 1.

    Parameters
    ----------
    point : Tube

    Returns
    -------
    list of arb
    """
    unknown, by_parameter = _parted(point.derivative, point.parameter)
    t = [
        -x.mid()
        for x in (krawczyk.approximate_inverse(unknown) * by_parameter).entries()
    ]
    t.insert(point.parameter, arb(1))
    return t


def _parted(derivative: arb_mat, parameter: int) -> tuple[arb_mat, arb_mat]:
    rows = derivative.tolist()
    return arb_mat([_others(row, parameter) for row in rows]), arb_mat(
        [[row[parameter]] for row in rows]
    )


def _others(values: Sequence[arb], parameter: int) -> list[arb]:
    """All coordinates but the parameter."""
    return [x for i, x in enumerate(values) if i != parameter]
