"""The candidate's side of candidate.py: loads one policy file behind the fence, then answers questions.

Run: python -P -m pipeline.shadow.child SOCKET PARENT MEMORY_BYTES CPU_S IDLE KIND STATE ENVIRONMENT FILE
"""

import socket
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np

from pipeline.errors import PolicyError, one_line
from pipeline.protocols import Observation, Policy
from pipeline.shadow import fence, wire

WARM_UP = 3
"""Answers to nobody before the first question: the runtime lays out its memory at the first."""


def main() -> None:
    """Answer questions until the control loop is gone."""
    number, parent, memory_bytes, cpu_s, idle, kind, state, environment, file = sys.argv[1:]
    fence.die_with(int(parent))
    fence.step_back(idle=idle == "1")
    fence.drop_rights()
    opened = _opener(kind)  # the runtime starts a thread, which shall have no rights either
    with socket.socket(fileno=int(number)) as line:
        fence.limit(int(memory_bytes), float(cpu_s))
        fence.enclose(reading=True)
        try:
            policy = _warm(opened(Path(file)), int(state), int(environment))
        except (PolicyError, MemoryError) as error:
            line.send(wire.word(wire.REFUSED, _why(error, int(memory_bytes))))
            return
        fence.no_more_files()
        fenced = fence.enclose(reading=False)
        line.send(wire.word(wire.READY, "no new files, no calls" if fenced else "no new files"))
        _serve(policy, line, int(memory_bytes))


def _opener(kind: str) -> Callable[[Path], Policy]:
    """How a file of this kind is opened; its libraries are loaded now, before the fence."""
    if kind == "ppo":
        from pipeline.ppo.policy import LeggedPolicy

        return LeggedPolicy
    from pipeline.policies.onnx_policy import OnnxPolicy

    return OnnxPolicy


def _warm(policy: Policy, state: int, environment: int) -> Policy:
    seen = Observation(np.zeros((1, state)), np.zeros((1, environment)))
    for _ in range(WARM_UP):
        policy.reset(1)
        policy.act(seen, np.arange(1))
    return policy


def _serve(policy: Policy, line: socket.socket, memory_bytes: int) -> None:
    epoch, expected = -1, -1
    while packet := line.recv(wire.MAX_PACKET):
        asked = wire.asked(packet)
        if asked.epoch != epoch or asked.number != expected:  # another batch, or a tick was lost on the way
            policy.reset(asked.attempts)
        epoch, expected = asked.epoch, asked.number + 1
        try:
            said = wire.answer(asked.number, policy.act(asked.observation, asked.ids))
        except (PolicyError, MemoryError) as error:
            line.send(wire.word(wire.FAILED, _why(error, memory_bytes), asked.number))
            return
        line.send(said)


def _why(error: Exception, memory_bytes: int) -> str:
    """What went wrong, as one line; ONNX Runtime says in words that it got no memory."""
    if isinstance(error, MemoryError) or "alloc" in str(error.__cause__):
        return f"takes more than {memory_bytes / 2**20:.0f} MiB of memory"
    return f"{error.what} (mend: {error.mend})" if isinstance(error, PolicyError) else one_line(error)


if __name__ == "__main__":
    main()
