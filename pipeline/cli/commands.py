"""The command line: `gaitsweep COMMAND`. Each command is a module of its name, imported
only if it is given.
"""

import argparse
import contextlib
import logging
import os
import re
import sys
import tomllib
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any, NoReturn

from gaitsweep.pipeline import terminal
from gaitsweep.pipeline.cli import kinds
from gaitsweep.pipeline.cli.errors import report_errors
from gaitsweep.pipeline.dispatch import resolve
from gaitsweep.pipeline.errors import StudyError

#: Purpose and arguments of each command.
COMMANDS: dict[str, dict[str, Any]] = tomllib.loads(
    Path(__file__).with_suffix(".toml").read_text(encoding="utf-8")
)
_SHARED = COMMANDS.pop("shared")
#: Numbers that are no options; argparse itself takes -1e-3 for one.
_NEGATIVE = re.compile(r"-\.?\d")


class _Parser(argparse.ArgumentParser):
    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:
        """Refuse unknown options before argparse misses others."""
        for word in () if self._subparsers or "--" in args else args:
            name, known = word.partition("=")[0], self._option_string_actions
            if name.startswith("--") and name not in known:
                from gaitsweep.pipeline.study.location import Location

                raise Location("").unknown(
                    name,
                    [option for option in known if option.startswith("--")],
                    "option",
                )

        return super().parse_known_args(args, namespace)

    def error(self, message: str) -> NoReturn:
        from gaitsweep.pipeline.study.location import clip

        raise StudyError(
            f"{message[:1].upper()}{clip(message[1:], 500)} ({self.prog} --help)."
        )

    def _check_value(self, action: argparse.Action, value: Any) -> None:
        from gaitsweep.pipeline.study.location import Location

        if action.choices is not None and value not in action.choices:
            raise Location("").unknown(
                value, action.choices, str(action.metavar or action.dest).lower()
            )

    def _print_message(self, message: str, file: Any = None) -> None:
        # argparse itself says nothing of help that finds no room.
        print(message, end="", file=file or sys.stderr)


class _Version(argparse.Action):
    def __call__(self, *_: Any) -> NoReturn:
        from gaitsweep.pipeline.archive.provenance import version

        print(f"gaitsweep {version('gaitsweep')}")
        sys.exit(0)


def parser(wanted: Iterable[str] = tuple(COMMANDS)) -> argparse.ArgumentParser:
    """Parser of all commands, with the options of those that are wanted."""
    top = _Parser(
        prog="gaitsweep", description="Gait sweeps of passive dynamic walkers."
    )
    top.add_argument(
        "--debug", action="store_true", help="show the traceback of an error"
    )
    top.add_argument("--version", action=_Version, nargs=0, help="show the version")
    commands = top.add_subparsers(dest="command", metavar="COMMAND", required=True)
    for name, about in COMMANDS.items():
        purpose = about["purpose"]
        command = commands.add_parser(
            name, help=purpose, description=purpose, allow_abbrev=False
        )
        command.add_argument(
            "--debug",
            action="store_true",
            default=argparse.SUPPRESS,
            help=argparse.SUPPRESS,
        )
        command._negative_number_matcher = _NEGATIVE
        if name in wanted:
            for argument, options in about["arguments"].items():
                command.add_argument(
                    argument,
                    **_resolved(
                        _SHARED[options] if isinstance(options, str) else options
                    ),
                )

            if "epilog" in about:
                command.epilog = resolve(about["epilog"])()
                command.formatter_class = argparse.RawDescriptionHelpFormatter

            command.set_defaults(
                run=resolve(f"gaitsweep.pipeline.cli.{name}:run"), top=parser
            )

    return top


def _resolved(options: dict[str, Any]) -> dict[str, Any]:
    """Options of an argument, the kinds that they name in their place, and a list of
    names as argparse takes it.
    """
    named = {
        key: getattr(kinds, value, value)
        for key, value in options.items()
        if key in ("type", "action")
    }
    keywords = options | named
    if isinstance(keywords.get("metavar"), list):
        keywords["metavar"] = tuple(keywords["metavar"])
    return keywords


class _Shown(logging.Handler):
    """Shows what is logged: warnings, and at a terminal what takes long.

    Workers have their own, by which a run shows what they log.
    """

    def emit(self, record: logging.LogRecord) -> None:
        """Show what was logged."""
        if record.levelno >= logging.WARNING or terminal.is_terminal():
            message = record.getMessage().removeprefix("gaitsweep: ")
            terminal.say(f"gaitsweep: {message}")


@contextlib.contextmanager
def _showing_what_is_logged() -> Iterator[None]:
    """Show what is logged while a command runs, and leave the log as it was."""
    logger, shown = logging.getLogger("gaitsweep"), _Shown()
    level = logger.level
    logger.setLevel(logging.INFO)
    logger.addHandler(shown)
    try:
        yield
    finally:
        logger.removeHandler(shown)
        logger.setLevel(level)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command and return its exit code."""
    terminal.prepare()
    # To start threads, which none needs, takes a tenth of a second.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    words, codes = list(sys.argv[1:] if arguments is None else arguments), list[int]()
    words = words or ["--help"]
    with report_errors(codes, "--debug" in words), _showing_what_is_logged():
        try:
            options = parser(words).parse_args(words)
            codes.append(options.run(options))
        finally:
            # Here: a failure to print could not be reported at interpreter exit.
            sys.stdout.flush()

    return codes[-1]


if __name__ == "__main__":
    sys.exit(main())
