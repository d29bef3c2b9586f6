"""`--shadow ID`: candidates of a store beside a robot in real time."""

import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager

from flows.teleop.devices import policy_id
from pipeline.errors import ConfigError
from pipeline.shadow.limits import Limits
from pipeline.shadow.riders import Riders
from pipeline.store import Store

GRACE_CPU_S, CPU_SHARE = 10, 0.25
"""What a candidate may take of a core: to load, and while the robot works."""
ANSWER_S = 5.0
"""Silence after which it counts as hung: a hundred ticks of the reference arm [s]."""


@contextmanager
def shadowed(names: Sequence[str], store: Store, seconds: float) -> Iterator[Riders | None]:
    """Riders that are ready while the body runs; None where none is asked for.

    Args:
        names: 'champion' or beginnings of ids.
        store: where policies are.
        seconds: longest time that the robot works [s].

    Raises:
        ConfigError: a name that is no policy's.
        StoreError: there is no such policy, or nothing is released.
    """
    if not names:
        yield None
        return
    if "expert" in names:
        raise ConfigError("the expert is no candidate: it has no file", where="--shadow expert",
                          mend="name a policy's id, or champion")
    ids = dict.fromkeys(policy_id(name, store, "--shadow") for name in names)
    files = {id: store.path(store.policy(id).checkpoint) / "policy.onnx" for id in ids}
    limits = Limits(cpu_s=GRACE_CPU_S + CPU_SHARE * seconds, answer_s=ANSWER_S)
    with Riders(files, limits, patient=False) as riders:
        riders.ready()
        yield riders


def print_states(states: Mapping[str, str]) -> None:
    """Tell what became of each candidate, on stderr."""
    for id, state in states.items():
        print(f"shadow {id}: {state}", file=sys.stderr)
