"""The command line: `gaitsweep COMMAND`. Each command is a module of its name, imported only if it is given."""

import argparse
import importlib
import sys
from collections.abc import Iterable, Sequence
from typing import Any, NoReturn

from pipeline import terminal
from pipeline.cli.errors import report_errors
from pipeline.errors import StudyError

#: What each command does.
COMMANDS = {
    "run": "run studies; the same command again resumes",
    "plan": "show what would run and why, without running it",
    "status": "progress of the current or last run",
    "report": "HTML report from archives",
    "solve": "all gaits at one point",
    "prove": "proofs of a walker's gaits at one slope, or of an archive's",
    "walkers": "the catalogue of walkers, or one walker",
    "claims": "claims of the paper: what it says, the computed number and the verdict",
    "tune": "the nearest walker that meets the conditions of walking at vanishing slope",
    "verify": "check that an archive is intact, complete and valid",
    "diff": "differences between two archives",
    "completion": "shell script that completes commands",
}


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


def parser(wanted: Iterable[str] = tuple(COMMANDS)) -> argparse.ArgumentParser:
    """Parser of all commands, with the options of those that are wanted."""
    top = _Parser(prog="gaitsweep", description="Gait sweeps of passive dynamic walkers.")
    top.add_argument("--debug", action="store_true", help="show the traceback of an error")
    top.add_argument("--version", action=_Version, nargs=0, help="show the version")
    commands = top.add_subparsers(dest="command", metavar="COMMAND", required=True)
    for name, purpose in COMMANDS.items():
        command = commands.add_parser(name, help=purpose, description=purpose, allow_abbrev=False)
        command.add_argument("--debug", action="store_true", default=argparse.SUPPRESS, help=argparse.SUPPRESS)
        if name in wanted:
            module = importlib.import_module(f"pipeline.cli.{name}")
            module.add_arguments(command)
            command.set_defaults(run=module.run, top=parser)
    return top


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command and return its exit code."""
    terminal.prepare()
    words, codes = list(sys.argv[1:] if arguments is None else arguments), list[int]()
    with report_errors(codes, "--debug" in words):
        try:
            options = parser(words).parse_args(words)
            codes.append(options.run(options))
        finally:
            sys.stdout.flush()  # here: a failure to print could not be reported at interpreter exit
    return codes[-1]


if __name__ == "__main__":
    sys.exit(main())
