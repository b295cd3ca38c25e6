"""The ledger of the paper's claims: each is one small function, entered under its id by `claim`.

A new claim is one such function in any module named here; importing this package fills `CLAIMS`.
"""

from tasks.ledger import appendix, chaos, energy, machine, point_feet, simplest, tables, tuned, zero_slope
from tasks.ledger.claim import CLAIMS, VERDICTS, Claim, Finding

__all__ = ["CLAIMS", "VERDICTS", "Claim", "Finding", "appendix", "chaos", "energy", "machine", "point_feet", "simplest",
           "tables", "tuned", "zero_slope"]
