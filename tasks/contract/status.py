"""Outcomes of a solve, and the sentence for each. A physical violation is not a status."""

from collections.abc import Sequence

import numpy as np

from gaitsweep.tasks.contract.registry import STATUSES

CONVERGED, NO_GAIT, NOT_CONVERGED, FELL, LESS_ACCURATE = (
    STATUSES[k]
    for k in ("converged", "no_gait", "not_converged", "fell", "less_accurate")
)
#: Gaits with values.
SOLVED = (CONVERGED, LESS_ACCURATE)

#: Places of the sentences among `reasons`.
(
    SETTLED,
    NO_LONG,
    NO_FURTHER,
    NEWTON_LOST,
    NOT_A_STEP,
    NO_SHORT,
    TOO_COARSE,
    UNLABELLED,
    UNVERIFIED,
) = range(9)


def ranges(pieces: Sequence[tuple[float, float]]) -> str:
    """Ranges of slopes in words, those that overlap as one."""
    apart: list[tuple[float, float]] = []
    for low, high in sorted(pieces):
        if apart and low <= apart[-1][1]:
            low, high = apart[-1][0], max(high, apart.pop()[1])
        apart.append((low, high))

    return "; ".join(
        " to ".join(dict.fromkeys((f"{low:.6g}", f"{high:.6g}"))) for low, high in apart
    )


def outside(
    label: str,
    pieces: list[tuple[float, float]],
    searched: str,
    lost: Sequence[float] = (),
    drive: str = "slope",
) -> str:
    """Say why no branch has a gait of a label at some slope, or value of another drive.

    Parameters
    ----------
    label : str
        `long` or `short`.
    pieces : list of (float, float) [rad]
        Least and largest slopes over which branches have such gaits.
    searched : str
        What was searched, in words.
    lost : sequence of float [rad]
        Slopes at which branches could be continued no further, or failed a check.
    """
    if lost:
        searched += (
            f"; continuation was lost at {', '.join(f'{slope:.6g}' for slope in lost)}"
        )
    if not pieces:
        return f"No {label} gait found: {searched}."
    return f"No {label} gait at this {drive}: the branches found span {ranges(pieces)} ({searched})."


def beyond(label: str, pieces: Sequence[tuple[float, float]], slope: float) -> str:
    """Say in few words that a slope lies beyond the pieces with a label; empty if it
    does not, or there are none.
    """
    below, above = (
        [high for _, high in pieces if high < slope],
        [low for low, _ in pieces if low > slope],
    )
    if len(below) + len(above) < len(pieces) or not pieces:
        return ""
    if below and above:
        return (
            f"No {label} gait: none between {max(below):.6g} and {min(above):.6g} rad."
        )

    return f"No {label} gait: none " + (
        f"above {max(below):.6g} rad." if below else f"below {min(above):.6g} rad."
    )


def over(gait: str, values: np.ndarray, key: str = "slope") -> str:
    """Say that a line has no gait of some kind at any of its points.

    Parameters
    ----------
    gait : str
    values : ndarray, shape (n,)
        Slopes [rad], or values of what else drives, in the walker's units.
    key : str
        The name of what they are values of.
    """
    low, high = f"{values.min():.6g}", f"{values.max():.6g}"
    where = "slope" if key == "slope" else f"`{key}`"
    several = "slopes" if key == "slope" else f"values of `{key}`"
    return f"No {gait} " + (
        f"at {several} from {low} to {high}." if low != high else f"at {where} {low}."
    )


def absent(label: str, where: str, drive: str = "slope") -> str:
    """Say that a family of walkers has no gait of a label at some keys and slope, or
    value of another drive.

    Parameters
    ----------
    label : str
        `long` or `short`.
    where : str
        The cell of keys over which its branches were interpolated, in words.
    drive : str
        The name of what drives.
    """
    found = f"no branch found over {where} has one here"
    return f"No {label} gait at this {drive}: {found}."


def unreached(
    label: str,
    sought: str,
    where: str,
    reached: Sequence[tuple[float, float]],
    searched: str,
) -> str:
    """Say why no gait of a label has a value of a measure.

    Parameters
    ----------
    label : str
        `long` or `short`, or none for any gait.
    sought : str
        The value, in words.
    where : str
        Over what was searched, in words.
    reached : sequence of (float, float)
        Least and largest values of the gaits found.
    searched : str
        How they were searched for, in words; may be empty.
    """
    kind = f"{label} gait".strip()
    more = f" ({searched})" if searched else ""
    if not reached:
        return f"No {kind} was found {where}{more}."
    return f"No {kind} has {sought} {where}: there are {ranges(reached)}{more}."


def reasons(long: str, short: str, point: str = "slope") -> list[str]:
    """Sentences in the order in which `reason` indexes them, with those of points
    without a long or a short gait; `point` is what a line has several of.
    """
    return [
        "Converged, and verified to be a step.",
        long,
        f"No further gait was found at this {point}.",
        "Newton's method did not converge from the atlas's guess.",
        "The solution is not a step: a guard is crossed before the event solved for.",
        short,
        "Converged to a step, but its error bound exceeds the accuracy wanted.",
        f"Converged, and verified to be a step. This {point} has more gaits than labels: "
        "those of smaller stance angles are left out.",
        "The solution was not verified to be a step: a guard comes nearer to zero than samples of the motion can tell.",
    ]
