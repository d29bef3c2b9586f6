"""The command line over a loop whose stages only count, on a real store: run as a program by the tests beside it.

It stands in for flows.run.steps and nothing else: flow, tasks, Prefect, store, display and exit codes are the real
ones.
Environment: COUNTING_LOG (a line for each begin and end), COUNTING_SLEEP_S, COUNTING_FAIL, COUNTING_CRASH ('train 1').
"""

import os
import sys
import time
from contextlib import contextmanager
from pathlib import Path
from types import ModuleType

from flows.run.steps_api import STAGES, StepResult
from pipeline.errors import SimulationError
from pipeline.files import short_id
from pipeline.store import RunInfo, Store
from schemas.summary import GateLine, Generation, LoopResult, Paired
from schemas.verdict import Proportion


class CountingSteps:
    """Each stage adds a line to the log and a manifest to the store."""

    def __init__(self, store, lease, recipe, seed, twin, arm, control=None):
        self.store, self.lease, self.recipe, self.arm, self.control = store, lease, recipe, arm, control
        self.seed, self.twin = seed, twin
        self.run = short_id(recipe.model_dump_json(), seed, twin, arm)
        numbers = recipe.model_dump(mode="json")
        info = RunInfo(recipe_name=recipe.name, recipe=numbers, seed=seed, twin=twin, control=arm, command="test")
        with store.commit(lease, self.run) as tx:
            tx.add_run(info)

    def __getattr__(self, stage):
        if stage not in STAGES:
            raise AttributeError(stage)
        return lambda generation, progress: self.step(stage, generation, progress)

    def step(self, stage, generation, progress):
        done = self.store.step(self.run, generation, stage)
        if done is not None:
            return StepResult(tuple(done.outputs["ids"]), "counted", resumed=True)
        note(f"begin {self.arm}{generation} {stage}")
        for tick in range(10):
            time.sleep(float(os.environ.get("COUNTING_SLEEP_S", "0")) / 10)
            progress(tick + 1, 10)
        if os.environ.get("COUNTING_FAIL") == f"{stage} {generation}":
            where = f"{stage} {generation}"
            raise SimulationError("the arm went through the table", where=where, mend="lower the gain")
        if os.environ.get("COUNTING_CRASH") == f"{stage} {generation}":
            raise ZeroDivisionError("not meant to happen")
        id = short_id(self.run, generation, stage)
        with self.store.commit(self.lease, self.run) as tx:
            tx.finish_step(generation, stage, outputs={"ids": [id]})
        note(f"end {self.arm}{generation} {stage}")
        return StepResult((id,), "counted")

    def report(self, progress):
        self.step("report", self.recipe.generations, progress)
        self.report_path().write_text("<html>counted</html>")
        return StepResult((str(self.report_path()),), "written")

    def report_path(self):
        return self.store.root / "report.html"

    def current(self, stage):
        for generation in range(self.recipe.generations + 1):
            if self.store.step(self.run, generation, stage) is None:
                return generation
        return self.recipe.generations

    def last_verdict(self):
        return None

    def rollback(self):
        return StepResult((self.run,), "rolled back")

    def laps(self):
        half = Proportion(n=100, successes=50, rate=0.5, low=0.4, high=0.6)
        kinds = ("all", "common", "rare", "deployment_mix")
        return tuple(
            Generation(
                generation=g,
                dataset_version=short_id(self.run, g, "build"),
                policy=short_id(self.run, g, "train"),
                success=dict.fromkeys(kinds, half),
                gate=GateLine(verdict="PASS", p=0.01),
                robot_s=75.0 * g,
                corrections=12 * g,
                wall_s={},
            )
            for g in range(self.recipe.generations + 1)
        )

    def result(self):
        return LoopResult(
            generations=self.laps(),
            control=self.control.laps() if self.control else None,
            paired=Paired(fixed=3, broken=1, p=0.6),
            wall_s=0,
            peak_pss_mb=0,
            seed=self.seed,
            twin=self.twin,
        )


def note(line):
    with Path(os.environ["COUNTING_LOG"]).open("a") as log:
        log.write(line + "\n")


@contextmanager
def open_run(root, recipe, *, seed, twin, control):
    loop_id = short_id(recipe.model_dump_json(), seed, twin, "")
    with Store.open(root, create=True) as store, store.lease(loop_id) as lease:
        other = CountingSteps(store, lease, recipe, seed, twin, "random") if control else None
        yield CountingSteps(store, lease, recipe, seed, twin, "", other)


if __name__ == "__main__":
    sys.modules["flows.run.steps"] = ModuleType("flows.run.steps")
    sys.modules["flows.run.steps"].open_run = open_run
    from flows.cli import main

    main()
