"""`gaitsweep film`: a gait, or what a push makes of it, as a film of a few steps or as a strip of poses for print."""

import argparse
import io
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from gaitsweep.pipeline import paths, terminal
from gaitsweep.pipeline.api.steps import simulate
from gaitsweep.pipeline.dispatch import ask
from gaitsweep.pipeline.errors import StudyError, unwritten
from gaitsweep.pipeline.study import files
from gaitsweep.pipeline.study.single_point import led, state_of

#: Formats of films and of strips, by the ending of the file.
_FILMS, _STRIPS = {".webp": "WEBP", ".png": "PNG", ".gif": "GIF"}, (".svg", ".pdf", ".png")
#: Size of a picture [inch], of which there are 100 dots to one; frames a second; poses of a strip a step, most frames.
_SIZE, _RATE, _POSES, _MAX_FRAMES = (6.4, 3.2), 25, 5, 1000
#: Time for which the last frame of a film stands [s].
_REST = 1.0


class Pose(NamedTuple):
    """The walker at one moment: hip and stance foot along the slope, angles of its links, number of the step."""

    hip: complex
    foot: float
    stance: float
    thigh: float
    shank: float
    step: int


def run(options: argparse.Namespace) -> int:
    """Write the film or the strip, and print its path."""
    endings = _STRIPS if options.strip else _FILMS
    if options.out.suffix.lower() not in endings:
        raise StudyError(f"The file must end in {', '.join(endings)}; got {options.out.name!a}.")
    for name, low, high in (("steps", 1, 50), ("push", -10, 10), ("slow", 0.1, 100)):
        if not low <= getattr(options, name) <= high:  # nan
            raise StudyError(f"`--{name}` must lie in [{low}, {high}]; got {getattr(options, name)}.")
    walker, keys = led(files.walker(options.walker, Path()), options.set)
    state = state_of(walker, options.slope, keys, options.gait)
    push = {0: [options.push * state[1]] * 2} if options.push else None
    motion = simulate(walker, options.slope, state, options.steps, motion=True, pushes=push, **keys)
    known = ask("check_walker", {"walker": walker, "set": keys})
    from gaitsweep.pipeline.report.figures.body import Body

    body = Body.of(known["parameters"])
    assert body is not None  # the walker was checked
    poses = _poses(motion, body, _moments(motion, options, 1.0 if known["si"] else math.sqrt(1 / 9.81)))
    words = f"{options.walker}, {options.gait} step, γ = {options.slope:g} rad"
    end = str(motion["reason"].item()) if int(motion["steps_taken"]) < options.steps else ""
    try:
        if options.strip:
            paths.publish(options.out, _strip(body, poses, options.slope, options.out.suffix[1:].lower()))
        else:
            pictures = _pictures(body, poses, options.slope, words, end)
            paths.publish(options.out, _film(pictures, len(poses), _FILMS[options.out.suffix.lower()]))
    except OSError as error:
        raise unwritten(options.out, error) from error
    print(options.out)
    if end:
        terminal.say(f"gaitsweep: {end}")
    return 0


def _moments(motion: xr.Dataset, options: argparse.Namespace, second: float) -> np.ndarray:
    """Times of the frames, or of the poses of a strip, from the first to the last moment of a motion."""
    lengths = _lengths(motion)
    if options.strip:
        return np.linspace(0, lengths.sum(), _POSES * len(lengths) + 1)
    count = max(2, round(float(lengths.sum()) * second * options.slow * _RATE) + 1)
    if count > _MAX_FRAMES:
        raise StudyError(
            f"The film would have {count:,} frames, more than {_MAX_FRAMES:,}: show fewer steps, or faster."
        )
    return np.linspace(0, lengths.sum(), count)


def _lengths(motion: xr.Dataset) -> np.ndarray:
    """Duration of each step that was begun, the last of which may end in a fall."""
    ends = motion["time"].max(("phase", "sample")).values
    return ends[np.isfinite(ends)]


def _poses(motion: xr.Dataset, body: Any, moments: np.ndarray) -> list[Pose]:
    """The walker at some moments; the foot of each step stands where the hip of the last step leads to."""
    begins, foot, steps = np.concatenate([[0], np.cumsum(_lengths(motion))]), 0.0, []
    for k in range(len(begins) - 1):
        arrays = [motion[name].values[k].ravel() for name in ("time", "theta_st", "theta_th", "theta_sh")]
        known = np.isfinite(arrays[0])
        time, stance, thigh, shank = (array[known] for array in arrays)
        shank = np.where(np.isfinite(shank), shank, thigh)
        steps.append((foot, time, stance, thigh, shank))
        foot += body.hip(stance[-1]).real - body.hip(-stance[-1]).real
    poses = []
    for moment in moments:
        k = int(min(np.searchsorted(begins, moment, side="right") - 1, len(steps) - 1))
        foot, time, *angles = steps[k]
        stance, thigh, shank = (float(np.interp(moment - begins[k], time, angle)) for angle in angles)
        poses.append(Pose(foot + complex(body.hip(stance)), foot, stance, thigh, shank, k))
        if poses[-1].hip.imag <= 0:  # what falls lies on the ground
            break
    return poses


def _draw(axes: Any, body: Any, pose: Pose, slope: float, camera: float = 0.0, scale: float = 1.0) -> None:
    """Draw a pose on the slope, which falls to the right; the leg that stands first is heavy."""
    from gaitsweep.pipeline.report.figures.body import draw_leg
    from gaitsweep.pipeline.report.figures.style import INK, LINE

    turn = np.exp(-1j * slope)
    hip = (pose.hip - camera) * turn
    inks = [{"color": ink, "lw": width * scale} for ink, width in ((LINE, 3.0), (INK, 1.6))]
    stance, swing = inks if pose.step % 2 == 0 else inks[::-1]
    draw_leg(axes, body, hip, pose.stance - slope, pose.stance - slope, **stance)
    draw_leg(axes, body, hip, pose.thigh - slope, pose.shank - slope, **swing)
    axes.plot(hip.real, hip.imag, "o", color=INK, ms=5 * scale, zorder=5)


def _stage(figure: Any, body: Any, left: float, right: float, slope: float) -> Any:
    """Empty axes with the ground from one place to another, to scale."""
    from gaitsweep.pipeline.report.figures.style import MUTED

    tall = body.length + body.radius
    axes = figure.add_axes((0, 0, 1, 1))
    ground = np.array([left - tall, right + tall]) * np.exp(-1j * slope)
    axes.plot(ground.real, ground.imag, color=MUTED, lw=1, zorder=1)
    axes.set_xlim(left, right)
    axes.set_aspect("equal")
    axes.axis("off")
    return axes


def _pictures(body: Any, poses: list[Pose], slope: float, words: str, end: str) -> Iterator[Any]:
    """Yield the frames of a film, seen by a camera that moves with the hip."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from PIL import Image

    from gaitsweep.pipeline.report.figures.style import MUTED, style

    tall = body.length + body.radius
    with style():
        for k, pose in enumerate(poses):
            figure = Figure(figsize=_SIZE, dpi=100, facecolor="white")
            canvas = FigureCanvasAgg(figure)
            axes = _stage(figure, body, -1.4 * tall, 1.4 * tall, slope)
            axes.set_ylim(-0.2 * tall, 1.2 * tall)
            _draw(axes, body, pose, slope, pose.hip.real)
            text = end if end and k == len(poses) - 1 else words
            figure.text(0.02, 0.93, text, color=MUTED, parse_math=False)
            canvas.draw()
            yield Image.fromarray(np.asarray(canvas.buffer_rgba())[..., :3].copy())


def _film(pictures: Iterator[Any], count: int, kind: str) -> bytes:
    """Pictures as one animation, which is repeated without end."""
    (first, *others), stream = pictures, io.BytesIO()
    pause = [round(1000 / _RATE)] * (count - 1) + [round(1000 * _REST)]
    more: dict[str, Any] = {"quality": 90} if kind == "WEBP" else {}
    first.save(stream, kind, save_all=True, append_images=others, duration=pause, loop=0, **more)
    return stream.getvalue()


def _strip(body: Any, poses: list[Pose], slope: float, kind: str) -> bytes:
    """Poses one after the other on one slope, as a picture for print."""
    from matplotlib import rc_context
    from matplotlib.figure import Figure

    from gaitsweep.pipeline.report.figures.style import style

    tall, stream = body.length + body.radius, io.BytesIO()
    left, right = poses[0].hip.real - 0.6 * tall, poses[-1].hip.real + 0.6 * tall
    low = -right * math.sin(slope) - 0.1 * tall
    with style(), rc_context({"svg.hashsalt": "strip"}):
        width = 7.0
        figure = Figure(figsize=(width, width * (1.15 * tall - low) / (right - left)), facecolor="white")
        axes = _stage(figure, body, left, right, slope)
        axes.set_ylim(low, 1.15 * tall)
        for pose in poses:
            _draw(axes, body, pose, slope, scale=0.45)
        undated = {"svg": {"Date": None}, "pdf": {"CreationDate": None}}.get(kind)
        figure.savefig(stream, format=kind, dpi=300, metadata=undated)
    return stream.getvalue()
