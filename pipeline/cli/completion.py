"""Scripts that complete `gaitsweep` commands in bash or zsh, generated from the parser."""

import argparse
import re
from pathlib import Path

from gaitsweep import extensions
from gaitsweep.pipeline import dispatch
from gaitsweep.pipeline.study.fields import EXTRA_AXES

#: zsh runs the bash functions.
_ZSH = """# zsh completion for gaitsweep; in ~/.zshrc, after compinit: eval "$(gaitsweep completion zsh)"
autoload -U +X bashcompinit && bashcompinit
"""


def run(options: argparse.Namespace) -> int:
    """Print the script."""
    print(script(options.top(), options.shell), end="")
    return 0


def script(parser: argparse.ArgumentParser, shell: str) -> str:
    """Completion script for a shell, "bash" or "zsh"."""
    (commands,) = (
        a.choices for a in parser._actions if isinstance(a, argparse._SubParsersAction)
    )
    walkers = [
        *dispatch.resolve("gaitsweep.tasks.walkers.catalogue:CATALOGUE"),
        *extensions.names("walkers"),
    ]
    keys, one_link = (
        dispatch.resolve(f"gaitsweep.tasks.walkers.walker:{name}")
        for name in ("NUMBERS", "ONE_LINK")
    )
    words = {
        name: [*_options(command), *_choices(command)]
        for name, command in commands.items()
    }
    words["walkers"] += walkers
    filled = {
        "commands": "|".join(commands),
        "top": " ".join([*commands, *_options(parser)]),
        "cases": "\n".join(
            f'    {name}) words="{" ".join(names)}";;' for name, names in words.items()
        ),
        "walkers": " ".join(walkers),
        "keys": " ".join(keys),
        "settings": " ".join(
            f"{key}=" for key in (*keys, *one_link, *[*EXTRA_AXES][1:], "knees")
        ),
    }
    text = Path(__file__).with_suffix(".bash").read_text(encoding="utf-8")
    text = re.sub("@([a-z]+)@", lambda place: filled[place[1]], text)
    return text if shell == "bash" else _ZSH + text.partition("\n")[2]


def _options(parser: argparse.ArgumentParser) -> list[str]:
    """Options that a parser shows in its help."""
    return [
        name
        for action in parser._actions
        if action.help != argparse.SUPPRESS
        for name in action.option_strings
    ]


def _choices(parser: argparse.ArgumentParser) -> list[str]:
    """Choices of positional arguments."""
    return [
        word
        for action in parser._actions
        if not action.option_strings
        for word in action.choices or ()
    ]
