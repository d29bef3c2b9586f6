"""Attempts of a finished loop's policies on fresh starts, with every signal, for the study of shadow mode."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

from flows.run import facts
from flows.run.signalling import neighbours_of
from flows.run.steps import Steps
from pipeline.protocols import Array, Ids, Observation, Policy
from pipeline.recording import read_episode
from pipeline.shadow.riders import Riders
from pipeline.trace import Rows
from stages.deploy import deploy

ATTEMPTS = 300
"""Of each champion on each twin."""


@dataclass(frozen=True, slots=True)
class Setting:
    """Who works, who watches, and where."""

    name: str
    champion: int
    """Generation whose candidate is the champion."""
    candidates: tuple[int, ...]
    """Generations of those that ride along."""
    rare_share: float | None = None
    """Share of rare starts; that of the recipe where None."""


SETTINGS = (Setting("first", 0, (1, 2)), Setting("second, half of the starts rare", 1, (0, 2), 0.5))
"""The champion of generation 0 fails at what it was never shown; that of generation 1 was shown some of it."""


@dataclass(frozen=True, slots=True)
class Attempt:
    """One attempt: how it ended, and what was known of it at every tick."""

    failed: bool
    """By truth."""
    stratum: str
    signals: Mapping[str, Rows]
    """Signal, or 'disagreement with generation G' -> value at each tick."""

    def __len__(self) -> int:
        return len(next(iter(self.signals.values())))


def attempts(steps: Steps, setting: Setting, *, twin: int, seed: int, count: int = ATTEMPTS) -> list[Attempt]:
    """Deploy a policy of a finished loop with others in its shadow, and read what was recorded.

    Args:
        steps: the loop.
        setting: who works and who watches.
        twin: where.
        seed: decides the starts.
        count: attempts.
    """
    champion, riding = _policy(steps, setting.champion), {g: _policy(steps, g) for g in setting.candidates}
    changed: dict[str, object] = {"episodes": count}
    if setting.rare_share is not None:
        changed["rare_share"] = setting.rare_share
    recipe = steps.recipe.model_copy(update={"deploy": steps.recipe.deploy.model_copy(update=changed), "threads": 1})
    with TemporaryDirectory(dir=steps.store.tmp) as folder, _Beside(
            {id: steps.policy(id) for id in riding.values()}) as riders:
        done = deploy(steps.policy(champion), champion, recipe, seed=seed, twin=twin, generation=setting.champion,
                      folder=Path(folder), software=facts.software("deploy"), riders=riders,
                      neighbours=neighbours_of(champion, steps.store))
        return list(_read([r.path for r in done.recorded], [bool(t) for t in done.truth], riding))


class _Beside(Riders):
    """Candidates in this process: there is no robot to shield here, and their answers are the same to the bit."""

    def __init__(self, policies: Mapping[str, Policy]) -> None:
        super().__init__({}, patient=True)
        self._policies, self._answers = policies, dict[str, Array]()

    @property
    def ids(self) -> tuple[str, ...]:
        """Ids of all candidates."""
        return tuple(self._policies)

    def reset(self, n: int) -> None:
        """Have all forget everything and prepare for n attempts."""
        for policy in self._policies.values():
            policy.reset(n)

    def offer(self, observation: Observation, ids: Ids) -> None:
        """Ask all at once."""
        self._answers = {id: policy.act(observation, ids) for id, policy in self._policies.items()}

    def answers(self) -> Mapping[str, Array]:
        """What they said."""
        return self._answers


def _read(paths: list[Path], truth: list[bool], riding: Mapping[int, str]) -> Iterator[Attempt]:
    for path, succeeded in zip(paths, truth, strict=True):
        episode, trace = read_episode(path)
        apart = {f"disagreement, generation {g}": trace.shadows[id].disagreement for g, id in riding.items()}
        yield Attempt(not succeeded, episode.scene.stratum, {**apart, **trace.signals})


def _policy(steps: Steps, generation: int) -> str:
    return steps.material.ids(generation, "train")[0]
