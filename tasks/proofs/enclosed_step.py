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
from gaitsweep.tasks.proofs.collisions import heelstrike, kneestrike
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
        Direction of the line, of which `half` is half the length.
    """

    middle: list[arb]
    offsets: list[arb]
    tangent: list[arb] | None = None
    half: arb = field(default_factory=arb)

    @property
    def box(self) -> list[arb]:
        """Every unknown over the whole region."""
        box = [c + w for c, w in zip(self.middle, self.offsets, strict=True)]
        return (
            box
            if self.tangent is None
            else [x + t * self.span for x, t in zip(box, self.tangent, strict=True)]
        )

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
    """

    defect: list[arb]
    derivative: arb_mat
    along: list[arb]
    phases: list[Flow]
    ends: list[State]


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
    m, links = len(x), 3 if body.kneed else 2
    angle, rates = x[0], arb_mat(m - 1, 1, list(x[1:]))
    state = [angle, *[-angle] * (links - 1), *x[1:]]
    rows = [[arb(1 if i == 0 else -1), *[arb(0)] * (m - 1)] for i in range(links)]
    rows += [[arb(int(i == j)) for j in range(m)] for i in range(1, m)]
    if m - 1 == links:
        return state, arb_mat(rows)
    law, by_angle = _release(body, angle, m - 1)
    last, turn = law * rates, by_angle * rates
    for i in range(links - (m - 1)):
        rows.append([turn[i, 0], *[law[i, j] for j in range(m - 1)]])
    return [*state, *last.entries()], arb_mat(rows)


def _release(body: Body, angle: arb, leading: int) -> tuple[arb_mat, arb_mat]:
    """Last rates after heelstrike as a matrix of the leading ones, and its derivative
    by the new stance angle.
    """
    after, by_before = heelstrike(body, -angle)
    (top, low), (d_top, d_low) = _split(after, leading), _split(by_before, leading)
    inverse = top.inv()
    law = low * inverse
    return law, (law * d_top - d_low) * inverse


def _split(matrix: arb_mat, leading: int) -> tuple[arb_mat, arb_mat]:
    rows = matrix.tolist()
    return (
        arb_mat([row[:leading] for row in rows[:leading]]),
        arb_mat([row[:leading] for row in rows[leading:]]),
    )


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
    box, middle, unknowns = region.box, region.middle, m + events
    one_slope = region.tangent is None
    width = unknowns if one_slope else unknowns + 2
    spread = region.offsets[:unknowns] if one_slope else [*region.offsets, region.span]
    direction = [[arb(int(i == j)) for j in range(unknowns + 1)] for i in range(width)]
    if region.tangent is not None:
        direction[-1] = region.tangent
    by_start, by_time, by_slope = (
        [row[part] for row in direction]
        for part in (slice(0, m), slice(m, unknowns), slice(unknowns, None))
    )
    slopes = None if one_slope else arb_mat([[row[0] for row in by_slope]])
    state, by_section = start(body, box[:m])
    centre, _ = start(body, middle[:m])
    V = by_section * arb_mat(by_start).transpose()
    phases, ends, rows, defect = [], [], [], []
    for k in range(events):
        earlier = k - 1
        lasts = [x[m + k] - x[m + earlier] if k else x[m] for x in (middle, box)]
        moved = [row[k] - row[earlier] if k else row[k] for row in by_time]
        phase = flow(
            body,
            (middle[-1], box[-1]),
            centre,
            state,
            V,
            (lasts[0], lasts[1]),
            accuracy,
            slopes,
            spread,
        )
        phases.append(phase)
        V = phase.derivative + _column(velocity(body, box[-1], phase.state)) * arb_mat(
            [moved]
        )
        centre = phase.middle
        end = narrower(phase.state, centre, V, spread)
        ends.append(end)
        values = V.tolist()
        if k == events - 1:
            rows.append([a + b for a, b in zip(values[0], values[1], strict=True)])
            defect.append(centre[0] + centre[1])
            break
        rows.append([a - b for a, b in zip(values[1], values[2], strict=True)])
        defect.append(centre[1] - centre[2])
        V, state, centre = _locked(body, V, end, centre)
        state = narrower(state, centre, V, spread)
    law, by_angle = heelstrike(body, end[0])
    turn = by_angle * _column(end[2:])
    rows.append([-x for x in values[0]])
    for i in range(m - 1):
        rows.append(
            [
                law[i, 0] * a + law[i, 1] * b + turn[i, 0] * c
                for c, a, b in zip(values[0], values[2], values[3], strict=True)
            ]
        )
    image = _image(body, centre, m)
    along = [] if one_slope else [row.pop() for row in rows]
    return Step(
        [*defect, *[a - b for a, b in zip(image, middle, strict=False)]],
        arb_mat(rows),
        along,
        phases,
        ends,
    )


def _locked(
    body: Body, V: arb_mat, before: State, centre: State
) -> tuple[arb_mat, State, State]:
    """Derivatives, states and the middle's state just after kneestrike."""
    law, by_stance, by_swing = kneestrike(body, *before[:2])
    rates, rows = _column(before[3:]), V.tolist()
    turned = by_stance * rates * arb_mat([rows[0]]) + by_swing * rates * arb_mat(
        [rows[1]]
    )
    V = arb_mat([*rows[:2], *(law * arb_mat(rows[3:]) + turned).tolist()])
    own = kneestrike(body, *centre[:2])[0] * _column(centre[3:])
    return V, [*before[:2], *(law * rates).entries()], [*centre[:2], *own.entries()]


def _column(values: Sequence[arb]) -> arb_mat:
    return arb_mat([[x] for x in values])


def _image(body: Body, before: State, m: int) -> list[arb]:
    """Section state after the heelstrike that ends a step."""
    law, _ = heelstrike(body, before[0])
    return [-before[0], *(law * _column(before[2:])).entries()[: m - 1]]
