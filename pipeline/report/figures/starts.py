"""The starts of gaits that a page holds, from which its script makes them walk: lines,
branches and single gaits.
"""

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from typing import Any
from urllib.parse import parse_qsl, urlencode

import numpy as np
import pandas as pd

from gaitsweep.pipeline.report.figures import fields
from gaitsweep.pipeline.report.figures.style import (
    LINE,
    VARIABLES,
    WALKERS,
    inks,
    spread_evenly,
)
from gaitsweep.pipeline.report.source import RATES, Line, Source, rows_at
from gaitsweep.pipeline.report.words import axis_values, symbol

#: A gait's start just after heelstrike, as columns of tables and variables of grids.
START = ("slope", "stance_angle", *RATES)

#: Gaits of all branches of a page, and the largest number of lines whose branches it
#: holds.
_MAX_GAITS, _MAX_LINES = 700, 40

#: Characters of the numbers of all maps of a figure.
_ROOM = 270_000

#: Tables of points of curves over keys, and their columns of the keys that vary and of
#: their values.
_OF_CURVES = ("curves", "turnings", "meetings")
_KEYS = (("key", "value"), ("other_key", "other_value"))

#: Tables with rows that start a step.
_TABLES = ("branches", "orbits", "basin", "census", "cascade")


def rounded(values: Iterable[float], digits: int = 7) -> list[float | None]:
    """Numbers to some digits, for JSON; None where there is none."""
    return [
        float(f"{v:.{digits}g}") if np.isfinite(v) else None for v in map(float, values)
    ]


def parameters(source: Source, at: Mapping[str, Any]) -> dict[str, Any]:
    """Parameters of a line's walker that its script flies, and the limits of
    violations; empty if one is missing.
    """
    table = source.parameters(at)
    kept = {k: v for k, v in table.items() if isinstance(v, (bool, int, float))}
    needed = {
        "l_t",
        "w_t",
        "m_t",
        "r_t",
        "c_t",
        "l_s",
        "w_s",
        "m_s",
        "r_s",
        "c_s",
        "R",
        "eps_T",
        "m_h",
        "g",
        "knees",
    }
    if not needed <= set(kept):
        return {}

    limits = [
        float(limit) for _, limit in source.provenance.get("violation_limits", [])
    ]  # in the order of their bits
    words = {"units": str(table.get("units", "1"))}
    if "trailing_knee" in table:
        words["trailing_knee"] = str(table["trailing_knee"])
    return {**kept, **words, "violation_limits": limits}


def _address(at: Mapping[str, Any], gait: Any) -> str:
    """Address of a gait on its page, by its line, slope and stance angle; empty where
    it has none.
    """
    near = {name: float(f"{gait[name]:.8g}") for name in START[:2]}
    is_known = np.isfinite([*near.values()]).all()
    return urlencode({**at, **near}) if is_known else ""


def _address_along(source: Source, at: Mapping[str, Any], gait: Any) -> str:
    """Address of a gait on a page along what drives at the slope of a line: of that
    and its whole state.
    """
    named = {source.along: float(gait[source.along]), **at}
    present = [name for name in START[1:] if name in gait]
    state = rounded([gait[name] for name in present], 12)
    pairs = zip(present, state, strict=True)
    known = {name: value for name, value in pairs if value is not None}
    return urlencode({**named, **known}) if "stance_angle" in known else ""


def addresses(source: Source, table: pd.DataFrame) -> list[str]:
    """Address of the gait of each row of a table, by its line, slope, what else drives,
    and stance angle; empty where there is none.
    """
    if not {source.along, "slope", "stance_angle"} <= set(table.columns):
        return [""] * len(table)

    found = []
    for k in range(len(table)):
        row = table.iloc[[k]]
        at, gait = source.line_of(row), row.iloc[0]
        if source.along == "slope":
            found.append(_address(at, gait))
        else:
            found.append(_address_along(source, at, gait))

    return found


def lines(source: Source, shown: Collection[str] = ()) -> list[dict[str, Any]]:
    """Lines whose gaits a page can start: name, values of the axes, walker, command and
    branches. `shown` are the commands of the points of curves that a page shows.

    A branch is a list of starts [slope, angle, rates of stance leg, thigh[, shank]] in
    the walker's units, in its order through folds. Lines of tables of initial
    conditions have none: their figures hold the starts. Nor have lines of gaits of
    several steps, from which Newton's method would lead the script to those of one:
    these fly freely. A line along what drives at its slope names that, as `along`; its
    gaits are those of its marks.
    """
    chosen = _chosen_lines(source)
    along = {} if source.along == "slope" else {"along": source.along}
    if source.steps > 1 or along:
        chosen = [(line, []) for line, _ in chosen]
    total = sum(len(branch) for _, branches in chosen for branch in branches)
    colours = _inks(source, [line for line, _ in chosen])

    found = []
    for (line, branches), ink in zip(chosen, colours, strict=True):
        if keys := parameters(source, line.at):
            nodes = [_nodes(branch, total, keys["knees"]) for branch in branches]
            record = _record(line.at, keys, line.command, ink)
            record["called"] = line.called
            record["first"] = _first(line.at, branches)
            record["branches"] = [own for own in nodes if own]
            found.append(record | along)

    return [*found, *_optimal_lines(source), *_lines_of_curves(source, shown)]


def _record(
    at: Mapping[str, Any], keys: Mapping[str, Any], command: str, ink: str
) -> dict[str, Any]:
    """What a page holds of a line, as yet without a gait of its own."""
    return {
        "name": axis_values(at),
        "at": at,
        "keys": keys,
        "command": command,
        "ink": VARIABLES[ink],
        "called": "",
        "first": "",
        "branches": [],
    }


def _lines_of_curves(
    source: Source, shown: Collection[str]
) -> Iterator[dict[str, Any]]:
    """Yield the walkers at points of curves over keys, each a line without branches
    whose gaits are those of its marks.
    """
    walkers = source.table("curve_walkers", "value")
    if walkers is None:
        return

    seen = set()
    for name in _OF_CURVES:
        table = source.table(name, *START[:4], "key", "value")
        if table is None:
            continue

        for at, row in points_of_curves(source, table):
            command = source.command(at)
            if command in seen or with_slope(command, row["slope"]) not in shown:
                continue

            seen.add(command)
            if keys := _parameters_there(source, walkers, at, row):
                ink = WALKERS.get(str(at["walker"]), LINE)
                yield _record(at, keys, command, ink)


def _parameters_there(
    source: Source, walkers: pd.DataFrame, at: dict[str, Any], row: dict[str, Any]
) -> dict[str, Any]:
    """Parameters of the walker at a point of a curve; empty if the archive lacks them."""
    # An axis may be called as a key that varies, whose value it has not.
    varying = {row.get(key) for key, _ in _KEYS}
    place = {name: value for name, value in row.items() if name not in varying}
    aside = ["walker", *(value for _, value in _KEYS)]
    own = rows_at(walkers, place)
    own = own.drop(columns=aside, errors="ignore")
    if own.empty:
        return {}

    numbers = own.iloc[0].to_dict()
    return parameters(source, numbers | at)


def points_of_curves(
    source: Source, table: pd.DataFrame
) -> Iterator[tuple[dict[str, Any], dict[str, Any]]]:
    """Yield the line of each point of curves, at its values of the keys that vary, and
    the row of the point.
    """
    for place, row in enumerate(table.to_dict("records")):
        at = source.line_of(table.iloc[[place]])
        at.pop("slope", None)
        for key, value in _KEYS:
            if value in row:
                at[str(row[key])] = row[value]

        named = {str(name): value for name, value in row.items()}
        yield at, named


def with_slope(command: str, slope: float) -> str:
    """The command of a line at a slope."""
    return f"{command} --slope {slope!r}"


def _optimal_lines(source: Source) -> list[dict[str, Any]]:
    """The walkers of optima, each a line without branches that shows its gait."""
    optima, walkers = (
        source.table("optimum", *START[:4], "error_bound"),
        source.table("optimal_walkers"),
    )
    if optima is None or walkers is None:
        return []

    free = [key for key in source.given("options", "free") or {} if key in optima]
    lines = []
    for place in range(min(len(optima), _MAX_LINES)):
        gait = optima.iloc[[place]]
        at = source.line_of(gait) | {key: float(gait[key].iloc[0]) for key in free}
        # A gait at a fold is found from its whole state alone, which its mark has.
        is_regular = bool(np.isfinite(gait["error_bound"].iloc[0]))
        own = walkers.iloc[place].to_dict()
        keys = parameters(source, {**at, **own})
        record = _record(at, keys, source.command(at), LINE)
        record["first"] = _address(at, gait.iloc[0]) if is_regular else ""
        record["branches"] = [_nodes(gait, 1, keys.get("knees", False))]
        lines.append(record)

    return [line for line in lines if line["keys"]]


def _chosen_lines(source: Source) -> list[tuple[Line, list[pd.DataFrame]]]:
    """The first lines of the grid and of tables, with their branches."""
    by_line = {
        tuple(line.at.values()): (line, _joined(line))
        for line in source.lines[:_MAX_LINES]
        if {"stance_angle", "gait"} <= set(source.grid.variables)
    }
    for name in _TABLES:
        table = source.table(name, "slope", "stance_angle")
        for line in [] if table is None else source.lines_of(table):
            branches: list[pd.DataFrame] = []
            if name == "branches" and set(START[:4]) <= set(line.rows.columns):
                by_branch = line.rows.groupby("branch", sort=False)
                branches = [part for _, part in by_branch]
            by_line.setdefault(tuple(line.at.values()), (line, branches))

    return list(by_line.values())[:_MAX_LINES]


def _inks(source: Source, lines: Sequence[Line]) -> list[str]:
    """Colours of lines, those that they have in the figures: where each line has its
    own panel, all lines of a walker have the walker's.
    """
    if "gait" in source.grid.dims:
        return inks([line.called for line in lines])
    return [WALKERS.get(line.at["walker"], LINE) for line in lines]


def _joined(line: Line) -> list[pd.DataFrame]:
    """Branches of a line of a grid: the pieces of each joined at its folds."""
    # Pieces are counted from the branch's end at the lower slope: every other one is
    # run through backwards.
    pieces = [
        piece.dropna(subset=[c for c in START[:4] if c in piece]).sort_values(
            "slope", ascending=piece["piece"].iloc[0] % 2 == 0
        )
        for piece in line.curves(*START[1:])
    ]
    return (
        [branch for _, branch in pd.concat(pieces).groupby("branch")] if pieces else []
    )


def _nodes(branch: pd.DataFrame, total: int, kneed: bool) -> list[list[float | None]]:
    """Gaits of a branch, evenly spaced along it; a page holds `_MAX_GAITS` of `total`."""
    most = max(8, len(branch) * _MAX_GAITS // max(total, 1))
    columns = [c for c in START[: 5 if kneed else 4] if c in branch]
    rows = branch[columns].to_numpy(float)[spread_evenly(len(branch), most)]

    return (
        [rounded(row) for row in rows[np.isfinite(rows).all(axis=1)]]
        if len(columns) > 3
        else []
    )


def _first(at: Mapping[str, Any], branches: list[pd.DataFrame]) -> str:
    """Address of the gait that a line shows at first: a stable one where there is one;
    empty without gaits.
    """
    every = pd.DataFrame()
    if branches:
        every = pd.concat(branches).dropna(subset=list(START[:2]))
    if every.empty:
        return ""

    stable = every[every["stable"] == 1] if "stable" in every else every.iloc[:0]
    rows = (stable if len(stable) else every).sort_values("slope")
    return _address(at, rows.iloc[2 * len(rows) // 3])


def brief(records: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """The first gaits of the first lines alone, for the index."""
    shortened = []
    for record in [r for r in records if r["first"] and r["branches"]][:2]:
        start = dict(parse_qsl(record["first"]))
        gaits = [gait for branch in record["branches"] for gait in branch]
        slope, angle = float(start["slope"]), float(start["stance_angle"])
        near = min(gaits, key=lambda gait: abs(gait[0] - slope) + abs(gait[1] - angle))
        shortened.append({**record, "branches": [[near]]})

    return shortened


def cells(
    source: Source, at: Mapping[str, Any], grids: Mapping[str, pd.DataFrame], shown: Sequence[str], maps: int,
    called: str,
) -> dict[str, Any]:  # fmt: skip
    """What the script needs to name and start the gait of any cell of a map.

    Parameters
    ----------
    source : Source
    at : mapping
        Values of the axes that the map does not vary, the study's first walker if none
        is among them.
    grids : mapping
        Columns of the gaits' starts, and quantities, over the keys of the map, down and
        across.
    shown : sequence of str
        Columns and keys whose values a cell shows under the pointer.
    maps : int
        Number of maps of the figure, which share its room.
    called : str
        What the cells are called, before the walker's name.

    Returns
    -------
    dict
        `at`, `keys` and `command` of the line that the map varies; `label` and `shown`;
        `moved`, for each key of the walker that other keys move or tune, these axes and
        its values along them, in rising order; `fields`, the numbers of the cells:
        whether there is a gait, its slope (unless it is along the map or given), stance
        angle and rates over the stance angle, and what is shown.
    """
    fixed = {key: float(value) for key, value in at.items() if key != "walker"}
    line = {"walker": str(at.get("walker", source.walker)), **fixed}
    keys = parameters(source, line)
    grid, *_ = grids.values()
    names = grid.columns.name, grid.index.name
    own = {
        name: grid.to_numpy(float)
        for name, grid in grids.items()
        if name not in (*names, *fixed)
    }
    moved = {}
    for key, axes in source.varied.items():
        across = [axis for axis in axes if axis in names]
        if across and key not in axes and key in source.grid:
            moved[key] = [across, rounded(source.moved(line, key, across), 10)]

    return {
        "at": line,
        "keys": keys,
        "command": source.command(line),
        "ink": VARIABLES[WALKERS.get(str(line["walker"]), LINE)],
        "label": f"{called} · {line['walker']}",
        "shown": [[symbol(name), name] for name in shown],
        "moved": moved,
        "fields": _fields(own, bool(keys.get("knees")), maps),
    }


def _fields(
    columns: Mapping[str, np.ndarray], knees: bool, maps: int
) -> dict[str, Any]:
    """The numbers of a map's cells: 8 digits of slope and angle, 5 of rates, which
    Newton finds, 7 of others.
    """
    angle, wanted = columns.get("stance_angle"), {}
    # Steps that vanish at slope 0 are told apart, for the slopes of the others have
    # their digits by their logarithms.
    still = columns.get("slope", np.zeros((0, 0))) == 0
    for name, values in columns.items():
        if name == "slope":
            values = np.where(still, np.nan, values)
        if name in START[2:]:
            if angle is not None and (knees or name != "shank_rate"):
                ratio = values / angle
                wanted[name] = (
                    ratio,
                    5e-6 * float(np.nanmax(np.abs(ratio), initial=1e-9)),
                    False,
                )
        else:
            log = bool((values[np.isfinite(values)] > 0).all())
            digits = 1e-9 if name in START else 1e-8
            wanted[name] = (
                values,
                digits
                * (1.0 if log else float(np.nanmax(np.abs(values), initial=1e-9))),
                log,
            )

    first = next(iter(columns.values()), np.zeros((0, 0))) if angle is None else angle
    words = {"present": fields.words(np.isfinite(first))} | (
        {"still": fields.words(still)} if still.any() else {}
    )
    return {**words, **fields.fitting(wanted, _ROOM // maps)}
