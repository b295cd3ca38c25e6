"""Figure 10 of the paper as a picture: the exponents of each walker's gaits beside the laws that it prints."""

import pandas as pd

from gaitsweep.pipeline.report.figures.sketch import Sketch
from gaitsweep.pipeline.report.figures.style import DOTTED, INK, MUTED, PAPER, colour, set_heading
from gaitsweep.pipeline.report.source import Source
from gaitsweep.pipeline.report.words import plain

#: Marker of each range of slopes, and the exponents that section 6.2 allows.
_RANGES = {"vanishing": "o", "small": "s", "larger": "^"}
_LAWS = {"angle": {1 / 3: "1/3", 1.0: "1"}, "power": {2.0: "2", 4.0: "4"}}
#: Further ticks, at which the other exponents are read.
_TICKS = {"angle": (0.5, 0.6, 0.7, 0.8, 0.9), "power": (2.5, 3.0, 3.5, 4.5)}


def exponents(source: Source) -> Sketch | None:
    """Plot the exponents of stance angle in slope and of power in speed, a row for each gait of each walker."""
    needed = [f"{gait}_{of}_{when}" for gait in ("short", "long") for of in _LAWS for when in _RANGES]
    table = source.table("figure10", "walker", *needed)
    if table is None:
        return None
    rows = [(str(row["walker"]), gait, row) for _, row in table.iterrows() for gait in ("short", "long")]
    sketch = Sketch(60 + 24 * len(rows), 1, 2, sharey=True)
    data = []
    walkers = list(dict.fromkeys(walker for walker, _, _ in rows))
    for axes, (of, laws) in zip(sketch.panels, _LAWS.items(), strict=True):
        name = "θ* ∝ γᵖ" if of == "angle" else "P ∝ vᵖ"
        set_heading(axes, f"p of {name}")
        for value in laws:
            axes.axvline(value, color=MUTED, lw=0.9, ls=DOTTED, zorder=1)
        for k, (walker, gait, row) in enumerate(rows):
            for when, marker in _RANGES.items():
                value, ink = float(row[f"{gait}_{of}_{when}"]), colour(walkers.index(walker))
                axes.plot([value], [-k], marker, color=ink, mfc=PAPER if when == "small" else ink, ms=6)
                data.append({"walker": walker, "gait": gait, "law": name, "slopes": when, "exponent": value})
                shown = {f"p of {name}": [value], "slopes": [when]}
                sketch.mark(axes, [value], [-k], f"{walker}, {gait} step", shown)
        axes.set_xticks([*laws, *_TICKS[of]], [*laws.values(), *(f"{tick:g}" for tick in _TICKS[of])])
        axes.set_yticks([-k for k in range(len(rows))], [f"{walker} {gait}" for walker, gait, _ in rows])
    for when, marker in _RANGES.items():
        sketch.dot_key(f"{when} slopes", marker=marker, mfc=PAPER if when == "small" else INK)
    return sketch.finish(pd.DataFrame(data), count=len(rows), slopes=_slopes(source))


def _slopes(source: Source) -> str:
    """The slopes of the three ranges, of a study that has those alone."""
    slopes: list[float] = source.grid["slope"].values.tolist() if "slope" in source.grid.coords else []
    return f" ({', '.join(plain(v) for v in slopes)} rad)" if len(slopes) == len(_RANGES) else ""
