"""Geometry of a walker's legs, and drawings of walkers to scale."""

import textwrap
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.patches import Arc, Circle

from gaitsweep.pipeline.report.figures.sketch import Sketch
from gaitsweep.pipeline.report.figures.style import (
    DOTTED,
    INK,
    LINE,
    MUTED,
    PAPER,
    SECOND,
    set_title,
)
from gaitsweep.pipeline.report.source import Source
from gaitsweep.pipeline.report.words import fill, plain

_LEG_KEYS = ("l_t", "l_s", "R", "eps_T")
#: Walkers drawn at most, and in one row.
_MAX_WALKERS, _MAX_IN_ROW = 8, 6
#: Angle of each leg of a walker that is drawn [rad].
_SPREAD = 0.26
#: How its legs are drawn.
_BACK, _FRONT = {"color": MUTED, "lw": 1.2}, {"color": INK, "lw": 1.8}


@dataclass(frozen=True)
class Body:
    """Geometry of a leg: thigh, shank from knee to foot centre, foot radius and the
    angles of both links.

    Notes
    -----
    sin ε_S = l_t sin ε_T / (l_s − R) closes the leg (the paper, figure 1); lengths in the walker's units.
    """

    thigh: float
    shank: float
    radius: float
    eps_T: float
    eps_S: float

    @classmethod
    def of(cls, parameters: Mapping[str, Any]) -> "Body | None":
        """The body of a table of parameters; None if one is missing or the leg does not
        close.
        """
        try:
            thigh, l_s, radius, eps = (float(parameters[key]) for key in _LEG_KEYS)
        except (KeyError, TypeError, ValueError):
            return None

        shank = l_s - radius
        sine = thigh * np.sin(eps) / shank if shank else 0.0

        return (
            cls(thigh, shank, radius, eps, float(np.arcsin(sine)))
            if abs(sine) <= 1
            else None
        )

    @property
    def length(self) -> float:
        """Distance from the hip to the foot centre, leg extended."""
        return float(self.thigh * np.cos(self.eps_T) + self.shank * np.cos(self.eps_S))

    @property
    def height(self) -> float:
        """Distance from the hip to the ground, leg extended and upright."""
        return self.length + self.radius

    def hip(self, stance: Any) -> Any:
        """Position of the hip as x + iy at a stance angle [rad], with the foot centre
        at x = −R θ.
        """
        return (
            -self.radius * stance
            + 1j * self.radius
            + 1j * self.length * np.exp(1j * stance)
        )

    def knee(self, hip: Any, thigh: Any) -> Any:
        """Position of the knee as x + iy, from that of the hip and the thigh's angle
        [rad].
        """
        return hip - 1j * self.thigh * np.exp(1j * (thigh - self.eps_T))

    def foot(self, knee: Any, shank: Any) -> Any:
        """Centre of the foot's arc as x + iy, from the position of the knee and the
        shank's angle [rad].
        """
        return knee - 1j * self.shank * np.exp(1j * (shank + self.eps_S))


def draw_leg(
    axes: Axes, body: Body, hip: complex, thigh: float, shank: float, **line: Any
) -> None:
    """Draw one leg: hip, knee, bottom of the foot, and the arc of the foot."""
    knee = body.knee(hip, thigh)
    foot = body.foot(knee, shank)
    bottom = foot - 1j * body.radius * np.exp(1j * (shank + body.eps_S))
    joints = np.array([hip, knee, bottom])
    axes.plot(joints.real, joints.imag, solid_joinstyle="round", **line)
    if body.radius:
        toward, size = np.degrees(shank) - 90, 2 * body.radius
        how: Any = {"theta1": toward - 28, "theta2": toward + 28, "zorder": 2, **line}
        axes.add_patch(Arc((foot.real, foot.imag), size, size, **how))
    else:
        axes.plot(foot.real, foot.imag, "o", color=line["color"], ms=2 + line["lw"])


def draw_pose(
    axes: Axes, body: Body, hip: complex, angles: Sequence[float], stance: dict[str, Any], swing: dict[str, Any],
    size: float,
) -> None:  # fmt: skip
    """Draw both legs, at the angles of stance leg, swing thigh and swing shank [rad],
    and the hip of some size [pt].
    """
    leg, thigh, shank = angles
    draw_leg(axes, body, hip, leg, leg, **stance)
    draw_leg(axes, body, hip, thigh, shank, **swing)
    axes.plot(hip.real, hip.imag, "o", color=INK, ms=size, zorder=5)


def _bodies(source: Source) -> dict[str, tuple[Body, dict[str, Any]]]:
    """Bodies and parameters of the study's first walkers, as far as the archive holds
    them.
    """
    bodies = {
        name: (Body.of(table), table)
        for name, table in list(source.walkers.items())[:_MAX_WALKERS]
    }
    return {
        name: (body, table)
        for name, (body, table) in bodies.items()
        if body is not None
    }


def _alike(
    bodies: Mapping[str, tuple[Body, dict[str, Any]]],
) -> dict[str, tuple[Body, dict[str, Any]]]:
    """Bodies that differ in a picture, under the names of all walkers that look alike."""
    looks: dict[tuple[float, ...], list[str]] = {}
    for name, (body, table) in bodies.items():
        leg, mass = (
            body.height,
            sum(_number(table, key) for key in ("m_t", "m_s", "m_h")) or 1.0,
        )
        lengths = [
            round(_number(table, key) / leg, 2)
            for key in ("l_t", "R", "w_t", "c_t", "r_t", "w_s", "c_s", "r_s")
        ]
        masses = [round(_number(table, key) / mass, 2) for key in ("m_t", "m_s", "m_h")]
        looks.setdefault((*lengths, *masses, round(body.eps_T, 2)), []).append(name)

    return {", ".join(names): bodies[names[0]] for names in looks.values()}


def _sketch(name: str, bodies: Collection[str], of_few: float) -> Sketch:
    """A panel for each walker, with its name as the title; more than six stand in two
    rows.

    The height [pt] of a figure of one or two is given.
    """
    rows = 1 if len(bodies) <= _MAX_IN_ROW else 2
    across = -(-len(bodies) // rows)
    sketch = Sketch(
        name, of_few if len(bodies) < 3 else 190 if rows == 1 else 370, rows, across
    )
    for axes in sketch.panels:
        axes.set_aspect("equal")
        axes.axis("off")

    for axes, walker in zip(sketch.panels, bodies, strict=False):
        set_title(
            axes,
            "\n".join(
                textwrap.wrap(walker, 48 // across + 2, max_lines=3, placeholder="…")
            ),
            pad=2,
        )

    return sketch


def _finish(
    sketch: Sketch,
    source: Source,
    bodies: Collection[str],
    data: pd.DataFrame,
    **values: Any,
) -> Sketch:
    """Say which walkers are drawn."""
    every, names = len(source.walkers), ", ".join(f"walker {name}" for name in bodies)
    drawn, varied = min(_MAX_WALKERS, every), ", ".join(source.varied)
    return sketch.finish(
        data, names=names, varied=varied, drawn=drawn, every=every, **values
    )


def walker(source: Source) -> Sketch | None:
    """Draw each walker to scale: links, feet, masses as discs in proportion, radii of
    gyration as rings.
    """
    bodies = _alike(_bodies(source))
    if not bodies:
        return None

    sketch, rows = _sketch("walker", bodies, 270), []
    for axes, (name, (body, table)) in zip(sketch.panels, bodies.items(), strict=False):
        _draw_walker(sketch, axes, name, body, table)
        rows += [
            {"walker": name, "parameter": key, "value": value}
            for key, value in table.items()
        ]

    s, each = ("s", ", each to its own scale") if len(bodies) > 1 else ("", "")
    return _finish(sketch, source, bodies, pd.DataFrame(rows), s=s, each=each)


class _Mass(NamedTuple):
    """A mass of a walker: its part, where it is as x + iy, how large, and its radius of
    gyration.
    """

    part: str
    at: complex
    mass: float
    gyration: float

    @property
    def values(self) -> dict[str, float]:
        """Its parameters by their keys; the hip has no radius of gyration."""
        letter = self.part[0]
        own = {f"m_{letter}": self.mass}
        return own if self.part == "hip" else own | {f"r_{letter}": self.gyration}


def _masses(
    body: Body, table: Mapping[str, Any], hip: complex, angle: float
) -> list[_Mass]:
    """The masses of the hip and of a leg at an angle [rad]."""
    thigh, shank = centres_of_mass(body, table, hip, angle)
    every = [
        _Mass(part, at, _number(table, f"m_{part[0]}"), _number(table, f"r_{part[0]}"))
        for part, at in (("thigh", thigh), ("shank", shank), ("hip", hip))
    ]
    return [one for one in every if np.isfinite(one.mass) and one.mass > 0]


def _total(table: Mapping[str, Any]) -> float:
    """Mass of a walker; 1 where it has none."""
    links = 2 * _number(table, "m_t") + 2 * _number(table, "m_s")
    return links + _number(table, "m_h") or 1.0


def _draw_walker(
    sketch: Sketch, axes: Axes, name: str, body: Body, table: Mapping[str, Any]
) -> None:
    """Draw one walker with its legs apart, the front leg darker."""
    hip, height = complex(body.hip(_SPREAD)), body.height
    ends = [body.foot(body.knee(hip, angle), angle) for angle in (_SPREAD, -_SPREAD)]
    ground = min(end.imag for end in ends) - body.radius
    axes.axhline(ground, color=MUTED, lw=0.8)
    draw_pose(axes, body, hip, (_SPREAD, -_SPREAD, -_SPREAD), _BACK, _FRONT, 4)

    total = _total(table)
    for one in _masses(body, table, hip, -_SPREAD):
        _draw_mass(axes, one, 0.11 * height * np.sqrt(one.mass / total))
        rows = pd.DataFrame([{**one.values, "x": one.at.real, "y": one.at.imag}])
        tips = {key: key for key in one.values}
        sketch.mark(axes, rows, f"{name} · {one.part}", tips=tips, x="x", y="y")

    axes.set_xlim(hip.real - 0.5 * height, hip.real + 0.5 * height)
    axes.set_ylim(ground - 0.04 * height, ground + 1.12 * height)


def _draw_mass(axes: Axes, one: _Mass, size: float) -> None:
    """Draw a mass as a disc, and its radius of gyration as a ring."""
    place = one.at.real, one.at.imag
    axes.add_patch(Circle(place, size, color=LINE, alpha=0.75, lw=0, zorder=4))
    if one.gyration > 0:
        dashes = (0, (2, 2))
        axes.add_patch(
            Circle(place, one.gyration, fill=False, color=MUTED, lw=0.7, ls=dashes)
        )


def centres_of_mass(
    body: Body, table: Mapping[str, Any], hip: complex, angle: float
) -> tuple[complex, complex]:
    """Centres of mass of thigh and shank as x + iy, with the extended leg at an angle
    [rad].
    """
    turn_t, turn_s = (
        np.exp(1j * (angle - body.eps_T)),
        np.exp(1j * (angle + body.eps_S)),
    )
    thigh = hip + turn_t * complex(-_number(table, "w_t"), -_number(table, "c_t"))
    return thigh, body.knee(hip, angle) + turn_s * complex(
        -_number(table, "w_s"), -_number(table, "c_s")
    )


class _Standing(NamedTuple):
    """A walker on parallel legs, its hip above the contact: points as x + iy, that of
    all masses too, and what its two static conditions lack.
    """

    hip: complex
    knee: complex
    thigh: complex
    shank: complex
    centre: complex
    has_knees: bool

    @classmethod
    def of(cls, body: Body, table: Mapping[str, Any]) -> "_Standing":
        """Where the parts of a walker are."""
        hip = complex(body.hip(0.0))
        thigh, shank = centres_of_mass(body, table, hip, 0.0)
        links = [2 * _number(table, key) for key in ("m_t", "m_s")]
        masses = np.array([*links, _number(table, "m_h")])
        centre = complex(masses @ np.array([thigh, shank, hip]) / (masses.sum() or 1.0))
        has_knees = bool(table.get("knees"))
        return cls(hip, body.knee(hip, 0.0), thigh, shank, centre, has_knees)

    @property
    def residuals(self) -> dict[str, float]:
        """Distances from the line of hip and contact, and of the shank's centre of mass
        from the line beside it through the knee; what is rounding is 0.
        """
        from_knee = self.shank.real - self.knee.real
        least = 1e-15 * abs(self.hip)
        return {
            "centre_of_mass_from_line": _or_zero(self.centre.real, least),
            "shank_centre_of_mass_from_knee_line": _or_zero(from_knee, least),
        }


def _or_zero(value: float, least: float) -> float:
    return value if abs(value) > least else 0.0


def conditions(source: Source) -> Sketch | None:
    """Draw the static conditions at zero slope (the paper's figure 7): legs parallel,
    the hip above the contact; below each walker, what it lacks of them.

    Notes
    -----
    A walker may walk at vanishing slopes only if its centre of mass and its foot's centre lie on the line from hip to
    contact and, with a free knee, the line from knee to shank's centre of mass is
    parallel to it (section 5.1).
    """
    bodies = _bodies(source)
    if not bodies:
        return None

    sketch, rows, missed = _sketch("conditions", bodies, 290), [], {}
    for axes, (name, (body, table)) in zip(sketch.panels, bodies.items(), strict=False):
        standing = _Standing.of(body, table)
        unit = " m" if table.get("units") == "SI" else ""
        _draw_standing(axes, body, standing)
        _write_residuals(axes, standing, unit)
        rows.append({"walker": name, **standing.residuals})
        missed[name] = _missed(standing, unit)

    said = (
        "the centre of mass of {walker} lies {centre_of_mass_from_line:3} from the line"
    )

    return _finish(
        sketch,
        source,
        bodies,
        pd.DataFrame(rows),
        distances="; ".join(fill(said, row) for row in rows),
        meeting=_listed([name for name, words in missed.items() if not words]),
        missed="; ".join(f"{name} {words}" for name, words in missed.items() if words),
    )


def _missed(standing: _Standing, unit: str) -> str:
    """What a walker lacks of the conditions that hold for it, in words; empty if it meets
    them.
    """
    places = ("first", "second")[: 1 + standing.has_knees]
    lacking = [
        f"the {place} by {plain(abs(value), 2)}{unit}"
        for place, value in zip(places, standing.residuals.values(), strict=False)
        if value
    ]
    return f"misses {_listed(lacking)}" if lacking else ""


def _listed(words: Sequence[str]) -> str:
    """Words as a list in a sentence."""
    return " and ".join(filter(None, (", ".join(words[:-1]), *words[-1:])))


def _draw_standing(axes: Axes, body: Body, standing: _Standing) -> None:
    """Draw one leg over the ground, the lines of both conditions and the centres of
    mass.
    """
    height = body.height
    axes.axhline(0, color=MUTED, lw=0.8)
    axes.plot([0, 0], [0, 1.06 * height], color=MUTED, lw=1, ls=DOTTED)
    draw_leg(axes, body, standing.hip, 0.0, 0.0, color=INK, lw=1.8)
    if standing.has_knees:
        line = np.array([standing.knee, standing.shank])
        axes.plot(line.real, line.imag, color=SECOND, lw=1.2, ls=(0, (4, 1.5)))

    for at in (standing.thigh, standing.shank):
        axes.plot(at.real, at.imag, "o", color=LINE, ms=5, zorder=5)
    centre = standing.centre
    axes.plot(centre.real, centre.imag, "P", color=INK, ms=8, mec=PAPER, zorder=6)
    axes.set_xlim(-0.4 * height, 0.4 * height)
    axes.set_ylim(-0.22 * height, 1.12 * height)


def _write_residuals(axes: Axes, standing: _Standing, unit: str) -> None:
    """Write below a walker what it lacks of the conditions."""
    names = ("cross", "dashed line")[: 1 + standing.has_knees]
    values = standing.residuals.values()
    lines = [
        f"{name}: {plain(value, 2)}{unit if value else ''}"
        for name, value in zip(names, values, strict=False)
    ]
    low, _ = axes.get_ylim()
    how: Any = {"ha": "center", "va": "top", "fontsize": 7.5, "linespacing": 1.5}
    axes.text(0.0, 0.24 * low, "\n".join(lines), **how)


def _number(table: Mapping[str, Any], key: str) -> float:
    """A parameter as a number; zero if it is missing or none."""
    try:
        return float(table.get(key, 0.0))
    except (TypeError, ValueError):
        return 0.0
