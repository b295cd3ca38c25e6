"""What can become of a solve, and the sentence for each. A physical violation is not a status."""

from tasks.registry import STATUSES

CONVERGED, NO_GAIT, NOT_CONVERGED, FELL = (STATUSES[k] for k in ("converged", "no_gait", "not_converged", "fell"))

SETTLED = "Converged, and verified to be a step."
NO_FURTHER = "No further gait was found at this slope."
UNWANTED = "The study does not ask for this gait."
NEWTON_LOST = "Newton's method did not settle from the atlas's guess."
NOT_A_STEP = "The solution is not a step: a guard is crossed before the event solved for."


def outside(label: str, pieces: list[tuple[float, float]], searched: str) -> str:
    """Why no branch has a gait of that label at a slope."""
    if not pieces:
        return f"No {label} gait found: {searched}."
    spans = "; ".join(f"{low:.6g} to {high:.6g}" for low, high in pieces)
    return f"No {label} gait: those found cover slopes {spans} only ({searched})."
