"""One arm of one run: its store, its numbers, and what all of its stages share; each stage is done once."""

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Self

from pydantic import JsonValue

from flows.run import facts
from flows.run.arms import arm_of
from flows.run.material import Material
from flows.run.steps_api import StepResult
from pipeline.errors import GateError
from pipeline.files import short_id
from pipeline.policies.table import policy_kind
from pipeline.protocols import Policy
from pipeline.simulation.recordings import Recorded
from pipeline.store import Lease, Store, Transaction
from schemas.episode import Episode
from schemas.recipe import Recipe

SHARED = ("collect", "augment", "build", "train", "gate", "exam")
"""Stages of generation 0 that a control arm has in common with its loop."""


@dataclass(frozen=True, slots=True)
class Made:
    """What a stage made: for people, for the manifest, and for the catalog."""

    ids: tuple[str, ...]
    says: str
    numbers: Mapping[str, JsonValue]
    write: Callable[[Transaction], None]


def no_rows(tx: Transaction) -> None:
    """The `write` of a stage that adds no rows."""


def run_id(recipe: Recipe, seed: int, twin: int, arm: str) -> str:
    """Id of a run: it follows from what is run, so that a killed one can be found again."""
    return short_id("run", recipe.model_dump_json(), seed, twin, arm)


class ArmRun:
    """One arm of one run.

    Args:
        store, lease: where everything goes.
        recipe, seed, twin: what is run.
        arm: key of ARMS.
        base: the loop that a control arm is compared with; generation 0 is shared with it.
    """

    sources: Mapping[str, str] = MappingProxyType({})
    """Stage -> name of the file below stages/ that does it, where that has another name."""
    day: int | None = None
    """Number of the day of a run by the clock, whose nights share an error budget; None by hand [d]."""

    def __init__(self, store: Store, lease: Lease, recipe: Recipe, seed: int, twin: int, arm: str,
                 base: Self | None = None) -> None:
        self.store, self.lease, self.base, self.seed, self.twin = store, lease, base, seed, twin
        self.name, self.arm = arm, arm_of(arm)
        self.recipe, self.run = self.arm.recipe(recipe), run_id(recipe, seed, twin, arm)
        self.material = Material(store, self.run)
        with store.commit(lease, self.run) as tx:
            tx.add_run(facts.run_info(recipe, seed, twin, arm))

    def once(self, generation: int, stage: str, work: Callable[[], Made]) -> StepResult:
        """What the manifest says of a stage; if it says nothing, the stage is done now and its manifest written."""
        done = self.store.step(self.run, generation, stage)
        if done is None and self._shares(generation, stage) and self.base is not None:
            done = self.store.step(self.base.run, generation, stage)
            if done is not None:
                with self.store.commit(self.lease, self.run) as tx:
                    tx.finish_step(generation, stage, inputs=done.inputs, outputs=done.outputs, code=done.code)
        if done is not None:
            ids = done.outputs["ids"]
            found = tuple(str(i) for i in ids) if isinstance(ids, list) else ()
            return StepResult(found, str(done.outputs["says"]), resumed=True)
        began = time.monotonic()
        made = work()
        with self.store.commit(self.lease, self.run) as tx:
            made.write(tx)
            tx.finish_step(generation, stage, inputs=self.material.inputs(generation, stage),
                           outputs={"ids": list(made.ids), "says": made.says, **made.numbers},
                           code=facts.stage_code(self.sources.get(stage, stage)), wall_s=time.monotonic() - began)
        return StepResult(made.ids, made.says)

    def _shares(self, generation: int, stage: str) -> bool:
        if generation:
            return False
        if self.arm.whole_workspace or self.arm.widen is not None:
            return stage == "collect"
        return stage in SHARED or (stage == "deploy" and self.arm.deploys)

    def recorded(self, recorded: Sequence[Recorded], says: str, numbers: Mapping[str, JsonValue]) -> Made:
        """Move recordings into the store; their episodes are what the stage made."""
        self.store.put_blobs([r.path for r in recorded], move=True)
        episodes: list[Episode] = [r.episode for r in recorded]
        return Made(tuple(e.id for e in episodes), says, numbers, lambda tx: tx.add_episodes(episodes))

    def candidate(self, generation: int) -> str:
        """Id of the policy that a lap trained."""
        return self.material.ids(generation, "train")[0]

    def champion(self, generation: int) -> str:
        """Id of the released policy, once the verdict of this lap was acted on.

        Raises:
            GateError: nothing is released yet.
            StoreError: this lap's release is still to come; the champion before it would be taken for its own.
        """
        champion = self.store.champion(self.run)
        if champion is None:
            raise GateError("nothing is released yet", where=f"run {self.run}",
                            mend="hardcase gate && hardcase release")
        self.material.outputs(generation, "release")
        return champion.policy

    def policy(self, policy: str) -> Policy:
        """The released form of a policy, ready to act."""
        return policy_kind(self.store.policy(policy).kind).open(self.file(policy))

    def file(self, policy: str) -> Path:
        """The released form of a policy."""
        return self.store.path(self.store.policy(policy).checkpoint) / "policy.onnx"

    def folder(self) -> Path:
        """Where this run's files wait until they are in the store; what a killed run left there is overwritten."""
        folder = self.store.tmp / self.run
        folder.mkdir(parents=True, exist_ok=True)
        return folder

    def robot_seconds(self, generation: int) -> float:
        """Robot time of one lap: deployment and corrections [s]."""
        steps = (self.store.step(self.run, generation, stage) for stage in ("deploy", "harvest"))
        return sum(float(str(s.outputs["robot_s"])) for s in steps if s is not None)
