"""Many calls of one foreign command in one process, so that what it imports is imported once.

Run: python -m pipeline.selftest.asking MODULE:FUNCTION < CALLS, a JSON list of argument lists. The function is the one
that the installed console script calls; it sees its arguments in sys.argv, as there.
"""

import contextlib
import io
import json
import sys
from collections.abc import Callable
from importlib import import_module
from typing import NamedTuple

REFUSED = 2
"""Exit code of a call that ended in an exception."""


class Answer(NamedTuple):
    """What one call of a command left behind."""

    code: int
    out: str
    err: str


def answer(command: Callable[[], object], arguments: list[str]) -> Answer:
    """Call a command as its console script does, and keep what it prints."""
    out, err = io.StringIO(), io.StringIO()
    sys.argv = ["referee", *arguments]
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        try:
            returned = command()
            code = returned if isinstance(returned, int) else 0
        except SystemExit as left:
            code = left.code if isinstance(left.code, int) else int(left.code is not None)
        except Exception as error:  # whatever others let through: the command has failed, the next call goes on
            err.write(f"{type(error).__name__}: {error}")
            code = REFUSED
    return Answer(code, out.getvalue(), err.getvalue())


def main() -> None:
    """Read calls from stdin, write their answers to stdout as JSON."""
    module, _, function = sys.argv[1].partition(":")
    stdout, calls = sys.stdout, json.load(sys.stdin)
    command = getattr(import_module(module), function)
    json.dump([answer(command, arguments) for arguments in calls], stdout)


if __name__ == "__main__":
    main()
