"""What can be computed: every task's name, function, inputs, outputs and version.

The lowest floor of the house, and the door by which the pipeline enters: the variables
(`tasks.contract.variables`) and the options of studies (`tasks.contract.options`) are read here too. It
imports no solver, so a study is planned without loading one. A version is bumped by
hand when a task's results change; it is the only thing (besides the parameters) that
makes a stored result stale.
"""

import tomllib
from dataclasses import dataclass
from pathlib import Path

from gaitsweep.tasks.contract.kinds import FOLLOWED as FOLLOWED
from gaitsweep.tasks.contract.options import MAX_STEPS as MAX_STEPS
from gaitsweep.tasks.contract.options import OPTIONS as OPTIONS
from gaitsweep.tasks.contract.options import Option as Option
from gaitsweep.tasks.contract.options import options as options
from gaitsweep.tasks.contract.variables import ALWAYS as ALWAYS
from gaitsweep.tasks.contract.variables import BY_KEY as BY_KEY
from gaitsweep.tasks.contract.variables import COSTLY as COSTLY
from gaitsweep.tasks.contract.variables import GAITS as GAITS
from gaitsweep.tasks.contract.variables import OF_TARGETS as OF_TARGETS
from gaitsweep.tasks.contract.variables import PROVED as PROVED
from gaitsweep.tasks.contract.variables import SENSITIVITIES as SENSITIVITIES
from gaitsweep.tasks.contract.variables import SI_UNITS as SI_UNITS
from gaitsweep.tasks.contract.variables import STATUSES as STATUSES
from gaitsweep.tasks.contract.variables import VARIABLES as VARIABLES
from gaitsweep.tasks.contract.variables import VARIED as VARIED
from gaitsweep.tasks.contract.variables import VIOLATIONS as VIOLATIONS
from gaitsweep.tasks.contract.variables import Variable as Variable
from gaitsweep.tasks.contract.variables import admit as admit
from gaitsweep.tasks.contract.variables import derivatives as derivatives
from gaitsweep.tasks.contract.variables import is_measure as is_measure
from gaitsweep.tasks.contract.variables import nameable as nameable

#: Slopes that can be asked for [rad], the first included: branches are followed down to
#: it.
SLOPES = (1e-18, 0.5)


@dataclass(frozen=True)
class Task:
    """One kind of work: `function` is "module:name", called as function(params,
    inputs).

    `side_by_side` computes this task and `points`, which needs it, for several short
    lines in one call, `over_plane` for those in one cell of a plane of keys. What they
    take is in `tasks.contract.costs`.
    """

    name: str
    function: str
    version: int
    needs: tuple[str, ...] = ()
    side_by_side: str = ""
    over_plane: str = ""


TASKS = {
    t.name: t
    for t in (
        Task(
            "atlas",
            "gaitsweep.tasks.studies.solve_points:atlas",
            35,
            side_by_side="gaitsweep.tasks.studies.solve_points:lines",
            over_plane="gaitsweep.tasks.studies.solve_planes:lines",
        ),
        Task(
            "points",
            "gaitsweep.tasks.studies.solve_points:points",
            35,
            needs=("atlas",),
        ),
        Task("targets", "gaitsweep.tasks.studies.solve_at_value:lines", 6),
        Task("charts", "gaitsweep.tasks.studies.solve_planes:charts", 13),
        Task(
            "trace", "gaitsweep.tasks.studies.trace_motion:trace", 7, needs=("atlas",)
        ),
        Task(
            "branch",
            "gaitsweep.tasks.studies.follow_branches:branch",
            30,
            needs=("atlas",),
        ),
        Task(
            "orbit",
            "gaitsweep.tasks.studies.iterate_orbits:orbit",
            12,
            needs=("atlas",),
        ),
        Task(
            "cascade",
            "gaitsweep.tasks.studies.locate_cascade:cascade",
            24,
            needs=("atlas",),
        ),
        Task("basin", "gaitsweep.tasks.studies.map_basin:basin", 13, needs=("atlas",)),
        Task(
            "curve", "gaitsweep.tasks.studies.follow_curves:curve", 34, needs=("atlas",)
        ),
        Task("design", "gaitsweep.tasks.studies.map_designs:design", 29),
        Task("optimum", "gaitsweep.tasks.studies.optimise_walker:optimum", 4),
        Task("census", "gaitsweep.tasks.studies.count_gaits:census", 19),
        Task("measured", "gaitsweep.tasks.studies.solve_measured:measured", 3),
        Task(
            "scaling", "gaitsweep.tasks.studies.fit_laws:scaling", 6, needs=("points",)
        ),
        Task(
            "transition",
            "gaitsweep.tasks.studies.fit_laws:transition",
            6,
            needs=("points",),
        ),
        Task(
            "landmarks",
            "gaitsweep.tasks.ledger.locate_landmarks:landmarks",
            11,
            needs=("atlas",),
        ),
        Task(
            "corners",
            "gaitsweep.tasks.ledger.locate_landmarks:corners",
            8,
            needs=("atlas",),
        ),
        Task(
            "crises",
            "gaitsweep.tasks.ledger.locate_landmarks:crises",
            9,
            needs=("atlas", "cascade", "corners"),
        ),
        Task(
            "claims",
            "gaitsweep.tasks.ledger.check_claims:claims",
            27,
            needs=("points", "atlas"),
        ),
    )
}

#: A line of no more slopes is short: its atlas is coarse, and what its gaits' error
#: bounds need is measured at each.
SHORT_LINE = 256

#: Every figure and fit, and the point variables and tasks it reads; the plan adds them
#: to what a study wants.
READS = {
    name: tuple(read)
    for name, read in tomllib.loads(
        Path(__file__).with_name("reads.toml").read_text(encoding="utf-8")
    ).items()
}

#: Tasks over a whole study that a study's `fits` may name, and names that its `figures`
#: may hold.
FITS = ("scaling", "transition", "landmarks", "crises")
FIGURES = tuple(name for name in READS if name not in FITS)

#: Tasks whose tables claims read beside those of the study's own task, and tasks whose
#: results are in no table.
READ_BY_CLAIMS, INTERNAL = (
    {"K2": ("corners",)},
    ("atlas", "charts", "points", "corners"),
)

#: Windows of slopes [rad] in which the walkers lose persistent walking whose loss the
#: paper prints.
LOSS_WINDOWS = {"D": (0.01, 0.0195), "C": (0.07, 0.1), "C-printed": (0.07, 0.1)}

#: Keys over which gaits are followed where the slope does not drive, the first of those
#: that vary; and the kinds of studies whose gaits may be followed over one.
DRIVES = ("push_off", "hip_torque")
OVER_DRIVE = ("branch", "cascade", "orbit", "basin", "census")

#: Most steps after which a state of a table is looked for again.
MAX_STEPS_OF_STATES = 8

#: Kinds whose slopes are a window, between the least and the largest.
WINDOWED = ("branch", "cascade", "curve", "design")
#: What is known of gaits of one step only: what a study of longer ones cannot want.
OF_ONE_STEP = (
    "transition",
    "landmarks",
    "crises",
    "angles",
    "claims",
    "proved",
    "proved_radius",
)

#: Figures and fits that need a study of one kind, and what reads tasks over lines,
#: which designs have not.
NEEDED_KINDS = {
    name: name for name in ("basin", "design", "census", "cascade", "optimum")
}
NEEDED_KINDS |= {
    "locus": "branch",
    "bifurcation": "orbit",
    "curves": "curve",
    "scaling": "grid",
    "transition": "grid",
}
OVER_LINES = ("landmarks", "crises", "angles", *READ_BY_CLAIMS)

#: How many claims the ledger has of each family, and their names.
_FAMILIES = {
    "D": 10,
    "E": 7,
    "P": 8,
    "T": 8,
    "Z": 6,
    "M": 7,
    "K": 3,
    "W": 1,
    "G": 2,
    "A": 6,
    "L": 2,
}
CLAIMS = tuple(
    f"{family}{n}" for family, count in _FAMILIES.items() for n in range(1, count + 1)
)

#: Calls answered at once, without a graph: of the command line and of Python, and the
#: check of a walker.
CALLS = {
    "solve": "gaitsweep.tasks.studies.solve_at_slope:solve_one",
    "solve_at": "gaitsweep.tasks.studies.solve_at_value:solve_at_value",
    "check_target": "gaitsweep.tasks.studies.solve_at_value:check_target",
    "differentiate": "gaitsweep.tasks.studies.differentiate_gaits:differentiate",
    "step_map": "gaitsweep.tasks.studies.map_step:map_step",
    "simulate": "gaitsweep.tasks.studies.simulate_steps:simulate_steps",
    "check_states": "gaitsweep.tasks.check.check_states:check_states",
    "verdicts": "gaitsweep.tasks.check.verdicts:verdicts",
    "convention": "gaitsweep.tasks.walkers.conventions:columns",
    "written_in": "gaitsweep.tasks.walkers.conventions:written_in",
    "prove": "gaitsweep.tasks.studies.prove_gaits:prove_one",
    "prove_stored": "gaitsweep.tasks.proofs.records:prove_stored",
    "certificates": "gaitsweep.tasks.ledger.write_certificates:names",
    "certify": "gaitsweep.tasks.ledger.write_certificates:certify",
    "enclose_special": "gaitsweep.tasks.ledger.write_certificates:enclose_special",
    "claims": "gaitsweep.tasks.ledger.check_claims:check",
    "walkers": "gaitsweep.tasks.walkers.describe:describe",
    "tune": "gaitsweep.tasks.walkers.tuning:tune",
    "untuned": "gaitsweep.tasks.walkers.tuning:untuned",
    "why_no_key": "gaitsweep.tasks.walkers.resolve:why_no_key",
    "check_walker": "gaitsweep.tasks.walkers.properties:check",
    "check_curve": "gaitsweep.tasks.studies.check_curve:check",
    "check_optimum": "gaitsweep.tasks.studies.check_optimum:check",
    "scaled": "gaitsweep.tasks.walkers.scaling:scaled",
    "search_words": "gaitsweep.tasks.studies.solve_points:search_words",
}

#: Function that says how long a process has integrated, once its module is loaded.
CLOCK = "gaitsweep.tasks.mechanics.kernel:integrating_seconds"
