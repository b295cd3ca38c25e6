"""A walker's shape: where its joints are, and a drawing of it to scale."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Arc, Circle

from pipeline.report.figures.style import INK, MUTED, PAPER, brief, canvas, colour, plain
from pipeline.report.figures.svg import Marks, Sketch
from pipeline.report.source import Source

_NEEDED = ("l_t", "l_s", "R", "eps_T")


@dataclass(frozen=True)
class Body:
    """Geometry of a leg: thigh, shank from knee to foot centre, foot radius and the offsets of both links.

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
    def of(cls, parameters: Mapping[str, Any]) -> Body | None:
        """The body of a table of parameters; None where one is missing."""
        try:
            thigh, l_s, radius, eps = (float(parameters[key]) for key in _NEEDED)
        except (KeyError, TypeError, ValueError):
            return None
        shank = l_s - radius
        sine = thigh * np.sin(eps) / shank if shank else 0.0
        return cls(thigh, shank, radius, eps, float(np.arcsin(sine))) if abs(sine) <= 1 else None

    @property
    def length(self) -> float:
        """Distance from the hip to the foot's centre, leg extended."""
        return float(self.thigh * np.cos(self.eps_T) + self.shank * np.cos(self.eps_S))

    def hip(self, stance: Any) -> Any:
        """Hip as x + iy, the stance foot's centre rolling from x = −R θ."""
        return -self.radius * stance + 1j * self.radius + 1j * self.length * np.exp(1j * stance)

    def knee(self, hip: Any, thigh: Any) -> Any:
        return hip - 1j * self.thigh * np.exp(1j * (thigh - self.eps_T))

    def foot(self, knee: Any, shank: Any) -> Any:
        """Centre of the foot's arc."""
        return knee - 1j * self.shank * np.exp(1j * (shank + self.eps_S))

    def step(self, stance: float) -> float:
        """Length of a step that starts at that stance angle."""
        return float(2 * (self.length * np.sin(stance) + self.radius * stance))


def draw_leg(axes: Axes, body: Body, hip: complex, thigh: float, shank: float, **line: Any) -> None:
    """One leg: hip, knee, foot centre, and the arc of the foot."""
    knee = body.knee(hip, thigh)
    foot = body.foot(knee, shank)
    bottom = foot - 1j * body.radius * np.exp(1j * (shank + body.eps_S))
    joints = np.array([hip, knee, bottom])
    axes.plot(joints.real, joints.imag, solid_joinstyle="round", **line)
    if body.radius:
        toward = np.degrees(shank) - 90
        axes.add_patch(
            Arc(
                (foot.real, foot.imag),
                2 * body.radius,
                2 * body.radius,
                theta1=toward - 28,
                theta2=toward + 28,
                color=line.get("color", INK),
                lw=line.get("lw", 1),
                zorder=line.get("zorder", 2),
            )
        )
    else:
        axes.plot(foot.real, foot.imag, "o", color=line.get("color", INK), ms=2 + line.get("lw", 1))


def _bodies(source: Source) -> dict[str, tuple[Body, dict[str, Any]]]:
    """The study's first six walkers whose shape the archive tells, with their parameters."""
    found = {name: (Body.of(table), table) for name, table in list(source.walkers.items())[:6]}
    return {name: (body, table) for name, (body, table) in found.items() if body is not None}


def _which(source: Source, drawn: int) -> str:
    """What a caption adds where a study has more walkers than are drawn, or varies their keys."""
    more = f" {drawn} of {len(source.walkers)} walkers are drawn." if len(source.walkers) > drawn else ""
    keys = list(source.varied)
    return more + (f" The study varies {', '.join(keys)}; drawn is what it starts from." if keys else "")


def _panels(figure: Figure, names: list[str]) -> list[Axes]:
    """A panel for each walker, under its name."""
    row = list(np.atleast_1d(figure.subplots(1, len(names))))
    for axes, name in zip(row, names, strict=True):
        axes.set_title(brief(name, 48 // len(names)), pad=2)
        axes.set_aspect("equal")
        axes.axis("off")
    return row


def walker(source: Source) -> Sketch | None:
    """Each walker to scale: links, feet, and every mass as a disc of that area, ringed at its radius of gyration."""
    bodies = _bodies(source)
    if not bodies:
        return None
    figure = canvas(270 if len(bodies) < 3 else 190)
    marks = []
    for axes, (name, (body, table)) in zip(_panels(figure, list(bodies)), bodies.items(), strict=True):
        marks += _portrait(axes, name, body, table)
    data = pd.DataFrame(
        [
            {"walker": name, "parameter": key, "value": value}
            for name, (_, table) in bodies.items()
            for key, value in table.items()
        ]
    )
    several = len(bodies) > 1
    return Sketch(
        figure,
        "The walkers" if several else "The walker",
        "Drawn to scale from the archive's parameters"
        + (", each to its own scale" if several else "")
        + ". A disc is a mass, its area in proportion; a ring is its radius of gyration."
        + _which(source, len(bodies)),
        "Side view of "
        + ", ".join(f"walker {name}" for name in bodies)
        + ": two legs joined at the hip, on the ground, with their masses as discs.",
        data,
        marks,
    )


def _portrait(axes: Axes, name: str, body: Body, table: Mapping[str, Any]) -> list[Marks]:
    """One walker with its legs a little apart, the front one in full ink."""
    spread = 0.26
    hip = complex(body.hip(spread))
    height = body.length + body.radius
    ends = [body.foot(body.knee(hip, a), a) for a in (spread, -spread)]
    ground = min(e.imag for e in ends) - body.radius
    axes.axhline(ground, color=MUTED, lw=0.8)
    draw_leg(axes, body, hip, spread, spread, color=MUTED, lw=1.2)
    draw_leg(axes, body, hip, -spread, -spread, color=INK, lw=1.8)
    axes.plot(hip.real, hip.imag, "o", color=INK, ms=4, zorder=5)
    knee = body.knee(hip, -spread)
    turn_t, turn_s = np.exp(1j * (-spread - body.eps_T)), np.exp(1j * (-spread + body.eps_S))
    masses = {
        "thigh": (hip + turn_t * complex(-_of(table, "w_t"), -_of(table, "c_t")), _of(table, "m_t"), _of(table, "r_t")),
        "shank": (
            knee + turn_s * complex(-_of(table, "w_s"), -_of(table, "c_s")),
            _of(table, "m_s"),
            _of(table, "r_s"),
        ),
        "hip": (hip, _of(table, "m_h"), 0.0),
    }
    total = sum(m * (1 if part == "hip" else 2) for part, (_, m, _) in masses.items()) or 1.0
    marks = []
    for part, (at, mass, gyration) in masses.items():
        if not np.isfinite(mass) or mass <= 0:
            continue
        axes.add_patch(
            Circle(
                (at.real, at.imag),
                0.11 * height * np.sqrt(mass / total),
                color=colour("long"),
                alpha=0.75,
                lw=0,
                zorder=4,
            )
        )
        if gyration > 0:
            axes.add_patch(Circle((at.real, at.imag), gyration, fill=False, color=MUTED, lw=0.7, ls=(0, (2, 2))))
        letter = part[0]
        values = {f"m_{letter}": [mass]} | ({f"r_{letter}": [gyration]} if part != "hip" else {})
        marks.append(Marks(axes, np.array([at.real]), np.array([at.imag]), f"{name} · {part}", values))
    axes.set_xlim(hip.real - 0.5 * height, hip.real + 0.5 * height)
    axes.set_ylim(ground - 0.04 * height, ground + 1.12 * height)
    return marks


def conditions(source: Source) -> Sketch | None:
    """The statics of standing at zero slope (the paper's figure 7): legs parallel, the hip above the contact.

    Notes
    -----
    A walker may walk at vanishing slopes only if its centre of mass and its foot's centre lie on the line from hip to
    contact and, with a free knee, the line from knee to shank's centre of mass is parallel to it (section 5.1).
    """
    bodies = _bodies(source)
    if not bodies:
        return None
    figure = canvas(290 if len(bodies) < 3 else 190)
    rows = []
    for axes, (name, (body, table)) in zip(_panels(figure, list(bodies)), bodies.items(), strict=True):
        hip = complex(body.hip(0.0))
        knee, height = body.knee(hip, 0.0), body.length + body.radius
        thigh = hip + np.exp(-1j * body.eps_T) * complex(-_of(table, "w_t"), -_of(table, "c_t"))
        shank = knee + np.exp(1j * body.eps_S) * complex(-_of(table, "w_s"), -_of(table, "c_s"))
        masses = np.array([2 * _of(table, "m_t"), 2 * _of(table, "m_s"), _of(table, "m_h")])
        centre = complex(masses @ np.array([thigh, shank, hip]) / (masses.sum() or 1.0))
        axes.axhline(0, color=MUTED, lw=0.8)
        axes.plot([0, 0], [0, 1.06 * height], color=MUTED, lw=1, ls=(0, (1, 2)))
        draw_leg(axes, body, hip, 0.0, 0.0, color=INK, lw=1.8)
        if table.get("knees"):
            axes.plot([knee.real, shank.real], [knee.imag, shank.imag], color=colour("short"), lw=1.2, ls=(0, (4, 1.5)))
        for at, size in ((thigh, 5), (shank, 5)):
            axes.plot(at.real, at.imag, "o", color=colour("long"), ms=size, zorder=5)
        axes.plot(centre.real, centre.imag, "P", color=INK, ms=8, mec=PAPER, zorder=6)
        axes.set_xlim(-0.4 * height, 0.4 * height)
        axes.set_ylim(-0.04 * height, 1.12 * height)
        rows.append(
            {
                "walker": name,
                "centre_of_mass_from_line": centre.real,
                "shank_centre_of_mass_from_knee_line": shank.real - knee.real,
            }
        )
    return Sketch(
        figure,
        "Standing at zero slope",
        "Legs parallel, hip above the contact. Discs: centres of mass of thigh and shank; cross: of the whole "
        "walker. To walk at vanishing slopes the cross must lie on the dotted line, and with free knees the "
        "dashed line from knee to shank's centre of mass must be parallel to it." + _which(source, len(bodies)),
        "Side view of "
        + ", ".join(f"walker {name}" for name in bodies)
        + " standing on parallel legs: "
        + "; ".join(
            f"{r['walker']}'s centre of mass lies {plain(r['centre_of_mass_from_line'], 3)} from the line" for r in rows
        )
        + ".",
        pd.DataFrame(rows),
        [],
    )


def _of(table: Mapping[str, Any], key: str) -> float:
    try:
        return float(table.get(key, 0.0))
    except (TypeError, ValueError):
        return 0.0
