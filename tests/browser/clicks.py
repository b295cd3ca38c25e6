"""Clicks on marks and cells of a page, and whether what walks is the gait that the
archive holds there.
"""

from __future__ import annotations

import json
import shlex
import time
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from gaitsweep.pipeline.report.figures.design_maps import MAPPED
from gaitsweep.pipeline.report.source import Source, read

#: What a page says of a step of no length, which cannot walk.
STILL = "Here the steps have no length: nothing walks."

#: Clicks a figure at points of its picture, as a hand does, and returns what tip, panel
#: and address say after each.
_CLICK = """
const [figure, points] = arguments, plot = document.querySelector(`#${figure} .plot`), picture = plot.querySelector("svg");
const part = name => document.querySelector(`[data-part=${name}]`), text = node => node?.textContent ?? "";
return points.map(([x, y]) => {
  const box = plot.getBoundingClientRect(), scale = box.width / plot.dataset.width;
  const where = { bubbles: true, clientX: box.left + x * scale, clientY: box.top + y * scale };
  picture.dispatchEvent(new PointerEvent("pointerdown", where));
  picture.dispatchEvent(new PointerEvent("pointerup", where));
  picture.dispatchEvent(new MouseEvent("click", where));
  const facts = Object.fromEntries([...part("facts").querySelectorAll("dt")].map(dt => [dt.textContent, dt.nextSibling.textContent.split(" ")[0]]));
  return { tip: text(plot.querySelector(".tip code")), values: [...plot.querySelectorAll(".tip dd")].map(text), command: text(part("command")),
    address: Object.fromEntries(new URLSearchParams(location.hash.slice(1))), said: text(part("said")), facts, title: text(part("title")),
    outcome: text(part("outcome")), ringed: !plot.querySelector(".ring").hidden };
});"""  # noqa: E501


def figures(browser: Any) -> list[str]:
    """Names of the page's figures."""
    found: list[str] = browser.execute_script(
        "return [...document.querySelectorAll('section:has(.plot)')].map(s => s.id)"
    )
    return found


def parts(browser: Any, figure: str, name: str) -> list[dict[str, Any]]:
    """Marks or maps of a figure, as its page holds them."""
    found: list[dict[str, Any]] = json.loads(browser.execute_script(
        "return document.querySelector(`#${arguments[0]} script.${arguments[1]}`)?.textContent ?? '[]'", figure, name
    ))  # fmt: skip
    for part in found:
        for side in "xy" if name == "panels" else "":
            part[side].setdefault("values", found[0][side].get("values"))
        part |= {key: found[i][key] for key, i in part.get("same", {}).items()}
    return found


def places(browser: Any, figure: str) -> list[list[float]]:
    """Where the marks of a figure lie that have a gait of their own."""
    return [
        row[:2]
        for curve in parts(browser, figure, "marks")
        if "starts" in curve
        for row in curve["rows"]
    ]


def place_in(panel: dict[str, Any], column: int, row: int) -> list[float]:
    """Where a cell of a map lies."""
    place = []
    for side, k, (a, b) in (("x", column, (0, 2)), ("y", row, (3, 1))):
        low, high = panel[side]["limits"]
        value = panel[side]["values"][k]
        share = (
            np.log(value / low) / np.log(high / low)
            if panel[side]["log"]
            else (value - low) / (high - low)
        )
        place.append(panel["box"][a] + share * (panel["box"][b] - panel["box"][a]))
    return place


def cells(
    browser: Any, figure: str, count: int, seed: int = 1
) -> list[tuple[int, int, int, list[float]]]:
    """Panels, columns and rows of some cells of each map of a figure, drawn by lot, and
    where they lie.
    """
    lot, drawn = np.random.default_rng(seed), []
    for k, panel in enumerate(parts(browser, figure, "panels")):
        m, n = len(panel["y"]["values"]), len(panel["x"]["values"])
        for number in lot.choice(m * n, min(count, m * n), replace=False).tolist():
            point = place_in(panel, number % n, number // n)
            (left, top, right, bottom) = panel["box"]
            if left <= point[0] <= right and top <= point[1] <= bottom:
                drawn.append((k, number % n, number // n, point))
    return drawn


def click(browser: Any, figure: str, points: list[list[float]]) -> list[dict[str, Any]]:
    """What tip, panel and address say after a click at each point of a figure's
    picture.
    """
    said: list[dict[str, Any]] = []
    for k in range(0, len(points), 40):
        begin = time.monotonic()
        said += browser.execute_script(_CLICK, figure, points[k : k + 40])
        # Chromium takes no more than 200 addresses in 10 s, WebKit 100 in 30 s.
        least = 12.5 if "webkit" in type(browser).__module__ else 2.5
        time.sleep(max(0.0, least - (time.monotonic() - begin)))
    return said


def archived(path: Path) -> pd.DataFrame:
    """Every gait of an archive: its line, slope, stance angle and period (NaN where it
    is not stored).
    """
    source = read(path)
    rows: list[dict[str, Any]] = []
    for line in source.lines:
        solved = (
            np.isfinite(line.data["stance_angle"].values)
            if "gait" in line.data.dims
            else []
        )
        for i, j in np.argwhere(solved).tolist():
            point = line.data.isel(slope=i, gait=j)
            known = {
                name: float(point[name])
                for name in ("stance_angle", "period")
                if name in point
            }
            rows.append({**line.at, "slope": float(point["slope"]), **known})
    for name in ("branches", "special_points", "census", "cascade"):
        rows += _of_table(source, name)
    return pd.DataFrame(rows)


def in_cell(
    source: Source, panel: dict[str, Any], which: int, values: list[str]
) -> pd.DataFrame:
    """The gait of map `which` that a design study's archive holds in the cell of which
    the tip says some values.

    Empty where there is none. A cell may be smaller than a pixel, so that the tip names
    one beside the one aimed at.
    """
    table = source.tables["design"]
    number = [float(value.replace("−", "-")) for value in values[:2]]
    named = dict(zip((panel["y"]["name"], panel["x"]["name"]), number, strict=True))
    for key, value in {**panel["at"], **named}.items():
        if key in table:
            table = table[
                table[key] == value
                if key == "walker"
                else np.isclose(table[key], value, rtol=1e-6)
            ]
    _, _, slope, of, _ = list(MAPPED.values())[which]
    (row,) = table.to_dict("records")
    gait = {
        "walker": panel["at"]["walker"],
        **named,
        "slope": row[slope],
        "stance_angle": row[f"stance_angle{of}"],
    }
    return pd.DataFrame([gait] if np.isfinite(row[slope]) else [])


def _of_table(source: Source, name: str) -> list[dict[str, Any]]:
    table = source.tables.get(name)
    if table is None or not {"slope", "stance_angle"} <= set(table.columns):
        return []
    along = dict.fromkeys((source.along, "slope", "stance_angle", "period"))
    wanted = [
        c for c in dict.fromkeys((*source.line_columns(table), *along)) if c in table
    ]
    return [
        {"walker": source.walker, **row} for row in table[wanted].to_dict("records")
    ]


def _asks_for(command: str, slope: str) -> bool:
    """Whether a command is of a slope, which of those along what drives is not last."""
    words = shlex.split(command)
    return float(words[words.index("--slope") + 1]) == float(slope)


def wrong(said: dict[str, Any], gaits: pd.DataFrame) -> str:
    """Why what a click says is not one gait of the archive; empty if it is."""
    if said["said"] == STILL and "end: steps vanish" in said["values"]:
        return (
            ""
            if said["title"] == "No gait" and not said["address"]
            else f"walks as {said['title']!r}"
        )
    if not said["facts"].get("period T") or "gait" in said["said"].lower():
        return f"does not walk: {said['said']}"
    if said["tip"] != said["command"]:
        return f"tip {said['tip']!r}, panel {said['command']!r}"
    address = {k: v if k == "walker" else float(v) for k, v in said["address"].items()}
    if not _asks_for(said["command"], said["address"]["slope"]):
        return f"address {said['address']}, panel {said['command']!r}"
    own = gaits
    for key, value in address.items():
        if key == "walker":
            own = own[own[key] == value]
        elif key in own and key != "stance_angle":
            own = own[np.isclose(own[key].astype(float), value, rtol=1e-7, atol=0)]
    own = own[
        np.isclose(own["stance_angle"], address["stance_angle"], rtol=1e-6, atol=0)
    ]
    if own.empty:
        return f"no such gait in the archive: {said['address']}"
    shown = {
        "slope": "slope γ",
        "stance_angle": "stance angle θ*",
        "period": "period T",
    }
    for name, words in shown.items():
        number = float(said["facts"][words].replace("−", "-"))
        stored = own[name].astype(float).to_numpy() if name in own else np.array([])
        stored = stored[np.isfinite(stored)]
        if len(stored) and not np.isclose(stored, number, rtol=1e-5, atol=0).any():
            return f"{words} {number}, archive {stored}"
    return ""


def wrong_motion(said: dict[str, Any]) -> str:
    """Why a pixel of a basin does not end as the archive says; empty if it does."""
    archived, outcome = said["values"][-1], said["outcome"].replace("the ", "")
    if archived.startswith(("fell", "foot", "knee")):
        return "" if archived in outcome else f"archive {archived!r}, page {outcome!r}"
    return (
        ""
        if "walks" in outcome or "recovers" in outcome
        else f"archive {archived!r}, page {outcome!r}"
    )
