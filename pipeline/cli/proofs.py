"""Proofs of a walker's gaits at one slope, of the gaits in an archive, and certificates."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.archive import read
from pipeline.dispatch import ask
from pipeline.errors import ArchiveError
from pipeline.statuses import FOUND
from pipeline.study import files, parse, slopes
from pipeline.study.location import Location
from tasks.registry import GAITS

#: Relative radii that may be asked for.
LEAST, MOST = 1e-30, 1e-6
#: Variables read for every gait, if the archive has them.
_VALUES = ("stance_angle", "stance_rate", "thigh_rate", "shank_rate", "kneestrike_time", "period", "error_bound")
_NEEDED = ("stance_angle", "stance_rate", "thigh_rate", "period", "error_bound")
#: Seed of the draw that `--sample` makes.
_DRAW = 0


def ready(accuracy: float) -> None:
    """Check that proofs can be made, and to that accuracy.

    Parameters
    ----------
    accuracy : float
        Largest relative radius.

    Raises
    ------
    StudyError
        If the extra is not installed, or the accuracy is out of range.
    """
    parse.need_proofs(Location("", "proofs"))
    if not LEAST <= accuracy <= MOST:
        raise Location("", "accuracy").wrong(f"must lie in [{LEAST:g}, {MOST:g}]", accuracy)


def of_walker(
    one: str, slope: str, keys: Mapping[str, str | bool], gait: str | None, accuracy: float
) -> dict[str, Any]:
    """Proofs of a walker's gaits at one slope; numbers are the decimals written.

    Parameters
    ----------
    one : str
        A name or a file.
    slope : str [rad]
    keys : mapping
        Keys to change.
    gait : str or None
        The one label wanted.
    accuracy : float
        Largest relative radius.

    Returns
    -------
    dict
        `gaits` and `search`.

    Raises
    ------
    StudyError
        If there is no such walker, key, slope or gait.
    """
    ready(accuracy)
    if not slopes.is_slope(float(slope)):
        raise Location("", "slope").wrong(slopes.BOUND, float(slope))
    if gait is not None and gait not in GAITS:
        raise Location("", "gait").unknown(gait, GAITS)
    table = files.walker(one, Path())
    ask("check_walker", {"walker": table})
    table = files.walker(one, Path(), number=str)  # with every digit
    return ask("prove", {"walker": table, "slope": slope, "set": dict(keys), "gait": gait, "accuracy": accuracy})


def of_archive(path: Path, sample: int | None, accuracy: float, jobs: int) -> Iterator[dict[str, Any]]:
    """Proofs of the gaits in an archive, in the archive's order.

    Parameters
    ----------
    path : Path
    sample : int or None
        Prove only this many, a fixed draw.
    accuracy : float
        Largest relative radius.
    jobs : int
        Processes.

    Yields
    ------
    dict
        One gait, with `at`, where it stands.

    Raises
    ------
    ArchiveError
        If it holds no gaits to prove.
    StudyError
        As `ready`.
    """
    from joblib import Parallel, delayed

    ready(accuracy)
    read.probe([path])
    wanted = list(_stored(path, sample))
    run = Parallel(n_jobs=min(jobs, max(1, len(wanted))), return_as="generator", batch_size=1)
    for item, proof in zip(wanted, run(delayed(_proved)({**w, "accuracy": accuracy}) for w in wanted), strict=True):
        yield {"at": item["at"], **proof}


def _proved(params: dict[str, Any]) -> dict[str, Any]:
    return ask("prove_stored", params)


def _stored(path: Path, sample: int | None) -> Iterator[dict[str, Any]]:
    """Every converged gait of an archive as the parameters of its proof."""
    with read.open_archive(path) as file:
        missing = [name for name in ("status", *_NEEDED) if name not in file.variables]
        if missing or "gait" not in file.dimensions:
            raise ArchiveError(f"{path} holds no gaits to prove: it has no {missing[0] if missing else 'gait'}.")
        if "steps" in file.ncattrs():
            raise ArchiveError(f"{path} holds gaits of {file.steps} steps; proofs are of gaits of one step.")
        dims, names = file["status"].dimensions, [n for n in _VALUES if n in file.variables]
        try:
            provenance = json.loads(file.provenance)
            tables, varied = provenance["walkers"], {key: file[key] for key in provenance["varied"]}
            walkers = [tables[k] for k in range(file.dimensions["walker"].size if "walker" in dims else 1)]
            lost = [key for key, values in varied.items() if not {*values.dimensions} <= {*dims}]
            if lost or not all(isinstance(walker, str | dict) for walker in walkers):
                raise ValueError(lost)
        except (ValueError, LookupError, TypeError) as error:
            raise ArchiveError(f"{path} does not say which walker it is of.") from error
        if "kneestrike_time" not in names and all(isinstance(w, dict) and w.get("knees", True) for w in walkers):
            raise ArchiveError(
                f"{path} holds no gaits to prove: with knees it needs kneestrike_time, which it has not."
            )
        status = np.ma.getdata(file["status"][...])
        places = np.argwhere(np.isin(status, FOUND))
        if sample is not None and sample < len(places):
            places = places[np.sort(np.random.default_rng(_DRAW).choice(len(places), sample, replace=False))]
        coordinates = {d: file[d][...] for d in dims}
        if not np.isfinite(np.ma.filled(coordinates["slope"], np.nan)).all():
            raise ArchiveError(f"{path} has a slope that is no number.")
        for index in map(tuple, places.tolist()):
            at = {d: _item(coordinates[d][i]) for d, i in zip(dims, index, strict=True)}
            place = dict(zip(dims, index, strict=True))
            yield {
                "at": at,
                "walker": walkers[place.get("walker", 0)],
                # What an axis such as `detuning` moves is stored key by key.
                "set": {
                    key: float(values[tuple(place[d] for d in values.dimensions)]) for key, values in varied.items()
                },
                "slope": at["slope"],
                "gait": at["gait"],
                "values": {n: float(np.ma.filled(file[n][index], np.nan)) for n in names},
            }


def _item(value: Any) -> Any:
    return value.item() if isinstance(value, np.generic) else value


def shown(proof: Mapping[str, Any]) -> str:
    """One proof on one line.

    Parameters
    ----------
    proof : mapping
        As `walker` and `archive` give it.

    Returns
    -------
    str
    """
    at = " ".join(
        f"{k}={v}" for k, v in proof.get("at", {"slope": proof["exact_slope"], "gait": proof["gait"]}).items()
    )
    if not proof["proved"]:
        return f"{at}: not proved. {proof['reason']}"
    stable = {True: "stable", False: "unstable", None: "stability not shown"}[proof["stable"]]
    middle, radius = proof["box"]["stance_angle"]
    return (
        f"{at}: proved, {stable}; stance angle {middle} +- {radius} rad, radius {proof['radius']:.1e},"
        f" {', '.join(proof['events'])} ({proof['bits']} bits)"
    )


def certificates(folder: Path, only: Sequence[str] = (), jobs: int = 2) -> Iterator[Path]:
    """Prove the project's statements and write a certificate of each.

    Parameters
    ----------
    folder : Path
    only : sequence of str
        Names of some; omitted: all.
    jobs : int
        Processes.

    Yields
    ------
    Path

    Raises
    ------
    NotProvedError
        If one is not proved; its certificate stays as it was.
    """
    from joblib import Parallel, delayed

    ready(MOST)
    folder.mkdir(parents=True, exist_ok=True)
    wanted = [{"name": name} for name in only or ask("certificates", {})]
    run = Parallel(n_jobs=jobs, return_as="generator_unordered", batch_size=1)
    for certificate in run(delayed(ask)("certify", params) for params in wanted):
        path = folder / f"{certificate['name']}.json"
        path.write_text(_laid_out(certificate), encoding="utf-8")
        yield path


def _laid_out(certificate: Mapping[str, Any]) -> str:
    """A certificate with a key to a line."""
    rows = []
    for key, value in certificate.items():
        text = json.dumps(value)
        if isinstance(value, dict):
            text = "{\n  " + ",\n  ".join(f"{json.dumps(k)}: {json.dumps(v)}" for k, v in value.items()) + "\n }"
        rows.append(f" {json.dumps(key)}: {text}")
    return "{\n" + ",\n".join(rows) + "\n}\n"


if __name__ == "__main__":
    for written in certificates(Path(sys.argv[1]), sys.argv[2:]):
        print(written, flush=True)
