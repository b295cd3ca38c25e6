"""Claims whose number is proved: certificates that back it, and what they say in a
sentence.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

from gaitsweep.tasks.ledger.claim import (
    BACKED,
    CONSISTENT,
    PROVED,
    REPRODUCED,
    ClaimResult,
)

FOLDER = Path(__file__).resolve().parents[2] / "data" / "reference" / "proofs"
#: Relative error of a slope computed in doubles.
ROUNDING = 1e-12


def backed(name: str, finding: ClaimResult, folder: Path = FOLDER) -> ClaimResult:
    """A finding with what its certificates say, `proved` where it is reproduced and
    they hold its number.

    Parameters
    ----------
    name : str
        The claim's.
    finding : ClaimResult
    folder : Path
        Where the certificates are.

    Returns
    -------
    ClaimResult

    Notes
    -----
    A finding that is consistent within rounding stays so: certificates hold the computed number, not the printed one.
    """
    kept = [
        path
        for certificate in BACKED.get(name, ())
        if (path := folder / f"{certificate}.json").is_file()
    ]
    if (
        not kept
        or len(kept) < len(BACKED[name])
        or finding.verdict not in (REPRODUCED, CONSISTENT)
        or not math.isfinite(finding.value)
    ):
        return finding

    certificates = [json.loads(path.read_text(encoding="utf-8")) for path in kept]
    middle, radius = map(Fraction, certificates[0]["slope"])
    if abs(Fraction(finding.value) - middle) > radius + Fraction(ROUNDING) * middle:
        return finding

    statements = "; ".join(
        part for certificate in certificates for part in _statements(certificate)
    )
    verdict = PROVED if finding.verdict == REPRODUCED else finding.verdict

    return replace(
        finding, verdict=verdict, computed=f"{finding.computed}; proved: {statements}"
    )


def _statements(certificate: Mapping[str, Any]) -> Iterator[str]:
    if certificate["kind"] == "tube":
        low, high = certificate["slope"]
        yield f"a stable {certificate['gait']} step at every slope from {low} to {high} rad"
    else:
        middle, radius = certificate["slope"]
        what = (
            "a multiplier passes -1"
            if certificate["kind"] == "flip"
            else "the branch turns back"
        )
        yield f"{what} at {middle} +- {radius} rad ({certificate['name']})"
