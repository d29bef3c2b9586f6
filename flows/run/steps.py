"""Steps: the stages of one run wired to its store; each is done once, and the manifest says so."""

from collections.abc import Generator
from contextlib import contextmanager
from itertools import count
from pathlib import Path

from flows.run import learning, summary
from flows.run.arm_run import ArmRun, run_id
from flows.run.arms import LOOP
from flows.run.steps_api import Progress, StepResult
from pipeline.store import Store
from schemas.recipe import Recipe
from schemas.summary import LoopResult
from schemas.verdict import Verdict
from stages.release import rollback


@contextmanager
def open_run(root: Path, recipe: Recipe, *, seed: int, twin: int, control: bool,
             arm: str = "random") -> Generator["Steps"]:
    """The stages of one run under the store's lease, with its control arm beside it where one was asked for."""
    run = run_id(recipe, seed, twin, LOOP)
    with Store.open(root, create=True) as store, store.lease(run) as lease:
        steps = steps_of(recipe)
        loop = steps(store, lease, recipe, seed, twin, LOOP)
        if control:
            loop.control = steps(store, lease, recipe, seed, twin, arm, loop)
        yield loop


def steps_of(recipe: Recipe) -> type["Steps"]:
    """Who turns a recipe: a robot that learns from demonstrations, or a legged one that learns by trying."""
    if recipe.rl is None:
        return Steps
    from flows.run.legged_steps import LeggedSteps

    return LeggedSteps


class Steps(ArmRun):
    """The stages of one arm of one run; implements flows.run.steps_api.LoopSteps.

    The deployment side is imported when it is first asked for: where its hidden physics is missing, everything
    up to the release runs all the same.
    """

    control: "Steps | None" = None

    def collect(self, generation: int, progress: Progress) -> StepResult:
        """Demonstrations of the scripted expert."""
        return self.once(generation, "collect", lambda: learning.collected(self))

    def augment(self, generation: int, progress: Progress) -> StepResult:
        """Variants of what is new."""
        return self.once(generation, "augment", lambda: learning.augmented(self, generation, progress))

    def build(self, generation: int, progress: Progress) -> StepResult:
        """The dataset version of everything so far."""
        return self.once(generation, "build", lambda: learning.built(self, generation))

    def train(self, generation: int, progress: Progress) -> StepResult:
        """The candidate."""
        return self.once(generation, "train", lambda: learning.trained(self, generation, progress))

    def gate(self, generation: int, progress: Progress) -> StepResult:
        """Candidate against champion in the training-side simulation."""
        return self.once(generation, "gate", lambda: learning.judged(self, generation, progress))

    def release(self, generation: int, progress: Progress) -> StepResult:
        """The champion after the verdict."""
        return self.once(generation, "release", lambda: learning.released(self, generation))

    def exam(self, generation: int, progress: Progress) -> StepResult:
        """Champion and candidate on the starts that no decision reads."""
        from flows.run import working

        return self.once(generation, "exam", lambda: working.examined(self, generation, progress))

    def deploy(self, generation: int, progress: Progress) -> StepResult:
        """The champion at work."""
        from flows.run import working

        return self.once(generation, "deploy", lambda: working.deployed(self, generation))

    def harvest(self, generation: int, progress: Progress) -> StepResult:
        """Hard cases and corrections, or what a control arm gets in their place."""
        from flows.run import working

        return self.once(generation, "harvest", lambda: working.harvested(self, generation, progress))

    def judge(self, generation: int, progress: Progress) -> StepResult:
        """Who was right where the newest candidate would have acted otherwise in the last deployment."""
        from flows.run import appraising

        return self.once(generation, "judge", lambda: appraising.judged(self, generation))

    def worth(self, generation: int, progress: Progress) -> StepResult:
        """What the last lap's new episodes were worth, by one extra training."""
        from flows.run import appraising

        return self.once(generation, "worth", lambda: appraising.worth_of(self, generation, progress))

    def report(self, progress: Progress) -> StepResult:
        """The page; written anew whenever it is asked for."""
        from flows.run.reporting import write_report

        page = write_report(self, progress)
        return StepResult((str(page),), f"{page}")

    def rollback(self) -> StepResult:
        """Put the champion before the present one back."""
        from flows.run import regression

        back = rollback(self.store.releases(self.run))
        kept = regression.checked(self, self.store.policy(back.policy).generation, back.policy)
        back = kept.mark(back)
        with self.store.commit(self.lease, self.run) as tx:
            tx.add_release(back)
            tx.add_regression_scenes(kept.fixed)
        return StepResult((back.policy,), f"release {back.number}: {back.policy} is champion again{kept.says()}")

    def current(self, stage: str) -> int:
        """Generation at which `stage` runs next, or the last one where it is finished everywhere."""
        last = 0 if stage == "collect" else self.recipe.generations
        return next((g for g in range(last + 1) if self.store.step(self.run, g, stage) is None), last)

    def tonight(self) -> int:
        """The lap that a night turns: the first one that has not sat its exam."""
        return next(g for g in count() if self.store.step(self.run, g, "exam") is None)

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
