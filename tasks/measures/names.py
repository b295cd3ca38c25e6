"""Names of the measures of a walker's gaits; this module imports no solver."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence

from gaitsweep.tasks.contract.registry import VARIABLES, VIOLATIONS, is_measure
from gaitsweep.tasks.walkers.walker import Walker, WalkerError


def measures(walker: Walker) -> list[str]:
    """Return the names of the measures of a walker whose value may be asked for."""
    return [
        name
        for name, about in VARIABLES.items()
        if is_measure(name) and about.only_of in ("", *walker.features)
    ]


def check_measure(
    name: str, walker: Walker, option: str, others: Iterable[str] = ()
) -> None:
    """Check that a name is that of a measure of a walker's gaits, or one of others.

    Raises
    ------
    WalkerError
        If it is not, naming the option that asks for it.
    """
    known = (*measures(walker), *others)
    if name not in known:
        bound = f"must be a measure of its gaits: {', '.join(known)}"
        raise WalkerError(option, name, bound)


def never_begin(names: Sequence[str], walker: Walker) -> Iterator[str]:
    """Say of each of some violations that gaits of a walker can have none of it, where
    that is so.
    """
    known = {*measures(walker)}
    for name in names:
        if name != "all" and known.isdisjoint(VIOLATIONS[name].amounts):
            yield f"`{name}` begins nowhere: gaits of this walker have no such violation."
