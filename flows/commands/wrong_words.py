"""What a person typed and no command takes, in the shape of every other error: what, where, mend."""

import re
import shlex
from collections.abc import Sequence

from typer.core import TyperCommand, TyperGroup
from typer.exceptions import TyperException

from pipeline.errors import ConfigError

PROGRAM = "hardcase"



def with_help(app: object, words: Sequence[str]) -> list[str]:
    """The words, and --help where they name a group of commands and none of them."""
    found, path = named(app, words)
    return [*words, "--help"] if isinstance(found, TyperGroup) and len(path) == len(words) else [*words]


def named(app: object, words: Sequence[str]) -> tuple[object, list[str]]:
    """The command that the first words name, as far as they name one, and these words."""
    here, path = app, list[str]()
    for word in words:
        below = here.commands.get(word) if isinstance(here, TyperGroup) else None
        if below is None:
            break
        here, path = below, [*path, word]
    return here, path


def refusal(app: object, words: Sequence[str], error: TyperException) -> ConfigError:
    """Our error for Typer's: its first sentence, all that was typed, and what would be right.

    Args:
        app: the whole command line, from typer.main.get_command.
        words: what was typed after `hardcase`.
        error: what Typer made of it.
    """
    command, path = named(app, words)
    said = " ".join(error.format_message().split())
    what, _, hint = re.sub(r" \((Possible options: .*)\)$", r". \1", said).partition(". ")
    about = command.help or "" if isinstance(command, TyperGroup | TyperCommand) else ""
    example = re.search(r"Example: (.+)", about)
    every = "every command" if isinstance(command, TyperGroup) else "every option"
    ways = [hint[:1].lower() + hint[1:].rstrip("."), f"for example: {example[1].strip()}" if example else "",
            f"{every}: {' '.join([PROGRAM, *path])} --help"]
    return ConfigError(what[:1].lower() + what[1:].rstrip("."), where=shlex.join([PROGRAM, *words]),
                       mend="; ".join(filter(None, ways)))
