"""Whether states are gaits of a walker, and if not, why.

All states are lanes of one batch. The rules are tried in the order of
contract/verdicts.toml, and the first that applies is the verdict: a state is the gait
that it is closest to at its slope if every coordinate is nearer than a tolerance, which
adds to a relative one the last digit of what was given. A state is a gait with a fault if
what the fault makes of the gait is as near. What is left may be a gait of another slope, or
of another walker of the catalogue.
"""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from gaitsweep.tasks.branches import atlas as atlases
from gaitsweep.tasks.branches.branch import Branch
from gaitsweep.tasks.branches.nearest import (
    Gaits,
    described,
    gaits_at,
    nearest_on_branches,
)
from gaitsweep.tasks.branches.refine import COARSE
from gaitsweep.tasks.contract.registry import GAITS, SLOPES
from gaitsweep.tasks.gaits.newton import newton
from gaitsweep.tasks.gaits.step_check import verify_steps
from gaitsweep.tasks.mechanics.lumped import general_structure_of
from gaitsweep.tasks.mechanics.sums import total
from gaitsweep.tasks.step.lanes import lanes_of
from gaitsweep.tasks.step.problem import Lanes, Problem
from gaitsweep.tasks.step.several_steps import joined
from gaitsweep.tasks.step.simulate import (
    BACKWARD,
    CAUSES,
    LOST,
    MAX_ANGLE,
    STRUCK,
    SimulatedSteps,
    fly_on,
    stride,
)
from gaitsweep.tasks.step.stance import (
    ON_GROUND,
    between_feet,
    ground_under,
    half_between,
)
from gaitsweep.tasks.studies.solve_driven import branches_of, driven
from gaitsweep.tasks.walkers.catalogue import CATALOGUE
from gaitsweep.tasks.walkers.conventions import KNEE, rate_unit, shank_of, to_ours
from gaitsweep.tasks.walkers.resolve import walker_of_line
from gaitsweep.tasks.walkers.walker import Walker, WalkerError

#: Most steps after which a state is looked for again.
MOST_STEPS = 8
#: What a state may miss itself by after some steps, relative, to be tried as a gait of
#: so many.
_RETURNS = 0.05
#: The last digit given never allows more than this, relative.
_COARSEST = 0.01
#: By how much a shank in line with its thigh may differ from it, beside the last digits.
_IN_LINE = 1e-9
#: By how much more a state flown to the section, or changed by a fault, may differ.
_FLOWN, _CHANGED = 20.0, 2.0
#: By how much more than states the sections of knees may differ, which are those before
#: the impact.
_BEFORE_IMPACT = 5.0
#: Change of ln slope over which branches count as straight.
_STRAIGHT = 0.02
#: Relative distance up to which a gait is called near.
_NEAR = 0.1
#: Points of each piece of a branch in a picture.
_PICTURED = 200
#: States that are solved for as gaits although no branch has one near.
_SOLVED_WITHIN, _MOST_ITERATIONS = 0.3, 8


@cache
def sentences() -> dict[str, str]:
    """Return what is said of each verdict, in the order of the rules."""
    path = Path(__file__).parents[1] / "contract" / "verdicts.toml"
    return tomllib.loads(path.read_text(encoding="utf-8"))


def check_states(params: Mapping[str, Any]) -> dict[str, Any]:
    """Check whether states are gaits of a walker.

    Parameters
    ----------
    params : mapping
        `walker` (name or table), `set` (keys to change), `slope`, ndarray, shape (n,)
        [rad]; `table`, the columns of a `convention`, ndarray, shape (n,), angles in rad;
        `digits`, the same columns and `slope` where the table has it, the size of the last
        digit given; `sizes`, of the last one that the table would have given; `rates`
        ("walker", "scaled", or None for the convention's own); `tolerance`, relative;
        `steps`, after which they are held to repeat.

    Returns
    -------
    dict
        Of n rows: `verdict` and `reason` (str), `is_gait`, `gait` (label of the nearest
        gait at the slope), `distance` (to it, relative), `missed` (after `steps` steps,
        relative; NaN of a fall), `steps` (after which the nearest gait repeats),
        `spectral_radius`, `belongs_to_slope` [rad], `walker` (the name of the one that it
        is a gait of), `flown` (whether the state was flown to the section), the
        `stance_angle`, `stance_rate` and `thigh_rate` that were judged, and those of the
        nearest gait as `nearest_...`, in the walker's units. `curves`, a list of the
        walker's branches: slope and stance angle at their nodes.

    Raises
    ------
    WalkerError
        If the walker is invalid, or cannot have the convention.
    """
    walker = walker_of_line(params)
    rows = _Rows.of(walker, params)
    problem = Problem(walker)
    branches = atlases.survey(problem, COARSE)
    grounds = _Grounds(problem, branches)
    case = _Case(walker, grounds, rows, int(params.get("steps", 1)))

    case.refuse()
    case.fly()
    case.step()
    case.find_nearest()
    case.judge_gaits()
    case.judge_rounded_slopes()
    case.judge_digits()
    case.judge_faults()
    case.judge_slopes()
    case.judge_gaits_beside_branches()
    case.judge_several_steps()
    case.judge_walkers()
    case.judge_rest()
    return case.answer()


def verdicts(params: Mapping[str, Any]) -> dict[str, str]:
    """Return the verdicts and what is said of each."""
    return sentences()


@dataclass
class _Rows:
    """States to be judged, in n lanes.

    `state` (3, n) stance angle, stance rate and thigh rate [rad, rad/sqrt(leg/g)] on the
    section; `thigh` (n,) [rad]; `shank` (2, n) angle and rate of the swing shank, NaN of a
    rate that is not given, and `bent` (n,) whether its knee is; `slope` (n,) [rad]; `near`
    (3, n) the last digit of the table, `own` that of the row's own digits; `near_slope`
    (n,) [rad] what rounding may have changed of the slope; `relative` the tolerance; `unit`
    what the table's rates were multiplied by.
    """

    state: np.ndarray
    thigh: np.ndarray
    shank: np.ndarray
    bent: np.ndarray
    slope: np.ndarray
    near: np.ndarray
    own: np.ndarray
    near_slope: np.ndarray
    relative: float
    unit: float

    @classmethod
    def of(cls, walker: Walker, params: Mapping[str, Any]) -> _Rows:
        """Read states in a convention's variables."""
        convention, slope = params["convention"], np.asarray(params["slope"], float)
        unit = rate_unit(walker, convention, params.get("rates"))
        units = np.array([1.0, 1.0, unit, unit])[:, None]
        ours = to_ours(convention, params["table"], slope) * units

        near = to_ours(convention, params["sizes"], slope, is_size=True) * units
        own = to_ours(convention, params["digits"], slope, is_size=True) * units

        on_section = [0, 2, 3]
        relative = float(params["tolerance"])
        state = ours[on_section].copy()
        shank, bent = _knees(walker, params, ours[1], near[1])
        shank[1] *= unit
        return cls(
            state=state,
            thigh=ours[1],
            shank=shank,
            bent=bent,
            slope=slope,
            near=near[on_section],
            own=own[on_section],
            near_slope=_sizes_of_slope(params, near[on_section]),
            relative=relative,
            unit=unit,
        )

    def links(self, lanes: np.ndarray) -> np.ndarray:
        """Angles, then rates, of stance leg, thigh and shank of some rows, (6, k); a shank
        whose rate is not given moves as its thigh.
        """
        angle, stance_rate, thigh_rate = self.state[:, lanes]
        shank_angle, shank_rate = self.shank[:, lanes]
        shank_rate = np.where(np.isnan(shank_rate), thigh_rate, shank_rate)
        angles = [angle, self.thigh[lanes], shank_angle]
        return np.array([*angles, stance_rate, thigh_rate, shank_rate])


def _sizes_of_slope(params: Mapping[str, Any], near: np.ndarray) -> np.ndarray:
    """What rounding may have changed of slopes: half of their last digit, where that is as
    fine as one of the states' (3, n); slopes in fewer decimals are taken for exact.
    """
    sizes = params["sizes"].get("slope", np.zeros(near.shape[1]))
    as_fine = sizes <= near.max(axis=0) * (1.0 + 1e-9)
    return np.asarray(np.where(as_fine, 0.5 * sizes, 0.0))


def _knees(
    walker: Walker, params: Mapping[str, Any], thigh: np.ndarray, size: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Angle and rate (2, n) of the swing shank, and whether the knee is bent by more than
    the last digits.

    Raises
    ------
    WalkerError
        If a knee is bent of a walker without knees, or of a shank without a rate.
    """
    shank = shank_of(params["convention"], params["table"])
    angle = KNEE[0]
    if angle not in params["table"]:
        shank[0] = thigh
        return shank, np.zeros(len(thigh), bool)

    sizes = size + params["sizes"][angle]
    bent = np.abs(shank[0] - thigh) > _IN_LINE + sizes
    if bent.any():
        row = int(bent.argmax())
        where = f"{shank[0, row]:.6g} rad and {thigh[row]:.6g} rad in row {row + 1}"
        if not walker.knees:
            line = "must be the thigh's angle of a walker without knees"
            raise WalkerError(angle, where, line)
        if KNEE[1] not in params["table"]:
            raise WalkerError(KNEE[1], "no column", f"is needed: a knee bends, {where}")
    return shank, bent


def _sizes(state: np.ndarray) -> np.ndarray:
    """What differences of states (3, n) are relative to: the angle, the larger rate."""
    rate = np.maximum(np.abs(state[1]), np.abs(state[2]))
    return np.array([np.abs(state[0]), rate, rate])


@np.errstate(invalid="ignore", divide="ignore")
def _distance(state: np.ndarray, gait: np.ndarray) -> np.ndarray:
    """Largest difference of a coordinate of states (3, n), relative to the gaits'."""
    return np.asarray((np.abs(state - gait) / _sizes(gait)).max(axis=0))


@dataclass(frozen=True)
class _Grounds:
    """A walker's gaits on any ground: those of branches over the slope and, where that is
    level or leads uphill, over what drives there.
    """

    problem: Problem
    branches: list[Branch]

    def of(
        self, slope: np.ndarray
    ) -> Iterator[tuple[np.ndarray, Problem, list[Branch], np.ndarray]]:
        """Yield the numbers of the slopes (n,) that have branches in common, with these
        and their problem, and the drive (k,) of each.
        """
        down = np.flatnonzero(slope > 0)
        yield down, self.problem, self.branches, slope[down]
        for level in np.unique(slope[slope <= 0]).tolist():
            lanes = np.flatnonzero(slope == level)
            problem, drive = driven(self.problem.walker, level)
            if drive:
                counted = np.full(len(lanes), drive)
                yield lanes, problem, branches_of(problem), counted

    def gaits_at(self, slope: np.ndarray) -> list[Gaits]:
        """The gaits at slopes (n,), in as many sets as there are pieces of branches."""
        found: list[Gaits] = []
        for lanes, problem, branches, drive in self.of(slope):
            for number, gaits in enumerate(gaits_at(problem, branches, drive)):
                if number == len(found):
                    found.append(Gaits.none(len(slope)))
                found[number].put(lanes, gaits)
        return found


def _general(walker: Walker, n: int) -> Lanes:
    """The step map with three coordinates in n lanes, of point feet as of other straight
    legs.
    """
    one = Lanes([walker], general_structure_of(walker))
    return one.some(np.zeros(n, int))


@dataclass
class _OnBranch:
    """The gaits (3, n) of a branch nearest to n states, NaN of none: at which slope, how
    they change by its ln, and how much further along it is nearest by the tolerances.
    """

    slope: np.ndarray
    gaits: Gaits
    changes: np.ndarray
    along: np.ndarray


@dataclass
class _Case:
    """States, the walker's gaits, and what is said so far."""

    walker: Walker
    grounds: _Grounds
    rows: _Rows
    claimed: int

    def __post_init__(self) -> None:
        n = len(self.rows.slope)
        self.n = n
        self.problem, self.branches = self.grounds.problem, self.grounds.branches
        self.verdict = np.full(n, "", dtype="<U32")
        self.reason = np.full(n, "", dtype=object)
        self.flown = np.zeros(n, bool)
        self.depth, self.missed = np.full(n, np.nan), np.full(n, np.nan)
        self.belongs = np.full(n, np.nan)
        self.other = np.full(n, "", dtype=object)
        self.outcome = np.full(n, LOST)
        self.times = np.full((self.problem.phases, n), np.nan)
        self.distance = np.full(n, np.inf)
        self.steps = np.ones(n, int)
        self.label = np.full(n, "", dtype=object)
        self.nearest, self.candidates = Gaits.none(n), list[Gaits]()
        self.general = _general(self.walker, n)

    @property
    def open(self) -> np.ndarray:
        """Numbers of the rows without a verdict."""
        return np.flatnonzero(self.verdict == "")

    @property
    def steppable(self) -> np.ndarray:
        """Numbers of the rows without a verdict from which a walker may step."""
        angle = self.rows.state[0]
        with np.errstate(invalid="ignore"):
            may = (angle > 0) & (angle < MAX_ANGLE)
        return self.open[may[self.open]]

    def say(self, verdict: str, lanes: np.ndarray, **words: Any) -> None:
        """Give some rows their verdict, with what the sentence tells of each."""
        self.verdict[lanes] = verdict
        sentence = sentences()[verdict]
        for place, lane in enumerate(np.asarray(lanes).tolist()):
            told = {name: values[place] for name, values in words.items()}
            self.reason[lane] = sentence.format(**told)

    def _say_period(self, lanes: np.ndarray) -> None:
        """Give some rows the verdict that they repeat after other steps than claimed."""
        steps = self.steps[lanes].tolist()
        words = [f"{count} step{'s' if count > 1 else ''}" for count in steps]
        self.say("period", lanes, steps=words)

    def within(
        self,
        state: np.ndarray,
        gait: np.ndarray,
        lanes: np.ndarray,
        factor: float | np.ndarray = 1.0,
    ) -> np.ndarray:
        """Whether states (3, k) of some rows are gaits (3, k), to the tolerance."""
        sizes = _sizes(gait)
        coarsest = _COARSEST * sizes
        digits = np.minimum(self.rows.near[:, lanes], coarsest)
        allowed = factor * (self.rows.relative * sizes + digits)
        return np.asarray((np.abs(state - gait) <= allowed).all(axis=0))

    def _relative_tolerance(self, lanes: np.ndarray) -> np.ndarray:
        """Largest relative tolerance of a coordinate."""
        sizes = _sizes(self.rows.state[:, lanes])
        digits = (self.rows.near[:, lanes] / sizes).max(axis=0)
        return np.asarray(self.rows.relative + np.minimum(digits, _COARSEST))

    def refuse(self) -> None:
        """Refuse rows that are no numbers, or whose swing foot is below the ground."""
        rows = self.rows
        links = rows.links(np.arange(self.n))
        self.say("not_a_number", np.flatnonzero(~np.isfinite(links).all(axis=0)))
        lacks_rate = rows.bent & ~np.isfinite(rows.shank[1])
        self.say("not_a_number", np.flatnonzero(lacks_rate))

        lanes = self.open
        way = between_feet(self.walker, *links[:3, lanes])
        tilt = ground_under(way)
        off = (np.abs(tilt) > self._on_ground(lanes)) | rows.bent[lanes]
        self.depth[lanes] = np.where(off, -way.imag, 0.0)
        self.belongs[lanes] = np.where(off, rows.slope[lanes] - tilt, np.nan)

    def _on_ground(self, lanes: np.ndarray) -> np.ndarray:
        """Half sum of the legs' angles that counts as zero."""
        angle = np.abs(self.rows.state[0, lanes])
        digits = np.minimum(self.rows.near[0, lanes], _COARSEST * angle)
        return np.asarray(ON_GROUND + self.rows.relative * angle + digits)

    def fly(self) -> None:
        """Fly states off the section to the next heelstrike; of those whose feet stand on
        other ground the angle from its normal is judged.
        """
        lanes = self.open[np.isfinite(self.belongs[self.open])]
        if not len(lanes):
            return
        rows, links = self.rows, self.rows.links(lanes)
        is_straight = ~rows.bent[lanes]
        if is_straight.any():
            straight = lanes[is_straight]
            rows.state[0, straight] = half_between(*links[:2, is_straight])
            self._judge_ground(straight)
            self._judge_vertical(straight)

        left = self.verdict[lanes] == ""
        lanes, links = lanes[left], links[:, left]
        below = self.depth[lanes] > 0
        self.say(
            "below_ground",
            lanes[below],
            depth=self.depth[lanes[below]],
            belongs=self.belongs[lanes[below]],
        )
        self._fly(lanes[~below], links[:, ~below])

    def _judge_vertical(self, lanes: np.ndarray) -> None:
        """Tell rows that are gaits by the angle between the legs, at the slope given."""
        lanes = lanes[self.verdict[lanes] == ""]
        self._find(lanes)
        numbers = self._match(lanes, self.rows.state[:, lanes])
        are = numbers >= 0
        self._settle_nearest(lanes[are], numbers[are])
        self.say("from_vertical", lanes[are])

    def _judge_ground(self, lanes: np.ndarray) -> None:
        """Tell rows that are gaits of the ground on which both feet stand."""
        low, high = SLOPES
        ground = self.belongs[lanes]
        is_level = np.abs(ground) <= self._on_ground(lanes)
        self.belongs[lanes] = np.where(is_level, 0.0, ground)
        is_slope = is_level | (ground >= low) & (ground < high)
        some = lanes[is_slope & (self.rows.state[0, lanes] > 0)]
        state = self.rows.state[:, some]
        for gaits in self.grounds.gaits_at(self.belongs[some]):
            with np.errstate(invalid="ignore"):
                are = self.within(state, gaits.state, some)
            are &= self.verdict[some] == ""
            known = some[are]
            self._say_slope(known, self.belongs[known])

    def _say_slope(self, lanes: np.ndarray, slopes: np.ndarray) -> None:
        self.belongs[lanes] = slopes
        self.say("slope", lanes, belongs=slopes, degrees=np.degrees(slopes))

    def _fly(self, lanes: np.ndarray, links: np.ndarray) -> None:
        """Fly states of links (6, k) with the swing foot above the ground to the section."""
        if not len(lanes):
            return
        section, outcome = fly_on(
            self.general.some(lanes),
            links,
            self.rows.bent[lanes],
            self.rows.slope[lanes],
        )
        struck = outcome == STRUCK
        self._land(lanes[struck], section[:, struck])
        self.outcome[lanes] = outcome
        self.flown[lanes] = True
        self.belongs[lanes] = np.nan
        self.verdict[lanes[~struck]] = "none"
        for lane in lanes[~struck].tolist():
            cause = CAUSES[self.outcome[lane]]
            self.reason[lane] = f"Flown on, the walker has no heelstrike: {cause}."

    def _land(self, lanes: np.ndarray, section: np.ndarray) -> None:
        """Give rows the state with which the step after sections begins."""
        if len(lanes):
            problem = self.general.some(lanes)
            state = problem.start(section, self.rows.slope[lanes])
            self.rows.state[:, lanes] = state[:3]

    def _sections(self, lanes: np.ndarray, state: np.ndarray) -> np.ndarray:
        return self.general.some(lanes).section_of(state, self.rows.slope[lanes])

    def step(self) -> None:
        """Take the steps after which the states are held to repeat."""
        lanes = self.steppable
        self.outcome[lanes] = BACKWARD
        if not len(lanes):
            return
        slope, problem = self.rows.slope[lanes], self.general.some(lanes)
        start = self._sections(lanes, self.rows.state[:, lanes])
        steps = stride(problem, start, slope)
        self.times[:, lanes] = steps.times
        image, outcome = steps.image, steps.outcome
        for _ in range(self.claimed - 1):
            steps = stride(problem, image, slope)
            image, outcome = steps.image, np.maximum(outcome, steps.outcome)
        self.outcome[lanes] = outcome
        self.missed[lanes] = _relative(image, start)

    def _find(self, lanes: np.ndarray) -> None:
        """Solve the walker's gaits at the slopes of some rows."""
        slope, place = np.unique(self.rows.slope[lanes], return_inverse=True)
        for number, gaits in enumerate(self.grounds.gaits_at(slope)):
            if number == len(self.candidates):
                self.candidates.append(Gaits.none(self.n))
            self.candidates[number].put(lanes, _taken(gaits, place))

    def _match(self, lanes: np.ndarray, state: np.ndarray, factor: float = 1.0) -> Any:
        """Which candidate each state (3, k) is, -1 for none."""
        match = np.full(len(lanes), -1)
        for number, gaits in enumerate(self.candidates):
            with np.errstate(invalid="ignore"):
                are = self.within(state, gaits.state[:, lanes], lanes, factor)
            match[are & (match < 0)] = number
        return match

    def _settle_nearest(self, lanes: np.ndarray, numbers: np.ndarray) -> None:
        """Make candidates, by their numbers, the nearest gaits of some rows."""
        for number, gaits in enumerate(self.candidates):
            some = lanes[numbers == number]
            self._set_nearest(some, _taken(gaits, some))

    def _set_nearest(self, lanes: np.ndarray, gaits: Gaits) -> None:
        self.nearest.put(lanes, gaits)
        self.distance[lanes] = _distance(self.rows.state[:, lanes], gaits.state)
        for lane, place, passes in zip(
            lanes.tolist(), gaits.place.tolist(), gaits.passes.tolist(), strict=True
        ):
            self.label[lane] = (
                GAITS[place] if passes == 1 else f"passes_{passes:g}_times"
            )

    def find_nearest(self) -> None:
        """Find the gait nearest to each row at its slope."""
        lanes = self.open
        self._find(lanes)
        self._take_nearest(lanes)

    def _take_nearest(self, lanes: np.ndarray) -> None:
        state = self.rows.state[:, lanes]
        for gaits in self.candidates:
            distance = _distance(state, gaits.state[:, lanes])
            nearer = distance < self.distance[lanes]
            self._set_nearest(lanes[nearer], _taken(gaits, lanes[nearer]))

    def judge_gaits_beside_branches(self) -> None:
        """Tell rows that are gaits which no branch leads to, as those whose legs pass
        more than once: they return, and Newton's method goes from them to gaits.
        """
        lanes = self._returning()
        if not len(lanes) or self.claimed > 1:
            return
        for some, problem, _, drive in self.grounds.of(self.rows.slope[lanes]):
            self._judge_solved(problem, lanes[some], np.log(drive))

    def _judge_solved(self, problem: Problem, lanes: np.ndarray, q: np.ndarray) -> None:
        """Tell rows near which Newton's method finds gaits, at values of ln drive."""
        y = self._sections(lanes, self.rows.state[:, lanes])
        w, solved = _solved(problem, y, self.times[:, lanes], q)
        lanes, q = lanes[solved], q[solved]
        gaits = described(problem, w, q)
        near = _distance(self.rows.state[:, lanes], gaits.state)
        nearer = np.flatnonzero(near < 0.999 * self.distance[lanes])
        if len(nearer):
            _, check = verify_steps(problem, w[:, nearer], q[nearer])
            happen = check.step & ~check.doubt
            gaits.passes[nearer] = check.leg_passes
            nearer = nearer[happen]
            self._set_nearest(lanes[nearer], _taken(gaits, nearer))
            self.judge_gaits()

    def _returning(self) -> np.ndarray:
        """Numbers of the rows without a verdict that come back to near themselves."""
        lanes = self.steppable
        walks = self.outcome[lanes] == STRUCK
        return lanes[walks & (self.missed[lanes] < _SOLVED_WITHIN)]

    def judge_gaits(self) -> None:
        """Tell rows that are gaits of one step."""
        lanes = self.open
        factors = np.where(self.flown[lanes], _FLOWN, 1.0)
        state, gait = self.rows.state[:, lanes], self.nearest.state[:, lanes]
        with np.errstate(invalid="ignore"):
            are = self.within(state, gait, lanes, factors)
        if self.claimed == 1:
            self.say("gait", lanes[are])
            self._tell_digits(lanes[are])
            self._judge_shanks(lanes[are])
        else:
            self._say_period(lanes[are])

    def _tell_digits(self, lanes: np.ndarray) -> None:
        """Say of gaits that are farther off than the tolerance to how many digits."""
        digits = self._digits(lanes)
        is_rounded = self.distance[lanes] > self.rows.relative
        is_rounded &= ~self.flown[lanes] & np.isfinite(digits)
        for lane, count in zip(lanes[is_rounded], digits[is_rounded], strict=True):
            self.reason[lane] = f"A gait, to the {count:.0f} digits given."

    def _digits(self, lanes: np.ndarray) -> np.ndarray:
        """To how many digits a table gives the coarsest coordinate of some rows."""
        with np.errstate(divide="ignore"):
            share = self.rows.near[:, lanes] / _sizes(self.rows.state[:, lanes])
            return np.asarray(np.ceil(-np.log10(share.max(axis=0))))

    def _judge_shanks(self, lanes: np.ndarray) -> None:
        """Tell rows that are gaits but for their free shank's rate."""
        lanes = lanes[np.isfinite(self.rows.shank[1, lanes]) & ~self.flown[lanes]]
        if not self.walker.knees or not len(lanes):
            return
        sections = self._sections(lanes, self.rows.state[:, lanes])
        given = self.general.some(lanes).start(sections, self.rows.slope[lanes])[3]
        found = self.rows.shank[1, lanes]
        sizes = _sizes(self.rows.state[:, lanes])[2]
        allowed = self._relative_tolerance(lanes) * np.maximum(sizes, np.abs(given))
        wrong = np.abs(found - given) > _CHANGED * allowed
        unit = self.walker.time_unit
        self.say(
            "shank_rate",
            lanes[wrong],
            found=found[wrong] / unit,
            given=given[wrong] / unit,
        )

    def judge_digits(self) -> None:
        """Tell rows that are gaits to fewer digits than the table has."""
        lanes = self.open
        own, gait = self.rows.own[:, lanes], self.nearest.state[:, lanes]
        sizes = _sizes(gait)
        with np.errstate(invalid="ignore"):
            allowed = np.minimum(own, 0.1 * sizes) * 1.001 + self.rows.relative * sizes
            are = (np.abs(self.rows.state[:, lanes] - gait) <= allowed).all(axis=0)
            are &= (own > 1.5 * self.rows.near[:, lanes]).any(axis=0)
        self.say("digits", lanes[are])

    def judge_several_steps(self) -> None:
        """Tell rows that repeat after several steps, up to the most that are tried."""
        lanes = self.steppable
        lanes = lanes[self.outcome[lanes] == STRUCK]
        if not len(lanes):
            return
        start = self._sections(lanes, self.rows.state[:, lanes])
        sections, times = [start], list[np.ndarray]()
        for steps in range(1, MOST_STEPS + 1):
            problem, slope = self.general.some(lanes), self.rows.slope[lanes]
            taken = stride(problem, sections[-1], slope, exact=False)
            sections.append(taken.image)
            times.append(taken.times)

            returns = _relative(taken.image, sections[0]) < _RETURNS
            if steps > 1 and returns.any():
                self._judge_cycles(lanes[returns], steps, sections, times, returns)
            goes_on = (taken.outcome == STRUCK) & (self.verdict[lanes] == "")
            lanes = lanes[goes_on]
            sections = [section[:, goes_on] for section in sections]
            times = [each[:, goes_on] for each in times]
            if not len(lanes):
                return

    def _judge_cycles(
        self,
        lanes: np.ndarray,
        steps: int,
        sections: list[np.ndarray],
        times: list[np.ndarray],
        returns: np.ndarray,
    ) -> None:
        """Tell rows that are gaits of so many steps, from the steps taken."""
        y = np.array(
            [section[: self.problem.m, returns] for section in sections[:steps]]
        )
        ends = np.array([each[:, returns] for each in times[:steps]])
        w = joined(0.0, y, np.diff(ends, axis=1, prepend=0))
        for some, problem, _, drive in self.grounds.of(self.rows.slope[lanes]):
            of_steps = problem.of_steps(steps)
            self._judge_cycles_of(of_steps, lanes[some], w[:, some], np.log(drive))

    def _judge_cycles_of(
        self, problem: Problem, lanes: np.ndarray, w: np.ndarray, q: np.ndarray
    ) -> None:
        """Tell rows that are gaits of several steps, by Newton's method from points w
        (c - 1, k) at values of ln drive.
        """
        steps = problem.steps
        w, converged = newton(problem, w, q)
        lanes = lanes[converged]
        gaits = described(problem, w[:, converged], q[converged])
        are = self.within(self.rows.state[:, lanes], gaits.state, lanes)
        lanes = lanes[are]
        self._set_nearest(lanes, _taken(gaits, np.flatnonzero(are)))
        self.steps[lanes] = steps
        if steps == self.claimed:
            self.say("gait", lanes)
        else:
            self._say_period(lanes)

    def judge_faults(self) -> None:
        """Tell rows that are gaits with a fault."""
        for verdict, change in _faults():
            lanes = self.open
            if not len(lanes):
                return
            slope = self.rows.slope[lanes]
            times = _Times(self.walker.time_unit, self.rows.unit)
            state = change(self.rows.state[:, lanes], slope, times)
            numbers = self._match(lanes, state, _CHANGED)
            # A walker whose unit of time is 1 has the same rates either way.
            is_same = self.within(state, self.rows.state[:, lanes], lanes, 2 * _CHANGED)
            are = (numbers >= 0) & ~is_same
            self._settle_nearest(lanes[are], numbers[are])
            self.say(verdict, lanes[are])
        self._judge_before_heelstrike()

    def _judge_before_heelstrike(self) -> None:
        """Tell rows that are gaits just before heelstrike, by either leg's name."""
        for gaits in self.candidates:
            lanes = self.open
            angle, (old, swing) = gaits.state[0, lanes], gaits.before[:, lanes]
            state = self.rows.state[:, lanes]
            with np.errstate(invalid="ignore"):
                is_near = self.within(state, gaits.state[:, lanes], lanes, 2 * _CHANGED)
            for before in (
                [-angle, old, swing],
                [angle, old, swing],
                [angle, swing, old],
            ):
                with np.errstate(invalid="ignore"):
                    are = self.within(state, np.array(before), lanes, _CHANGED)
                are &= (self.verdict[lanes] == "") & ~is_near
                self._set_nearest(lanes[are], _taken(gaits, lanes[are]))
                self.say("before_heelstrike", lanes[are])

    def judge_rounded_slopes(self) -> None:
        """Tell rows that are gaits of the slope that was rounded to theirs, of one above
        0 that was rounded to 0 too.
        """
        near, slope = self.rows.near_slope, self.rows.slope
        lanes = self.steppable
        is_rounded = near[lanes] > self.rows.relative * slope[lanes]
        lanes = lanes[is_rounded & (slope[lanes] + near[lanes] > 0)]
        with np.errstate(invalid="ignore", divide="ignore"):
            low, high = np.log(np.maximum(slope - near, 0.0)), np.log(slope + near)
        for found in self._on_branches(lanes):
            q = np.log(found.slope)
            along = np.clip(q + found.along, low[lanes], high[lanes]) - q
            are = self._are(found, along, lanes, 1.0)
            self._set_nearest(lanes[are], _taken(found.gaits, np.flatnonzero(are)))
            if self.claimed > 1:
                self._say_period(lanes[are])
                continue
            self.say("gait", lanes[are])
            self._tell_slopes(lanes[are], np.exp(q + along)[are])
            self._judge_shanks(lanes[are])

    def _tell_slopes(self, lanes: np.ndarray, belong: np.ndarray) -> None:
        """Say of gaits from which slope theirs may have been rounded."""
        for lane, to in zip(lanes, belong, strict=True):
            digits = f"{self.rows.slope[lane]:.6g}, which may have been {to:.6g}"
            self.reason[lane] = f"A gait to the digits of its slope, {digits}."

    def judge_slopes(self) -> None:
        """Tell rows that are gaits of another slope."""
        lanes = self.steppable
        for found in self._on_branches(lanes):
            are = self._are(found, found.along, lanes, _CHANGED)
            slope = found.slope * np.exp(found.along)
            self._say_slope(lanes[are], slope[are])
        self._judge_level(lanes)

    def _are(
        self, found: _OnBranch, along: np.ndarray, lanes: np.ndarray, factor: float
    ) -> np.ndarray:
        """Which of some rows without a verdict are the gaits found, so far along."""
        with np.errstate(invalid="ignore"):
            is_straight = np.abs(along) <= _STRAIGHT
            gait = found.gaits.state + along * found.changes
            are = self.within(self.rows.state[:, lanes], gait, lanes, factor)
        return np.asarray(are & is_straight & (self.verdict[lanes] == ""))

    def _on_branches(self, lanes: np.ndarray) -> Iterator[_OnBranch]:
        """The gaits nearest to some rows on each branch, at any slope."""
        if not len(lanes):
            return
        state = self.rows.state[:, lanes]
        y = self._sections(lanes, state)[: self.problem.m]
        within = _CHANGED * self._relative_tolerance(lanes)
        if self.walker.knees:
            within *= _BEFORE_IMPACT
        allowed = self.rows.relative * _sizes(state) + self.rows.near[:, lanes]
        for slope, gaits, changes in nearest_on_branches(
            self.problem, self.branches, y, within
        ):
            moves = changes / allowed
            with np.errstate(invalid="ignore", divide="ignore"):
                products = moves * (state - gaits.state) / allowed
                along = total(products) / total(moves**2)
            yield _OnBranch(slope, gaits, changes, along)

    def _judge_level(self, lanes: np.ndarray) -> None:
        """Tell rows that are gaits of level ground."""
        lanes = lanes[self.rows.slope[lanes] != 0]
        if "drive" not in self.walker.features or not len(lanes):
            return
        level = np.zeros(len(lanes))
        for gaits in self.grounds.gaits_at(level):
            with np.errstate(invalid="ignore"):
                are = self.within(
                    self.rows.state[:, lanes], gaits.state, lanes, _CHANGED
                )
            are &= self.verdict[lanes] == ""
            self._say_slope(lanes[are], level[are])

    def judge_walkers(self) -> None:
        """Tell rows that are gaits of another walker of the catalogue at their slope."""
        for name, walker in CATALOGUE.items():
            # They are passive.
            lanes = self.steppable
            lanes = lanes[self.rows.slope[lanes] > 0]
            if not len(lanes) or walker == self.walker:
                continue
            if walker.knees == self.walker.knees:
                self._judge_walker(name, walker, lanes)

    def _judge_walker(self, name: str, walker: Walker, lanes: np.ndarray) -> None:
        """Tell rows that a catalogue walker takes back to themselves."""
        general = Lanes([walker], general_structure_of(walker))
        general = general.some(np.zeros(len(lanes), int))
        slope, state = self.rows.slope[lanes], self.rows.state[:, lanes].copy()
        state[1:] *= walker.time_unit / self.walker.time_unit
        y = general.section_of(state, slope)
        steps = stride(general, y, slope, exact=False)
        returns = _close(steps, y)
        problem = Problem(walker)
        w, solved = _solved(
            problem,
            y[:, returns],
            steps.times[:, returns],
            np.log(slope[returns]),
        )
        returns = returns[solved]
        gaits = described(problem, w, np.log(slope[returns]))
        are = self.within(state[:, returns], gaits.state, lanes[returns], _CHANGED)
        known = lanes[returns[are]]
        self.other[known] = name
        self.say("walker", known, walker=self.other[known])

    def judge_rest(self) -> None:
        """Say of all other rows how far the nearest gait is."""
        lanes = self.open
        near = self.distance[lanes] < _NEAR
        near_lanes = lanes[near]
        self.say("near", near_lanes, distance=self.distance[near_lanes])
        self.say("none", lanes[~near])

    def answer(self) -> dict[str, Any]:
        """What is said, in the walker's units."""
        flown = self.flown & (self.verdict == "gait")
        self.reason[flown] = "A gait, in the middle of a step."
        units = np.array([1.0, *[1.0 / self.walker.time_unit] * 2])[:, None]
        names = ("stance_angle", "stance_rate", "thigh_rate")
        columns = dict(zip(names, self.rows.state * units, strict=True))
        nearest = self.nearest.state * units
        columns |= {f"nearest_{x}": v for x, v in zip(names, nearest, strict=True)}

        curves = [_curve(branch) for branch in self.branches]
        return {**self._said(), **columns, "curves": curves}

    def _said(self) -> dict[str, np.ndarray]:
        """What is said of the rows."""
        is_slope = np.isin(self.verdict, ("slope", "below_ground"))
        has_nearest = np.isfinite(self.distance)
        return {
            "verdict": self.verdict.astype(str),
            "reason": self.reason.astype(str),
            "is_gait": self.verdict == "gait",
            "slope": self.rows.slope,
            "gait": self.label.astype(str),
            "steps": np.where(has_nearest, self.steps, 0),
            "distance": np.where(has_nearest, self.distance, np.nan),
            "missed": self.missed,
            "spectral_radius": self.nearest.radius,
            "belongs_to_slope": np.where(is_slope, self.belongs, np.nan),
            "walker": self.other.astype(str),
            "flown": self.flown,
        }


def _close(steps: SimulatedSteps, start: np.ndarray) -> np.ndarray:
    """Numbers of the steps that end near where they began."""
    is_near = _relative(steps.image, start) < _SOLVED_WITHIN
    return np.flatnonzero((steps.outcome == STRUCK) & is_near)


def _solved(
    problem: Problem, y: np.ndarray, times: np.ndarray, q: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Gaits in similarity coordinates to which Newton's method leads from sections at
    values of ln drive, and which sections lead to one.
    """
    if not len(q):
        return np.empty((problem.m + problem.phases, 0)), np.empty(0, bool)
    y = y[: problem.m]
    w = np.vstack([np.log(y[:1]), y[1:] / y[0], times])
    w, converged = newton(
        problem,
        w,
        q,
        max_iterations=_MOST_ITERATIONS,
    )
    return w[:, converged], converged


def _taken(gaits: Gaits, lanes: np.ndarray) -> Gaits:
    """The gaits of some lanes."""
    taken: Gaits = lanes_of(gaits, lanes)
    return taken


@np.errstate(invalid="ignore", divide="ignore")
def _relative(image: np.ndarray, start: np.ndarray) -> np.ndarray:
    """By what sections miss themselves, relative."""
    return _distance(image, start)


@dataclass(frozen=True)
class _Times:
    """The walker's unit of time, and that by which the table's rates were multiplied."""

    walker: float
    table: float


_DEGREE = np.pi / 180.0
Change = Callable[[np.ndarray, np.ndarray, _Times], np.ndarray]


def _faults() -> Iterator[tuple[str, Change]]:
    """Faults by name, each with what undoes it in states (3, n), from the slope (n,) and
    units of time.
    """
    yield "sign_of_angle", _scaled(-1, 1, 1)
    yield "sign_of_stance_rate", _scaled(1, -1, 1)
    yield "sign_of_thigh_rate", _scaled(1, 1, -1)
    yield "sign_of_rates", _scaled(1, -1, -1)
    yield "mirrored", _scaled(-1, -1, -1)
    yield "rates_exchanged", _chosen(0, 2, 1)
    yield "legs_exchanged", _with_legs_exchanged
    yield "degrees", _scaled(_DEGREE, _DEGREE, _DEGREE)
    yield "angle_in_degrees", _scaled(_DEGREE, 1, 1)
    yield "rates_in_degrees", _scaled(1, _DEGREE, _DEGREE)
    yield "radians", _scaled(1 / _DEGREE, 1 / _DEGREE, 1 / _DEGREE)
    yield "rates_over_root", lambda state, _, time: state * _rates(1 / time.walker)
    yield "rates_in_units", lambda state, _, time: state * _rates(time.walker)
    yield "reversed", _chosen(2, 1, 0)
    for places in ((1, 0, 2), (1, 2, 0), (2, 0, 1)):
        yield "columns_exchanged", _chosen(*places)
    yield "angle_between_legs", _scaled(0.5, 1, 1)
    yield "rate_between_legs", _with_relative_rate
    yield "from_vertical", _from_vertical
    yield "clockwise_from_vertical", _clockwise_from_vertical


def _scaled(*factors: float) -> Change:
    """A change that multiplies coordinates."""
    column = np.array(factors)[:, None]
    return lambda state, slope, time: state * column


def _chosen(*places: int) -> Change:
    """A change that puts the table's columns into another order."""

    def change(state: np.ndarray, slope: np.ndarray, time: _Times) -> np.ndarray:
        columns = state / _rates(time.table)
        return np.asarray(columns[list(places)] * _rates(time.table))

    return change


def _with_legs_exchanged(
    state: np.ndarray, slope: np.ndarray, time: _Times
) -> np.ndarray:
    angle, swing, stance = state
    return np.array([-angle, stance, swing])


def _with_relative_rate(
    state: np.ndarray, slope: np.ndarray, time: _Times
) -> np.ndarray:
    angle, stance, relative = state
    return np.array([angle, stance, stance - relative])


def _from_vertical(state: np.ndarray, slope: np.ndarray, time: _Times) -> np.ndarray:
    angle, stance, swing = state
    return np.array([angle + slope, stance, swing])


def _clockwise_from_vertical(
    state: np.ndarray, slope: np.ndarray, time: _Times
) -> np.ndarray:
    angle, stance, swing = state
    return np.array([slope - angle, -stance, -swing])


def _rates(factor: float) -> np.ndarray:
    """Factors (3, 1) of a state that change its rates."""
    return np.array([[1.0], [factor], [factor]])


def _curve(branch: Branch) -> dict[str, np.ndarray]:
    """Points along a branch for a picture, several between its nodes."""
    parts = []
    for first, last in branch.pieces():
        q = np.linspace(branch.q[first], branch.q[last], _PICTURED)
        parts.append(branch.on_piece(first, last, q)[0])
    Z = np.hstack(parts)
    return {"slope": np.exp(Z[-1]), "stance_angle": np.exp(Z[0])}
