"""The child's side of child.py: jobs come as lines of JSON, each runs under its limits, answers go back the same way.

Run: python -P -m pipeline.logs.worker
"""

import json
import os
import resource
import signal
import sys
import time
from importlib import import_module
from typing import Any

LAYERS = ("pipeline", "stages")
"""Only functions of ours are run."""


def main() -> None:
    """Answer jobs until the parent closes the pipe."""
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # whatever a library prints is no answer
    for line in sys.stdin.buffer:
        answers.write(json.dumps(_answer(json.loads(line))).encode() + b"\n")
        answers.flush()


def _answer(job: dict[str, Any]) -> dict[str, Any]:
    from pipeline.errors import HardcaseError

    try:
        module, _, name = str(job["function"]).partition(":")
        if module.split(".")[0] not in LAYERS:
            raise ValueError(f"{module} is not ours")
        function = getattr(import_module(module), name)
        _limit(job["memory_bytes"], job["cpu_s"], job["wall_s"])
        return {"result": function(*job["arguments"])}
    except HardcaseError as error:
        return {"refused": [type(error).__name__, error.what, error.where, error.mend]}
    except MemoryError:
        return {"failed": "MemoryError"}
    except Exception as error:
        return {"failed": f"{type(error).__name__}: {error}"[:500]}
    finally:
        _limit(resource.RLIM_INFINITY, 0, 0)


def _limit(memory_bytes: int, cpu_s: float, wall_s: float) -> None:
    """Limits of this process from now on; 0 s for none. Past a time limit the kernel ends it."""
    _soft(resource.RLIMIT_AS, memory_bytes)
    signal.setitimer(signal.ITIMER_PROF, cpu_s)
    signal.setitimer(signal.ITIMER_REAL, wall_s)
    # A second fence: the timers could be taken away by a library, this one only by setting it again.
    _soft(resource.RLIMIT_CPU, int(time.process_time() + cpu_s) + 2 if cpu_s else resource.RLIM_INFINITY)


def _soft(kind: int, value: int) -> None:
    """Set a limit, as far as the one we were started with allows."""
    hard = resource.getrlimit(kind)[1]
    without = resource.RLIM_INFINITY
    resource.setrlimit(kind, (hard if value == without else value if hard == without else min(value, hard), hard))


if __name__ == "__main__":
    main()
