"""Steps: the stages of one run wired to its store; each is done once, and the manifest says so."""

import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from pydantic import JsonValue

from flows import facts, summary
from flows.arms import LOOP, ARMS, arm_of
from flows.material import Material
from flows.steps_api import Progress, StepResult
from pipeline.errors import GateError
from pipeline.files import short_id
from pipeline.lerobot_view.training_data import TrainingData
from pipeline.policies.onnx_policy import OnnxPolicy
from pipeline.protocols import Policy
from pipeline.shards import write_shard
from pipeline.simulation.evaluation import evaluate, gate_scenes
from pipeline.simulation.recordings import Recorded
from pipeline.simulation.tasks import load_task
from pipeline.store import Lease, Store, Transaction
from schemas.episode import Episode
from schemas.recipe import Recipe
from schemas.scene import SceneSpec
from schemas.summary import LoopResult
from schemas.verdict import Verdict
from stages.augment import augment
from stages.build import build
from stages.collect import collect
from stages.deploy import Rider, deploy, deploy_scenes
from stages.exam import exam, success_by
from stages.gate import gate
from stages.harvest import demonstrate, harvest
from stages.release import release, rollback
from stages.train import train

SHARED = ("collect", "augment", "build", "train", "gate", "exam")
"""Stages of generation 0 that a control arm has in common with its loop."""


@dataclass(frozen=True, slots=True)
class Made:
    """What a stage made: for people, for the manifest, and for the catalog."""

    ids: tuple[str, ...]
    says: str
    numbers: Mapping[str, JsonValue]
    write: Callable[[Transaction], None]


@contextmanager
def open_run(root: Path, recipe: Recipe, *, seed: int, twin: int, control: bool,
             arm: str = "random") -> Iterator["Steps"]:
    """The stages of one run under the store's lease, with its control arm beside it where one was asked for."""
    run = run_id(recipe, seed, twin, LOOP)
    with Store.open(root, create=True) as store, store.lease(run) as lease:
        loop = Steps(store, lease, recipe, seed, twin, LOOP)
        if control:
            loop.control = Steps(store, lease, recipe, seed, twin, arm, loop)
        yield loop


def run_id(recipe: Recipe, seed: int, twin: int, arm: str) -> str:
    """Id of a run: it follows from what is run, so that a killed one can be found again."""
    return short_id("run", recipe.model_dump_json(), seed, twin, arm)


class Steps:
    """The stages of one arm of one run; implements flows.steps_api.LoopSteps.

    Args:
        store, lease: where everything goes.
        recipe, seed, twin: what is run.
        arm: key of ARMS.
        base: the loop that a control arm is compared with; generation 0 is shared with it.
    """

    def __init__(self, store: Store, lease: Lease, recipe: Recipe, seed: int, twin: int, arm: str,
                 base: "Steps | None" = None) -> None:
        self.store, self.arm, self.base, self.seed, self.twin = store, arm_of(arm), base, seed, twin
        self.lease, self.recipe = lease, self.arm.recipe(recipe)
        self.run, self.control = run_id(recipe, seed, twin, arm), None
        self.name = arm
        self._material = Material(store, self.run)
        with store.commit(lease, self.run) as tx:
            tx.add_run(facts.run_info(recipe, seed, twin, arm))

    control: "Steps | None"

    # -- the stages -------------------------------------------------------------------------------------------------

    def collect(self, generation: int, progress: Progress) -> StepResult:
        """Demonstrations of the scripted expert."""
        def work() -> Made:
            recorded = collect(self.recipe, seed=self.seed, folder=self._folder(), software=facts.software())
            good = sum(r.episode.outcome.label == "success" for r in recorded)
            return self._recorded(recorded, f"{good} of {len(recorded)} demonstrations succeeded", {})
        return self._once(generation, "collect", work)

    def augment(self, generation: int, progress: Progress) -> StepResult:
        """Variants of what is new."""
        return self._once(generation, "augment", lambda: self._augment(generation, progress))

    def build(self, generation: int, progress: Progress) -> StepResult:
        """The dataset version of everything so far."""
        def work() -> Made:
            episodes = self._material.episodes(generation)
            parent = self._material.version(generation - 1) if generation else None
            version = build(episodes, self._material.frames, self.recipe, store=self.store.root,
                            task=load_task(self.recipe.task).instruction, generation=generation, parent=parent)
            says = f"{len(version.episodes)} episodes, {version.frames} frames"
            return Made((version.id,), says, {"frames": version.frames}, lambda tx: tx.add_version(version))
        return self._once(generation, "build", work)

    def train(self, generation: int, progress: Progress) -> StepResult:
        """The candidate."""
        def work() -> Made:
            version = self._material.version(generation)
            data = TrainingData.load(self.store.path(version.path))
            policy = train(version, data, self.recipe.train, seed=1000 * self.seed + generation, store=self.store.root,
                           progress=lambda done, total, loss: progress(done, total))
            says = f"loss {policy.train_loss[-1][1]:.3f}, ONNX within {policy.onnx_error:.0e}"
            return Made((policy.id,), says, {}, lambda tx: tx.add_policy(policy))
        return self._once(generation, "train", work)

    def gate(self, generation: int, progress: Progress) -> StepResult:
        """Candidate against champion in the training-side simulation."""
        return self._once(generation, "gate", lambda: self._gate(generation, progress))

    def release(self, generation: int, progress: Progress) -> StepResult:
        """The champion after the verdict."""
        def work() -> Made:
            verdict = self.store.verdict(self._id(generation, "gate"))
            champion = self.store.champion(self.run)
            if verdict.decision in ("PASS", "BOOTSTRAP"):
                new = release(verdict, champion, self.store.policy(verdict.candidate))
                return Made((new.policy,), f"{verdict.decision}: release {new.number}", {"released": True},
                            lambda tx: tx.add_release(new))
            if champion is None:
                raise GateError(f"generation 0 is not good enough to deploy: {verdict.reason}", where=f"run {self.run}",
                                mend="collect more demonstrations, or lower gate.bootstrap_success in the recipe")
            return Made((champion.policy,), f"{verdict.decision}: the champion stays", {"released": False}, _nothing)
        return self._once(generation, "release", work)

    def exam(self, generation: int, progress: Progress) -> StepResult:
        """Champion and candidate on the starts that no decision reads."""
        return self._once(generation, "exam", lambda: self._exam(generation, progress))

    def deploy(self, generation: int, progress: Progress) -> StepResult:
        """The champion at work."""
        return self._once(generation, "deploy", lambda: self._deploy(generation))

    def harvest(self, generation: int, progress: Progress) -> StepResult:
        """Hard cases and corrections, or what a control arm gets in their place."""
        return self._once(generation, "harvest", lambda: self._harvest(generation, progress))

    def report(self, progress: Progress) -> StepResult:
        """The page; written anew whenever it is asked for."""
        from flows.reporting import write_report

        page = write_report(self, progress)
        return StepResult((str(page),), f"{page}")

    def rollback(self) -> StepResult:
        """Put the champion before the present one back."""
        back = rollback(self.store.releases(self.run))
        with self.store.commit(self.lease, self.run) as tx:
            tx.add_release(back)
        return StepResult((back.policy,), f"release {back.number}: {back.policy} is champion again")

    # -- what flows ask ---------------------------------------------------------------------------------------------

    def current(self, stage: str) -> int:
        """Generation at which `stage` runs next, or the last one where it is finished everywhere."""
        last = self.recipe.generations
        return next((g for g in range(last + 1) if self.store.step(self.run, g, stage) is None), last)

    def result(self) -> LoopResult:
        """The numbers so far."""
        return summary.result(self)

    def last_verdict(self) -> Verdict | None:
        """The newest verdict of this run."""
        return next(reversed(self.store.verdicts(run=self.run)), None)

    def report_path(self) -> Path | None:
        """The newest report, if one was written."""
        page = self.store.root / "reports" / f"{self.run}.html"
        return page if page.exists() else None

    # -- how the longer ones work -----------------------------------------------------------------------------------

    def _augment(self, generation: int, progress: Progress) -> Made:
        config, task = self.recipe.augment, load_task(self.recipe.task)
        parents = self._material.fresh(generation)
        parents = [e for e in parents if e.outcome.label == "success"]
        many = config.per_correction * len(parents) if generation else 0
        replays, retargets = (many // 2, many - many // 2) if generation else (config.replays, config.retargets)
        if not parents or replays + retargets == 0:
            return Made((), "nothing new to multiply", {}, _nothing)
        everywhere = (*task.common, *(n for n in task.rare if task.strata[n].half_m == task.strata["common"].half_m))
        aim = None if generation else everywhere if self.arm.whole_workspace else task.common
        made = augment([(e, self._material.frames(e)) for e in parents], config, replays=replays, retargets=retargets,
                       seed=self.seed, generation=generation, strata=aim, threads=self.recipe.threads,
                       progress=progress)
        kept = [e for e in made.episodes if config.keep_rejected or e.outcome.label == "success"]
        blob = None
        if kept:
            shard = self._folder() / f"variants-{self.run}-{generation}.arrow"
            write_shard(shard, {e.id: made.frames[e.id] for e in kept})
            blob = self.store.put_blob(shard, move=True)
        ids = {e.id for e in kept}
        episodes = [e.model_copy(update={"blob": blob if e.id in ids else None}) for e in made.episodes]
        says = f"{len(kept)} of {len(episodes)} variants kept"
        return Made(tuple(e.id for e in kept), says, {"report": made.report.model_dump(mode="json")},
                    lambda tx: tx.add_episodes(episodes))

    def _gate(self, generation: int, progress: Progress) -> Made:
        candidate, champion = self._id(generation, "train"), self.store.champion(self.run)
        rare = self._material.harvested_strata()
        policies = {p: self._policy(p) for p in {candidate, *((champion.policy,) if champion else ())}}

        def scenes(start: int, stop: int) -> list[SceneSpec]:
            return gate_scenes(self.recipe.task, self.recipe.robot, self.recipe.scene, seed=self.seed,
                               generation=generation, start=start, stop=stop, rare=rare,
                               rare_share=self.recipe.gate.rare_share)

        verdict = gate(candidate, champion.policy if champion else None, generation=generation, scenes=scenes,
                       evaluate=lambda p, s: evaluate(policies[p], s, threads=self.recipe.threads).success,
                       config=self.recipe.gate, progress=progress)
        return Made((verdict.id,), f"{verdict.decision}: {verdict.reason}", {}, lambda tx: tx.add_verdict(verdict))

    def _exam(self, generation: int, progress: Progress) -> Made:
        champion, candidate = self._champion(), self._id(generation, "train")
        results = dict(self._material.exams())
        fresh = [p for p in dict.fromkeys((champion, candidate)) if p not in results]
        for k, policy in enumerate(fresh):
            done = exam(self._policy(policy), self.recipe, seed=self.seed, twin=self.twin)
            results[policy] = {
                "bits": "".join("01"[int(s)] for s in done.success), "strata": list(done.strata),
                "rewards": {n: [round(float(v), 5) for v in c if np.isfinite(v)] for n, c in done.rewards.items()},
                "success": {k: p.model_dump() for k, p in success_by(done.success, done.strata, self.recipe).items()}}
            progress(k + 1, len(fresh))
        mix = summary.proportions(results[champion])["deployment_mix"]
        return Made((champion,), f"champion {mix.rate:.3f} [{mix.low:.3f} {mix.high:.3f}] at the deployment mix",
                    {"champion": champion, "candidate": candidate,
                     "results": {p: results[p] for p in {champion, candidate}}}, _nothing)

    def _deploy(self, generation: int) -> Made:
        if not self.arm.deploys:
            return Made((), "this arm does not deploy", {"robot_s": 0.0}, _nothing)
        champion = self._champion()
        rider = self._material.rider(champion) if self.recipe.deploy.shadow else None
        done = deploy(self._policy(champion), champion, self.recipe, seed=self.seed, twin=self.twin,
                      generation=generation, folder=self._folder(), software=facts.software(),
                      rider=Rider(rider, self._policy(rider)) if rider else None)
        numbers = {"robot_s": done.robot_s, "truth": "".join("01"[int(t)] for t in done.truth),
                   "disagreement": [None if np.isnan(d) else round(float(d), 5) for d in done.disagreement]}
        flagged = sum(r.episode.outcome.label == "failure" for r in done.recorded)
        return self._recorded(done.recorded, f"{flagged} of {len(done.recorded)} attempts flagged by the robot", numbers)

    def _harvest(self, generation: int, progress: Progress) -> Made:
        folder, software, recipe = self._folder(), facts.software(), self.recipe
        count, new = recipe.harvest.corrections, self.arm.new_data
        common = {"twin": self.twin, "generation": generation, "folder": folder, "software": software}
        if new == "none":
            return Made((), "this arm learns nothing new", {"robot_s": 0.0, "asked": 0, "cases": []}, _nothing)
        if new.startswith("random"):
            budget = self.base.robot_seconds(generation) if new == "random-seconds" and self.base else None
            wide = recipe.model_copy(update={"deploy": recipe.deploy.model_copy(
                update={"episodes": count if budget is None else max(count, int(budget / 2))})})
            starts = deploy_scenes(wide, seed=self.seed + 500_000, twin=self.twin, generation=generation)
            recorded = _within(demonstrate(starts, recipe, **common), budget)
            return self._demonstrated(recorded, len(recorded))
        attempts = self._material.failed_attempts(generation)
        done = harvest(attempts, recipe, **common, arm=self.name, progress=progress, record_corrections=new != "failed-starts")
        if new == "failed-starts":
            chosen = {e.id: e.scene for e, _ in attempts}
            starts = [chosen[c.episode] for c in done.chosen]
            recorded = demonstrate(starts, recipe, **common) if starts else []
            return self._demonstrated(recorded, len(starts))
        good = sum(c.corrected for c in done.cases)
        made = self._recorded(done.recorded, f"{len(done.cases)} hard cases, {good} of {len(done.recorded)} corrected",
                              {"robot_s": done.robot_s, "asked": len(done.recorded),
                               "cases": [c.id for c in done.cases]})

        def write(tx: Transaction) -> None:
            made.write(tx)
            tx.add_hard_cases(done.cases)
        return Made(made.ids, made.says, made.numbers, write)

    def _demonstrated(self, recorded: list[Recorded], asked: int) -> Made:
        seconds = sum(r.episode.duration_s for r in recorded)
        return self._recorded(recorded, f"{len(recorded)} demonstrations, {seconds:.0f} s",
                              {"robot_s": seconds, "asked": asked, "cases": []})

    # -- shared by all ----------------------------------------------------------------------------------------------

    def robot_seconds(self, generation: int) -> float:
        """Robot time of one lap: deployment and corrections [s]."""
        steps = (self.store.step(self.run, generation, stage) for stage in ("deploy", "harvest"))
        return sum(float(str(s.outputs["robot_s"])) for s in steps if s is not None)

    def _once(self, generation: int, stage: str, work: Callable[[], Made]) -> StepResult:
        done = self.store.step(self.run, generation, stage)
        if done is None and self._shares(generation, stage) and self.base is not None:
            done = self.store.step(self.base.run, generation, stage)
            if done is not None:
                with self.store.commit(self.lease, self.run) as tx:
                    tx.finish_step(generation, stage, inputs=done.inputs, outputs=done.outputs, code=done.code)
        if done is not None:
            return StepResult(tuple(str(i) for i in _list(done.outputs["ids"])), str(done.outputs["says"]), resumed=True)
        began = time.monotonic()
        made = work()
        with self.store.commit(self.lease, self.run) as tx:
            made.write(tx)
            tx.finish_step(generation, stage, inputs=self._material.inputs(generation, stage),
                           outputs={"ids": list(made.ids), "says": made.says, **made.numbers},
                           code=facts.stage_code(stage), wall_s=time.monotonic() - began)
        return StepResult(made.ids, made.says)

    def _shares(self, generation: int, stage: str) -> bool:
        if generation:
            return False
        if self.arm.whole_workspace or self.arm.widen is not None:
            return stage == "collect"
        return stage in SHARED or (stage == "deploy" and self.arm.deploys)

    def _recorded(self, recorded: "list[Recorded] | tuple[Recorded, ...]", says: str,
                  numbers: Mapping[str, JsonValue]) -> Made:
        self.store.put_blobs([r.path for r in recorded], move=True)
        episodes: list[Episode] = [r.episode for r in recorded]
        return Made(tuple(e.id for e in episodes), says, numbers, lambda tx: tx.add_episodes(episodes))

    def _id(self, generation: int, stage: str) -> str:
        return self._material.ids(generation, stage)[0]

    def _champion(self) -> str:
        champion = self.store.champion(self.run)
        if champion is None:
            raise GateError("nothing is released yet", where=f"run {self.run}", mend="hardcase gate && hardcase release")
        return champion.policy

    def _policy(self, policy: str) -> Policy:
        return OnnxPolicy(self.store.path(self.store.policy(policy).checkpoint) / "policy.onnx")

    def _folder(self) -> Path:
        folder = self.store.tmp / self.run
        folder.mkdir(parents=True, exist_ok=True)
        return folder


def _within(recorded: list[Recorded], budget_s: float | None) -> list[Recorded]:
    """The first demonstrations that fit into the robot time; all where there is no limit."""
    if budget_s is None:
        return recorded
    spent = np.cumsum([r.episode.duration_s for r in recorded])
    return [r for r, s in zip(recorded, spent, strict=True) if s <= budget_s]


def _list(value: JsonValue) -> list[JsonValue]:
    return value if isinstance(value, list) else []


def _nothing(tx: Transaction) -> None:
    """A step that adds no rows."""
