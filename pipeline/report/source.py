"""One archive as a report reads it: plain arrays, tables and the text of its study."""

import itertools
import json
import math
import re
import shlex
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import netCDF4
import numpy as np
import pandas as pd
import xarray as xr

from gaitsweep.pipeline.archive import layout
from gaitsweep.pipeline.archive import read as archives
from gaitsweep.pipeline.archive.unfold import dataset, table
from gaitsweep.pipeline.companions import Companions
from gaitsweep.pipeline.report.words import (
    axis_values,
    print_units,
    spaced,
    titled,
    with_unit,
)
from gaitsweep.pipeline.study import toml
from gaitsweep.pipeline.study.ways import ends

#: Rates of a state just after heelstrike.
RATES = ("stance_rate", "thigh_rate", "shank_rate")

#: Cache of chunks for each variable [byte].
_CACHE = 1 << 20
#: Largest number of values of a variable that are read for the figures; a larger grid
#: is thinned in slope.
MAX_POINTS = 500_000
#: Numbers of archives need no decoding.
_AS_STORED = {"mask_and_scale": False, "decode_times": False}


def rows_at(
    frame: pd.DataFrame, at: Mapping[str, Any], tolerance: float = 1e-9
) -> pd.DataFrame:
    """Rows of a frame at some values of those axes that it has; numbers may differ by a
    share of their size.
    """
    for column in at.keys() & set(frame.columns):
        # Relative to the value alone: axes such as `foot_mass_ratio` may hold values of
        # 1e-9.
        value, own = at[column], frame[column]
        frame = frame[
            own == value
            if isinstance(value, str)
            else np.isclose(own, value, rtol=tolerance, atol=0)
        ]

    return frame


@dataclass(frozen=True)
class Line:
    """One walker with every axis fixed but that along which gaits are followed, and what
    the archive holds along it.

    `at` is its place: `walker`, by name, then the values of the axes; `command` solves
    it, without the slope. `rows` are its rows of a table; of a line of the grid, which
    has `data`, those of its branches, if the study follows them. `called` is the walker
    of the catalogue that it is, empty if it is none.
    """

    at: dict[str, Any]
    label: str
    command: str
    rows: pd.DataFrame
    data: xr.Dataset = field(default_factory=xr.Dataset)
    called: str = ""

    def curves(self, *variables: str) -> Iterator[pd.DataFrame]:
        """Yield a frame for each piece of a branch: `slope`, variables, state, `stable`
        (1, 0 or NaN) and `gait`.

        Labels jump from branch to branch, and a branch passes a slope once on each side
        of a fold: curves follow pieces, and `gait` is the label of each point. Slopes
        at which the piece has no gait are kept, as NaN, so that gaps are drawn as gaps.
        In an archive without branches a curve follows a label; of a branch that is
        followed a piece has the columns of its table.
        """
        if "gait" in self.data.dims:
            yield from self._pieces(variables)
        else:
            yield from self._followed()

    def _followed(self) -> Iterator[pd.DataFrame]:
        """Branches of the line's rows, parted where they turn, each in order of slope."""
        for _, rows in self.rows.groupby("branch", sort=False):
            falls = rows["slope"].diff().bfill() < 0
            parts = rows.groupby((falls != falls.shift()).cumsum())
            yield from (part.sort_values("slope") for _, part in parts)

    def _pieces(self, variables: Sequence[str]) -> Iterator[pd.DataFrame]:
        """Pieces of the branches of which the line's data has points."""
        data = self.data
        wanted = dict.fromkeys((*variables, "spectral_radius", "stance_angle", *RATES))
        dims = ("slope", "gait")
        columns = {v: data[v] for v in wanted if v in data}
        values = {v: one.values for v, one in columns.items() if one.dims == dims}
        branch, piece = self._branch_and_piece()
        on_branch = branch >= 0
        pairs = np.column_stack([branch[on_branch], piece[on_branch]])
        for number, part in np.unique(pairs, axis=0).tolist():
            here = (branch == number) & (piece == part)
            yield self._piece(here, values).assign(branch=number, piece=part)

    def _piece(
        self, here: np.ndarray, values: Mapping[str, np.ndarray]
    ) -> pd.DataFrame:
        """The points of which `here`, (slope, gait), is true, from the first to the last
        slope that has one, with values NaN at slopes between that have none.
        """
        is_there = np.any(here, axis=1)
        known = np.flatnonzero(is_there)
        row = np.arange(known[0], known[-1] + 1)
        has = is_there[row]
        column = here.argmax(axis=1)[row]

        quantities = {
            name: np.where(has, own[row, column], np.nan)
            for name, own in values.items()
        }
        slopes = self.data["slope"].values[row]
        labels = self.data["gait"].values.astype(str)[column]
        frame = pd.DataFrame({"slope": slopes, **quantities})
        return frame.assign(stable=stable(frame), gait=np.where(has, labels, ""))

    def _branch_and_piece(self) -> tuple[np.ndarray, np.ndarray]:
        """Numbers of the branch and of its piece of each gait (slope, gait); -1 where
        there is no gait. Without branches each label is one.
        """
        data = self.data
        shape = data.sizes["slope"], data.sizes["gait"]
        labels = np.broadcast_to(np.arange(shape[1]), shape)
        branch = data["branch"].values if "branch" in data else labels
        piece = data["piece"].values if "piece" in data else np.zeros(shape, int)
        return branch, piece


def stable(frame: pd.DataFrame) -> np.ndarray:
    """Return 1 where a gait is stable, 0 where it is not, NaN where its radius is
    unknown.
    """
    if "spectral_radius" not in frame:
        return np.full(len(frame), np.nan)
    radius = frame["spectral_radius"].to_numpy()
    return np.where(np.isnan(radius), np.nan, (radius < 1).astype(float))


@dataclass(frozen=True)
class Source:
    """One archive, read once: the grid as it is drawn, and the `outcomes` at all its
    points.
    """

    path: Path
    grid: xr.Dataset
    outcomes: xr.Dataset
    tables: dict[str, pd.DataFrame]
    provenance: dict[str, Any]
    study: dict[str, Any]
    run: dict[str, Any] = field(default_factory=dict)

    def given(self, *keys: str) -> Any:
        """An entry of the study, by its key and those of the tables that hold it; None
        where there is none.
        """
        value: Any = self.study
        for key in keys:
            value = value.get(key) if isinstance(value, dict) else None
        return value

    @property
    def name(self) -> str:
        """The study's name."""
        return str(self.study.get("name") or self.path.stem)

    @property
    def slug(self) -> str:
        """The study's name, made safe as a file name."""
        return re.sub(r"[^A-Za-z0-9_-]+", "-", self.name).strip("-") or "study"

    @property
    def title(self) -> str:
        """The study's name in words: figure5 becomes figure 5."""
        return re.sub(r"(?<=[a-z])(?=\d)", " ", re.sub(r"[-_]+", " ", self.name))

    @property
    def about(self) -> str:
        """The study's description of itself: its first comment."""
        lines = itertools.takewhile(
            lambda line: line.startswith("#"),
            self.provenance["study"].strip().splitlines(),
        )
        return " ".join(line.lstrip("# ").strip() for line in lines)

    @property
    def named_files(self) -> list[str]:
        """Names of the files that the study names: those of its walkers, and that of
        its measurements.
        """
        walkers = self.study.get("walker")
        given = [*_listed(walkers), self.toward]
        given += [
            each.get(key)
            for each in given
            if isinstance(each, dict)
            for key in ("base", "toward")
        ]
        names = [
            each for each in given if isinstance(each, str) and each.endswith(".toml")
        ]
        overlay = self.given("figures", "overlay", "file")
        return list(dict.fromkeys([*names, *([str(overlay)] if overlay else [])]))

    @property
    def toward(self) -> str | dict[str, Any]:
        """The walker to which the axis `detuning` leads, as the study writes it; empty
        if it names none.
        """
        toward = self.given("axes", "detuning", "toward")
        return toward if isinstance(toward, str | dict) else ""

    @property
    def detuning_ends(self) -> tuple[str, str]:
        """The walkers at `detuning` 0 and 1 in words; those of the paper in an archive
        of an earlier version.
        """
        ways = self.provenance.get("ways")
        return ends(ways) if ways else ("the exactly tuned walker", "the physical one")

    @property
    def file(self) -> str:
        """A name for the study's file that differs from those of its walkers."""
        return (
            f"{self.slug}-study.toml"
            if f"{self.slug}.toml" in self.named_files
            else f"{self.slug}.toml"
        )

    @property
    def run_options(self) -> str:
        """Options of the command that made the archive: an accuracy that is not written
        in the study.
        """
        accuracy = float(self.grid.attrs.get("accuracy", 0.0))
        return (
            f" --accuracy {accuracy!r}"
            if accuracy and accuracy != self.study.get("accuracy")
            else ""
        )

    @property
    def whole(self) -> str:
        """What a status refers to: a point of a grid, or a line."""
        return "point" if "gait" in self.grid.dims else "line"

    @property
    def steps(self) -> int:
        """Steps after which the gaits repeat."""
        return int(self.grid.attrs.get("steps", 1))

    @property
    def figures(self) -> list[str]:
        """Names of the figures that the study wants."""
        return [str(name) for name in self.given("want", "figures") or ()]

    @property
    def only_claims(self) -> bool:
        """Whether the study only feeds the ledger: it wants claims, and no figure but
        those.
        """
        return "claims" in self.tables and self.figures == ["claims"]

    @cached_property
    def walkers(self) -> dict[str, dict[str, Any]]:
        """Parameters of each walker before the axes change them, by the walker's name
        in the study.
        """
        given, stored = self.study.get("walker"), self.provenance.get("walkers", [])
        named = [_name(w, i) for i, w in enumerate(_listed(given))]
        return {
            name: dict(w)
            for name, w in zip(named, stored, strict=False)
            if isinstance(w, dict)
        }

    @property
    def notes(self) -> list[str]:
        """Sentences on the study's walkers."""
        return str(self.grid.attrs.get("walker_notes", "")).splitlines()

    @property
    def varied(self) -> dict[str, tuple[str, ...]]:
        """Walker keys that the study varies, and the axes that change each."""
        return {
            key: tuple(axes) for key, axes in self.provenance.get("varied", {}).items()
        }

    @property
    def walker(self) -> str:
        """The study's first walker: the only one where there is no axis of walkers."""
        return next(iter(self.walkers), "")

    def period_title(self, at: Mapping[str, Any]) -> str:
        """What the periods of a line's gaits are called: with their unit, which walkers
        in consistent units have not.
        """
        walker = self.walkers.get(str(at.get("walker", self.walker)), {})
        return with_unit("period", "s" if walker.get("units") == "SI" else "")

    def parameters(self, at: Mapping[str, Any]) -> dict[str, Any]:
        """Parameters of a line's walker, as far as the archive holds them, with those
        that its axes change.
        """
        walker = str(at.get("walker", self.walker))
        table = {**self.walkers.get(walker, self.walkers.get(self.walker, {})), **at}
        for key, axes in self.varied.items():
            column = self.grid.get(key)
            if (
                key not in axes
                and key not in at
                and column is not None
                and all(a in at and a in column.coords for a in axes)
            ):
                near = self._of_walker(column, walker).sel(
                    {axis: at[axis] for axis in axes}, method="nearest"
                )
                table[key] = float(near) if near.ndim == 0 else table.get(key)

        return table

    def moved(self, at: Mapping[str, Any], key: str, axes: Sequence[str]) -> np.ndarray:
        """Values of a walker's key that some axes change, each in its rising order, the
        last axis first to change.
        """
        column = self._of_walker(self.grid[key], at["walker"])
        fixed = {
            name: value
            for name, value in at.items()
            if name in column.dims and name not in axes
        }
        return np.asarray(
            column.sel(fixed).sortby([*axes]).transpose(*axes).values
        ).ravel()

    def _of_walker(self, column: xr.DataArray, walker: str) -> xr.DataArray:
        """A column of the grid for one of its walkers, where they differ."""
        return (
            column.isel(walker=list(self.walkers).index(walker))
            if "walker" in column.dims
            else column
        )

    @property
    def axes(self) -> list[str]:
        """Dimensions of the grid, in order, without gait and multiplier."""
        return [
            str(d)
            for d in self.grid.dims
            if d in self.grid.coords and d not in ("gait", "multiplier", "key")
        ]

    @property
    def gaits(self) -> list[str]:
        """Labels along the grid's dimension `gait`."""
        return (
            [str(g) for g in self.grid["gait"].values]
            if "gait" in self.grid.coords
            else []
        )

    @property
    def statuses(self) -> dict[int, str]:
        """Status names by their flag value."""
        attrs = self.grid["status"].attrs if "status" in self.grid else {}
        values = np.atleast_1d(attrs.get("flag_values", []))
        return dict(
            zip(
                (int(v) for v in values),
                str(attrs.get("flag_meanings", "")).split(),
                strict=False,
            )
        )

    @property
    def reasons(self) -> list[str]:
        """The sentences that `reason` indexes."""
        return (
            list(map(str, self.grid["reason_text"].values))
            if "reason_text" in self.grid
            else []
        )

    def units(self, variable: str) -> str:
        """Units to print after a quantity; empty if it is dimensionless."""
        units = ""
        if variable in self.grid.variables:
            units = str(self.grid[variable].attrs.get("units", ""))
        elif variable == self.along:
            units = self._units_of_tables.get(variable, "")

        if not units and variable in ("slope", "stance_angle"):
            units = "rad"
        return print_units(units)

    @cached_property
    def _units_of_tables(self) -> dict[str, str]:
        """Units of the columns of tables, by the names of these."""
        found: dict[str, str] = {}
        for frame in self.tables.values():
            found |= frame.attrs.get("units", {})
        return found

    @property
    def along(self) -> str:
        """What gaits are followed along: the slope, or what drives at one."""
        return str(self.grid.attrs.get("along", "slope"))

    @property
    def words_along(self) -> dict[str, str]:
        """What gaits are followed along in the words of a figure: the title `x` of an
        axis, `axis`, `values` of it, and its `unit`.
        """
        name, unit = self.along, self.units(self.along)
        words = "slope" if name == "slope" else spaced(name)
        return {
            "x": titled(name, unit, words),
            "axis": words,
            "values": "slopes" if name == "slope" else words,
            "unit": f" {unit}" if unit else "",
        }

    def command(self, at: Mapping[str, Any]) -> str:
        """The `gaitsweep solve` command of a line, without the slope; that of one along
        what drives has its slope, and lacks the value of this, with which it ends.
        """
        command = self._command(at)
        if self.along in ("slope", *at) or "slope" not in at:
            return command
        return f"{command} --slope {float(at['slope'])!r} --set {self.along}="

    def _command(self, at: Mapping[str, Any]) -> str:
        """The command of a walker, without the slope and what drives at it."""
        walker, overrides = (
            at["walker"],
            {key: value for key, value in at.items() if key not in ("walker", "slope")},
        )
        table = self.study.get("walker")
        if isinstance(table, str):
            walker = table
        elif isinstance(table, dict):
            # Only numbers can be set on the command line; otherwise the study's file
            # serves as the walker's file.
            own = {k: v for k, v in table.items() if k not in ("base", self.along)}
            # Of a walker on its way to another the table's keys are those at one end.
            settable = (
                "base" in table
                and all(type(v) in (int, float) for v in own.values())
                and not self.toward
            )
            walker, overrides = (
                (str(table["base"]), own | overrides)
                if settable
                else (self.file, overrides)
            )

        words = ["gaitsweep", "solve", "--walker", walker]
        for key, value in overrides.items():
            words += [
                "--set",
                f"{key}={value!r}" if isinstance(value, float) else f"{key}={value}",
            ]

        return shlex.join([*words, *self._words_of_all])

    @property
    def _words_of_all(self) -> list[str]:
        """Words of the commands of all lines alike: toward which walker these lead, keys
        by which they are tuned, and steps.
        """
        words: list[str] = []
        if self.toward:
            words += [
                "--set",
                f"toward={self.toward if isinstance(self.toward, str) else toml.written(self.toward)}",
            ]

        words += [
            word
            for key in self.given("options", "tuned") or ()
            for word in ("--tuned", str(key))
        ]
        words += ["--steps", str(self.steps)] if self.steps > 1 else []
        return words

    def called(self, at: Mapping[str, Any]) -> str:
        """The named walker that a line is: its own where nothing is changed, or that
        whose foot mass ratio it has; empty if it is none.
        """
        given = self.study.get("walker")
        names = [name for name in _listed(given) if isinstance(name, str)]
        changed = [key for key in at if key not in ("walker", "slope")]
        if not changed:
            return str(at["walker"]) if at["walker"] in names else ""
        if changed == ["foot_mass_ratio"]:
            return self._of_ratios.get(float(at["foot_mass_ratio"]), "")

        return ""

    @cached_property
    def _of_ratios(self) -> dict[float, str]:
        """Walkers by the foot mass ratios of which the archive has them as a pair."""
        table = self.table("fits/transition_ratio", "pair", "foot_mass_ratios")
        if table is None or len(table) != 1:
            return {}
        ratios = str(table["foot_mass_ratios"].iloc[0]).split(" / ")
        pair = str(table["pair"].iloc[0]).split(" / ")
        return dict(zip(map(float, ratios), pair, strict=True))

    @cached_property
    def lines(self) -> list[Line]:
        """Every line of the grid, in grid order."""
        has_gaits = "slope" in self.grid.dims and "gait" in self.grid.dims
        return (
            list(self._lines())
            if has_gaits or self.table("branches", "branch", self.along) is not None
            else []
        )

    def _lines(self) -> Iterator[Line]:
        across = [d for d in self.axes if d != self.along]
        walkers, followed = (
            list(self.walkers),
            self.tables.get("branches", pd.DataFrame()),
        )
        for place in itertools.product(*(range(self.grid.sizes[d]) for d in across)):
            at = dict(zip(across, place, strict=True))
            settings = {
                d: float(self.grid[d].values[i]) for d, i in at.items() if d != "walker"
            }
            i = at.get("walker", 0)
            walker = (
                walkers[i]
                if i < len(walkers)
                else str(self.grid["walker"].values[i])
                if "walker" in at
                else ""
            )
            line = {"walker": walker, **settings}
            yield Line(
                line,
                self._label(line),
                self.command(line),
                rows_at(followed, line),
                self.grid.isel(at),
                self.called(line),
            )

    def _label(self, at: Mapping[str, Any]) -> str:
        """A line of the grid by the axes of several values; by its walker if there are
        several, or no such axes.
        """
        varying = {
            axis: value
            for axis, value in at.items()
            if axis != "walker" and self.grid.sizes[axis] > 1
        }
        is_named = self.grid.sizes.get("walker", 1) > 1 or not varying
        named = {"walker": at["walker"]} if is_named else {}
        return axis_values({**named, **varying})

    def label_among_lines(self, at: Mapping[str, Any]) -> str:
        """A line of the grid as `lines` labels it; empty where it is the only one."""
        across = [self.grid.sizes[d] for d in self.axes if d != self.along]
        return self._label(at) if math.prod(across) > 1 else ""

    def table(self, name: str, *columns: str) -> pd.DataFrame | None:
        """A table of the archive that has rows and the columns that a figure needs;
        None if there is none.
        """
        table = self.tables.get(name)
        return (
            table
            if table is not None and len(table) and set(columns) <= set(table.columns)
            else None
        )

    def line_of(self, rows: pd.DataFrame) -> dict[str, Any]:
        """The place of the line on which rows of a table lie."""
        settings = {
            c: float(rows[c].iloc[0]) for c in self.line_columns(rows) if c != "walker"
        }
        return {
            "walker": str(rows["walker"].iloc[0]) if "walker" in rows else self.walker,
            **settings,
        }

    def lines_of(self, table: pd.DataFrame) -> list[Line]:
        """Lines of a table, in its order, called by the values that differ between
        them: one alone by none.
        """
        columns = [c for c in self.line_columns(table) if table[c].nunique() > 1]
        lines = []
        for key, rows in (
            table.groupby(columns, sort=False) if columns else [((), table)]
        ):
            at, label = (
                self.line_of(rows),
                axis_values(dict(zip(columns, key, strict=True))),
            )
            line = Line(at, label, self.command(at), rows, called=self.called(at))
            lines.append(line)

        return lines

    def line_columns(self, table: pd.DataFrame) -> list[str]:
        """Columns of a table that identify the line of a row."""
        names = {"walker", *(self.given("axes") or ()), *self.axes} - {self.along}
        return [c for c in table.columns if c in names]


def read(path: Path) -> Source:
    """Read one archive.

    Raises
    ------
    ArchiveError
        If the file is missing, damaged, or not an archive of gaitsweep.
    """
    # Every variable is read once, from end to end: the default cache, 64 MiB per
    # variable, would only cost memory.
    netCDF4.set_chunk_cache(_CACHE)
    with archives.open_archive(path) as file:
        whole = dataset(file, **_AS_STORED)
        outcomes = whole[
            [name for name in ("status", "reason") if name in whole]
        ].load()
        grid = _thinned(whole).load()
        tables = {
            name: table(dataset(file[name], **_AS_STORED).load(), grid)
            for name in layout.tables(file)
        }

    with archives.blamed_if_damaged(path):
        provenance = json.loads(grid.attrs["provenance"])
        study = toml.read(provenance["study"])
        source = Source(path, grid, outcomes, tables, provenance, study, _run(path))
        for frame in tables.values():
            # In a study of one walker of its own, tables call it `walker`.
            if (
                source.walker
                and "walker" in frame
                and set(frame["walker"]) == {"walker"}
            ):
                frame["walker"] = source.walker

    return source


def _thinned(grid: xr.Dataset) -> xr.Dataset:
    """A grid at every n-th slope, so that a variable has at most about `MAX_POINTS`
    values.
    """
    points = math.prod(n for name, n in grid.sizes.items() if name in grid.coords)
    step = -(-points // MAX_POINTS)
    return (
        grid.isel(slope=slice(None, None, step))
        if step > 1 and "slope" in grid.dims
        else grid
    )


def _listed(given: Any) -> list[Any]:
    """The walkers that a study gives, one or several."""
    return given if isinstance(given, list) else [given]


def _name(walker: Any, place: int) -> str:
    """A walker's name in its study: that of the catalogue, the file or the table."""
    if isinstance(walker, dict):
        return str(walker.get("name", walker.get("base", f"walker {place + 1}")))
    return "walker" if walker is None else str(walker)


def _run(path: Path) -> dict[str, Any]:
    """The record of the run, from the companions of the archive; empty if there is none."""
    record = Companions(path).record
    try:
        fields = json.loads(record.read_text()) if record.is_file() else {}
    except (OSError, ValueError, RecursionError):
        return {}
    return fields if isinstance(fields, dict) else {}
