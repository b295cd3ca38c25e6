"""The command line: `gaitsweep COMMAND`. Each command imports only what it needs."""

from __future__ import annotations

import argparse
import contextlib
import dataclasses
import json
import math
import sys
import time
import traceback
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, NoReturn

from pipeline import terminal
from pipeline.cli import kinds
from pipeline.errors import DiskFullError, GaitsweepError, StudyError, is_disk_full, reached_limit, unwritten

#: Exit codes of several studies, gravest first: the gravest is that of all.
_EXIT_CODES_BY_SEVERITY = (143, 130, 129, 4, 3, 2, 5, 1, 0)
#: Time for which a report says nothing [s].
_QUIET = 2.0


class _Parser(argparse.ArgumentParser):
    def error(self, message: str) -> NoReturn:
        from pipeline.study.location import clip

        raise StudyError(f"{message[:1].upper()}{clip(message[1:], 500)} ({self.prog} --help).")

    def _print_message(self, message: str, file: Any = None) -> None:
        print(message, end="", file=file or sys.stderr)  # argparse itself says nothing of help that finds no room


class _Version(argparse.Action):
    def __call__(self, *_: Any) -> NoReturn:
        from pipeline.archive.provenance import version

        print(f"gaitsweep {version('gaitsweep')}")
        sys.exit(0)


def parser() -> argparse.ArgumentParser:
    """Parser of every command and its options."""
    top = _Parser(prog="gaitsweep", description="Gait sweeps of passive dynamic walkers.")
    top.add_argument("--debug", action="store_true", help="show the traceback of an error")
    top.add_argument("--version", action=_Version, nargs=0, help="show the version")
    from pipeline.study import options

    commands = top.add_subparsers(dest="command", metavar="COMMAND", required=True)

    def add(function: Callable[[argparse.Namespace], int], purpose: str) -> argparse.ArgumentParser:
        command = commands.add_parser(
            function.__name__.strip("_"), help=purpose, description=purpose, allow_abbrev=False
        )
        command.set_defaults(function=function)
        command.add_argument("--debug", action="store_true", default=argparse.SUPPRESS, help=argparse.SUPPRESS)
        return command

    c = add(_run, "run studies; the same command again resumes")
    c.add_argument("studies", nargs="+", metavar="STUDY.toml", type=Path)
    _add_accuracy(c)
    c.add_argument("--jobs", type=kinds.jobs, default=2, metavar="N", help="worker processes (default 2)")
    c.add_argument("--cluster", metavar="ADDRESS", help="a Dask scheduler, tcp://HOST:PORT, or local:N")
    c.add_argument("--archive", type=kinds.archive, metavar="FILE", help="instead of data/archive/NAME.nc")
    c.add_argument("--fresh", action="store_true", help="discard the results of earlier runs")
    c.add_argument("--retry-failed", action="store_true", help="retry failed points and tasks")
    c.add_argument(
        "--chunk",
        type=kinds.count,
        metavar="N",
        help="most points that a worker computes at a time (default: those of a chunk)",
    )
    c.add_argument(
        "--snapshot",
        type=kinds.interval,
        default=60.0,
        metavar="SECONDS",
        help="minimum interval at which a running study publishes its archive (default 60)",
    )
    c.add_argument("--quiet", action="store_true", help="print errors only")
    c.add_argument("--verbose", action="store_true", help="report every chunk")
    c = add(_plan, "show what would run and why, without running it")
    c.epilog, c.formatter_class = options.listing(), argparse.RawDescriptionHelpFormatter
    c.add_argument("studies", nargs="+", metavar="STUDY.toml", type=Path)
    _add_accuracy(c)
    c.add_argument("--archive", type=kinds.archive, metavar="FILE", help="instead of data/archive/NAME.nc")
    c.add_argument("--retry-failed", action="store_true", help="as `run` would")
    c.add_argument("--json", action="store_true", help="for machines")
    c = add(_status, "progress of the current or last run")
    c.add_argument("studies", nargs="*", metavar="STUDY.toml", type=Path)
    c.add_argument("--archive", type=kinds.archive, metavar="FILE", help="instead of data/archive/NAME.nc")
    c.add_argument("--json", action="store_true", help="for machines")
    c = add(_report, "HTML report from archives")
    c.add_argument("archives", nargs="+", metavar="ARCHIVE.nc", type=Path)
    c.add_argument(
        "-o",
        dest="out",
        type=Path,
        default=Path("reports"),
        metavar="DIR",
        help="folder to which pages are added (default reports)",
    )
    c.add_argument("--only", action="store_true", help="remove other pages there")
    c.add_argument("--open", action="store_true", help="open the index in a browser")
    c = add(_solve, "all gaits at one point")
    c.add_argument("--walker", required=True, metavar="NAME|FILE.toml")
    c.add_argument("--slope", required=True, type=kinds.number, metavar="S", help="rad")
    c.add_argument(
        "--set", action=kinds.Settings, type=kinds.setting, default={}, metavar="KEY=VALUE", help="a walker key"
    )
    c.add_argument(
        "--tuned",
        action="append",
        default=[],
        metavar="KEY",
        help="a key changed by least so that the walker meets the static conditions",
    )
    _add_accuracy(c)
    c.add_argument("--all", action="store_true", help="include gaits that are not anthropomorphic")
    c.add_argument(
        "--limit",
        action=kinds.Settings,
        type=kinds.limit,
        default={},
        metavar="VIOLATION=VALUE",
        help="flag a violation above this value instead of its default (listed by `plan --help`)",
    )
    c.add_argument(
        "--steps", type=kinds.count, default=1, metavar="N", help="gaits that repeat after N steps (default 1)"
    )
    c.add_argument("--degrees", action="store_true", help="slope and angles in degrees (--json: the slope only)")
    c.add_argument("--json", action="store_true", help="for machines")
    c = add(_prove, "proofs of a walker's gaits at one slope, or of an archive's")
    c.add_argument("archive", nargs="?", metavar="ARCHIVE.nc", type=Path)
    c.add_argument("--walker", metavar="NAME|FILE.toml")
    c.add_argument("--slope", type=kinds.decimal, metavar="S", help="rad")
    c.add_argument(
        "--set", action=kinds.Settings, type=kinds.decimal_setting, default={}, metavar="KEY=VALUE", help="a walker key"
    )
    c.add_argument("--gait", metavar="G", help="only the gait of this label")
    c.add_argument("--sample", type=kinds.count, metavar="N", help="only so many gaits of the archive, a fixed draw")
    c.add_argument("--accuracy", type=kinds.number, default=1e-12, metavar="A", help="relative radius (default 1e-12)")
    c.add_argument("--jobs", type=kinds.jobs, default=2, metavar="N", help="processes for an archive (default 2)")
    c.add_argument("--json", action="store_true", help="for machines")
    c = add(_walkers, "the catalogue of walkers, or one walker")
    c.add_argument("name", nargs="?", metavar="NAME")
    c.add_argument("--json", action="store_true", help="for machines")
    c = add(_claims, "claims of the paper: what it says, the computed number and the verdict")
    c.add_argument("ids", nargs="*", metavar="ID", help="such as D2 or K1 (default: all)")
    c.add_argument("--json", action="store_true", help="for machines")
    c = add(_tune, "the nearest walker that meets the conditions of walking at vanishing slope")
    c.add_argument("--walker", required=True, metavar="NAME|FILE.toml")
    c.add_argument("--free", action="append", default=[], metavar="KEY", help="a key that may change")
    c.add_argument("--json", action="store_true", help="for machines")
    c = add(_verify, "check that an archive is intact, complete and valid")
    c.add_argument("archive", type=Path, metavar="ARCHIVE.nc")
    c.add_argument("--json", action="store_true", help="for machines")
    c = add(_diff, "differences between two archives")
    c.add_argument("a", type=Path, metavar="A.nc")
    c.add_argument("b", type=Path, metavar="B.nc")
    c.add_argument(
        "--rtol",
        type=kinds.tolerance,
        action="append",
        default=[],
        metavar="R|NAME=R",
        help="relative tolerance (default 0), or that of one variable",
    )
    c = add(_completion, "shell script that completes commands")
    c.add_argument("shell", choices=("bash", "zsh"))
    return top


def _add_accuracy(command: argparse.ArgumentParser) -> None:
    command.add_argument(
        "--accuracy", type=kinds.number, metavar="A", help="largest error bound wanted, 1e-2 to 1e-15 (default: best)"
    )


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command and return its exit code."""
    terminal.prepare()
    words, codes = list(sys.argv[1:] if arguments is None else arguments), list[int]()
    with _report_errors(codes, "--debug" in words):
        try:
            options = parser().parse_args(words)
            codes.append(options.function(options))
        finally:
            sys.stdout.flush()  # here: a failure to print could not be reported at interpreter exit
    return codes[-1]


@contextlib.contextmanager
def _report_errors(codes: list[int], debug: bool) -> Iterator[None]:
    """Print an error on one line and append its exit code to `codes`."""
    try:
        yield
    except GaitsweepError as error:
        if debug:
            traceback.print_exc()
        terminal.say(f"gaitsweep: {error}")
        codes.append(error.exit_code)
    except BrokenPipeError:
        terminal.silence(1)
        codes.append(1)
    except KeyboardInterrupt:
        terminal.say("gaitsweep: Stopped.")
        codes.append(130)
    except Exception as error:
        if debug:
            traceback.print_exc()
        if is_disk_full(error):  # of standard output
            terminal.silence(1)
            terminal.say("gaitsweep: The disk is full; not everything could be printed.")
            codes.append(DiskFullError.exit_code)
            return
        if limit := reached_limit(error):
            terminal.say(f"gaitsweep: {(known := unwritten(Path(), limit))}")
            codes.append(known.exit_code)
            return
        message = f"{type(error).__name__}: {' '.join(str(error).split())[:300]}"
        terminal.say(f"gaitsweep: Internal error, {message}; --debug shows where.")
        codes.append(2)


def _archives(options: argparse.Namespace, codes: list[int] | None = None) -> list[tuple[Any, Path]]:
    """Read and check each study and name its archive; with `codes`, invalid studies are reported and skipped."""
    from pipeline.study import parse

    if options.archive and len(options.studies) > 1:
        raise StudyError("`--archive` names one file, but there are several studies.")
    studies = []
    for path in options.studies:
        with contextlib.nullcontext() if codes is None else _report_errors(codes, options.debug):
            studies.append(parse.read(path, getattr(options, "accuracy", None)))
    targets = [(s, options.archive or Path("data", "archive", f"{s.name}.nc")) for s in studies]
    for i, (study, path) in enumerate(targets):
        if any(path == other for _, other in targets[:i]):
            raise StudyError(f"Two studies are called {study.name}.")
    return targets


def _run(options: argparse.Namespace) -> int:
    codes: list[int] = []
    studies = _archives(options, codes)
    from pipeline.cli import text
    from pipeline.engine import runner

    names = (field.name for field in dataclasses.fields(runner.Options))
    run_options = runner.Options(**{name: getattr(options, name) for name in names})
    start = time.monotonic()

    def report(error: Exception) -> None:
        with _report_errors([], options.debug):
            raise error

    ends = runner.run(studies, run_options, report)
    codes += ends
    if not options.quiet:
        finished = {study.path: path for (study, path), end in zip(studies, ends, strict=True) if end in (0, 1)}
        others = [str(path) for path in options.studies if path not in finished]
        for line in text.after(list(finished.values()), others, time.monotonic() - start):
            terminal.say(line)
    return min(codes, key=_EXIT_CODES_BY_SEVERITY.index)


def _plan(options: argparse.Namespace) -> int:
    from pipeline import paths
    from pipeline.cli import text
    from pipeline.graph.plan import Plan, summary
    from pipeline.store.store import Store

    records = []
    for study, path in _archives(options):
        store = Store(paths.sidecar_path(path, ".journal"), write=False)
        planned = Plan(study, store, options.retry_failed)
        describe = text.plan_record if options.json else text.plan
        records.append(describe(planned, summary(planned), path))
    print(json.dumps(records) if options.json else "\n".join(line for record in records for line in record))
    return 0


def _status(options: argparse.Namespace) -> int:
    from pipeline.cli import text

    logs = sorted(Path("data/archive").glob("*.events.jsonl"))
    recorded = [log.with_name(log.name.removesuffix(".events.jsonl") + ".nc") for log in logs]
    every = [options.archive] if options.archive else recorded
    archives = [path for _, path in _archives(options)] or every
    states = {path: text.state(path) for path in archives}
    if options.json:
        print(json.dumps([{"archive": str(path), **(state or {})} for path, state in states.items()]))
        return 0
    for path, state in states.items():
        print("\n".join(text.status(path, state)))
    if not states:
        print("There is no record of a run in data/archive.")
    return 0


@contextlib.contextmanager
def _pages_counted(total: int) -> Iterator[Callable[[int], None]]:
    """Show how many pages of a report are made, if it takes long."""
    begin = said = time.monotonic()
    shown = False

    def tell(made: int) -> None:
        nonlocal said, shown
        now = time.monotonic()
        if now - begin > _QUIET and now - said > (0.5 if terminal.is_terminal() else 10):
            said, shown = now, terminal.is_terminal()
            text = f"{made} of {total} pages, {(now - begin) / made * (total - made):.0f} s to go"
            terminal.say(f"\r\033[K{text}" if shown else text, end="" if shown else "\n")

    try:
        yield tell
    finally:
        if shown:
            terminal.say("\r\033[K", end="")


def _report(options: argparse.Namespace) -> int:
    from pipeline.archive import read

    read.probe(options.archives)
    for path in options.archives:
        with read.open_archive(path):
            pass
    # Asked whether an array is one of dask's, xarray would import dask.array, and so half of SciPy: a second a process.
    no_dask = sys.modules.setdefault("dask.array", None) is None  # type: ignore[arg-type]
    try:
        from pipeline.report import pages

        with _pages_counted(len(options.archives)) as tell:
            index = pages.write(options.archives, options.out, options.only, tell)
    except OSError as error:
        raise unwritten(options.out, error) from error
    finally:
        if no_dask:
            del sys.modules["dask.array"]
    print(index)
    if options.open:
        import webbrowser

        if not webbrowser.open(index.resolve().as_uri()):
            terminal.say("gaitsweep: No browser could be opened.")
    return 0


def _solve(options: argparse.Namespace) -> int:
    from pipeline.study.single_point import solve

    slope = math.radians(options.slope) if options.degrees else options.slope
    asked = options.all, options.steps, options.accuracy, options.limit, options.tuned
    answer = solve(options.walker, slope, options.set, *asked)
    for line in answer.get("search", []):
        terminal.say(line)
    if options.degrees and answer.get("search"):
        terminal.say("Slopes in the lines above are in rad.")
    if options.json:
        # JSON has no infinite numbers; `float` reads the word.
        gaits = [{k: "inf" if v == math.inf else v for k, v in gait.items()} for gait in answer["gaits"]]
        print(json.dumps(gaits, allow_nan=False))
    else:
        from pipeline.cli import text

        print("\n".join(text.gaits(answer["gaits"], answer["units"], options.degrees)))
    return int(any(gait["status"] != "converged" for gait in answer["gaits"]))


def _prove(options: argparse.Namespace) -> int:
    from pipeline.cli import proofs

    return proofs.run(options)


def _walkers(options: argparse.Namespace) -> int:
    from pipeline.dispatch import ask
    from pipeline.study import files

    table = files.walker(options.name, Path()) if options.name else None
    walkers = ask("walkers", {"walker": table} if isinstance(table, dict) else {"name": table})["walkers"]
    if options.json:
        print(json.dumps(walkers))
        return 0
    from pipeline.cli import text

    print("\n".join(text.walkers(walkers, in_full=options.name is not None)))
    return 0


def _claims(options: argparse.Namespace) -> int:
    from pipeline.cli import claims

    return claims.report(options.ids, options.json)


def _tune(options: argparse.Namespace) -> int:
    from pipeline.dispatch import ask
    from pipeline.study import files

    free = {"free": options.free} if options.free else {}
    answer = ask("tune", {"walker": files.walker(options.walker, Path()), **free})
    if options.json:
        print(json.dumps(answer))
        return 0
    from pipeline.cli import text

    print("\n".join(text.tuned_walker(answer)))
    return 0


def _verify(options: argparse.Namespace) -> int:
    from pipeline.cli import verify

    return verify.report(options.archive, options.json)


def _diff(options: argparse.Namespace) -> int:
    from pipeline.archive import diff, read

    read.probe([options.a, options.b])
    own = dict(options.rtol)
    differences = diff.diff(options.a, options.b, own.pop("", 0.0), own)
    print("\n".join(differences) if differences else "They agree.")
    return 1 if differences else 0


def _completion(options: argparse.Namespace) -> int:
    from pipeline.cli import completion

    print(completion.script(parser(), options.shell), end="")
    return 0


if __name__ == "__main__":
    sys.exit(main())
