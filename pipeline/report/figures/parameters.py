"""The parameters of a walker, drawn to scale at a leg (the paper's figure 1)."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.patches import Arc, Circle

from gaitsweep.pipeline.report.figures.body import Body, centres_of_mass, draw_leg
from gaitsweep.pipeline.report.figures.sketch import Sketch
from gaitsweep.pipeline.report.figures.style import (
    DOTTED,
    INK,
    LINE,
    MUTED,
    SECOND,
    spread_heights,
)
from gaitsweep.pipeline.report.source import Source
from gaitsweep.pipeline.report.words import WORDS, plain

#: Parameters named at the left of the leg, of its geometry; the others stand at the
#: right.
_LEFT = ("eps_T", "l_t", "l_s", "R")

#: Half the width of the picture, and where the words begin, over the leg's height.
_HALF, _WORDS = 0.8, 0.26

#: Distance of two lines of words, over the height of the picture.
_APART = 0.055


class _Place(NamedTuple):
    """A parameter and the point at the leg to which its name leads."""

    name: str
    at: complex


def parameters(source: Source) -> Sketch | None:
    """Draw one leg of the study's first walker with knees, or its first, and name every
    parameter where it is measured.
    """
    found = [(name, table, Body.of(table)) for name, table in source.walkers.items()]
    known = [item for item in found if item[2] is not None]
    if not known:
        return None

    first = max(known, key=lambda item: bool(item[1].get("knees")))
    name, table, body = first
    assert body is not None

    sketch = Sketch("parameters", 330)
    (axes,) = sketch.panels
    axes.set_aspect("equal")
    axes.axis("off")
    places = _draw_leg(axes, body, table)
    _name_places(axes, body, table, places)
    rows = [{"parameter": one.name, "value": table.get(one.name)} for one in places]
    return sketch.finish(pd.DataFrame(rows), name=name)


def _draw_leg(axes: Axes, body: Body, table: Mapping[str, Any]) -> list[_Place]:
    """Draw the leg upright on the ground, with its masses and lengths; where each
    parameter is.
    """
    hip = complex(body.hip(0.0))
    knee = complex(body.knee(hip, 0.0))
    foot = complex(body.foot(knee, 0.0))

    axes.axhline(0, color=MUTED, lw=0.8)
    _draw_line(axes, hip, foot, color=MUTED, lw=1, ls=DOTTED)
    draw_leg(axes, body, hip, 0.0, 0.0, color=INK, lw=2.2)
    axes.plot(hip.real, hip.imag, "o", color=INK, ms=6, zorder=5)

    places = [
        _Place("l_t", hip + 0.75 * (knee - hip)),
        _Place("l_s", knee + 0.3 * (foot - knee)),
        _Place("m_h", hip),
    ]
    if body.radius:
        bottom = foot - 1j * body.radius
        _draw_line(axes, foot, bottom, color=SECOND, lw=1)
        places.append(_Place("R", (foot + bottom) / 2))

    if body.eps_T:
        places.append(_draw_angle(axes, body, hip, knee))

    thigh, shank = centres_of_mass(body, table, hip, 0.0)
    places += _draw_mass(axes, table, "t", (hip, knee), thigh)
    places += _draw_mass(axes, table, "s", (knee, foot), shank)
    return places


def _draw_line(axes: Axes, start: complex, end: complex, **line: Any) -> None:
    """Draw a straight line between two points."""
    axes.plot([start.real, end.real], [start.imag, end.imag], **line)


def _draw_angle(axes: Axes, body: Body, hip: complex, knee: complex) -> _Place:
    """Draw the angle at the hip between the thigh and the line to the foot's centre."""
    radius = 0.6 * body.thigh
    thigh = (knee - hip) / abs(knee - hip)
    ends = sorted(np.degrees([-np.pi / 2, float(np.angle(thigh))]))
    size = 2 * radius
    arc = Arc((hip.real, hip.imag), size, size, theta1=ends[0], theta2=ends[1])
    arc.set(color=SECOND, linewidth=1.4)
    axes.add_patch(arc)

    middle = thigh - 1j
    middle = middle / abs(middle)
    return _Place("eps_T", hip + radius * middle)


def _draw_mass(
    axes: Axes,
    table: Mapping[str, Any],
    link: str,
    ends: tuple[complex, complex],
    centre: complex,
) -> list[_Place]:
    """Draw the centre of mass of a link, its distances along the link and from it, and
    the radius of gyration.
    """
    first, last = ends
    along = (last - first) / abs(last - first)

    share = ((centre - first) / along).real
    foot = first + share * along

    _draw_line(axes, first, foot, color=LINE, lw=4, alpha=0.4)
    _draw_line(axes, foot, centre, color=SECOND, lw=1.4)
    axes.plot(centre.real, centre.imag, "o", color=LINE, ms=6, zorder=6)
    places = [
        _Place(f"c_{link}", first + 0.5 * share * along),
        _Place(f"w_{link}", (foot + centre) / 2),
        _Place(f"m_{link}", centre),
    ]

    gyration = float(table.get(f"r_{link}") or 0.0)
    if gyration > 0:
        ring: Any = {"fill": False, "color": MUTED, "lw": 0.8, "ls": (0, (2, 2))}
        axes.add_patch(Circle((centre.real, centre.imag), gyration, **ring))
        places.append(_Place(f"r_{link}", centre + gyration * np.exp(0.3j)))

    return places


def _name_places(
    axes: Axes, body: Body, table: Mapping[str, Any], places: Sequence[_Place]
) -> None:
    """Write every parameter's name, meaning and value in columns beside the leg."""
    tall = body.height
    low = -0.06 * tall
    high = 1.17 * tall
    axes.set_xlim(-_HALF * tall, _HALF * tall)
    axes.set_ylim(low, high)

    for aligned, sign in (("right", -1), ("left", 1)):
        own = [one for one in places if (one.name in _LEFT) == (sign < 0)]
        own.sort(key=lambda one: one.at.imag)
        shares = [(one.at.imag - low) / (high - low) for one in own]
        rows = spread_heights(shares, _APART)
        for one, share in zip(own, rows, strict=True):
            words = (sign * _WORDS * tall, low + share * (high - low))
            _write(axes, _said(table, one.name), one.at, words, aligned)


def _said(table: Mapping[str, Any], name: str) -> str:
    """A parameter's name, meaning and value."""
    value = plain(float(table.get(name) or 0.0))
    unit = _units(table)[name[0]]
    return f"{name}  {WORDS['parameters'][name]}: {value}{unit}"


def _write(
    axes: Axes, text: str, at: complex, words: tuple[float, float], aligned: str
) -> None:
    """Write words with a thin line from their end, beside the leg, to a point."""
    end = (1.0, 0.5) if aligned == "right" else (0.0, 0.5)
    line = {
        "arrowstyle": "-",
        "color": MUTED,
        "lw": 0.5,
        "relpos": end,
    }

    axes.annotate(
        text,
        (at.real, at.imag),
        xytext=words,
        ha=aligned,
        va="center",
        fontsize=8,
        arrowprops=line,
    )


def _units(table: Mapping[str, Any]) -> dict[str, str]:
    """Units of parameters by their first letter."""
    is_si = table.get("units") == "SI"
    length, mass = (" m", " kg") if is_si else ("", "")
    return dict.fromkeys("lwcrR", length) | {"m": mass, "e": " rad"}
