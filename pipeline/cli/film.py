"""`gaitsweep film`: a gait, or what a push makes of it, as a film of a few steps or as
a strip of poses for print.
"""

import argparse
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from gaitsweep.pipeline import paths, terminal
from gaitsweep.pipeline.api.steps import simulate
from gaitsweep.pipeline.dispatch import ask
from gaitsweep.pipeline.errors import StudyError
from gaitsweep.pipeline.study.single_point import led, state_of

#: Formats of films and of strips, by the ending of the file.
_FILMS, _STRIPS = (".webp", ".png", ".gif"), (".svg", ".pdf", ".png")
#: Frames of a film a second, the most of one, and poses of a strip a step.
_RATE, _MAX_FRAMES, _POSES = 25, 1000, 5


def run(options: argparse.Namespace) -> int:
    """Write the film or the strip, and print its path."""
    ending = _ending(options)
    _check_numbers(options)
    _check_file(options.out)
    walker, keys = led(options.walker, options.set)
    state = state_of(walker, options.slope, keys, options.gait)
    push = {0: [options.push * state[1]] * 2} if options.push else None
    motion = simulate(
        walker, options.slope, state, options.steps, motion=True, pushes=push, **keys
    )

    end = ""
    if int(motion["steps_taken"]) < options.steps:
        end = str(motion["reason"].item())
    known = ask("check_walker", {"walker": walker, "set": keys})
    content = _content(motion, known, options, ending, end)
    _check_file(options.out)
    paths.publish_for_user(options.out, content)

    print(options.out)
    if end:
        terminal.say(f"gaitsweep: {end}")
    return 0


def _check_file(path: Path) -> None:
    """Check that nothing stands where the film is to be written, or an earlier one."""
    from gaitsweep.pipeline.report.figures.film import MARK

    paths.check_own(path, b"", MARK.encode())


def _ending(options: argparse.Namespace) -> str:
    """Ending of the file, which names the format."""
    endings = _STRIPS if options.strip else _FILMS
    ending: str = options.out.suffix.lower()
    if ending not in endings:
        known = ", ".join(endings)
        raise StudyError(f"The file must end in {known}; got {options.out.name!a}.")
    return ending


def _check_numbers(options: argparse.Namespace) -> None:
    """Refuse numbers beyond their limits."""
    for name, low, high in (("steps", 1, 50), ("push", -10, 10), ("slow", 0.1, 100)):
        value = getattr(options, name)
        if not low <= value <= high:  # nan
            raise StudyError(f"`--{name}` must lie in [{low}, {high}]; got {value}.")


def _content(
    motion: xr.Dataset,
    known: Mapping[str, Any],
    options: argparse.Namespace,
    ending: str,
    end: str,
) -> bytes:
    """The film or the strip of a motion of the walker that is `known`; `end` says why it
    fell, if it did.
    """
    from gaitsweep.pipeline.report.figures import film
    from gaitsweep.pipeline.report.figures.body import Body

    body = Body.of(known["parameters"])
    assert body is not None  # the walker was checked
    moments = _moments(film.lengths(motion), options, known["si"])
    shown = film.poses(motion, body, moments)
    if options.strip:
        return film.strip(body, shown, options.slope, ending)

    words = f"{options.walker}, {options.gait} step, γ = {options.slope:g} rad"
    return film.film(body, shown, options.slope, words, end, ending, _RATE)


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
        frames = f"The film would have {count:,} frames, more than {_MAX_FRAMES:,}"
        raise StudyError(f"{frames}: show fewer steps, or faster.")

    return np.linspace(0, lengths.sum(), count)
