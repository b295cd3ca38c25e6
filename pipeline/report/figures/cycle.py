"""A gait in motion: joint angles over two steps with a cartoon (figure 3), and the steps that the page animates."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes

from pipeline.report.figures.body import Body, draw_leg
from pipeline.report.figures.style import (
    GAIT_COLOURS,
    INK,
    MUTED,
    canvas,
    colour,
    plain,
    set_heading,
    spread_evenly,
    thin,
)
from pipeline.report.figures.svg import Marks, Sketch
from pipeline.report.source import SYMBOLS, Source

#: Gaits that a page animates, and samples of each step.
MAX_STEPS, MAX_SAMPLES = 12, 90


@dataclass(frozen=True)
class TracedStep:
    """One step of a gait, sampled in time, with the body of its walker."""

    label: str
    gait: str
    slope: float
    command: str
    body: Body
    frame: pd.DataFrame

    @property
    def period(self) -> float:
        """Duration of the step, in the walker's unit of time."""
        return float(self.frame["time"].iloc[-1])


def traced_steps(source: Source) -> Iterator[TracedStep]:
    """Yield the steps in the archive's table `trace`, at most `MAX_STEPS` of them."""
    table = source.tables.get("trace")
    if table is None or not {"gait", "slope", "time", "theta_st", "theta_th"} <= set(table.columns):
        return
    coordinates = source.line_columns(table)
    steps = list(
        table.dropna(subset=["time", "theta_st", "theta_th"]).groupby([*coordinates, "gait", "slope"], sort=False)
    )
    for i in spread_evenly(len(steps), MAX_STEPS) if steps else ():
        key, frame = steps[i]
        at = dict(zip(coordinates, key, strict=False))
        gait, slope = str(key[-2]), float(key[-1])
        walker = str(at.pop("walker", source.walker))
        settings = {k: float(v) for k, v in at.items()}
        body = Body.of(source.parameters(walker, settings))
        frame = frame.sort_values("time", kind="stable").reset_index(drop=True)
        if body is None or len(frame) < 2:
            continue
        shank = frame.get("theta_sh", frame["theta_th"])
        frame = frame.assign(time=frame["time"] - frame["time"].iloc[0], theta_sh=shank.fillna(frame["theta_th"]))
        label = ", ".join([walker, *(f"{SYMBOLS.get(k, k)} = {v:g}" for k, v in settings.items())])
        yield TracedStep(label, gait, slope, source.command(walker, settings), body, frame)


def angles(source: Source) -> Sketch | None:
    """Plot joint angles over two steps, with a cartoon of the walker at even times below."""
    step = _middle(list(traced_steps(source)))
    if step is None:
        return None
    figure = canvas(300)
    top, below = figure.subplots(2, 1, height_ratios=[5, 2], sharex=False)
    frame, period = step.frame, step.period
    time = frame["time"].to_numpy()
    first = {"thigh": frame["theta_st"].to_numpy(), "shank": frame["theta_st"].to_numpy()}
    second = {"thigh": frame["theta_th"].to_numpy(), "shank": frame["theta_sh"].to_numpy()}
    pieces, marks = [], []
    kneed = not np.allclose(second["thigh"], second["shank"])
    for leg, (early, late) in {"heavy": (first, second), "light": (second, first)}.items():
        for part in ("thigh", "shank") if kneed else ("thigh",):
            t, angle = np.concatenate([time, period + time]), np.concatenate([early[part], late[part]])
            width, ink = (2.2, colour(step.gait)) if leg == "heavy" else (0.9, MUTED)
            top.plot(t, angle, color=ink, lw=width, ls="-" if part == "thigh" else (0, (4, 1.4)))
            pieces.append(pd.DataFrame({"time": t, "angle": angle, "leg": leg, "link": part if kneed else "leg"}))
            if leg == "heavy":
                label, values = f"{part if kneed else 'leg'}, heavy line", {"time": t, "angle (rad)": angle}
                marks.append(Marks(top, t, angle, label, values, step.command, np.full(len(t), step.slope)))
    top.axvline(period, color=MUTED, lw=0.7, ls=(0, (1, 2)))
    top.text(1.01 * period, 0.99, "heelstrike", transform=top.get_xaxis_transform(), va="top", fontsize=8.5)
    top.set_xlim(0, 2 * period)
    set_heading(top, "angle from the ground normal (rad)")
    unit = source.units("period")
    top.set_xlabel(f"time ({unit})" if unit else "time")
    _draw_strobe(below, step)
    data = pd.concat(pieces, ignore_index=True).assign(gait=step.gait, slope=step.slope)
    caption = (
        f"Two steps of the {step.gait} gait of walker {step.label} at γ = {plain(step.slope)} rad. The heavy line is "
        "the leg drawn heavy in the cartoon, first in stance, then in swing." + (" Dashed: the shank." if kneed else "")
    )
    alt = (
        f"Joint angles of walker {step.label} over two steps lasting {plain(period)} each, "
        f"between {plain(data['angle'].min(), 3)} and {plain(data['angle'].max(), 3)} rad; the walker is drawn below."
    )
    return Sketch(figure, "A walking cycle", caption, alt, data, marks)


def _middle(steps: list[TracedStep]) -> TracedStep | None:
    """The long step in the middle of the list, or the step there if none is long."""
    long = [step for step in steps if step.gait == "long"] or steps
    return long[(len(long) - 1) // 2] if long else None


def _draw_strobe(axes: Axes, step: TracedStep, moments: int = 6) -> None:
    """Draw the walker at even times of two steps, each below its time in the graph."""
    body, frame, period = step.body, step.frame, step.period
    height = body.length + body.radius
    apart = 0.62 * height
    axes.plot([-0.5 * apart, (2 * moments - 0.5) * apart], [0, 0], color=MUTED, lw=0.8)
    for number in (0, 1):
        for k in range(moments):
            t = period * (k + 0.5) / moments
            st, th, sh = (float(np.interp(t, frame["time"], frame[c])) for c in ("theta_st", "theta_th", "theta_sh"))
            hip = complex(body.hip(st))
            hip += (number * moments + k) * apart - hip.real
            heavy = {"color": colour(step.gait), "lw": 2.0, "zorder": 4}
            light = {"color": INK, "lw": 0.8, "zorder": 3}
            draw_leg(axes, body, hip, st, st, **(heavy if number == 0 else light))
            draw_leg(axes, body, hip, th, sh, **(light if number == 0 else heavy))
            axes.plot(hip.real, hip.imag, "o", color=INK, ms=2.6, zorder=5)
    axes.set_xlim(-0.5 * apart, (2 * moments - 0.5) * apart)
    axes.set_ylim(-0.06 * height, 1.08 * height)
    axes.set_aspect("equal")
    axes.axis("off")


def animation(source: Source) -> list[dict[str, Any]]:
    """Data with which the page's script animates each gait: numbers rounded to what can be seen."""
    moves = []
    for step in traced_steps(source):
        frame, body = thin(step.frame, MAX_SAMPLES), step.body
        time = frame["time"].to_numpy()
        moves.append(
            {
                "label": f"{step.label} · {step.gait} step · γ = {plain(step.slope)}",
                "gait": step.gait if step.gait in GAIT_COLOURS else "long",
                "slope": step.slope,
                "command": f"{step.command} --slope {step.slope!r}",
                "body": [
                    round(v, 6) for v in (body.thigh, body.shank, body.radius, body.eps_T, body.eps_S, body.length)
                ],
                "step": round(body.step(float(frame["theta_st"].iloc[0])), 6),
                "time": _rounded(time),
                "angles": [_rounded(frame[c]) for c in ("theta_st", "theta_th", "theta_sh")],
                "rates": [_rounded(_rate(time, frame[c].to_numpy())) for c in ("theta_st", "theta_th", "theta_sh")],
            }
        )
    return moves


def _rate(time: np.ndarray, angle: np.ndarray) -> np.ndarray:
    """Rate of change of an angle, whose samples may share a time at an impact."""
    keep = np.concatenate([[True], np.diff(time) > 0])
    return np.interp(time, time[keep], np.gradient(angle[keep], time[keep])) if keep.sum() > 2 else np.zeros_like(angle)


def _rounded(values: Any) -> list[float]:
    return [round(float(v), 5) for v in values]
