"""The studies and archives that a command names."""

import argparse
import os
from collections.abc import Sequence
from pathlib import Path

from gaitsweep.pipeline import terminal
from gaitsweep.pipeline.cli.errors import say
from gaitsweep.pipeline.companions import ARCHIVES, default_archive, found_in
from gaitsweep.pipeline.errors import StudyError, WalkerFileError
from gaitsweep.pipeline.study import files, parse
from gaitsweep.pipeline.study.location import clip
from gaitsweep.pipeline.study.model import Study


def read(
    paths: Sequence[Path], debug: bool, accuracy: float | None = None
) -> tuple[list[Study], dict[Path, int]]:
    """Read and check the studies of some files. Invalid ones are reported and passed
    over; so are files of walkers among several files.

    Returns
    -------
    list of Study
    dict of int
        Exit codes of the invalid ones, by file.

    Raises
    ------
    StudyError
        If every one of several files holds a walker.
    """
    studies: list[Study] = []
    invalid: dict[Path, int] = {}
    for path in paths:
        try:
            studies.append(parse.read(path, accuracy))
        except WalkerFileError as error:
            if len(paths) == 1:
                invalid[path] = say(error, debug)
            else:
                terminal.say(f"{path} holds a walker and no study; it is skipped.")
        except Exception as error:
            invalid[path] = say(error, debug)

    if not studies and not invalid:
        raise StudyError("All of these files hold walkers, and none a study.")

    return studies, invalid


def targets(
    options: argparse.Namespace,
) -> tuple[list[tuple[Study, Path]], dict[Path, int]]:
    """The studies that a command names, each with the path of its archive.

    Returns
    -------
    list of (Study, Path)
    dict of int
        Exit codes of the invalid ones, by file.

    Raises
    ------
    StudyError
        If several studies have one archive.
    """
    if options.archive and len(options.studies) > 1:
        raise StudyError("`--archive` names one file, but there are several studies.")

    studies, invalid = read(options.studies, options.debug, options.accuracy)
    by_archive: dict[Path, Study] = {}
    for study in studies:
        path = options.archive or default_archive(study.name)
        if path in by_archive:
            raise StudyError(f"Two studies are called {study.name}.")
        by_archive[path] = study

    return [(study, path) for path, study in by_archive.items()], invalid


def archives(names: Sequence[Path], debug: bool) -> tuple[list[Path], list[int]]:
    """Archives that names of archives, studies and folders of either mean, each once;
    without names those of `data/archive`.

    Returns
    -------
    list of Path
    list of int
        Exit codes of the names that mean none, which are reported, and of invalid
        studies.
    """
    if not names:
        return _in_folder(ARCHIVES), []

    found: dict[Path, None] = {}
    codes: list[int] = []
    for name in names:
        is_archive = name.suffix == ".nc"
        if is_archive and not _is_known(name):
            missing = f"There is no archive {clip(str(name), 200)}"
            error = StudyError(f"{missing}, and no record of its run.")
            codes.append(say(error, debug))
            continue

        inside = [name] if is_archive else _in_folder(name)
        found |= dict.fromkeys(inside)
        if inside and not any(name.glob("*.toml")):
            continue

        try:
            studies, invalid = read(files.studies(name), debug)
        except Exception as error:
            codes.append(say(error, debug))
            continue

        found |= dict.fromkeys(default_archive(study.name) for study in studies)
        codes += invalid.values()

    return list(found), codes


def _is_known(archive: Path) -> bool:
    """Whether there is an archive, or any of its companions."""
    if os.path.lexists(archive):  # unlike `Path.exists`, no error if it is too long
        return True
    begun = (companions.archive for companions in found_in(archive.parent))
    return archive in begun


def _in_folder(folder: Path) -> list[Path]:
    """Archives in a folder, also those of which there are companions alone."""
    begun = (companions.archive for companions in found_in(folder))
    return sorted({*folder.glob("*.nc"), *begun})
