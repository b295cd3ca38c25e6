"""Read archives with care: is one ours, is it whole, and how do two differ."""

from __future__ import annotations

import contextlib
import json
import subprocess
import sys
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from pipeline import grid
from pipeline.errors import ArchiveError, GaitsweepError
from pipeline.worker import ALL_STATUSES
from tasks.registry import ALWAYS, GAITS, VARIABLES

SCHEMA = 1
_PATIENCE, _PACE = 30.0, 5e6  # s, and byte per s, that reading an archive may take
_ROWS = 1 << 20  # values read at a time
Pair = tuple[np.ndarray, np.ndarray]
_ATTRIBUTES = ("Conventions", "title", "institution", "source", "history", "references", "provenance", "study", "kind",
               "checksums")
#: Variables that measure rounding, relative to what they speak of: a tolerance is held against their difference.
_ROUNDING = ("residual", "error_bound", "energy_imbalance")


@contextlib.contextmanager
def opened(path: Path) -> Iterator[Any]:
    """An archive of this schema, open for reading.

    Raises
    ------
    ArchiveError
        If it cannot be read or is none of ours.
    """
    import netCDF4

    if not path.is_file():
        raise ArchiveError(f"There is no archive {path}.")
    try:
        file = netCDF4.Dataset(path)
    except (OSError, RuntimeError, ValueError) as error:
        raise ArchiveError(f"{path} is no netCDF file that can be read.") from error
    try:
        schema = getattr(file, "gaitsweep_schema", None)
        if not isinstance(schema, np.integer) or schema != SCHEMA:
            raise ArchiveError(f"{path} is not an archive of gaitsweep (schema {SCHEMA}).")
        try:
            yield file
        except GaitsweepError:
            raise
        except Exception as error:
            # Where the file is as it was written, whatever else goes wrong is a bug of ours.
            found = _line(error) if _unread(error) else next(_torn(file), "")
            if not found:
                raise
            raise ArchiveError(f"{path} is damaged: {found.rstrip('.')}.") from error
    finally:
        with contextlib.suppress(RuntimeError):
            file.close()


def _unread(error: Exception) -> bool:
    """Whether an exception is the netCDF library's: it could not read, or what it read is no text."""
    return isinstance(error, OSError | UnicodeDecodeError) or str(error).startswith("NetCDF:")


def _torn(file: Any) -> Iterator[str]:
    """What is not as its checksum says, one sentence each; empty where the file is as it was written."""
    try:
        sums = json.loads(file.checksums)
        for name in sums:
            try:
                if _checksum(file[name]) != sums[name]:
                    yield f"`{name}` is not as it was written."
            except (IndexError, KeyError):
                yield f"`{name}` is missing."
    except Exception as error:
        yield f"its checksums cannot be checked, {_line(error)}."


def _checksum(variable: Any) -> int:
    """Checksum of a variable as the archive keeps it: the sum of its boxes'."""
    sizes = dict(zip(variable.dimensions, variable.shape, strict=True))
    large = "gait" in sizes and len(sizes) > 1
    boxes = grid.boxes({d: n for d, n in sizes.items() if d not in ("gait", "multiplier")}) if large else [()]
    return sum(grid.checksum(np.ma.getdata(variable[box] if large else variable[...]), box) for box in boxes) % 2**32


def tables(place: Any, path: str = "") -> Iterator[str]:
    """Names of the tables in an open archive, as "fits/scaling"."""
    for name, group in place.groups.items():
        if group.variables:
            yield f"{path}{name}"
        yield from tables(group, f"{path}{name}/")


def columns(place: Any) -> Iterator[str]:
    """Names of all columns of tables, as "fits/scaling/exponent"."""
    for name, group in place.groups.items():
        yield from (f"{name}/{column}" for column in (*group.variables, *columns(group)))


def probe(paths: Iterable[Path]) -> None:
    """Let another process read the archives whole first: a mangled file can crash or hang the netCDF library.

    Raises
    ------
    ArchiveError
        If one does.
    """
    for path in paths:
        size = path.stat().st_size if path.is_file() else 0
        command = [sys.executable, "-P", "-m", "pipeline.check", str(path)]
        try:
            done = subprocess.run(command, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL,
                                  stderr=subprocess.DEVNULL, timeout=_PATIENCE + size / _PACE)
        except subprocess.TimeoutExpired as error:
            raise ArchiveError(f"{path} is damaged: the netCDF library does not come back from it.") from error
        if done.returncode:
            raise ArchiveError(f"{path} is damaged: the netCDF library does not survive it.")


def _read_whole(path: Path) -> None:
    """Read all there is; what can be caught is left to those who read in earnest."""
    with contextlib.suppress(Exception), opened(path) as file:
        places = [file]
        for place in places:
            for variable in place.variables.values():
                with contextlib.suppress(Exception):
                    rows = max(1, _ROWS // max(1, int(np.prod(variable.shape[1:]))))
                    for start in range(0, variable.shape[0] if variable.shape else 1, rows):
                        variable[start:start + rows] if variable.shape else variable[...]
            places += place.groups.values()


def _line(error: Exception) -> str:
    return " ".join(str(error).split())[:200] or type(error).__name__


def ours(path: Path) -> None:
    """Check that `path` may be replaced by an archive of ours."""
    try:
        with opened(path):
            pass
    except ArchiveError as error:
        raise ArchiveError(f"{str(error).rstrip('.')}; move it away.") from error


def not_attempted(path: Path) -> int | None:
    """How many points of an archive were not come to; None where there is none."""
    try:
        with opened(path) as file:
            return int(file.not_attempted)
    except (ArchiveError, ValueError, TypeError, AttributeError):
        return None


def verify(path: Path) -> list[str]:
    """What is wrong with an archive, one sentence each; empty if it is whole, complete and of this schema."""
    with opened(path) as file:
        return [*_heads(file), *_states(file), *_values(file), *_groups(file)]


def _heads(file: Any) -> Iterator[str]:
    for name in _ATTRIBUTES:
        if not isinstance(getattr(file, name, None), str):
            yield f"The attribute `{name}` is missing."
    try:
        if not isinstance(json.loads(file.provenance), dict):
            raise ValueError
    except (AttributeError, ValueError, RecursionError):
        yield "`provenance` is not JSON."
    for name in (*(ALWAYS if getattr(file, "kind", "grid") == "grid" else ("status", "reason")), "reason_text"):
        if name not in file.variables:
            yield f"`{name}` is missing."
    order = list(file.dimensions)
    for name, variable in file.variables.items():
        if [order.index(d) for d in variable.dimensions] != sorted({order.index(d) for d in variable.dimensions}):
            yield f"`{name}` has its dimensions in another order."
        for attribute in ("long_name", "units"):
            if attribute not in variable.ncattrs():
                yield f"`{name}` has no {attribute}."
    for name in file.dimensions:
        if name not in file.variables and name != "reason_index":
            yield f"The dimension `{name}` has no coordinate."


def _states(file: Any) -> Iterator[str]:
    if not {"status", "reason", "reason_text"} <= set(file.variables):
        return
    status, reason = np.asarray(file.variables["status"][...]), np.asarray(file.variables["reason"][...])
    if not np.isin(status, list(ALL_STATUSES.values())).all():
        yield "`status` holds values without a meaning."
    if reason.size and not (reason.min() >= 0 and reason.max() < len(file.dimensions["reason_index"])):
        yield "`reason` points outside its table."
    left = int(np.count_nonzero(status == ALL_STATUSES["not_attempted"]))
    if left:
        yield f"It is not complete: {left:,} values of `status` are not_attempted."
    if "gait" in file.variables and not set(file.variables["gait"][...].tolist()) <= set(GAITS):
        yield "`gait` holds unknown names."


def _values(file: Any) -> Iterator[str]:
    """Read every value, so that every checksum is checked; a number stands only where something converged."""
    sums = json.loads(getattr(file, "checksums", "{}"))
    tabled = list(columns(file))
    held = {*file.variables, *tabled}
    yield from (f"`{name}` is missing." for name in sums if name not in held)
    for name in tabled:
        if grid.checksum(np.ma.getdata(file[name][...])) % 2**32 != sums.get(name) and name in sums:
            yield f"`{name}` is not as it was written."
    for name, variable in file.variables.items():
        about, sizes = VARIABLES.get(name), dict(zip(variable.dimensions, variable.shape, strict=True))
        wrong = total = 0
        large = "gait" in sizes and name != "gait"
        places = grid.boxes({d: n for d, n in sizes.items() if d not in ("gait", "multiplier")}) if large else [()]
        for box in places:
            values = np.ma.getdata(variable[box] if large else variable[...])
            total += grid.checksum(values, box)
            if large and about and about.dtype == "f8":
                other = np.asarray(file.variables["status"][box]) != ALL_STATUSES["converged"]
                wrong += int(np.count_nonzero(~np.isnan(values[other])))
        if total % 2**32 != sums.get(name):
            yield f"`{name}` is not as it was written."
        if wrong:
            yield f"`{name}` has {wrong:,} values where nothing converged."


def _groups(place: Any, path: str = "") -> Iterator[str]:
    for name, group in place.groups.items():
        for column, variable in group.variables.items():
            if "units" not in variable.ncattrs() or "long_name" not in variable.ncattrs():
                yield f"`{path}/{name}/{column}` has no units or long_name."
        yield from _groups(group, f"{path}/{name}")


@dataclass(frozen=True)
class Tolerance:
    """Relative tolerance of every variable, and of some by name."""

    rtol: float
    own: Mapping[str, float]

    def of(self, name: str) -> float | None:
        """Relative tolerance of a variable; None where it is one of its own size, as `rtol` is."""
        if name in self.own:
            return self.own[name]
        return None if name.rpartition("/")[2] in _ROUNDING else self.rtol


def diff(a: Path, b: Path, rtol: float = 0.0, own: Mapping[str, float] | None = None) -> list[str]:
    """How archive `b` differs from `a`, one sentence each, aligned by coordinates.

    Numbers are equal if they differ by at most `rtol` times the larger, or `own[name]` where a variable or a column
    "group/column" has a tolerance of its own; parts of an eigenvalue are held against its magnitude, and what measures
    rounding, itself relative, against one.

    Raises
    ------
    ArchiveError
        If `own` names what neither archive holds.
    """
    within = Tolerance(rtol, own or {})
    with opened(a) as left, opened(b) as right:
        found = [f"the {what} differs: {getattr(left, what, None)} and {getattr(right, what, None)}"
                 for what in ("kind",) if getattr(left, what, None) != getattr(right, what, None)]
        places: dict[str, Pair] = {}
        for name in sorted(set(left.dimensions) | set(right.dimensions)):
            if name == "reason_index":
                continue
            if name not in left.dimensions or name not in right.dimensions:
                found.append(f"the dimension `{name}` is only in {a if name in left.dimensions else b}")
                continue
            places[name], sentences = _aligned(name, left, right, a, b)
            found += sentences
        for name in sorted(set(left.variables) | set(right.variables)):
            if name in left.dimensions or name in right.dimensions or name == "reason_text":
                continue
            if name not in left.variables or name not in right.variables:
                found.append(f"`{name}` is only in {a if name in left.variables else b}")
            elif set(left.variables[name].dimensions) <= set(places):
                found += _compare(name, left, right, places, within)
        shared = {name: np.ma.getdata(left.variables[name][...])[pair[0]] for name, pair in places.items()}
        found += _compare_groups(left, right, within, shared, a, b)
        known = {name for file in (left, right) for name in (*file.variables, *columns(file))}
        for name in within.own:
            if name not in known:
                raise ArchiveError(f"Neither {a} nor {b} holds `{name}`.")
        return found


def _aligned(name: str, left: Any, right: Any, a: Path, b: Path) -> tuple[Pair, list[str]]:
    """Positions of the coordinates both have, and what only one has."""
    x, y = np.ma.getdata(left.variables[name][...]), np.ma.getdata(right.variables[name][...])
    if x.dtype.kind == "O" or y.dtype.kind == "O":
        x, y = x.astype(str), y.astype(str)
    _, i, j = np.intersect1d(x, y, return_indices=True)
    order = np.argsort(i)
    sentences = [f"{len(one) - len(i):,} of {len(one):,} values of `{name}` are only in {where}"
                 for one, where in ((x, a), (y, b)) if len(one) > len(i)]
    return (i[order], j[order]), sentences


def _compare(name: str, left: Any, right: Any, places: dict[str, Pair], within: Tolerance) -> list[str]:
    dims = left.variables[name].dimensions
    if right.variables[name].dimensions != dims:
        return [f"`{name}` has other dimensions"]
    units = [getattr(file.variables[name], "units", None) for file in (left, right)]
    if units[0] != units[1]:
        return [f"`{name}` is in {units[0]} and in {units[1]}"]
    x, y = (np.ma.getdata(file.variables[name][...])[np.ix_(*(places[d][k] for d in dims))]
            for k, file in enumerate((left, right)))
    x, y = np.atleast_1d(x), np.atleast_1d(y)  # of a single line: numbers
    if name == "reason":
        x, y = (np.ma.getdata(f.variables["reason_text"][...]).astype(str)[v] for f, v in ((left, x), (right, y)))
    elif name == "status":
        return _compare_status(x, y)
    scale = None
    if name in ("multiplier_real", "multiplier_imag") and {"multiplier_real", "multiplier_imag"} <= set(left.variables):
        real, imag = (np.ma.getdata(left.variables[f"multiplier_{part}"][...]) for part in ("real", "imag"))
        scale = np.hypot(real, imag)[np.ix_(*(places[d][0] for d in dims))]
    return _different(name, x, y, within, scale)


def _compare_status(x: np.ndarray, y: np.ndarray) -> list[str]:
    names = {code: name for name, code in ALL_STATUSES.items()}
    pairs, counts = np.unique(np.stack([x[x != y], y[x != y]]), axis=1, return_counts=True)
    return [f"`status`: {n:,} were {names.get(int(p), p)} and are {names.get(int(q), q)}"
            for (p, q), n in zip(pairs.T, counts, strict=True)]


def _different(name: str, x: np.ndarray, y: np.ndarray, within: Tolerance, scale: np.ndarray | None = None
               ) -> list[str]:
    if x.shape != y.shape:
        return [f"`{name}` has {x.size:,} values and {y.size:,}"]
    if x.dtype.kind != "f" or y.dtype.kind != "f":
        unequal = x.astype(str) != y.astype(str) if "O" in (x.dtype.kind, y.dtype.kind) else x != y
        return [f"`{name}`: {np.count_nonzero(unequal):,} of {x.size:,} differ"] if unequal.any() else []
    rtol = within.of(name)
    with np.errstate(invalid="ignore", divide="ignore"):
        size = np.maximum(np.abs(x), np.abs(y)) if scale is None else scale
        if rtol is None:
            rtol, size = within.rtol, np.ones(x.shape)
        gap = np.abs(x - y)
        unequal = ~((gap <= rtol * size) | (x == y) | (np.isnan(x) & np.isnan(y)))
        worst = np.max(np.where(unequal & np.isfinite(gap) & (size > 0), gap / size, 0.0), initial=0.0)
    if not unequal.any():
        return []
    return [f"`{name}`: {np.count_nonzero(unequal):,} of {x.size:,} differ, by up to {worst:.2g} of their size"]


def _compare_groups(left: Any, right: Any, within: Tolerance, shared: dict[str, np.ndarray], a: Path, b: Path,
                    path: str = "") -> list[str]:
    """How the tables differ on the lines both archives have; `shared` holds the coordinates of those."""
    found = []
    for name in sorted(set(left.groups) | set(right.groups)):
        place = f"{path}/{name}"
        if name not in left.groups or name not in right.groups:
            found.append(f"the group {place} is only in {a if name in left.groups else b}")
            continue
        one, two = left.groups[name], right.groups[name]
        rows = [_rows_of(group, shared) for group in (one, two)]
        for column in sorted(set(one.variables) | set(two.variables)):
            if column not in one.variables or column not in two.variables:
                found.append(f"`{place}/{column}` is only in {a if column in one.variables else b}")
            else:
                x, y = (np.ma.getdata(g.variables[column][...])[kept] for g, kept in zip((one, two), rows, strict=True))
                found += _different(f"{place}/{column}".lstrip("/"), x, y, within)
        found += _compare_groups(one, two, within, shared, a, b, place)
    return found


def _rows_of(group: Any, shared: dict[str, np.ndarray]) -> np.ndarray:
    """Rows of a table whose line both archives have."""
    rows = np.ones(len(group.dimensions["row"]) if "row" in group.dimensions else 0, bool)
    for name, values in shared.items():
        # A column `slope` may hold slopes of its own: along a branch, of a fold.
        if name in group.variables and name not in ("slope", "gait", "multiplier"):
            rows &= np.isin(np.ma.getdata(group.variables[name][...]).astype(values.dtype), values)
    return rows


if __name__ == "__main__":
    _read_whole(Path(sys.argv[1]))
