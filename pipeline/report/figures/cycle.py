"""A walking cycle: joint angles over two steps with a cartoon (the paper's figure 3)."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from matplotlib.axes import Axes

from gaitsweep.pipeline.report.figures.body import Body, draw_pose
from gaitsweep.pipeline.report.figures.sketch import Sketch
from gaitsweep.pipeline.report.figures.style import (
    DOTTED,
    INK,
    LINE,
    MUTED,
    WALKERS,
    evenly,
    set_heading,
    write_at,
)
from gaitsweep.pipeline.report.source import Source
from gaitsweep.pipeline.report.words import axis_values, plain, shorten, with_unit

#: Steps of the archive that are read, evenly spread, and poses drawn of one.
_MAX_STEPS, _POSES = 12, 4


@dataclass(frozen=True)
class TracedStep:
    """One step of a gait, sampled in time, with the body of its walker and its colour."""

    label: str
    ink: str
    gait: str
    slope: float
    command: str
    body: Body
    frame: pd.DataFrame

    @property
    def period(self) -> float:
        """Duration of the step, in the walker's unit of time."""
        return float(self.frame["time"].iloc[-1])

    @property
    def kneestrike(self) -> float | None:
        """Time at which the swing knee locks; None for legs that do not bend."""
        bent = np.flatnonzero(
            np.abs(self.frame["theta_th"] - self.frame["theta_sh"]).to_numpy() > 1e-9
        )
        return (
            float(self.frame["time"].iloc[min(bent[-1] + 1, len(self.frame) - 1)])
            if len(bent)
            else None
        )


def traced_steps(source: Source) -> Iterator[TracedStep]:
    """Yield the steps in the archive's table `trace`, at most `_MAX_STEPS` of them."""
    table = source.table("trace", "gait", "slope", "time", "theta_st", "theta_th")
    if table is None:
        return

    known = table.dropna(subset=["time", "theta_st", "theta_th"])
    steps = [
        rows
        for _, rows in known.groupby(
            [*source.line_columns(table), "gait", "slope"], sort=False
        )
    ]
    for frame in evenly(steps, _MAX_STEPS):
        gait, slope = str(frame["gait"].iloc[0]), float(frame["slope"].iloc[0])
        at = source.line_of(frame)
        body = Body.of(source.parameters(at))
        frame = frame.sort_values("time", kind="stable").reset_index(drop=True)
        if body is None or len(frame) < 2:
            continue

        shank = frame.get("theta_sh", frame["theta_th"])
        frame = frame.assign(
            time=frame["time"] - frame["time"].iloc[0],
            theta_sh=shank.fillna(frame["theta_th"]),
        )
        label, ink = axis_values(at), WALKERS.get(str(at.get("walker")), LINE)
        yield TracedStep(label, ink, gait, slope, source.command(at), body, frame)


def angles(source: Source) -> Sketch | None:
    """Plot joint angles over two steps, with a cartoon of the walker at even times
    below; one column per walker.
    """
    steps = _one_per_walker(list(traced_steps(source)))
    if not steps:
        return None

    several = len(steps) > 1
    sketch = Sketch(
        "angles",
        270 * len(steps) if several else 310,
        2 * len(steps),
        height_ratios=[5, 2] * len(steps),
    )
    for top, below, step in zip(
        sketch.panels[::2], sketch.panels[1::2], steps, strict=True
    ):
        _draw_angles(sketch, top, step)
        set_heading(
            top,
            f"{shorten(step.label, 24)}: " * several
            + "angle from the ground normal (rad)",
        )
        top.set_xlabel(with_unit("time", source.units("period")))
        _draw_strobe(below, step)

    listing = "; ".join(
        f"the {s.gait} gait of walker {s.label} at γ = {plain(s.slope)} rad"
        for s in steps
    )
    kneed = any(step.kneestrike for step in steps)
    drawn = sketch.data["angle"]
    return sketch.finish(gaits=listing, kneed=kneed, low=drawn.min(), high=drawn.max())


def _draw_angles(sketch: Sketch, axes: Axes, step: TracedStep) -> None:
    """Draw the angles of both legs over two steps, with the impacts."""
    drawn = []
    for link in _links(step):
        _draw_link(sketch, axes, step, link)
        drawn.append(link.data)

    data = pd.concat(drawn, ignore_index=True)
    data = data.assign(walker=step.label, gait=step.gait, slope=step.slope)
    sketch.pieces.append(data)

    _draw_impact(axes, step, data, "heelstrike", step.period)
    if step.kneestrike is not None:
        for begin in (0.0, step.period):
            _draw_impact(axes, step, data, "kneestrike", begin + step.kneestrike)

    axes.set_xlim(0, 2 * step.period)


class _Link(NamedTuple):
    """A link of a leg over two steps: how both are called, and `time`, `angle`, `leg` and
    `link` of its points.
    """

    leg: str
    link: str
    data: pd.DataFrame


def _links(step: TracedStep) -> Iterator[_Link]:
    """The links of the leg drawn heavy, first the stance leg, then the swing leg, and
    those of the other.
    """
    frame, period = step.frame, step.period
    time = frame["time"].to_numpy()
    stance = frame["theta_st"].to_numpy()
    swings = {"leg": "theta_th"}
    if step.kneestrike is not None:
        swings = {"thigh": "theta_th", "shank": "theta_sh"}
    for leg in ("heavy", "light"):
        for link, column in swings.items():
            angles = [stance, frame[column].to_numpy()]
            if leg == "light":
                angles.reverse()
            data = {
                "time": np.concatenate([time, period + time]),
                "angle": np.concatenate(angles),
                "leg": leg,
                "link": link,
            }
            yield _Link(leg, link, pd.DataFrame(data))


def _draw_link(sketch: Sketch, axes: Axes, step: TracedStep, link: _Link) -> None:
    """Draw the angle of a link, with marks on the heavy leg."""
    is_heavy = link.leg == "heavy"
    width, ink = (2.2, step.ink) if is_heavy else (0.9, MUTED)
    dashes: Any = (0, (4, 1.4)) if link.link == "shank" else "-"
    time, angle = link.data["time"], link.data["angle"]
    axes.plot(time, angle, color=ink, lw=width, ls=dashes)
    if not is_heavy:
        return

    rows = link.data[["time", "angle"]].assign(slope=step.slope)
    sketch.mark(
        axes,
        rows,
        f"{link.link}, heavy line",
        command=step.command,
        tips={"time": "time", "angle": "angle (rad)"},
        x="time",
        y="angle",
    )


def _draw_impact(
    axes: Axes, step: TracedStep, data: pd.DataFrame, word: str, at: float
) -> None:
    """Draw an impact at a time, with its name where there is room."""
    low, high = axes.get_ylim()
    is_near = (data["time"] - at).abs() < 0.05 * step.period
    near = data.loc[is_near, "angle"]
    is_below = near.min() - low >= high - near.max()

    dashes = "-" if word == "heelstrike" else DOTTED
    axes.axvline(at, color=MUTED, lw=0.8, ls=dashes)
    place, beside = (at, 0.99), (2, 0)
    how: Any = {"ha": "left", "va": "top"}
    if is_below:
        place, beside = (at, 0.01), (-2, 0)
        how = {"ha": "right", "va": "bottom"}

    how |= {"xycoords": axes.get_xaxis_transform(), "rotation": 90, "fontsize": 8}
    write_at(axes, word, place, beside, **how)


def _one_per_walker(steps: list[TracedStep]) -> list[TracedStep]:
    """The long step, or else the first, in the middle of each walker's list; at most
    two walkers.
    """
    walkers: dict[str, list[TracedStep]] = {}
    for step in steps:
        walkers.setdefault(step.label, []).append(step)
    chosen = [
        long if (long := [s for s in own if s.gait == "long"]) else own
        for own in walkers.values()
    ]
    middle = [own[(len(own) - 1) // 2] for own in chosen]
    return middle if len(middle) <= 2 else [middle[(len(middle) - 1) // 2]]


def _draw_strobe(axes: Axes, step: TracedStep) -> None:
    """Draw the walker at even times of two steps, each below its time in the graph."""
    body, frame, period = step.body, step.frame, step.period
    height = body.height
    apart = 1.15 * height
    edges = -0.7 * apart, (2 * _POSES - 0.3) * apart
    axes.plot(edges, [0, 0], color=MUTED, lw=0.8)
    legs = (
        {"color": step.ink, "lw": 2.0, "zorder": 4},
        {"color": INK, "lw": 0.8, "zorder": 3},
    )
    for number in (0, 1):
        for k in range(_POSES):
            t = period * (k + 0.5) / _POSES
            angles = [
                float(np.interp(t, frame["time"], frame[c]))
                for c in ("theta_st", "theta_th", "theta_sh")
            ]
            hip = complex(
                (number * _POSES + k) * apart, complex(body.hip(angles[0])).imag
            )
            draw_pose(
                axes, body, hip, angles, *(legs if number == 0 else legs[::-1]), 2.6
            )

    axes.set_xlim(*edges)
    axes.set_ylim(-0.06 * height, 1.08 * height)
    axes.set_aspect("equal")
    axes.axis("off")
