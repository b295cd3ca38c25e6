"""`gaitsweep claims`: what the paper says, the computed number and the verdict."""

import argparse
import contextlib
import json
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

from gaitsweep.pipeline import terminal
from gaitsweep.pipeline.archive import provenance, read
from gaitsweep.pipeline.companions import ARCHIVES
from gaitsweep.pipeline.dispatch import ask
from gaitsweep.pipeline.errors import ArchiveError, StudyError
from gaitsweep.tasks.contract.registry import CLAIMS, TASKS


def run(options: argparse.Namespace) -> int:
    """Print the results of claims in the order of the paper, each as soon as it is
    known; returns the exit code.

    The first ones take a second or two; those of its appendix need all gaits with
    knees.

    Results in archives of `data/archive` of the present versions of all tasks are not
    computed again.

    Raises
    ------
    StudyError
        If there is no such claim.
    """
    ids = options.ids
    unknown = [name for name in ids if name not in CLAIMS]
    if unknown:
        raise StudyError(
            f"There is no claim {unknown[0]!r}; there are {', '.join(CLAIMS)}."
        )

    results = _results(name for name in CLAIMS if not ids or name in ids)
    if options.json:
        print(json.dumps(list(results)))
        return 0

    for claim in results:
        print("\n".join(_lines(claim)), flush=True)
    return 0


def _results(ids: Iterable[str]) -> Iterator[dict[str, Any]]:
    """Results of claims: from the archives of studies that check them, all others
    computed.
    """
    archives = {
        name: path
        for path in sorted(ARCHIVES.glob("*.nc"))
        for name in _claims_of(path)
    }
    tables: dict[Path, dict[str, dict[str, Any]]] = {}
    for name in ids:
        path = archives.get(name)
        if path and path not in tables:
            tables[path] = _table(path)
            terminal.say(
                f"Claims are read from {path}; `run --fresh` of its study computes them again."
            )

        if path and name in tables[path]:
            yield tables[path][name]
        else:
            yield ask("claims", {"ids": [name]})[0]


def _claims_of(path: Path) -> list[str]:
    """Claims that a study checks, if its archive was written by the present versions of
    its tasks.
    """
    record = provenance.stored(path)
    with contextlib.suppress(
        AttributeError, LookupError, TypeError
    ):  # of a record that somebody else made
        versions = record["tasks"]
        if "claims" in versions and all(
            TASKS[name].version == version for name, version in versions.items()
        ):
            return [
                name for name in record["table"]["want"]["claims"] if name in CLAIMS
            ]

    return []


def _table(path: Path) -> dict[str, dict[str, Any]]:
    """The ledger of an archive by claim, NaN as None; empty if it cannot be read."""
    from gaitsweep.pipeline.api.studies import load

    try:
        read.probe([path])
        rows = load(path, "claims").to_dict("records")
    except ArchiveError as error:
        terminal.say(f"gaitsweep: {error}")
        return {}

    claims = {}
    for row in rows:
        claims[row["id"]] = {k: None if v != v else v for k, v in row.items()}
    return claims


def _lines(claim: dict[str, Any]) -> Iterator[str]:
    """Result of a claim, a paragraph: the paper's words, the printed and the computed
    number, the verdict.
    """
    yield f"{claim['id']}: {claim['verdict']}"
    yield f'  the paper   "{claim["quotation"]}" ({claim["source"]})'
    # The claim's own number alone would have no name: it stands beside the printed one.
    if claim["printed_value"] is not None and claim["value"] is not None:
        half = claim["printed_half_unit"]
        margin = f" +- {half:.2g}" if half else ""
        yield f"  printed     {claim['printed_value']:.6g}{margin}"
        allowed = ""
        if claim["interval"]:
            interval = claim["interval"]
            allowed = f" (rounding of the printed parameters allows {interval})"
        yield f"  computed    {claim['value']:.6g}{allowed}"
        yield f"              {claim['computed']}"
    else:
        yield f"  computed    {claim['computed']}"
