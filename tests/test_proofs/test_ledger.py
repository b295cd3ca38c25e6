"""The ledger's verdict `proved`."""

import json
import shutil

import pytest

from exact_gaits import REFERENCE
from gaitsweep.tasks.ledger.certificates import backed
from gaitsweep.tasks.ledger.claim import BACKED, ClaimResult

FLIP, FOLD = 0.015088437941119463, 0.0191228796947384


def test_a_reproduced_number_with_a_certificate_is_proved():
    found = backed("D2", ClaimResult("computed", "reproduced", FLIP))
    assert found.verdict == "proved"
    assert found.computed.startswith(
        "computed; proved: a multiplier passes -1 at 0.01508"
    )


def test_a_proved_number_that_does_not_round_to_the_printed_one_does_not_prove_the_claim():
    found = backed("P1", ClaimResult("computed", "consistent within rounding", FOLD))
    assert found.verdict == "consistent within rounding"
    assert found.computed.startswith(
        "computed; proved: the branch turns back at 0.01912"
    )


@pytest.mark.parametrize(
    "found",
    [
        ClaimResult("", "not reproduced", FLIP),
        ClaimResult("", "reproduced", FLIP * (1 + 1e-9)),
        ClaimResult("", "reproduced"),
        ClaimResult("", "approximate", FLIP),
    ],
)
def test_nothing_else_is(found):
    assert backed("D2", found) is found
    assert backed("D3", ClaimResult("", "reproduced", FLIP)).verdict == "reproduced"


def test_a_missing_certificate_proves_nothing(tmp_path):
    for name in BACKED["D2"][:1]:
        shutil.copy(REFERENCE / "proofs" / f"{name}.json", tmp_path)
    assert (
        backed("D2", ClaimResult("", "reproduced", FLIP), tmp_path).verdict
        == "reproduced"
    )


def test_the_certificates_are_of_the_walkers_claimed():
    for name, walker in (("D-flip", "0"), ("physical-fold", "1.013")):
        assert (
            json.loads((REFERENCE / "proofs" / f"{name}.json").read_text())["walker"][
                "m_s"
            ]
            == walker
        )
