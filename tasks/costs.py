"""Processor time of the tasks on one core of 2023, for plans and times to go before any task is measured.

Like the registry, this module imports nothing but the standard library.
"""

from dataclasses import dataclass

#: Share of the lines of a plane that are surveyed by themselves, because charts predict none of their gaits.
ALONE = 0.05


@dataclass(frozen=True)
class Cost:
    """Time of each of a product of numbers [s], for walkers without knees and with.

    `of` names the factors: `slopes` of the study, `points`, `gait_steps` after which gaits repeat, `searches` for
    longer gaits, or options of its kind, those that are lists by their lengths; `a+b` is a sum. Without factors it is
    that of a line, or of a study if the task is over studies.
    """

    straight: float
    kneed: float
    of: tuple[str, ...] = ()


#: Costs of a task that is not named here.
OTHERS = (Cost(0.01, 0.01),)
#: Time to start a run of any size: its processes, compiled code and archive.
STARTING = (Cost(0.65, 0.95),)
_STEPS = "transient+steps"
#: Costs of each task, which add up. That of a line computed side by side with others includes no points.
COSTS = {
    "atlas": (Cost(0.13, 0.55), Cost(1.3, 3.0, ("searches",))),
    "atlas side by side": (Cost(0.05, 0.16),),
    "charts": (Cost(1.4, 3.5),),
    "trace": (Cost(0.05, 0.15),),
    "branch": (Cost(0.04, 0.15),),
    "orbit": (Cost(1.3e-3, 2e-3, (_STEPS,)), Cost(4e-6, 2.1e-5, ("slopes", "starts", _STEPS))),
    "cascade": (Cost(0.025, 0.075, ("families", "periods")), Cost(4.5e-3, 1.2e-2, ("families", "steps"))),
    "basin": (
        Cost(0.4, 0.8, ("slopes",)),
        Cost(1.6e-3, 7e-3, ("slopes", "size")),
        Cost(1.1e-5, 2.2e-5, ("slopes", "size", "size")),
    ),
    "curve": (Cost(0.4, 2.0),),
    "design": (Cost(0.1, 0.3),),
    "design of a plane": (Cost(8e-5, 2.2e-4),),
    "plane of designs": (Cost(5.0, 10.0),),
    "census": (Cost(0.06, 0.1), Cost(5e-6, 6e-5, ("slopes", "starts"))),
    "landmarks": (Cost(1.0, 2.0),),
    "corners": (Cost(0.01, 4.0),),
    "claims": (Cost(20.0, 30.0),),
}
#: Costs of a point: of a long line, of a short one, of gaits of several steps; and of groups of variables beside these.
POINTS = {
    "long": Cost(1.8e-5, 7e-5, ("points",)),
    "interpolated": Cost(1.3e-6, 1.3e-6, ("points",)),
    "plane": Cost(6e-5, 1.6e-4, ("points",)),
    "short": Cost(4e-4, 1e-3, ("points",)),
    "cycles": Cost(2e-3, 3e-3, ("points", "gait_steps")),
    "violations": Cost(1.4e-4, 4.4e-4, ("points",)),
    "proofs": Cost(0.3, 1.2, ("points",)),
}
