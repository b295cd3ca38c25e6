"""A motion as a film, or as a strip of poses for print."""

import io
import math
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
import xarray as xr
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from PIL import ExifTags, Image
from PIL.PngImagePlugin import PngInfo

from gaitsweep.pipeline.report.figures.body import Body, draw_pose
from gaitsweep.pipeline.report.figures.style import INK, LINE, MUTED, style

#: What films and strips say of the program that made them.
MARK = "gaitsweep film"
#: The same as metadata of strips, by the ending of the file, which have no date.
_ABOUT_STRIPS: dict[str, dict[str, str | None]] = {
    ".svg": {"Creator": MARK, "Date": None},
    ".pdf": {"Creator": MARK, "CreationDate": None},
    ".png": {"Software": MARK},
}
#: Time for which the last frame of a film stands [s].
_REST = 1.0
#: Size of a frame, and width of a strip [inch].
_SIZE, _WIDTH = (6.4, 3.2), 7.0


class Pose(NamedTuple):
    """The walker at one moment: hip and stance foot along the slope, angles of its
    links, number of the step.
    """

    hip: complex
    foot: float
    stance: float
    thigh: float
    shank: float
    step: int


def lengths(motion: xr.Dataset) -> np.ndarray:
    """Duration of each step that was begun, the last of which may end in a fall."""
    ends = motion["time"].max(("phase", "sample")).values
    return ends[np.isfinite(ends)]


def poses(motion: xr.Dataset, body: Body, moments: np.ndarray) -> list[Pose]:
    """The walker at some moments; the foot of each step stands where the hip of the
    last step leads to.
    """
    begins = np.concatenate([[0], np.cumsum(lengths(motion))])
    steps = list(_steps(motion, body, len(begins) - 1))
    found = []
    for moment in moments:
        begun = int(np.searchsorted(begins, moment, side="right"))
        k = min(begun - 1, len(steps) - 1)
        pose = steps[k].pose(moment - begins[k], body, k)
        found.append(pose)
        if pose.hip.imag <= 0:  # what falls lies on the ground
            break

    return found


class _Step(NamedTuple):
    """A step: where its foot stands, and the angles of stance leg, thigh and shank,
    (n,) each, at times since it began.
    """

    foot: float
    time: np.ndarray
    angles: list[np.ndarray]

    def pose(self, time: float, body: Body, number: int) -> Pose:
        """The walker at a time."""
        stance, thigh, shank = (
            float(np.interp(time, self.time, angle)) for angle in self.angles
        )
        hip = self.foot + complex(body.hip(stance))
        return Pose(hip, self.foot, stance, thigh, shank, number)


def _steps(motion: xr.Dataset, body: Body, count: int) -> Iterator[_Step]:
    """The steps of a motion; a leg whose knee is locked has a shank in line."""
    foot = 0.0
    for k in range(count):
        time, stance, thigh, shank = (
            motion[name].values[k].ravel()
            for name in ("time", "theta_st", "theta_th", "theta_sh")
        )
        known = np.isfinite(time)
        shank = np.where(np.isfinite(shank), shank, thigh)
        angles = [angle[known] for angle in (stance, thigh, shank)]
        yield _Step(foot, time[known], angles)
        last = angles[0][-1]
        foot += body.hip(last).real - body.hip(-last).real


def draw(
    axes: Axes,
    body: Body,
    pose: Pose,
    slope: float,
    camera: float = 0.0,
    scale: float = 1.0,
) -> None:
    """Draw a pose on the slope, which falls to the right; the leg that stands first is
    heavy.
    """
    inks: list[dict[str, Any]] = [
        {"color": ink, "lw": width * scale} for ink, width in ((LINE, 3.0), (INK, 1.6))
    ]
    stance, swing = inks if pose.step % 2 == 0 else inks[::-1]
    hip, angles = (
        (pose.hip - camera) * np.exp(-1j * slope),
        (pose.stance, pose.thigh, pose.shank),
    )
    draw_pose(
        axes, body, hip, [angle - slope for angle in angles], stance, swing, 5 * scale
    )


def stage(
    figure: Figure,
    body: Body,
    slope: float,
    across: tuple[float, float],
    upward: tuple[float, float],
) -> Axes:
    """Empty axes over a whole figure, to scale, with the ground from side to side."""
    axes = figure.add_axes((0, 0, 1, 1))
    beyond = body.height * np.array([-1, 1])
    ground = (np.array(across) + beyond) * np.exp(-1j * slope)
    axes.plot(ground.real, ground.imag, color=MUTED, lw=1, zorder=1)
    axes.set(xlim=across, ylim=upward, aspect="equal")
    axes.axis("off")
    return axes


def film(
    body: Body,
    shown: list[Pose],
    slope: float,
    words: str,
    end: str,
    ending: str,
    rate: int,
) -> bytes:
    """Poses as an animation of so many a second, which is repeated without end; `end`
    stands on the last one.
    """
    (first, *others), stream = _frames(body, shown, slope, words, end), io.BytesIO()
    pause = [round(1000 / rate)] * (len(shown) - 1) + [round(1000 * _REST)]
    kind = ending[1:].upper()
    first.save(
        stream,
        kind,
        save_all=True,
        append_images=others,
        duration=pause,
        loop=0,
        **_marked(ending),
    )
    return stream.getvalue()


def _marked(ending: str) -> dict[str, Any]:
    """How a film of a format is saved, with the mark by which it is known."""
    if ending == ".gif":
        return {"comment": MARK.encode()}
    if ending == ".png":
        text = PngInfo()
        text.add_text("Software", MARK)
        return {"pnginfo": text}

    exif = Image.Exif()
    exif[ExifTags.Base.Software] = MARK
    return {"quality": 90, "exif": exif}


def _frames(
    body: Body, shown: list[Pose], slope: float, words: str, end: str
) -> Iterator[Image.Image]:
    """The frames of a film, seen by a camera that moves with the hip."""
    tall = body.height
    with style():
        for k, pose in enumerate(shown):
            figure = Figure(figsize=_SIZE, dpi=100, facecolor="white")
            canvas = FigureCanvasAgg(figure)
            axes = stage(
                figure,
                body,
                slope,
                (-1.4 * tall, 1.4 * tall),
                (-0.2 * tall, 1.2 * tall),
            )
            draw(axes, body, pose, slope, pose.hip.real)
            text = end if end and k == len(shown) - 1 else words
            figure.text(0.02, 0.93, text, color=MUTED, parse_math=False)
            canvas.draw()
            yield Image.fromarray(np.asarray(canvas.buffer_rgba())[..., :3].copy())


def strip(body: Body, shown: list[Pose], slope: float, ending: str) -> bytes:
    """Poses one after the other on one slope, as a picture for print."""
    tall, stream = body.height, io.BytesIO()
    left, right = shown[0].hip.real - 0.6 * tall, shown[-1].hip.real + 0.6 * tall
    low, high = -right * math.sin(slope) - 0.1 * tall, 1.15 * tall
    with style(), rc_context({"svg.hashsalt": "strip"}):
        figure = Figure(
            figsize=(_WIDTH, _WIDTH * (high - low) / (right - left)), facecolor="white"
        )
        axes = stage(figure, body, slope, (left, right), (low, high))
        for pose in shown:
            draw(axes, body, pose, slope, scale=0.45)
        about = _ABOUT_STRIPS[ending]
        figure.savefig(stream, format=ending[1:], dpi=300, metadata=about)

    return stream.getvalue()
