"""What is being run in this process: the arm whose stages the tasks call, and who watches."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from typing import Protocol

from flows.run.steps_api import LoopSteps, StepResult
from flows.service.memory import tree_pss_mb


@dataclass(frozen=True, slots=True)
class Step:
    """One stage of one lap of one arm."""

    arm: str
    """'loop', or 'control' for the loop with random starts."""
    generation: int
    stage: str


class Watcher(Protocol):
    """Is told what happens; must be cheap and must not raise."""

    def begin(self, step: Step) -> None:
        """A stage begins."""
        ...

    def advance(self, done: int, total: int) -> None:
        """How far the running stage is."""
        ...

    def end(self, step: Step, result: StepResult) -> None:
        """A stage is finished."""
        ...


@dataclass(frozen=True, slots=True)
class Running:
    """The arm that tasks work for."""

    steps: LoopSteps
    watcher: Watcher
    arm: str = "loop"
    check: Callable[[], None] = lambda: None
    """Called before each stage; raises if there is a reason not to begin it."""
    peak_mb: Callable[[], float] = tree_pss_mb
    """Peak memory of this process and its children so far [MB]; without a watch, what they hold now."""


_RUNNING: ContextVar[Running] = ContextVar("running")


def running() -> Running | None:
    """What this context runs, or None outside of `run_with`."""
    return _RUNNING.get(None)


@contextmanager
def run_with(active: Running) -> Iterator[Running]:
    """Let every task called in the block work for `active`; tasks carry ids and nothing else."""
    token = _RUNNING.set(active)
    try:
        yield active
    finally:
        _RUNNING.reset(token)
