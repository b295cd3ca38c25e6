"""One step in balls: from a box of section states and event times to the defect of a
gait and its derivative.

The section is the state just after heelstrike. Rates there are an impact's image, so of
kneed walkers and of point feet the last one follows from the others; it is left out,
and with it one multiplier that is zero by construction.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

from flint import arb, arb_mat

from gaitsweep.tasks.proofs.body import Body
from gaitsweep.tasks.proofs.collisions import heelstrike, kneestrike, push_off
from gaitsweep.tasks.proofs.enclosure import Accuracy, Flow, State, flow, narrower
from gaitsweep.tasks.proofs.motion import velocity


@dataclass(frozen=True)
class Region:
    """A box of unknowns around a line: middle + tangent [-half, half] + offsets.

    Attributes
    ----------
    middle, offsets : list of arb
        Section state, event times and slope; the middle is exact but for the slope, and
        offsets hold zero.
    tangent : list of arb, optional
        Direction of the line.
    half : arb
        Half the length of the line.
    """

    middle: list[arb]
    offsets: list[arb]
    tangent: list[arb] | None = None
    half: arb = field(default_factory=arb)

    @property
    def box(self) -> list[arb]:
        """Every unknown over the whole region."""
        box = [c + w for c, w in zip(self.middle, self.offsets, strict=True)]
        if self.tangent is None:
            return box
        return [x + t * self.span for x, t in zip(box, self.tangent, strict=True)]

    @property
    def span(self) -> arb:
        """How far the line reaches on both sides."""
        return arb(0, self.half)


@dataclass(frozen=True)
class Step:
    """Enclosures of one step from every point of a region.

    Attributes
    ----------
    defect : list of arb
        Guards at their events, then image minus start, of the region's middle.
    derivative : arb_mat
        Of guards and image (not of the defect) by the unknowns over the whole region:
        by the slope too, in the last column, where the region is not of one slope.
    along : list of arb
        Derivatives of guards and image along the tangent, narrower than the matrix
        times it; empty without one.
    phases : list of Flow
    ends : list of states
        At the events, over the whole region.
    released_at_rest : bool
        Whether the knee begins to bend without a rate, since it was locked during
        heelstrike.
    """

    defect: list[arb]
    derivative: arb_mat
    along: list[arb]
    phases: list[Flow]
    ends: list[State]
    released_at_rest: bool = False


def dimensions(body: Body) -> tuple[int, int]:
    """How many coordinates the section has, and how many events a step.

    Parameters
    ----------
    body : Body

    Returns
    -------
    int, int
    """
    return body.dimension, 2 if body.kneed else 1


def start(body: Body, x: Sequence[arb]) -> tuple[State, arb_mat]:
    """State just after heelstrike from the section's coordinates, and its derivative by
    them.

    Parameters
    ----------
    body : Body
    x : sequence of arb
        Stance angle [rad] and leading rates.

    Returns
    -------
    list of arb, arb_mat
    """
    m = len(x)
    links = 3 if body.kneed else 2
    angle, *rates = x
    by_x = _identity(m, m)
    state = [angle, *[-angle] * (links - 1), *rates]
    swing_angle = [-y for y in by_x[0]]
    rows = [by_x[0], *[swing_angle] * (links - 1), *by_x[1:]]
    if m - 1 == links:
        return state, arb_mat(rows)
    if body.locks_trailing_knee:
        return [*state, rates[-1]], arb_mat([*rows, rows[-1]])

    last, law, turn = _release(body, angle, _column(rates))
    for i, by_rates in enumerate(law.tolist()):
        rows.append([turn[i, 0], *by_rates])
    return [*state, *last.entries()], arb_mat(rows)


def _release(
    body: Body, angle: arb, rates: arb_mat
) -> tuple[arb_mat, arb_mat, arb_mat]:
    """Last rates after heelstrike from the leading ones, and their derivatives by these
    and by the new stance angle.
    """
    leading = rates.nrows()
    after, by_before = heelstrike(body, -angle)
    top, low = _split(after, leading)
    d_top, d_low = _split(by_before, leading)
    inverse = top.inv()
    law = low * inverse
    by_angle = (law * d_top - d_low) * inverse
    if body.drive is None:
        return law * rates, law, by_angle * rates

    added, d_added = (each.tolist() for each in push_off(body, -angle))
    own = rates - arb_mat(added[:leading])
    last = law * own + arb_mat(added[leading:])
    turn = law * arb_mat(d_added[:leading]) - arb_mat(d_added[leading:])
    return last, law, by_angle * own + turn


def _split(matrix: arb_mat, leading: int) -> tuple[arb_mat, arb_mat]:
    rows = matrix.tolist()
    square = [row[:leading] for row in rows]
    return arb_mat(square[:leading]), arb_mat(square[leading:])


def step(body: Body, region: Region, accuracy: Accuracy) -> Step:
    """Enclose the step from every point of a region.

    Parameters
    ----------
    body : Body
    region : Region
    accuracy : Accuracy

    Returns
    -------
    Step

    Raises
    ------
    NotProvedError
        If a phase is not enclosed.

    Notes
    -----
    The derivatives are columns, one for each unknown and one for the tangent, each carried through the step as a whole:
    its start's change, the slope's, and the change of the event times, by which the
    state moves along the flow.
    """
    m, events = dimensions(body)
    way = _Way(body, region, accuracy)
    phases: list[Flow] = []
    ends: list[State] = []
    rows: list[list[arb]] = []
    defect: list[arb] = []
    for k in range(events):
        is_knee = k < events - 1
        phases.append(way.to_event(k))
        ends.append(way.state)
        columns = way.derivative.transpose().tolist()
        rows.append([_guard(column, is_knee) for column in columns])
        defect.append(_guard(way.centre, is_knee))
        if is_knee:
            way.lock_knee()

    rows += _by_image(body, way.state, way.derivative, m)
    image = _image(body, way.centre, m)
    defect += [a - b for a, b in zip(image, region.middle, strict=False)]
    by_tangent: list[arb] = []
    if region.tangent is not None:
        by_tangent = [row.pop() for row in rows]

    return Step(
        defect, arb_mat(rows), by_tangent, phases, ends, body.locks_trailing_knee
    )


class _Way:
    """What is carried through a step: the motion of a region's middle, of every point of
    it, and the derivatives.

    Attributes
    ----------
    centre, state : list of arb
        Angles, then rates, of the middle's motion, and of all.
    derivative : arb_mat, shape (2 n, d)
        Of the state along the unknowns and the tangent.
    """

    def __init__(self, body: Body, region: Region, accuracy: Accuracy):
        m, events = dimensions(body)
        self._body = body
        self._region = region
        self._accuracy = accuracy
        self._m = m
        self._directions, self._slopes, self._spread = _directions(region, m + events)
        self.state, by_section = start(body, region.box[:m])
        self.centre, _ = start(body, region.middle[:m])
        sections = arb_mat([row[:m] for row in self._directions])
        self.derivative = by_section * sections.transpose()

    def to_event(self, k: int) -> Flow:
        """Carry everything through a phase to the event that ends it."""
        body = self._body
        box = self._region.box
        middle = self._region.middle
        m = self._m
        phase = flow(
            body,
            (middle[-1], box[-1]),
            self.centre,
            self.state,
            self.derivative,
            (_duration(middle[m:], k), _duration(box[m:], k)),
            self._accuracy,
            self._slopes,
            self._spread,
        )

        by_duration = [_duration(row[m:], k) for row in self._directions]
        self.centre = phase.middle
        self.derivative = _at_event(body, phase, box[-1], by_duration)
        self.state = self._narrower(phase.state)
        return phase

    def lock_knee(self) -> None:
        """Carry everything through kneestrike."""
        self.derivative, state, self.centre = _locked(
            self._body, self.derivative, self.state, self.centre
        )
        self.state = self._narrower(state)

    def _narrower(self, state: State) -> State:
        return narrower(state, self.centre, self.derivative, self._spread)


def _at_event(body: Body, phase: Flow, slope: arb, by_duration: list[arb]) -> arb_mat:
    """Derivatives of the state at the event that ends a phase, whose duration changes
    too.
    """
    along = _column(velocity(body, slope, phase.state))
    return phase.derivative + along * arb_mat([by_duration])


def _directions(
    region: Region, unknowns: int
) -> tuple[list[list[arb]], arb_mat | None, list[arb]]:
    """Directions by which a step is differentiated, as changes of the unknowns and of
    the slope; those of the slope alone, None where it is fixed; and how far a region
    reaches along each.
    """
    tangent = region.tangent
    height = unknowns if tangent is None else unknowns + 2
    rows = _identity(height, unknowns + 1)
    if tangent is None:
        return rows, None, region.offsets[:unknowns]

    rows[-1] = tangent
    slopes = arb_mat([[row[unknowns] for row in rows]])
    return rows, slopes, [*region.offsets, region.span]


def _identity(height: int, width: int) -> list[list[arb]]:
    rows = []
    for i in range(height):
        row = [arb(int(i == j)) for j in range(width)]
        rows.append(row)
    return rows


def _duration(times: Sequence[arb], k: int) -> arb:
    """Duration of a phase, by the event times."""
    return times[k] - times[k - 1] if k else times[0]


def _guard(angles: Sequence[arb], is_knee: bool) -> arb:
    """What vanishes at a strike: shank and thigh in line, or both feet on the ground."""
    if is_knee:
        return angles[1] - angles[2]
    return angles[0] + angles[1]


def _by_image(body: Body, end: State, V: arb_mat, m: int) -> list[list[arb]]:
    """Derivatives of the section state after heelstrike, by those before it."""
    law, by_angle = heelstrike(body, end[0])
    turn = by_angle * _column(end[2:])
    if body.drive is not None:
        turn = turn + push_off(body, end[0])[1]
    angle, _, stance_rate, swing_rate = V.tolist()
    rows = [[-x for x in angle]]
    for i in range(m - 1):
        row = []
        for c, a, b in zip(angle, stance_rate, swing_rate, strict=True):
            by_rates = law[i, 0] * a + law[i, 1] * b
            row.append(by_rates + turn[i, 0] * c)
        rows.append(row)

    return rows


def _locked(
    body: Body,
    V: arb_mat,
    before: State,
    centre: State,
) -> tuple[arb_mat, State, State]:
    """Derivatives, states and the middle's state just after kneestrike."""
    law, by_stance, by_swing = kneestrike(body, *before[:2])
    rates = _column(before[3:])
    rows = V.tolist()
    by_angles = by_stance * rates * arb_mat([rows[0]])
    by_angles = by_angles + by_swing * rates * arb_mat([rows[1]])
    by_rates = law * arb_mat(rows[3:]) + by_angles
    V = arb_mat([*rows[:2], *by_rates.tolist()])

    law_at_middle, *_ = kneestrike(body, *centre[:2])
    middle_rates = law_at_middle * _column(centre[3:])
    state = [*before[:2], *(law * rates).entries()]
    centre = [*centre[:2], *middle_rates.entries()]
    return V, state, centre


def _column(values: Sequence[arb]) -> arb_mat:
    return arb_mat([[x] for x in values])


def _image(body: Body, before: State, m: int) -> list[arb]:
    """Section state after the heelstrike that ends a step."""
    law, _ = heelstrike(body, before[0])
    rates = law * _column(before[2:])
    if body.drive is not None:
        rates = rates + push_off(body, before[0])[0]
    return [-before[0], *rates.entries()[: m - 1]]
