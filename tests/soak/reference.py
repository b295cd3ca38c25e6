"""Reference values: gaits, flips and folds in proved digits, `python -m soak.reference
FOLDER`.
"""

import csv
import io
import json
import sys
import tomllib
from decimal import ROUND_HALF_EVEN, Context, Decimal
from pathlib import Path

from joblib import Parallel, delayed

from gaitsweep.pipeline.dispatch import ask
from gaitsweep.pipeline.study import files
from gaitsweep.tasks.walkers.walker import NUMBERS, OF_DRIVE

COMPASS = "goswami-compass"
_BOTH = ("long", "short")
#: Walker, slopes [rad] as written, gaits.
GAITS = (
    *(
        (w, ("0.001", "0.003", "0.01", "0.03", "0.05", "0.08"), _BOTH)
        for w in (*"ABCDEF", COMPASS)
    ),
    *(
        ("C", ("0.0001",), _BOTH),
        ("D", ("0.0001", "0.009"), _BOTH),
        (COMPASS, ("0.0524",), _BOTH),
    ),
    (
        "physical",
        ("0.0195", "0.02", "0.025", "0.03", "0.036", "0.04", "0.05"),
        ("long",),
    ),
    ("physical", ("0.022", "0.04", "0.05"), ("short",)),
    (
        "physical-straight",
        ("0.016", "0.02", "0.03", "0.036", "0.05", "0.06"),
        ("long",),
    ),
    ("physical-straight", ("0.06", "0.08"), ("short",)),
)
#: Kind, walker, slope [rad] beside it, and the label of a gait there.
SPECIAL = (
    *(
        ("flip", w, s, "long")
        for w, s in zip(
            "ABCDF", ("0.0643", "0.000491", "0.0769", "0.0151", "0.00679"), strict=True
        )
    ),
    *(("flip", COMPASS, "0.0766", "long"), ("flip", "physical", "0.1988", "long")),
    *(("flip", "physical", s, "other1") for s in ("0.0202", "0.01913")),
    *(
        ("fold", "physical", s, g)
        for s, g in (("0.0192", "long"), ("0.0530", "short"), ("0.1638", "short"))
    ),
    ("fold", "physical-straight", "0.0154", "long"),
)
#: Relative radius of a gait's box, and half the interval around a flip's slope or a
#: fold's angle [rad].
ACCURACY, HALF = "1e-28", 1e-22
#: Digits of states and decimals of multipliers: of so much larger units than the
#: intervals that where these lie, which differs from machine to machine, decides no
#: digit.
DIGITS = {"gait": (20, 9), "flip": (14, 8), "fold": (14, 8)}
SLOPE_DIGITS = 16
STATE = (
    "stance_angle",
    "stance_rate",
    "thigh_rate",
    "shank_rate",
    "kneestrike_time",
    "period",
)
UNITS = {
    name: "time" if "time" in name or name == "period" else "rad"
    for name in ("slope", *STATE)
}
UNITS |= {name: "rad/time" for name in STATE if name.endswith("_rate")}
MULTIPLIERS = [
    f"multiplier_{count}{part}" for count in (1, 2, 3) for part in ("", "_imaginary")
]
KEYS = (*(key for key in NUMBERS if key not in OF_DRIVE), "knees")
_EXACT = Context(prec=400, rounding=ROUND_HALF_EVEN)
ABOUT = tomllib.loads(Path(__file__).with_suffix(".toml").read_text(encoding="utf-8"))


def asked():
    """What is proved: of every entry its name, the question, and the parameters."""
    for walker, slopes, labels in GAITS:
        for slope in slopes:
            for label in labels:
                gait = {
                    "walker": walker,
                    "slope": slope,
                    "gait": label,
                    "accuracy": float(ACCURACY),
                }
                yield f"{walker}-{label}-{slope}", "prove", gait
    for kind, walker, slope, label in SPECIAL:
        special = {
            "kind": kind,
            "walker": walker,
            "slope": slope,
            "gait": label,
            "half": HALF,
        }
        yield f"{walker}-{kind}-{slope}", "enclose_special", special


def rounded(middle, radius, place):
    """The decimal to which all of an interval rounds, its last digit at a power of ten
    or as little above as may be.
    """
    if not float(radius):
        return middle, "0"
    low, high = (
        _EXACT.subtract(Decimal(middle), Decimal(radius)),
        _EXACT.add(Decimal(middle), Decimal(radius)),
    )
    while (found := _EXACT.quantize(low, Decimal(1).scaleb(place))) != _EXACT.quantize(
        high, found
    ):
        place += 1
    return f"{_EXACT.plus(found):f}", f"5e{place - 1}"  # no zero with a sign


def digits(middle, radius, number):
    """The decimal of so many digits to which all of an interval rounds."""
    return rounded(middle, radius, Decimal(middle).adjusted() - number + 1)


def enter(name, question, params):
    """Prove an entry, and write it in the digits that are proved; with it the keys of
    its walker.
    """
    walker = params["walker"]
    table = (
        files.walker(f"{walker}.toml", Path(), number=str)
        if walker == COMPASS
        else walker
    )
    found = ask(question, {**params, "walker": table})
    if question == "prove":
        (found,) = found["gaits"]
        if not found["proved"] or found["stable"] is None:
            raise ValueError(f"{name} is not proved: {found['reason']}")
    kind = found.get("kind", "gait")
    number, decimals = DIGITS[kind]
    slope = (
        (params["slope"], "0")
        if kind == "gait"
        else digits(*found["slope"], SLOPE_DIGITS)
    )
    values = {
        "slope": slope,
        **{
            key: digits(*found["box"][key], number)
            for key in STATE
            if key in found["box"]
        },
    }
    values |= dict(
        zip(MULTIPLIERS, _multipliers(found["multipliers"], -decimals), strict=False)
    )
    asked = f"--slope {params['slope']} --gait {params['gait']} --accuracy {ACCURACY}"
    proved = (
        f"gaitsweep prove --walker {walker + '.toml' * (walker == COMPASS)} {asked}"
    )
    entry = {
        "name": name,
        "kind": kind,
        "walker": walker,
        "gait": found["gait"],
        "stable": found.get("stable"),
    }
    entry |= {
        "events": found["events"],
        **{key: value for key, (value, _) in values.items()},
    }
    entry["radius"] = {
        key: radius for key, (_, radius) in values.items() if radius != "0"
    }
    return {**entry, "made_by": proved if kind == "gait" else "make reference"}, _keys(
        found["walker"]
    )


def _multipliers(balls, place):
    """Real and imaginary parts of the multipliers, the largest first."""
    pairs = [[rounded(*part, place) for part in ball] for ball in balls]
    upper = [
        pair for pair in pairs if float(pair[1][0]) >= 0
    ]  # of a conjugate pair it stands for both
    for real, (text, radius) in sorted(
        upper, key=lambda pair: -abs(complex(*(float(text) for text, _ in pair)))
    ):
        yield from (real, (text, radius))
        if float(text):
            yield from (real, (f"-{text}", radius))


def _keys(table):
    """A walker's keys in decimals."""
    balls = {
        key: table[key].strip("[]").split(" +/- ")
        for key in KEYS
        if table[key].startswith("[")
    }
    return {
        key: digits(*balls[key], 38)[0] if key in balls else table[key] for key in KEYS
    }


def make(only=None, jobs=2):
    """Everything the file holds, or the entries named only."""
    wanted = [each for each in asked() if only is None or each[0] in only]
    found = Parallel(n_jobs=jobs, batch_size=1)(
        delayed(enter)(*each) for each in wanted
    )
    walkers = {entry["walker"]: keys for entry, keys in found}
    return {
        "about": ABOUT,
        "walkers": walkers,
        "entries": [entry for entry, _ in found],
    }


def table(reference):
    """The entries as CSV, the keys of their walkers with them, units in the head."""
    head = ("name", "kind", "walker", "gait", "stable", "events", *UNITS, *MULTIPLIERS)
    heads = [
        f"{key} [{UNITS[key]}]" if key in UNITS else key
        for key in (*head, *KEYS, "made_by")
    ]
    text = io.StringIO()
    rows = csv.writer(text, lineterminator="\n")
    rows.writerow(heads)
    for entry in reference["entries"]:
        cells = (entry.get(key) for key in head)
        cells = [
            " ".join(c)
            if isinstance(c, list)
            else str(c).lower()
            if isinstance(c, bool)
            else c
            for c in cells
        ]
        rows.writerow(
            [*cells, *reference["walkers"][entry["walker"]].values(), entry["made_by"]]
        )
    return text.getvalue()


if __name__ == "__main__":
    reference, folder = make(), Path(sys.argv[1])
    (folder / "gaits.json").write_text(
        json.dumps(reference, indent=1) + "\n", encoding="utf-8"
    )
    (folder / "gaits.csv").write_text(table(reference), encoding="utf-8")
