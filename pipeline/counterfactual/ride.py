"""Ride: what a policy would have done, tick by tick, along recordings that another one made."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np

from pipeline.protocols import Array, Ids, Observation, Policy


@runtime_checkable
class Restorable(Policy, Protocol):
    """A policy whose memory can be put back."""

    def restore(self, ids: Ids, rows: Array) -> None:
        """Set the memory of attempts to rows that memory() gave."""
        ...


class Perceived(Protocol):
    """What a policy is shown along a recording, and what was done: of a Trace, or of less than that."""

    @property
    def state(self) -> Array:
        """See pipeline.frames.STATE, shape (m, 16)."""
        ...

    @property
    def environment(self) -> Array:
        """See pipeline.frames.ENVIRONMENT, shape (m, 7)."""
        ...

    @property
    def action(self) -> Array:
        """See pipeline.frames.ACTION, shape (m, 5)."""
        ...

    @property
    def phase(self) -> tuple[str, ...]:
        """Subtask at each tick."""
        ...

    def __len__(self) -> int:
        """How many ticks."""
        ...


@dataclass(frozen=True, slots=True)
class Ride:
    """One policy along one recording of m ticks."""

    action: Array
    """What it would have done, shape (m, 5)."""
    memory: Array
    """What it remembers before it acts at each tick, shape (m, w)."""


def ride(policy: Restorable, traces: Sequence[Perceived], *, ticks: int | None = None) -> list[Ride]:
    """Let a policy see what was recorded, from the first tick on, all attempts side by side.

    A policy is a function of what it has seen so far, so its memory at any tick is what it would be had it ridden
    along: nobody has to have recorded it.

    Args:
        policy: forgets what it knew.
        traces: recordings, of any lengths.
        ticks: only that many ticks of each.
    """
    policy.reset(len(traces))
    lengths = np.array([len(t) if ticks is None else min(len(t), ticks) for t in traces])
    actions: list[list[Array]] = [[] for _ in traces]
    memories: list[list[Array]] = [[] for _ in traces]
    for tick in range(int(lengths.max(initial=0))):
        ids = np.flatnonzero(lengths > tick)
        there: list[int] = ids.tolist()
        before = policy.memory(ids)
        seen = Observation(np.stack([traces[i].state[tick] for i in there]),
                           np.stack([traces[i].environment[tick] for i in there]))
        action = policy.act(seen, ids)
        for row, i in enumerate(there):
            actions[i].append(action[row])
            memories[i].append(before[row])
    return [Ride(np.stack(a), np.stack(m)) for a, m in zip(actions, memories, strict=True)]
