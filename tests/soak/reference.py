"""Reference values: gaits, flips and folds in proved digits, `python -m soak.reference FOLDER`."""

import csv
import io
import json
import sys
from decimal import ROUND_HALF_EVEN, Context, Decimal
from pathlib import Path

from joblib import Parallel, delayed

from gaitsweep.pipeline.archive.citation import PAPER
from gaitsweep.pipeline.dispatch import ask
from gaitsweep.pipeline.study import files
from gaitsweep.tasks.walkers.walker import NUMBERS

COMPASS = "goswami-compass"
_BOTH = ("long", "short")
#: Walker, slopes [rad] as written, gaits.
GAITS = (
    *((w, ("0.001", "0.003", "0.01", "0.03", "0.05", "0.08"), _BOTH) for w in (*"ABCDEF", COMPASS)),
    *(("C", ("0.0001",), _BOTH), ("D", ("0.0001", "0.009"), _BOTH), (COMPASS, ("0.0524",), _BOTH)),
    ("physical", ("0.0195", "0.02", "0.025", "0.03", "0.036", "0.04", "0.05"), ("long",)),
    ("physical", ("0.022", "0.04", "0.05"), ("short",)),
    ("physical-straight", ("0.016", "0.02", "0.03", "0.036", "0.05", "0.06"), ("long",)),
    ("physical-straight", ("0.06", "0.08"), ("short",)),
)
#: Kind, walker, slope [rad] beside it, and the label of a gait there.
SPECIAL = (
    *(("flip", w, s, "long") for w, s in zip("ABCDF", ("0.0643", "0.000491", "0.0769", "0.0151", "0.00679"))),
    *(("flip", COMPASS, "0.0766", "long"), ("flip", "physical", "0.1988", "long")),
    *(("flip", "physical", s, "other1") for s in ("0.0202", "0.01913")),
    *(("fold", "physical", s, g) for s, g in (("0.0192", "long"), ("0.0530", "short"), ("0.164", "short"))),
    ("fold", "physical-straight", "0.0154", "long"),
)
#: Relative radius of a gait's box, and half the interval around a flip's slope or a fold's angle [rad]. They are so much
#: smaller than a unit of the last digit that they decide no digit: digits of states and decimals of multipliers.
ACCURACY, HALF = "1e-28", 1e-22
DIGITS = {"gait": (20, 12), "flip": (14, 8), "fold": (14, 8)}
SLOPE_DECIMALS = 18
STATE = ("stance_angle", "stance_rate", "thigh_rate", "shank_rate", "kneestrike_time", "period")
UNITS = dict(zip(("slope", *STATE), ("rad", "rad", *["rad/time"] * 3, "time", "time")))
MULTIPLIERS = [f"multiplier_{count}{part}" for count in (1, 2, 3) for part in ("", "_imaginary")]
KEYS = (*NUMBERS, "knees")
_EXACT = Context(prec=400, rounding=ROUND_HALF_EVEN)
ABOUT = {
    "title": "Gaits of passive dynamic walkers, their flips and folds, in proved digits",
    "rule": "Every number is a decimal nearest to the true one: it is proved in ball arithmetic that the true number"
    " lies within half a unit of the last digit, which `radius` gives. Slopes of gaits are exact.",
    "kinds": {
        "gait": "a period-one gait on the slope; `stable` and its strikes are proved",
        "flip": "the slope where a multiplier passes -1, and the gait there; `stable` is null",
        "fold": "the slope where the branch of gaits turns back, and the gait there; `stable` is null",
    },
    "conventions": "Angles are counter-clockwise from the ground normal, x points down the slope. The state is that just"
    " after heelstrike, of the stance leg, the swing thigh and the swing shank; with straight legs the last two are one."
    " Time is from there to kneestrike and to the next heelstrike, which is the period. Multipliers are those of the"
    " step map, largest first; those that vanish by construction (one with knees or point feet) are left out. A gait is"
    " `long` if its thigh's rate exceeds the stance leg's by less than half of it before heelstrike, else `short`; several"
    " gaits on a slope may be.",
    "units": "SI (m, kg, s, rad) for walkers of g = 9.81; for those of g = 1 all numbers have the consistent units in"
    " which the walker's keys are given, time sqrt(length/g). D is the limit of vanishing foot mass: m_s = 0.",
    "walkers": "Keys are exact decimals and mean what docs/physics.md says; w_s and w_t of A and C are to 38 digits what"
    " tunes them exactly: w_s = c_s tan(eps_S), w_t = -tan(eps_T) (c_t + m_s l_t/m_t),"
    " sin(eps_S) = l_t sin(eps_T)/(l_s - R).",
    "paper": PAPER,
    "bibtex": [
        "@software{gaitsweep, author = {{gaitsweep developers}}, title = {gaitsweep}, version = {0.1.0}}",
        "@article{garcia2000, author = {Garcia, Mariano and Chatterjee, Anindya and Ruina, Andy}, title = {Efficiency,"
        " speed, and scaling of two-dimensional passive-dynamic walking}, journal = {Dynamics and Stability of Systems},"
        " volume = {15}, number = {2}, pages = {75--99}, year = {2000}, doi = {10.1080/713603737}}",
    ],
    "made_by": "make reference",
}


def asked():
    """What is proved: of every entry its name, the question, and the parameters."""
    for walker, slopes, labels in GAITS:
        for slope in slopes:
            for label in labels:
                gait = {"walker": walker, "slope": slope, "gait": label, "accuracy": float(ACCURACY)}
                yield f"{walker}-{label}-{slope}", "prove", gait
    for kind, walker, slope, label in SPECIAL:
        special = {"kind": kind, "walker": walker, "slope": slope, "gait": label, "half": HALF}
        yield f"{walker}-{kind}-{slope}", "enclose_special", special


def rounded(middle, radius, place):
    """The decimal to which all of an interval rounds, its last digit at a power of ten or as little above as may be."""
    if not float(radius):
        return middle, "0"
    low, high = _EXACT.subtract(Decimal(middle), Decimal(radius)), _EXACT.add(Decimal(middle), Decimal(radius))
    while (found := _EXACT.quantize(low, Decimal(1).scaleb(place))) != _EXACT.quantize(high, found):
        place += 1
    return f"{_EXACT.plus(found):f}", f"5e{place - 1}"  # no zero with a sign


def digits(middle, radius, number):
    """The decimal of so many digits to which all of an interval rounds."""
    return rounded(middle, radius, Decimal(middle).adjusted() - number + 1)


def enter(name, question, params):
    """Prove an entry, and write it in the digits that are proved; with it the keys of its walker."""
    walker = params["walker"]
    table = files.walker(f"{walker}.toml", Path(), number=str) if walker == COMPASS else walker
    found = ask(question, {**params, "walker": table})
    if question == "prove":
        (found,) = found["gaits"]
        if not found["proved"] or found["stable"] is None:
            raise ValueError(f"{name} is not proved: {found['reason']}")
    kind = found.get("kind", "gait")
    number, decimals = DIGITS[kind]
    slope = (params["slope"], "0") if kind == "gait" else rounded(*found["slope"], -SLOPE_DECIMALS)
    values = {"slope": slope, **{key: digits(*found["box"][key], number) for key in STATE if key in found["box"]}}
    pairs = [[rounded(*part, -decimals) for part in pair] for pair in found["multipliers"]]
    pairs = [pair for pair in pairs if float(pair[1][0]) >= 0]  # of a conjugate pair the upper one stands for both
    numbers = []
    for real, imaginary in sorted(pairs, key=lambda p: -abs(complex(float(p[0][0]), float(p[1][0])))):
        for value in ("", "-")[: 1 + (float(imaginary[0]) > 0)]:
            numbers += [real, (value + imaginary[0], imaginary[1])]
    values |= dict(zip(MULTIPLIERS, numbers))
    file = f"{COMPASS}.toml" if walker == COMPASS else walker
    proved = f"gaitsweep prove --walker {file} --slope {params['slope']} --gait {params['gait']} --accuracy {ACCURACY}"
    entry = {"name": name, "kind": kind, "walker": walker, "gait": found["gait"], "stable": found.get("stable")}
    entry |= {"events": found["events"], **{key: value for key, (value, _) in values.items()}}
    entry["radius"] = {key: radius for key, (_, radius) in values.items() if radius != "0"}
    return {**entry, "made_by": proved if kind == "gait" else "make reference"}, _keys(found["walker"])


def _keys(table):
    """A walker's keys in decimals."""
    balls = {key: table[key].strip("[]").split(" +/- ") for key in NUMBERS if table[key].startswith("[")}
    return {key: digits(*balls[key], 38)[0] if key in balls else table[key] for key in KEYS}


def make(only=None, jobs=2):
    """Everything the file holds, or the entries named only."""
    wanted = [each for each in asked() if only is None or each[0] in only]
    found = Parallel(n_jobs=jobs, batch_size=1)(delayed(enter)(*each) for each in wanted)
    walkers = {entry["walker"]: keys for entry, keys in found}
    return {"about": ABOUT, "walkers": walkers, "entries": [entry for entry, _ in found]}


def table(reference):
    """The entries as CSV, the keys of their walkers with them, units in the head."""
    head = ("name", "kind", "walker", "gait", "stable", "events", *UNITS, *MULTIPLIERS)
    heads = [f"{key} [{UNITS[key]}]" if key in UNITS else key for key in (*head, *KEYS, "made_by")]
    text = io.StringIO()
    rows = csv.writer(text, lineterminator="\n")
    rows.writerow(heads)
    for entry in reference["entries"]:
        cells = (entry.get(key) for key in head)
        cells = [" ".join(c) if isinstance(c, list) else str(c).lower() if isinstance(c, bool) else c for c in cells]
        rows.writerow([*cells, *reference["walkers"][entry["walker"]].values(), entry["made_by"]])
    return text.getvalue()


if __name__ == "__main__":
    reference, folder = make(), Path(sys.argv[1])
    (folder / "gaits.json").write_text(json.dumps(reference, indent=1) + "\n", encoding="utf-8")
    (folder / "gaits.csv").write_text(table(reference), encoding="utf-8")
