"""The regression set: what a release has fixed stays fixed, or the release that loses it says so."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from flows.run.arm_run import ArmRun, Made
from pipeline.files import short_id
from pipeline.mining.happened import start_of
from pipeline.protocols import Policy
from pipeline.simulation.evaluation import evaluate
from pipeline.simulation.night_scenes import played_again
from pipeline.simulation.perceived import as_perceived
from pipeline.store import Transaction
from schemas.hardcase import HardCase
from schemas.mining import RegressionScene
from schemas.recipe import NightlyConfig
from schemas.release import Release
from schemas.scene import SceneSpec

MOSTLY = 7 / 8
"""Share of perception seeds at which a policy solves a scene that counts as fixed."""


@dataclass(frozen=True, slots=True)
class Kept:
    """What the set says of a policy that becomes champion."""

    scenes: int
    """In the set so far."""
    fixed: tuple[RegressionScene, ...]
    """Scenes that it is the first to solve; they join the set."""
    lost: tuple[RegressionScene, ...]
    """Scenes of the set that it hardly ever solves, seen twice."""

    def mark(self, release: Release) -> Release:
        """The release, with what it loses."""
        return release.model_copy(update={"lost": tuple(s.id for s in self.lost)})

    def says(self) -> str:
        """For the line of the release, '' where there is nothing to say."""
        parts = [f"fixes {_by_family(self.fixed)}"] if self.fixed else []
        if self.lost:
            names = ", ".join(f"{s.family} {s.id}" for s in self.lost[:5])
            parts.append(f"LOSES {len(self.lost)} of {self.scenes} regression scenes: {names}")
        elif self.scenes:
            parts.append(f"keeps all {self.scenes} regression scenes")
        return "".join(f"; {part}" for part in parts)

    def joined(self, made: Made) -> Made:
        """What a stage made, and the scenes that join the set with it."""

        def write(tx: Transaction) -> None:
            made.write(tx)
            tx.add_regression_scenes(self.fixed)

        return Made(made.ids, made.says + self.says(), made.numbers, write)


def checked(run: ArmRun, generation: int, policy: str) -> Kept:
    """Play the regression set, and what may join it, in the training-side simulation.

    What may join it are hard cases that somebody corrected and whose correction this policy has learnt from. It is lost
    where the policy hardly ever solves it, in two rounds of perception seeds: the rule of the nightly gate.

    Args:
        run: one arm of one run.
        generation: lap of the release.
        policy: the one that becomes champion.
    """
    night = run.recipe.gate.nightly or NightlyConfig()
    known = run.store.regression_scenes(run=run.run)
    learnt = set(run.store.version(run.store.policy(policy).dataset).episodes)
    have = {s.hard_case for s in known}
    new = [c for c in run.store.hard_cases(run=run.run, corrected=True)
           if c.id not in have and c.correction in learnt]
    if not known and not new:
        return Kept(0, (), ())
    scenes = [*(s.scene for s in known), *(_start(run, c) for c in new)]
    opened, seeds = run.policy(policy), night.regression_seeds
    solved = solved_of(opened, scenes, seeds, run.recipe.threads)
    low = [s for s, n in zip(known, solved, strict=False) if n <= night.regression_lost]
    again = solved_of(opened, [s.scene for s in low], seeds, run.recipe.threads, after=seeds)
    lost = tuple(s for s, n in zip(low, again, strict=True) if n <= night.regression_lost)
    names = {f.id: f.name for f in run.store.families(run=run.run)}
    fixed = tuple(
        RegressionScene(id=short_id("regression scene", c.id), hard_case=c.id, episode=c.episode,
                        family=names.get(c.found or "", c.family), scene=scene, fixed_by=policy,
                        generation=generation, solved=n, played=seeds)
        for c, scene, n in zip(new, scenes[len(known):], solved[len(known):], strict=True) if n >= MOSTLY * seeds)
    return Kept(len(known), fixed, lost)


def solved_of(policy: Policy, scenes: Sequence[SceneSpec], times: int, threads: int, *, after: int = 0) -> list[int]:
    """How often each start is solved, of so many times under physics and noise of their own.

    Args:
        policy: who plays.
        scenes: perceived starts.
        times: how often each is played.
        threads: of the simulation.
        after: perception seeds that are left out, because they were played before.
    """
    copies = [copy for scene in scenes for copy in played_again(scene, after + times)[after:]]
    if not copies:
        return []
    won = evaluate(policy, copies, threads=threads).success
    return [int(n) for n in np.asarray(won).reshape(len(scenes), times).sum(axis=1)]


def _start(run: ArmRun, case: HardCase) -> SceneSpec:
    """Where the attempt began, as its robot perceived it."""
    episode = run.store.episode(case.episode)
    seen = run.material.frames(episode).environment
    return as_perceived(episode.scene, np.concatenate([start_of(seen), seen[0, 3:]]))


def _by_family(scenes: Sequence[RegressionScene]) -> str:
    counts: dict[str, int] = {}
    for scene in scenes:
        counts[scene.family] = counts.get(scene.family, 0) + 1
    return ", ".join(f"{n} of {name}" for name, n in counts.items())
