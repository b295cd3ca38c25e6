"""`gaitsweep prove`: proofs of a walker's gaits at one slope, or of an archive's."""

import argparse
import json
import sys
import warnings
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from gaitsweep.pipeline.archive import read
from gaitsweep.pipeline.dispatch import ask
from gaitsweep.pipeline.errors import ArchiveError, StudyError
from gaitsweep.pipeline.statuses import FOUND
from gaitsweep.pipeline.study import slopes, want
from gaitsweep.pipeline.study.location import Location
from gaitsweep.pipeline.study.single_point import check_driven, led
from gaitsweep.tasks.contract.registry import GAITS

#: Relative radii that may be asked for.
_LEAST, _MOST = 1e-30, 1e-6
#: Variables read for every gait, if the archive has them.
_VALUES = (
    "stance_angle",
    "stance_rate",
    "thigh_rate",
    "shank_rate",
    "kneestrike_time",
    "period",
    "error_bound",
)
_NEEDED = ("stance_angle", "stance_rate", "thigh_rate", "period", "error_bound")
#: Events of a step in words; strikes are called so.
_EVENTS = {"legs_pass": "the legs pass", "knee_flexes": "the knee flexes"}
#: Whether a gait was proved to be stable, in words.
_STABILITY = {True: "stable", False: "unstable", None: "stability not shown"}
#: Seed of the draw that `--sample` makes.
_DRAW = 0


def run(options: argparse.Namespace) -> int:
    """Prove what the options request and print it; returns the exit code."""
    _check(options)
    if options.archive:
        answer = _of_archive(options)
    else:
        answer = _of_walker(options)

    gaits = []
    for gait in answer["gaits"]:
        gaits.append(gait)
        if not options.json:
            print(_shown(gait), flush=True)

    if not gaits:
        search = "\n".join(answer["search"])
        why = answer["others"] or search or "The archive holds no gait."
        print(why, file=sys.stderr)

    if options.json:
        print(json.dumps(gaits))
    return 0 if gaits and all(gait["proved"] for gait in gaits) else 1


def _check(options: argparse.Namespace) -> None:
    """Refuse options that contradict each other, and an accuracy beyond its limits."""
    of_archive, of_walker = options.archive is not None, options.walker is not None
    if of_archive == of_walker or of_walker != (options.slope is not None):
        raise StudyError(
            "Prove either the gaits of an archive, or those of a `--walker` on a `--slope`."
        )

    foreign, whose = ["sample"], "an archive"
    if of_archive:
        foreign, whose = ["set", "gait"], "a `--walker`"
    for name in foreign:
        if getattr(options, name):
            raise StudyError(f"`--{name}` goes with {whose}.")

    want.need_proofs(Location("", "proofs"))
    if not _LEAST <= options.accuracy <= _MOST:
        bounds = f"must lie in [{_LEAST:g}, {_MOST:g}]"
        raise Location("", "accuracy").wrong(bounds, options.accuracy)


def _of_walker(options: argparse.Namespace) -> dict[str, Any]:
    """Proofs of a walker's gaits at one slope, and the search for them; numbers are the
    decimals written.
    """
    slope, gait = options.slope, options.gait
    slopes.check(float(slope), may_be_level=True)
    Location("", "gait").check_names([] if gait is None else [gait], GAITS)
    known, given = led(options.walker, options.set)
    ask("check_walker", {"walker": known})
    check_driven(known, {k: _number(v) for k, v in given.items()}, float(slope))
    table, changes = led(options.walker, options.set, str)  # with every digit
    wanted = {"set": changes, "gait": gait, "accuracy": options.accuracy}
    answer: dict[str, Any] = ask("prove", {"walker": table, "slope": slope, **wanted})
    return answer


def _number(value: Any) -> Any:
    """A key's value in doubles; a text that is none, as it stands."""
    try:
        return float(value)
    except (TypeError, ValueError):
        return value


def _of_archive(options: argparse.Namespace) -> dict[str, Any]:
    """Proofs of the gaits in an archive, in its order, each with `at`, where it stands."""
    # Where joblib cannot make semaphores, proofs are made one after the other.
    warnings.filterwarnings(
        "ignore", ".*joblib will operate in serial mode", UserWarning
    )
    from joblib import Parallel, delayed

    read.probe([options.archive])
    stored = _stored(options.archive, options.sample)
    wanted = [{**gait, "accuracy": options.accuracy} for gait in stored]
    jobs = min(options.jobs, max(1, len(wanted)))
    parallel = Parallel(n_jobs=jobs, return_as="generator", batch_size=1)
    proofs = parallel(delayed(ask)("prove_stored", gait) for gait in wanted)
    pairs = zip(wanted, proofs, strict=True)
    found = ({"at": gait["at"], **proof} for gait, proof in pairs)
    return {"gaits": found, "search": (), "others": ""}


def _stored(path: Path, sample: int | None) -> Iterator[dict[str, Any]]:
    """Every converged gait of an archive as the parameters of its proof."""
    with read.open_archive(path) as file:
        _check_gaits(file, path)
        walkers, varied = _walkers(file, path)
        names = [name for name in _VALUES if name in file.variables]
        if "kneestrike_time" not in names and all(map(_has_knees, walkers)):
            raise ArchiveError(
                f"{path} holds no gaits to prove: with knees it needs kneestrike_time, which it has not."
            )

        dims = file["status"].dimensions
        coordinates = {dim: file[dim][...].tolist() for dim in dims}
        if not np.isfinite(np.array(coordinates["slope"], float)).all():
            raise ArchiveError(f"{path} has a slope that is no number.")

        for index in _places(np.ma.getdata(file["status"][...]), sample):
            place = dict(zip(dims, index, strict=True))
            at = {dim: coordinates[dim][i] for dim, i in place.items()}
            yield {
                "at": at,
                "walker": walkers[place.get("walker", 0)],
                "set": _moved(varied, place),
                "slope": at["slope"],
                "gait": at["gait"],
                "values": _numbers(file, names, index),
            }


def _moved(varied: Mapping[str, Any], place: Mapping[str, int]) -> dict[str, float]:
    """Keys that vary, at a place of the grid: what an axis such as `detuning` moves is
    stored key by key.
    """
    moved = {}
    for key, values in varied.items():
        on_its_axes = tuple(place[dim] for dim in values.dimensions)
        moved[key] = float(values[on_its_axes])
    return moved


def _numbers(file: Any, names: list[str], index: tuple[int, ...]) -> dict[str, float]:
    """Values of some variables at a place of the grid, NaN where there is none."""
    return {name: float(np.ma.filled(file[name][index], np.nan)) for name in names}


def _check_gaits(file: Any, path: Path) -> None:
    """Refuse an archive without gaits of one step.

    Raises
    ------
    ArchiveError
    """
    missing = [name for name in ("status", *_NEEDED) if name not in file.variables]
    if missing or "gait" not in file.dimensions:
        lacking = missing[0] if missing else "gait"
        raise ArchiveError(f"{path} holds no gaits to prove: it has no {lacking}.")

    if "steps" in file.ncattrs():
        raise ArchiveError(
            f"{path} holds gaits of {file.steps} steps; proofs are of gaits of one step."
        )


def _walkers(
    file: Any, path: Path
) -> tuple[list[str | dict[str, Any]], dict[str, Any]]:
    """The walkers of an archive, and the variables of keys that vary over its axes.

    Raises
    ------
    ArchiveError
        If it does not say so.
    """
    dims = {*file["status"].dimensions}
    try:
        provenance = json.loads(file.provenance)
        varied = {key: file[key] for key in provenance["varied"]}
        count = file.dimensions["walker"].size if "walker" in dims else 1
        walkers = [provenance["walkers"][k] for k in range(count)]
        if any({*values.dimensions} - dims for values in varied.values()):
            raise ValueError
        if not all(isinstance(walker, str | dict) for walker in walkers):
            raise ValueError
    except (ValueError, LookupError, TypeError) as error:
        raise ArchiveError(f"{path} does not say which walker it is of.") from error

    return walkers, varied


def _has_knees(walker: str | dict[str, Any]) -> bool:
    """Whether a table of a walker is of one with knees; names are not asked."""
    return isinstance(walker, dict) and bool(walker.get("knees", True))


def _places(status: np.ndarray, sample: int | None) -> list[tuple[int, ...]]:
    """Places of the gaits that were found, or of some of them drawn by lot."""
    places = np.argwhere(np.isin(status, FOUND))
    if sample is not None and sample < len(places):
        dice = np.random.default_rng(_DRAW)
        drawn = dice.choice(len(places), sample, replace=False)
        places = places[np.sort(drawn)]
    return [tuple(place) for place in places.tolist()]


def _shown(proof: Mapping[str, Any]) -> str:
    """One proof in words, on one line."""
    at = proof.get("at", {"slope": proof["exact_slope"]})
    places = [f"{key} {value}" for key, value in at.items() if key != "gait"]
    head = ", ".join([f"{proof['gait'].capitalize()} gait", *places])
    if not proof["proved"]:
        return f"{head}: not proved. {proof['reason']}"

    stable = _STABILITY[proof["stable"]]
    middle, radius = proof["box"]["stance_angle"]
    events = ", then ".join(_EVENTS.get(event, event) for event in proof["events"])

    return (
        f"{head}: proved, {stable}. Stance angle {middle} +- {radius} rad, in a box of relative radius"
        f" {proof['radius']:.1e} that holds exactly one gait; {events} ({proof['bits']} bits)."
    )
