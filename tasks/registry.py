"""What can be computed: every task's name, function, inputs, outputs and version.

The lowest floor of the house. It imports nothing, so a study is planned without loading a solver.
A version is bumped by hand when a task's results change; it is the only thing (besides the
parameters) that makes a stored result stale.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

#: Labels of the gait dimension. `other1`, ... hold the further gaits of a label, by falling angle.
GAITS = ("long", "short", "other1", "other2")

#: What can become of a solve (CF flag values). How a run ended for a worker is added by the pipeline.
STATUSES = {"converged": 0, "no_gait": 1, "not_converged": 2, "fell": 3, "less_accurate": 9}

#: SI units of each kind of quantity; every one is "1" for a walker in consistent units.
SI_UNITS = {
    "angle": "rad",
    "rate": "rad s-1",
    "time": "s",
    "length": "m",
    "mass": "kg",
    "speed": "m s-1",
    "energy": "J",
    "power": "W",
    "impulse": "N s",
    "angular_impulse": "N m s",
    "torque": "N m",
    "acceleration": "m s-2",
    "inertia": "kg m2",
    "number": "1",
}


@dataclass(frozen=True)
class Variable:
    """One archive variable: name, dimensions after the axes, kind of quantity, meaning, value without a gait."""

    name: str
    dims: tuple[str, ...]
    kind: str
    long_name: str
    group: str = ""
    dtype: str = "f8"
    absent: float = float("nan")

    def units(self, si: bool) -> str:
        """CF units of this variable for a walker in SI (`si`) or in consistent units."""
        return SI_UNITS[self.kind] if si or self.kind == "angle" else "1"


_G, _M = ("gait",), ("gait", "multiplier")

#: Variables of a grid study in the order they are archived.
VARIABLES = {
    v.name: v
    for v in (
        Variable("stance_angle", _G, "angle", "stance angle just after heelstrike"),
        Variable("stance_rate", _G, "rate", "stance leg rate just after heelstrike"),
        Variable("thigh_rate", _G, "rate", "swing thigh rate just after heelstrike"),
        Variable("shank_rate", _G, "rate", "swing shank rate just after heelstrike"),
        Variable("period", _G, "time", "duration of one step"),
        Variable("kneestrike_time", _G, "time", "time of kneestrike after the start of the step"),
        Variable("multiplier_real", _M, "number", "real part of the step map's eigenvalues", "multipliers"),
        Variable("multiplier_imag", _M, "number", "imaginary part of the step map's eigenvalues", "multipliers"),
        Variable("spectral_radius", _G, "number", "largest magnitude of the step map's eigenvalues", "multipliers"),
        Variable(
            "multiplier_error_bound", _G, "number", "bound on the absolute errors of the multipliers", "multipliers"
        ),
        Variable("speed", _G, "speed", "mean speed along the slope"),
        Variable("froude_speed", _G, "number", "mean speed over sqrt(g (l + R))"),
        Variable("cost_of_transport", _G, "number", "energy lost over weight and distance"),
        Variable("power", _G, "power", "mean power drawn from gravity"),
        Variable("loss_normal", _G, "energy", "heelstrike loss on the eigenvector nearer the ground normal", "energy"),
        Variable("loss_tangential", _G, "energy", "heelstrike loss on the eigenvector nearer the slope", "energy"),
        Variable("loss_kneestrike", _G, "energy", "loss at kneestrike", "energy"),
        Variable("energy_imbalance", _G, "number", "losses minus drop of potential energy, over that drop", "energy"),
        Variable(
            "heelstrike_rate_ratio",
            _G,
            "number",
            "(thigh rate - stance rate)/|stance rate| just before heelstrike; below 1/2 a gait is long",
        ),
        Variable("violations", _G, "number", "physical assumptions a gait violates", "violations", "i4", 0),
        Variable("scuff_depth", _G, "length", "greatest depth of the swing foot below the ground", "violations"),
        Variable(
            "unlocking_torque",
            _G,
            "torque",
            "worst torque that would flex the stance knee (negative: its stop holds)",
            "violations",
        ),
        Variable("unlocking_torque_time", _G, "time", "when the unlocking torque is worst", "violations"),
        Variable(
            "unlocking_impulse_kneestrike",
            _G,
            "angular_impulse",
            "angular impulse that would flex the stance knee at kneestrike",
            "violations",
        ),
        Variable(
            "unlocking_impulse_heelstrike",
            _G,
            "angular_impulse",
            "angular impulse that would flex the stance knee at heelstrike",
            "violations",
        ),
        Variable("least_normal_force", _G, "number", "least ground normal force over weight", "violations"),
        Variable(
            "friction_demand",
            _G,
            "number",
            "largest |tangential|/normal ground force (infinite: the contact would pull)",
            "violations",
        ),
        Variable(
            "friction_demand_heelstrike",
            _G,
            "number",
            "|tangential|/normal impulse at heelstrike (infinite: the contact would pull)",
            "violations",
        ),
        Variable(
            "friction_demand_kneestrike",
            _G,
            "number",
            "|tangential|/normal impulse at kneestrike (infinite: the contact would pull)",
            "violations",
        ),
        Variable("hyperextension", _G, "angle", "largest hyperextension of the swing knee", "violations"),
        Variable(
            "penetration_depth", _G, "length", "depth the released foot sinks just after heelstrike", "violations"
        ),
        Variable(
            "trailing_impulse", _G, "impulse", "impulse two contacts would need at the trailing foot", "violations"
        ),
        Variable("residual", _G, "number", "largest residual of the fixed-point equations"),
        Variable(
            "error_bound",
            _G,
            "number",
            "bound on the relative errors of angle and period and on the rates' errors over the largest rate",
        ),
        Variable(
            "branch",
            _G,
            "number",
            "branch of its line a gait lies on, by rank; -1 where there is no gait",
            dtype="i2",
            absent=-1,
        ),
        Variable(
            "piece", _G, "number", "piece of its branch between folds; -1 where there is no gait", dtype="i2", absent=-1
        ),
        Variable(
            "proved", _G, "number", "whether the gait is proved to exist, alone in a box, as a step", "proofs", "i1", 0
        ),
        Variable("proved_radius", _G, "number", "relative radius of the box of the proof", "proofs"),
        Variable("status", _G, "number", "outcome of the solve", dtype="i1", absent=STATUSES["no_gait"]),
        Variable("reason", _G, "number", "index into the table of reasons", dtype="i2", absent=0),
    )
}

#: Bits of `violations`, lowest first (PHYSICS: Appendix A of the paper).
VIOLATIONS = (
    "scuff",
    "stance_knee_unlocks",
    "contact_tension",
    "friction",
    "release_hyperextends",
    "release_penetrates",
    "trailing_foot_pulls",
)

#: Values of `proved` (CF flags).
PROVED = {"not_attempted": 0, "proved": 1, "not_proved": 2}

#: What a point with proofs takes, before any is measured [s].
SECONDS_PER_PROOF = 1.0

#: Groups of variables that cost much: only a study that names them has them.
COSTLY = ("violations", "proofs")

#: Always archived, whatever a study wants.
ALWAYS = ("residual", "error_bound", "branch", "piece", "status", "reason")


@dataclass(frozen=True)
class Task:
    """One kind of work: `function` is "module:name", called as function(params, inputs).

    `side_by_side` computes this task and `points`, which needs it, for several short lines in one call, `over_plane`
    for those in one cell of a plane of keys. `seconds_per_point` is the scheduler's first guess; what whole studies
    take is in `tasks.costs`.
    """

    name: str
    function: str
    version: int
    needs: tuple[str, ...] = ()
    seconds_per_point: float = 0.0
    side_by_side: str = ""
    over_plane: str = ""


TASKS = {
    t.name: t
    for t in (
        Task(
            "atlas",
            "tasks.solve_points:atlas",
            23,
            side_by_side="tasks.solve_points:lines",
            over_plane="tasks.solve_planes:lines",
        ),
        Task("points", "tasks.solve_points:points", 15, needs=("atlas",), seconds_per_point=3e-5),
        Task("trace", "tasks.trace_motion:trace", 3, needs=("atlas",)),
        Task("branch", "tasks.follow_branches:branch", 11, needs=("atlas",)),
        Task("orbit", "tasks.iterate_orbits:orbit", 6, needs=("atlas",)),
        Task("cascade", "tasks.locate_cascade:cascade", 10, needs=("atlas",)),
        Task("basin", "tasks.map_basin:basin", 7, needs=("atlas",)),
        Task("curve", "tasks.follow_curves:curve", 8, needs=("atlas",)),
        Task("design", "tasks.map_designs:design", 14),
        Task("census", "tasks.count_gaits:census", 9),
        Task("scaling", "tasks.fit_laws:scaling", 4, needs=("points",)),
        Task("transition", "tasks.fit_laws:transition", 4, needs=("points",)),
        Task("landmarks", "tasks.locate_landmarks:landmarks", 2, needs=("atlas",)),
        Task("corners", "tasks.locate_landmarks:corners", 1, needs=("atlas",)),
        Task("crises", "tasks.locate_landmarks:crises", 4, needs=("atlas", "cascade", "corners")),
        Task("claims", "tasks.check_claims:claims", 13, needs=("points", "atlas")),
    )
}

#: A line of no more slopes is short: its atlas is coarse, and what its gaits' error bounds need is measured at each.
SHORT_LINE = 256

#: Rates that complete the start of a step: a click on a gait's mark in a figure makes it walk.
_START = ("stance_rate", "thigh_rate", "shank_rate")

#: Every figure and fit, and the point variables and tasks it reads; the plan adds them to what a study wants.
READS = {
    "scaling": ("stance_angle", "period", "speed", "power", "branch", "piece"),
    "transition": ("stance_angle", "branch", "piece"),
    "loglog": ("stance_angle", "spectral_radius", *_START),
    "linear": ("stance_angle", "spectral_radius", *_START),
    "transition_ladder": ("stance_angle",),
    "angles": ("trace",),
    "multipliers": ("spectral_radius", "stance_angle", *_START),
    "losses": ("loss_normal", "loss_tangential", "loss_kneestrike", "spectral_radius", "stance_angle", *_START),
    "heelstrike": ("heelstrike_rate_ratio", "spectral_radius", "stance_angle", *_START),
    "power": ("power", "speed", "spectral_radius", "stance_angle", *_START),
    "heatmap": ("speed", "stance_angle", "period", "spectral_radius", *_START),
    **dict.fromkeys(
        (
            "walker",
            "conditions",
            "locus",
            "bifurcation",
            "basin",
            "design",
            "census",
            "cascade",
            "curves",
            "exponents",
            "claims",
        ),
        (),
    ),
}

#: Tasks over a whole study that a study's `fits` may name, and names that its `figures` may hold.
FITS = ("scaling", "transition", "landmarks", "crises")
FIGURES = tuple(name for name in READS if name not in FITS)

#: Tasks whose tables claims read beside those of the study's own task, and tasks whose results are in no table.
READ_BY_CLAIMS, INTERNAL = {"K2": ("corners",)}, ("atlas", "points", "corners")

#: Windows of slopes [rad] in which the walkers lose persistent walking whose loss the paper prints.
LOSS_WINDOWS = {"D": (0.01, 0.0195), "C": (0.07, 0.1), "C-printed": (0.07, 0.1)}

#: Longest period of gaits, in steps.
MAX_STEPS = 64


@dataclass(frozen=True)
class Option:
    """One option of a kind of study: what it holds, its default, and its meaning.

    `holds` is "number", "positive", "count" (a whole number from 1), "count or 0", "counts" (a list of them),
    "steps" (from 1 to MAX_STEPS), "slope" (above 0 and below 0.5), "share" (from 0 to 0.5), "range" (two rising
    numbers), "gait" (a label), "key" (of a walker) or "kinds" (of special points).
    """

    holds: str
    default: Any
    meaning: str


_STEPS = Option("steps", 1, f"steps after which a gait repeats, at most {MAX_STEPS}")

#: Options of each kind of study; the parser, `gaitsweep plan --help`, the tasks and the docs read them here.
OPTIONS: dict[str, dict[str, Option]] = {
    "grid": {
        "friction_limit": Option("positive", 1.0, "contact friction above which a gait is flagged"),
        "steps": _STEPS,
    },
    "branch": {"steps": _STEPS},
    "orbit": {
        "gait": Option("gait", "long", "label of the gait that the initial states are near"),
        "starts": Option("count", 8, "initial states"),
        "spread": Option("number", 1e-3, "relative distance of the initial states from the gait"),
        "transient": Option("count", 400, "steps before the orbit is kept"),
        "steps": Option("count", 240, "steps over which Lyapunov exponents are averaged"),
        "shown": Option("count", 120, "last steps kept in the archive"),
    },
    "cascade": {
        "periods": Option("count", 64, "largest period to which doublings are followed"),
        "families": Option("counts", [1], "periods of the gaits at which cascades begin"),
        "starts": Option("count", 400, "initial states of the search for families of other periods than one"),
        "steps": Option("count or 0", 200, "steps that walking must last; 0 leaves the loss of walking out"),
    },
    "basin": {
        "size": Option("count", 160, "initial states along each axis"),
        "steps": Option("count", 200, "steps each initial state is followed"),
        "stance_angle": Option("range", None, "stance angles of the initial states [rad]; by default around the gaits"),
        "stance_rate": Option("range", None, "stance rates of the initial states; by default around the gaits"),
    },
    "curve": {
        "key": Option("key", "detuning", "key that varies along the curve beside the slope"),
        "from": Option("number", 0.0, "least value of the key"),
        "to": Option("number", 1.0, "largest value of the key"),
        "kinds": Option("kinds", ("fold", "flip"), "special points whose curves are followed"),
    },
    "census": {"starts": Option("count", 2000, "initial guesses at each slope")},
    "design": {
        "at_slope": Option("slope", None, "slope at which attractors are found [rad]"),
        "at_speed": Option("positive", None, "speed at which the least cost is found, in the walker's units"),
        "ground": Option("share", 0.0, "largest step of the ground tried at `at_slope`, over the leg; 0: none"),
    },
}

#: Options that had another name before, which is still read.
RENAMED_OPTIONS = {"strides": "steps"}


def options(kind: str, given: Mapping[str, Any]) -> dict[str, Any]:
    """Options of a kind of study: those given, and the defaults of the others."""
    return {name: given.get(name, option.default) for name, option in OPTIONS[kind].items()}


#: Points whose curves a study of kind `curve` follows.
FOLLOWED = ("fold", "flip", "end_kneestrike_at_heelstrike", "end_tangential_heelstrike")

#: Kinds whose slopes are a window, between the least and the largest.
WINDOWED = ("branch", "cascade", "curve", "design")
#: What is known of gaits of one step only: what a study of longer ones cannot want.
OF_ONE_STEP = ("transition", "landmarks", "crises", "angles", "claims", "proved", "proved_radius")

#: Figures and fits that need a study of one kind, and what reads tasks over lines, which designs have not.
NEEDED_KINDS = {name: name for name in ("basin", "design", "census", "cascade")}
NEEDED_KINDS |= {"locus": "branch", "bifurcation": "orbit", "curves": "curve", "scaling": "grid", "transition": "grid"}
OVER_LINES = ("landmarks", "crises", "angles", *READ_BY_CLAIMS)

#: Claims of the ledger.
CLAIMS = tuple(
    f"{family}{n}"
    for family, numbers in {
        "D": range(1, 11),
        "E": range(1, 8),
        "P": range(1, 9),
        "T": range(1, 9),
        "Z": range(1, 7),
        "M": range(1, 8),
        "K": range(1, 4),
        "W": (1,),
        "G": (1, 2),
        "A": range(1, 7),
    }.items()
    for n in numbers
)

#: Calls answered at once, without a graph: of the command line and of Python, and the check of a walker.
CALLS = {
    "solve": "tasks.solve_at_slope:solve_one",
    "step_map": "tasks.map_step:map_step",
    "simulate": "tasks.simulate_steps:simulate_steps",
    "prove": "tasks.prove_gaits:prove_one",
    "prove_stored": "tasks.proofs.records:prove_stored",
    "certificates": "tasks.write_certificates:names",
    "certify": "tasks.write_certificates:certify",
    "claims": "tasks.check_claims:check",
    "walkers": "tasks.walkers.describe:describe",
    "tune": "tasks.walkers.tuning:tune",
    "check_walker": "tasks.walkers.resolve:check",
}

#: Function that says how long a process has integrated, once its module is loaded.
CLOCK = "tasks.mechanics.kernel:integrating_seconds"
