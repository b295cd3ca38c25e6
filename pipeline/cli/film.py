"""`gaitsweep film`: a gait, or what a push makes of it, as a film of a few steps or as
a strip of poses for print.
"""

import argparse
import math

import numpy as np

from gaitsweep.pipeline import paths, terminal
from gaitsweep.pipeline.api.steps import simulate
from gaitsweep.pipeline.dispatch import ask
from gaitsweep.pipeline.errors import StudyError, unwritten
from gaitsweep.pipeline.study.single_point import led, state_of

#: Formats of films and of strips, by the ending of the file.
_FILMS, _STRIPS = (".webp", ".png", ".gif"), (".svg", ".pdf", ".png")
#: Frames of a film a second, the most of one, and poses of a strip a step.
_RATE, _MAX_FRAMES, _POSES = 25, 1000, 5


def run(options: argparse.Namespace) -> int:
    """Write the film or the strip, and print its path."""
    endings, ending = _STRIPS if options.strip else _FILMS, options.out.suffix.lower()
    if ending not in endings:
        raise StudyError(
            f"The file must end in {', '.join(endings)}; got {options.out.name!a}."
        )
    for name, low, high in (("steps", 1, 50), ("push", -10, 10), ("slow", 0.1, 100)):
        if not low <= getattr(options, name) <= high:  # nan
            raise StudyError(
                f"`--{name}` must lie in [{low}, {high}]; got {getattr(options, name)}."
            )
    walker, keys = led(options.walker, options.set)
    state = state_of(walker, options.slope, keys, options.gait)
    push = {0: [options.push * state[1]] * 2} if options.push else None
    motion = simulate(
        walker, options.slope, state, options.steps, motion=True, pushes=push, **keys
    )
    known = ask("check_walker", {"walker": walker, "set": keys})
    from gaitsweep.pipeline.report.figures import film
    from gaitsweep.pipeline.report.figures.body import Body

    body = Body.of(known["parameters"])
    assert body is not None  # the walker was checked
    shown = film.poses(
        motion, body, _moments(film.lengths(motion), options, known["si"])
    )
    end = (
        str(motion["reason"].item())
        if int(motion["steps_taken"]) < options.steps
        else ""
    )
    if options.strip:
        content = film.strip(body, shown, options.slope, ending)
    else:
        words = f"{options.walker}, {options.gait} step, γ = {options.slope:g} rad"
        content = film.film(body, shown, options.slope, words, end, ending, _RATE)
    try:
        paths.publish(options.out, content)
    except OSError as error:
        raise unwritten(options.out, error) from error
    print(options.out)
    if end:
        terminal.say(f"gaitsweep: {end}")
    return 0


def _moments(
    lengths: np.ndarray, options: argparse.Namespace, is_si: bool
) -> np.ndarray:
    """Times of the frames, or of the poses of a strip, from the first to the last
    moment of steps of some lengths.
    """
    if options.strip:
        return np.linspace(0, lengths.sum(), _POSES * len(lengths) + 1)
    second = 1.0 if is_si else math.sqrt(1 / 9.81)  # legs of 1 m
    count = max(2, round(float(lengths.sum()) * second * options.slow * _RATE) + 1)
    if count > _MAX_FRAMES:
        raise StudyError(
            f"The film would have {count:,} frames, more than {_MAX_FRAMES:,}: show fewer steps, or faster."
        )
    return np.linspace(0, lengths.sum(), count)
