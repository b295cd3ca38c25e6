"""The ledger of the paper's claims: each is one small function, entered under its id by
the decorator `claim`.

Importing this package fills `CLAIMS`; a new claim is one such function in any module
imported here.
"""

from gaitsweep.tasks.ledger import (  # noqa: F401 (each module enters its claims)
    appendix_a,
    energy,
    kneed_chaos,
    level_ground,
    physical_walker,
    point_feet,
    published_tables,
    simplest_walker,
    tuned_walkers,
    zero_slope,
)
