"""What may be said of a state: contract/verdicts.toml."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any


@cache
def sentences() -> dict[str, str]:
    """Return what is said of each verdict."""
    path = Path(__file__).parents[1] / "contract" / "verdicts.toml"
    return tomllib.loads(path.read_text(encoding="utf-8"))


def verdicts(params: Mapping[str, Any]) -> dict[str, str]:
    """Return the verdicts and what is said of each."""
    return sentences()
