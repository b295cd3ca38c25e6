"""The command `gaitsweep claims`: what the paper says, the computed number and the verdict."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator
from typing import Any

from pipeline.dispatch import ask
from pipeline.errors import StudyError
from tasks.registry import CLAIMS


def report(ids: list[str], as_json: bool) -> int:
    """Check claims and print the results; returns the exit code.

    Raises
    ------
    StudyError
        If there is no such claim.
    """
    unknown = [name for name in ids if name not in CLAIMS]
    if unknown:
        raise StudyError(f"There is no claim {unknown[0]!r}; there are {', '.join(CLAIMS)}.")
    results = ask("claims", {"ids": ids})
    print(json.dumps(results) if as_json else "\n".join(_lines(results)))
    return 0


def _lines(results: Iterable[dict[str, Any]]) -> Iterator[str]:
    """Results of claims, a paragraph each: the paper's words, the printed and the computed number, the verdict."""
    for claim in results:
        yield f"{claim['id']}: {claim['verdict']}"
        yield f'  the paper   "{claim["quotation"]}" ({claim["source"]})'
        if claim["printed_value"] is not None:
            half = claim["printed_half_unit"]
            yield f"  printed     {claim['printed_value']:.6g}" + (f" +- {half:.2g}" if half else "")
        if claim["value"] is not None:
            allowed = f" (rounding of the printed parameters allows {claim['interval']})" if claim["interval"] else ""
            yield f"  number      {claim['value']:.12g}{allowed}"
        yield f"  computed    {claim['computed']}"
