"""Ridden: the champion with candidates in its shadow, for robots that are recorded by a Tracer."""

from collections.abc import Callable, Mapping

from pipeline.disagreement import ACTION_SCALE, disagreement
from pipeline.protocols import Array, Ids, Observation, Policy
from pipeline.shadow.riders import Riders
from pipeline.shadow.targets import joint_targets
from pipeline.simulation.tracing import Tracer
from pipeline.trace import Event


class Ridden:
    """Same observations for all; the riders' answers go to the record alone. Implements Policy.

    Args:
        champion: who acts.
        riders: who may not.
        would_send: what actions of the attempts would send to the joints; nothing moves.
        tracer: of the champion's work.
        width: joints that are sent to.
        scale: of each value of an action, for the disagreement.
    """

    def __init__(self, champion: Policy, riders: Riders, would_send: Callable[[Array, Ids], Array], tracer: Tracer, *,
                 width: int = 7, scale: Array = ACTION_SCALE) -> None:
        self.champion, self.riders, self.tracer = champion, riders, tracer
        self._would_send, self._width, self._scale, self._tick = would_send, width, scale, 0

    def reset(self, n: int) -> None:
        """Prepare all for n attempts."""
        self.champion.reset(n)
        self.riders.reset(n)
        self._tick = 0

    def act(self, observation: Observation, ids: Ids) -> Array:
        """The champion's actions, untouched."""
        plan = self.planned(ids)
        action = self.champion.act(observation, ids)
        self.riders.offer(observation, ids)
        answers = self.riders.answers()
        for id, other in answers.items():
            self.tracer.pend(f"shadow/{id}/joint", joint_targets(self._would_send, other, ids, self._width))
            self.tracer.pend(f"shadow/{id}/disagreement", disagreement(other, action, self._scale))
        for name, values in self.signals(observation, action, answers, ids, plan).items():
            self.tracer.pend(f"signal/{name}", values)
        for id, state in self.riders.news():
            for attempt in ids:
                self.tracer.events[int(attempt)].append(Event(self._tick, 30, "shadow", f"{id} {state}"))
        self._tick += 1
        return action

    def memory(self, ids: Ids) -> Array:
        """The champion's memory."""
        return self.champion.memory(ids)

    def planned(self, ids: Ids) -> Array | None:
        """What the champion had planned for this tick, asked before it acts; None where nobody wants to know."""
        del ids
        return None

    def signals(self, observation: Observation, action: Array, answers: Mapping[str, Array], ids: Ids,
                plan: Array | None) -> Mapping[str, Array]:
        """Signals of risk to record with this tick, each (len(ids),); none here."""
        del observation, action, answers, ids, plan
        return {}
