"""LeggedSteps: the stages of one run of a legged robot; what it learns by is trying, so some have nothing to do."""

from types import MappingProxyType
from typing import override

from flows.run import legged_learning
from flows.run.legged_learning import nothing
from flows.run.steps import Steps
from flows.run.steps_api import Progress, StepResult


class LeggedSteps(Steps):
    """As Steps; the deployment side is imported when it is first asked for, here too."""

    sources = MappingProxyType({"build": "assemble", "exam": "exam_legged", "deploy": "deploy_legged",
                                "harvest": "harvest_legged"})

    @override
    def collect(self, generation: int, progress: Progress) -> StepResult:
        """Nothing: nobody shows a legged robot how to stand."""
        return self.once(generation, "collect", lambda: nothing("no demonstrations: it learns by trying"))

    @override
    def augment(self, generation: int, progress: Progress) -> StepResult:
        """Nothing: the robots of the training differ from each other, place by place."""
        return self.once(generation, "augment", lambda: nothing("no variants: the robots of the training differ"))

    @override
    def build(self, generation: int, progress: Progress) -> StepResult:
        """The curriculum of everything so far."""
        return self.once(generation, "build", lambda: legged_learning.assembled(self, generation))

    @override
    def train(self, generation: int, progress: Progress) -> StepResult:
        """The candidate: PPO, from the champion on; by hand, too, its curriculum is made first."""
        for stage in (*((self.collect,) if not generation else ()), self.augment, self.build):
            stage(generation, progress)
        return self.once(generation, "train", lambda: legged_learning.trained(self, generation, progress))

    @override
    def gate(self, generation: int, progress: Progress) -> StepResult:
        """Candidate against champion in the training-side simulation."""
        return self.once(generation, "gate", lambda: legged_learning.judged(self, generation, progress))

    @override
    def exam(self, generation: int, progress: Progress) -> StepResult:
        """Champion and candidate on the starts that no decision reads."""
        from flows.run import legged_working

        return self.once(generation, "exam", lambda: legged_working.examined(self, generation, progress))

    @override
    def deploy(self, generation: int, progress: Progress) -> StepResult:
        """The champion at work."""
        from flows.run import legged_working

        return self.once(generation, "deploy", lambda: legged_working.deployed(self, generation))

    @override
    def harvest(self, generation: int, progress: Progress) -> StepResult:
        """Falls become starts."""
        from flows.run import legged_working

        return self.once(generation, "harvest", lambda: legged_working.harvested(self, generation))

    @override
    def judge(self, generation: int, progress: Progress) -> StepResult:
        """Nothing yet: disagreements of legged robots are recorded, and not played on."""
        return self.once(generation, "judge", lambda: nothing("disagreements of legged robots are not played on"))

    @override
    def worth(self, generation: int, progress: Progress) -> StepResult:
        """Nothing: what hard starts are worth is what the control arm tells."""
        return self.once(generation, "worth", lambda: nothing("see the control arm: as many steps at drawn starts"))

    @override
    def report(self, progress: Progress) -> StepResult:
        """The page; written anew whenever it is asked for."""
        from flows.run.legged_reporting import learned, legged_strips
        from flows.run.reporting import write_report

        page = write_report(self, progress, legged_strips, learned(self))
        return StepResult((str(page),), f"{page}")
