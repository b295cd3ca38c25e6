"""Figure 10 of the paper as a picture: the exponents of each walker's gaits beside the laws that it prints."""

from __future__ import annotations

import pandas as pd
from matplotlib.lines import Line2D

from pipeline.report.figures.style import INK, MUTED, PAPER, canvas, colour, plain, set_heading
from pipeline.report.figures.svg import Marks, Sketch
from pipeline.report.source import Source

#: Marker of each range of slopes, and the exponents that section 6.2 allows.
_RANGES = {"vanishing": "o", "small": "s", "larger": "^"}
_LAWS = {"angle": {1 / 3: "1/3", 1.0: "1"}, "power": {2.0: "2", 4.0: "4"}}
#: Further ticks, at which the other exponents are read.
_TICKS = {"angle": (0.5, 0.6, 0.7, 0.8, 0.9), "power": (2.5, 3.0, 3.5, 4.5)}


def exponents(source: Source) -> Sketch | None:
    """Plot the exponents of stance angle in slope and of power in speed, a row for each gait of each walker."""
    table = source.tables.get("figure10")
    needed = {f"{gait}_{of}_{when}" for gait in ("short", "long") for of in _LAWS for when in _RANGES}
    if table is None or not {"walker", *needed} <= set(table.columns):
        return None
    rows = [(str(row["walker"]), gait, row) for _, row in table.iterrows() for gait in ("short", "long")]
    figure = canvas(60 + 24 * len(rows))
    panels = figure.subplots(1, 2, sharey=True)
    marks, data = [], []
    for axes, (of, laws) in zip(panels, _LAWS.items(), strict=True):
        for value in laws:
            axes.axvline(value, color=MUTED, lw=0.9, ls=(0, (1, 2)), zorder=1)
        for k, (walker, gait, row) in enumerate(rows):
            values = [float(row[f"{gait}_{of}_{when}"]) for when in _RANGES]
            for value, (when, marker) in zip(values, _RANGES.items(), strict=True):
                fill = PAPER if when == "small" else colour(gait)
                axes.plot([value], [-k], marker, color=colour(gait), mfc=fill, ms=6)
                name = "θ* ∝ γᵖ" if of == "angle" else "P ∝ vᵖ"
                data.append({"walker": walker, "gait": gait, "law": name, "slopes": when, "exponent": value})
                shown = {f"p of {name}": [value], "slopes": [when]}
                marks.append(Marks(axes, pd.Series([value]), pd.Series([-k]), f"{walker}, {gait} step", shown))
        axes.set_xticks([*laws, *_TICKS[of]], [*laws.values(), *(f"{tick:g}" for tick in _TICKS[of])])
        axes.set_yticks([-k for k in range(len(rows))], [f"{walker} {gait}" for walker, gait, _ in rows])
    set_heading(panels[0], "p of θ* ∝ γᵖ")
    set_heading(panels[1], "p of P ∝ vᵖ")
    keys = [
        Line2D([], [], ls="", marker=m, color=INK, mfc=PAPER if when == "small" else INK, label=f"{when} slopes")
        for when, m in _RANGES.items()
    ]
    figure.legend(handles=keys, loc="outside upper left", ncols=3)
    frame = pd.DataFrame(data)
    return Sketch(
        figure,
        "Scaling laws of the tuned walkers",
        f"Local exponents of both gaits at vanishing, small and larger slopes{_slopes(source)}; dotted, the only "
        "powers that the energy balance allows (section 6.2). The table compares them with each cell that the paper "
        "prints.",
        f"Exponents of the stance angle in slope and of power in speed for {len(rows)} gaits.",
        frame,
        marks,
    )


def _slopes(source: Source) -> str:
    """The slopes of the three ranges, of a study that has those alone."""
    slopes: list[float] = source.grid["slope"].values.tolist() if "slope" in source.grid.coords else []
    return f" ({', '.join(plain(v) for v in slopes)} rad)" if len(slopes) == len(_RANGES) else ""
