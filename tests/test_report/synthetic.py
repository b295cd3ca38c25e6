"""Archives shaped as the contract says, with plausible numbers and no solver behind
them.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp

from gaitsweep.pipeline.report.figures import design_maps
from test_report.shape import GAITS, KNEED, POINT, write


def short_angle(slope: np.ndarray, ratio: float) -> np.ndarray:
    """A curve that goes from 4 tanh²(π/2) γ/ρ to tanh(π/2)^(2/3) γ^(1/3)."""
    steep = np.tanh(np.pi / 2) ** (2 / 3) * slope ** (1 / 3)
    return (
        steep
        if ratio == 0
        else (steep**-3.0 + (4 * np.tanh(np.pi / 2) ** 2 * slope / ratio) ** -3.0)
        ** (-1 / 3)
    )


def _fitted(slope: np.ndarray, angle: np.ndarray) -> tuple[float, float]:
    exponent, log_amplitude = np.polyfit(np.log(slope), np.log(angle), 1)
    return exponent, float(np.exp(log_amplitude))


def transition(
    folder: Path, slopes: int = 80, ratios: tuple[float, ...] = (0.1, 0.05)
) -> Path:
    """A ladder of foot masses with fits, claims, a trace, and a few points that failed."""
    ratios_, slope = np.array(ratios), np.geomspace(1e-6, 0.1, slopes)
    angle = np.full((len(ratios), slopes, 2), np.nan)
    status = np.zeros(angle.shape, dtype="i1")
    rows: list[dict[str, Any]] = []
    for i, ratio in enumerate(ratios):
        angle[i, :, 0] = (
            np.tanh(3.8120917945 / 2) ** (2 / 3)
            * slope ** (1 / 3)
            * (1 - 0.27 * slope ** (2 / 3))
        )
        angle[i, :, 1] = short_angle(slope, ratio)
        for gait in (0, 1):
            cross = ratio**1.5 / 8
            for regime, keep in (
                ("small", slope < cross / 30),
                ("large", slope > cross * 30 if gait else slope > 1e-3),
            ):
                if keep.sum() > 2:
                    exponent, amplitude = _fitted(slope[keep], angle[i, keep, gait])
                    rows.append(
                        {
                            "walker": "E",
                            "foot_mass_ratio": ratio,
                            "gait": str(GAITS[gait]),
                            "quantity": "stance_angle",
                            "regime": regime,
                            "exponent": exponent,
                            "exponent_low": exponent - 2e-3,
                            "exponent_high": exponent + 2e-3,
                            "amplitude": amplitude,
                            "from": slope[keep][0],
                            "to": slope[keep][-1],
                            "n": int(keep.sum()),
                        }
                    )
    status[:, -3:, 0] = 1
    status[0, 5, 1], status[-1, 7, 1] = 2, 4
    reason = np.select([status == 1, status == 2, status == 4], [1, 2, 3], 0).astype(
        "i2"
    )
    angle[status != 0] = np.nan
    radius = np.where(np.arange(2) == 0, 0.6 + 20 * slope[:, None], 4.0) * np.ones_like(
        angle
    )
    ladder = np.geomspace(1e-5, 0.1, 9)
    crossing = ladder**1.5 / 8 * (1 + 1.2 * ladder**0.5)
    study = """name = "transition"
walker = "E"
[axes]
slope = { from = 1e-6, to = 0.1, n = 80, spacing = "log" }
foot_mass_ratio = [0.1, 0.05]
[want]
fits = ["scaling", "transition"]
figures = ["loglog", "linear", "transition_ladder", "angles", "walker", "claims"]
claims = ["E2", "E3", "E4"]
"""
    claims = {
        "id": ["E2", "E3", "E4", "Z5"],
        "printed": ["1/3", "1 below, 1/3 above", "2.828", "every walker"],
        "quotation": [
            "proportional to the cube root",
            "proportional to γ",
            "approximately as observed",
            "all of them",
        ],
        "value": [0.3333, 1.0, 3.69, 0.0],
        "printed_value": [1 / 3, 1.0, 2.828, np.nan],
        "printed_half_unit": [0.0, 0.0, 5e-4, np.nan],
        "source": ["section 4.1", "section 4.1", "figure 5", "section 7"],
        "computed": [0.3333, 1.0, 3.69, 0.0],
        "interval_low": [0.332, 0.99, 3.1, np.nan],
        "interval_high": [0.335, 1.01, 3.9, np.nan],
        "verdict": ["reproduced", "reproduced", "not reproduced", "not_reproduced"],
        "figure": ["loglog", "loglog", "transition_ladder", "loglog"],
        "command": ["gaitsweep run transition.toml"] * 4,
    }
    dims = ("foot_mass_ratio", "slope", "gait")
    grid = {
        "stance_angle": (dims, angle),
        "period": (dims, np.where(np.isnan(angle), np.nan, 3.5 + angle)),
        "spectral_radius": (dims, np.where(np.isnan(angle), np.nan, radius)),
        "status": (dims, status),
        "reason": (dims, reason),
        "multiplier_real": ((*dims, "multiplier"), np.zeros((*angle.shape, 3))),
    }
    coords = {"foot_mass_ratio": ratios_, "slope": slope, "gait": GAITS}
    tables = {
        "fits/scaling": _columns(rows),
        "claims": claims,
        "trace": simplest_trace("E", {"foot_mass_ratio": 0.1}),
        "fits/transition": {
            "foot_mass_ratio": ladder,
            "slope_transition": crossing,
            "slope_transition_fitted": ladder**1.5 / 8 * 1.18,
            "local_exponent": np.gradient(np.log(crossing), np.log(ladder)),
        },
    }
    run = {
        "seconds": 12.5,
        "jobs": 2,
        "account": {"workers_cpu": 0.25},
        "host": "secret-host",
        "points": int(angle.size),
    }
    return write(
        folder / "transition.nc", study, grid, coords, {"E": POINT}, tables, run
    )


def tuned(folder: Path) -> Path:
    """Several walkers on one pair of axes, as in figure 11."""
    names, slope = ["A", "B", "D", "E"], np.geomspace(1e-5, 0.06, 70)
    angle = np.stack(
        [
            np.stack(
                [
                    0.97 * (1 - 0.06 * k) * slope ** (1 / 3),
                    short_angle(slope, [0.2, 0.15, 0.0, 0.1][k]),
                ],
                -1,
            )
            for k in range(4)
        ]
    )
    dims = ("walker", "slope", "gait")
    radius = np.where(np.arange(2) == 0, 0.5 + 30 * slope[:, None], 3.0) * np.ones_like(
        angle
    )
    study = (
        'name = "tuned walkers"\nwalker = ["A", "B", "D", "E"]\n[axes]\nslope = [0.01]\n'
        '[want]\nfigures = ["loglog", "linear", "walker"]\n'
    )
    return write(
        folder / "tuned.nc",
        study,
        {
            "stance_angle": (dims, angle),
            "spectral_radius": (dims, radius),
            "status": (dims, np.zeros(angle.shape, "i1")),
            "reason": (dims, np.zeros(angle.shape, "i2")),
        },
        {"walker": np.array(names, dtype=object), "slope": slope, "gait": GAITS},
        {
            "A": KNEED | {"knees": False},
            "B": POINT | {"R": 0.2},
            "D": POINT | {"m_t": 0.5, "m_s": 0.0},
            "E": POINT,
        },
        {
            "figure9": {
                "walker": names,
                "l_t": [0.35, 0.5, 0.5, 0.5],
                "m_t": [2.345, 0.4, 0.5, 0.4],
                "knees": [0] * 4,
            }
        },
    )


def jumping(folder: Path) -> Path:
    """A branch with a fold, both pieces long, and another branch: `long` jumps to it,
    as the first becomes `other1`.
    """
    slope = np.linspace(0.005, 0.08, 151)
    pieces = np.stack(
        [
            np.where(slope < 0.03, 0.05 - slope, np.nan),
            0.1 + 2 * slope,
            np.where(slope > 0.02, 0.3 + slope, np.nan),
        ]
    )
    numbers = np.array([[0, 0], [0, 1], [1, 0]])
    order = np.argsort(-pieces, axis=0)
    angle = np.take_along_axis(pieces, order, axis=0)
    dims, gaits = ("slope", "gait"), np.array(["long", "other1", "other2"], object)
    named = {
        k: (dims, np.where(np.isnan(angle), -1, numbers[order, i]).T.astype("i2"))
        for i, k in enumerate(("branch", "piece"))
    }
    fit = {
        "walker": "E",
        "gait": "long",
        "quantity": "stance_angle",
        "regime": ["small", "large"],
        "branch": [0, 1],
        "piece": [1, 0],
        "exponent": [0.4, 0.1],
        "amplitude": [0.7, 0.4],
        "from": [0.005, 0.03],
        "to": [0.03, 0.08],
    }
    study = 'name = "jumping"\nwalker = "E"\n[axes]\nslope = [0.01]\n[want]\nfigures = ["linear", "loglog"]\n'
    grid = {
        "stance_angle": (dims, angle.T),
        **named,
        "status": (dims, np.isnan(angle.T).astype("i1")),
        "spectral_radius": (dims, np.where(np.isnan(angle.T), np.nan, 0.5)),
        "reason": (dims, np.isnan(angle.T).astype("i2")),
    }
    table = {k: v if isinstance(v, list) else [v] * 2 for k, v in fit.items()}
    return write(
        folder / "jumping.nc",
        study,
        grid,
        {"slope": slope, "gait": gaits},
        {"E": POINT},
        {"fits/scaling": table},
    )


def detuning(folder: Path, lines: int = 6) -> Path:
    """Branches through folds, one panel a detuning, with special points; a kneed trace."""
    columns: dict[str, list] = {
        k: []
        for k in (
            "walker",
            "detuning",
            "branch",
            "slope",
            "stance_angle",
            "period",
            "stable",
        )
    }
    special: dict[str, list] = {
        k: []
        for k in (
            "walker",
            "detuning",
            "kind",
            "slope",
            "stance_angle",
            "period",
            "error_bound",
        )
    }
    for value in np.linspace(0, 1, lines):
        s = np.linspace(-1, 1, 121)
        slope = 0.004 + 0.012 * value + 0.05 * s**2 + 0.004 * s
        angle = 0.14 + 0.1 * s + 0.03 * s**2
        columns["walker"] += ["C"] * len(s)
        columns["detuning"] += [value] * len(s)
        columns["branch"] += [0] * len(s)
        columns["slope"] += list(slope)
        columns["stance_angle"] += list(angle)
        columns["period"] += list(0.7 + angle)
        columns["stable"] += list(((s > 0.1) & (s < 0.6)).astype("i1"))
        for kind, k in (
            ("fold", int(np.argmin(slope))),
            ("flip", 96),
            ("end_kneestrike_at_heelstrike", 120),
        ):
            for name, item in zip(
                special,
                ("C", value, kind, slope[k], angle[k], 0.7 + angle[k], 1e-9),
                strict=True,
            ):
                special[name].append(item)
    study = (
        'name = "detuning"\nkind = "branch"\nwalker = "C"\n[axes]\nslope = { from = 1e-4, to = 0.06, n = 100 }\n'
        'detuning = [0, 0.2, 0.4, 0.6, 0.8, 1]\n[want]\nfigures = ["locus", "walker", "conditions", "angles"]\n'
    )
    return write(
        folder / "detuning.nc",
        study,
        {},
        {},
        {"C": KNEED},
        {
            "branches": columns,
            "special_points": special,
            "trace": simplest_trace("C", {}, knees=True),
        },
    )


def cascade(folder: Path, points: int = 6000) -> Path:
    """Orbits of a logistic map dressed as stance angles, and a basin."""
    slope = np.repeat(np.linspace(0.07, 0.103, points // 20), 20)
    r, x = 2.8 + 1.2 * (slope - 0.07) / 0.033, np.full(len(slope), 0.4)
    for _ in range(400):
        x = r * x * (1 - x)
    for k in range(20):
        x[k::20] = (
            x[k::20]
            if k == 0
            else (r * 1.0)[k::20] * x[k - 1 :: 20] * (1 - x[k - 1 :: 20])
        )
    start = np.stack(
        np.meshgrid(np.linspace(0.1, 0.3, 50), np.linspace(-0.3, -0.1, 50)), -1
    ).reshape(-1, 2)
    outcome = np.where(
        np.hypot(start[:, 0] - 0.2, start[:, 1] + 0.2) < 0.05, "long", "fell"
    )
    study = (
        'name = "cascade"\nkind = "orbit"\nwalker = "C"\n[axes]\nslope = [0.07]\n'
        '[want]\nfigures = ["bifurcation", "basin", "nonsense"]\n'
    )
    return write(
        folder / "cascade.nc",
        study,
        {},
        {},
        {"C": KNEED},
        {
            "orbits": {
                "walker": ["C"] * len(slope),
                "slope": slope,
                "stance_angle": 0.2 + 0.1 * x,
            },
            "basin": {
                "stance_angle": start[:, 0],
                "stance_rate": start[:, 1],
                "outcome": outcome,
            },
        },
    )


def states(angles: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Made-up states of the gaits of a design map's quantities, by their stance angles."""
    return {
        f"{name}{mapped.ending}": share * angle
        for mapped, angle in zip(
            design_maps.MAPPED.values(), angles.values(), strict=True
        )
        for name, share in (
            ("stance_angle", 1.0),
            ("stance_rate", -1.0),
            ("thigh_rate", -0.9),
        )
    }


def design(folder: Path, side: int = 40) -> Path:
    """A design map over foot radius and slope."""
    radius, slope = np.linspace(0.0, 0.4, side), np.linspace(0.002, 0.06, side)
    speed = (
        0.2 + radius[:, None, None] + 3 * slope[None, :, None] + np.array([0.0, 0.05])
    )
    spectral = (
        0.4 + 12 * slope[None, :, None] + radius[:, None, None] + np.array([0.0, 1.5])
    )
    speed[(radius[:, None] < 0.1) & (slope[None, :] > 0.05)] = np.nan
    status = np.isnan(speed).astype("i1")
    dims = ("R", "slope", "gait")
    study = (
        'name = "design"\nwalker = { base = "B" }\n[axes]\nR = { from = 0, to = 0.4, n = 40 }\nc_t = [0.1]\n'
        'slope = { from = 0.002, to = 0.06, n = 40 }\n[want]\nfigures = ["heatmap", "design"]\n'
    )
    key = np.repeat([0.1, 0.2, 0.3], 3)
    fast = np.where(key > 0.15, key, np.nan)
    best = {
        "R": key,
        "c_t": np.tile([0.08, 0.1, 0.12], 3),
        "smallest_slope": 0.1 * key,
        "largest_stable_slope": key,
        "fastest_froude_speed": fast,
        "fastest_slope": fast,
    } | states({"smallest": 0.1 * key, "largest": key, "fastest": fast})
    return write(
        folder / "design.nc",
        study,
        {
            "speed": (dims, speed),
            "spectral_radius": (dims, spectral),
            "status": (dims, status),
            "reason": (dims, status.astype("i2")),
        },
        {"R": radius, "slope": slope, "gait": GAITS},
        {"B": POINT | {"R": 0.2}},
        {"design": best},
    )


def simplest_trace(
    walker: str, settings: dict[str, float], knees: bool = False
) -> dict[str, Any]:
    """One step of the simplest walker at 0.009, both gaits; a made-up flexion where
    there are knees.
    """
    rows: dict[str, list] = {
        k: []
        for k in (
            "walker",
            *settings,
            "gait",
            "slope",
            "time",
            "theta_st",
            "theta_th",
            "theta_sh",
        )
    }
    for gait, angle, rate in (
        ("long", 0.2003109005442470, -0.1998324730049523),
        ("short", 0.19393736981, -0.20386692744),
    ):

        def fall(_, y, slope=0.009):
            acceleration = np.sin(y[0] - slope)
            return [
                y[2],
                y[3],
                acceleration,
                acceleration + np.sin(y[1]) * (y[2] ** 2 - np.cos(y[0] - slope)),
            ]

        done = solve_ivp(
            fall,
            (0, 8),
            [angle, 2 * angle, rate, rate * (1 - np.cos(2 * angle))],
            rtol=1e-9,
            atol=1e-11,
            dense_output=True,
        )
        grid = np.linspace(3.0, 4.6, 16001)
        gap = done.sol(grid)[1] - 2 * done.sol(grid)[0]
        period = grid[np.flatnonzero(np.diff(np.sign(gap)))[0]]
        time = np.linspace(0, period, 121)
        stance, between = done.sol(time)[:2]
        thigh = stance - between
        flexion = (
            0.55 * np.sin(np.pi * np.clip(time / (0.7 * period), 0, 1)) ** 2
            if knees
            else 0.0
        )
        for name, column in zip(
            rows,
            (
                *[[walker] * 121],
                *[[v] * 121 for v in settings.values()],
                [gait] * 121,
                [0.009] * 121,
                time,
                stance,
                thigh,
                thigh - flexion,
            ),
            strict=True,
        ):
            rows[name] += list(column)
    return rows


def _columns(rows: list[dict[str, Any]]) -> dict[str, list]:
    return {key: [row[key] for row in rows] for key in rows[0]}


def everything(folder: Path) -> list[Path]:
    """One archive of each kind."""
    return [
        transition(folder),
        tuned(folder),
        detuning(folder),
        cascade(folder),
        design(folder),
    ]
