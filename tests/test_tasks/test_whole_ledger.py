"""The whole ledger is, claim by claim, the one kept.

That is written by `gaitsweep claims --json | python -m json.tool --no-ensure-ascii
--indent 1`.
"""

import json
import re
from pathlib import Path

import numpy as np
import pytest

from gaitsweep.tasks.ledger.check_claims import claims

KEPT = Path(__file__).parents[2] / "data" / "reference" / "ledger.json"
NUMBER = re.compile(r"(?<![\w.])-?\d+(?:\.\d+)?(?:e-?\d+)?")
#: Relative difference of a sentence's numbers: of Lyapunov exponents and their standard
#: errors, averages over chaotic orbits that depend on the last bit, and of all others,
#: which are printed to a few digits.
CHAOTIC, TOLERANCE = {"D8": 0.25, "Z6": 0.25}, 1e-3
# The search for gaits lets lanes that go astray overflow.
pytestmark = pytest.mark.filterwarnings("ignore::RuntimeWarning")


def told(sentence):
    """The words of a sentence and its numbers."""
    return NUMBER.sub("#", sentence), [float(x) for x in NUMBER.findall(sentence)]


# Three and a half minutes of processor time, on a machine that may do other things.
@pytest.mark.timeout(1200)
def test_every_claim_is_computed_as_the_ledger_has_it():
    """What is rounding of zero may be other rounding; Lyapunov exponents depend on the
    processor.
    """
    kept = json.loads(KEPT.read_text(encoding="utf-8"))
    table = claims({"lines": [], "ids": [each["id"] for each in kept]}, [])
    off = []
    for k, each in enumerate(kept):
        words, numbers = told(each["computed"])
        found, others = told(str(table["claims/computed"][k]))
        told_of = ("value", "interval_low", "interval_high")
        values = [float(table[f"claims/{name}"][k]) for name in told_of]
        wanted = [np.nan if each[name] is None else each[name] for name in told_of]
        same = (
            table["claims/verdict"][k] == each["verdict"]
            and found == words
            and np.allclose(
                others, numbers, rtol=CHAOTIC.get(each["id"], TOLERANCE), atol=1e-11
            )
            and np.allclose(values, wanted, 1e-6, 1e-11, equal_nan=True)
        )
        if not same:
            off.append(
                (
                    each["id"],
                    values,
                    str(table["claims/verdict"][k]),
                    str(table["claims/computed"][k]),
                )
            )
    assert not off
    assert table["figure9/walker"].tolist() == [
        "A",
        "A-printed",
        "B",
        "C",
        "C-printed",
        "D",
        "E",
        "F",
    ]
    cells = [
        f"figure10_cells/{name}"
        for name in ("walker", "column", "slopes", "printed", "computed", "verdict")
    ]
    assert {len(table[name]) for name in cells} == {37}
    same = table[cells[3]] == table[cells[4]]
    assert set(table["figure10_cells/verdict"][same]) == {"reproduced"}
