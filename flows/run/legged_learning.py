"""The training side of a legged robot's lap: curriculum, PPO, gate; nothing here knows the twin."""

from dataclasses import replace

from flows.run.arm_run import ArmRun, Made, no_rows
from flows.run.steps_api import Progress
from pipeline.errors import ConfigError
from pipeline.locomotion.gating import legged_gate_scenes, play
from pipeline.locomotion.lesson import Lesson
from pipeline.policies.table import policy_kind
from schemas.recipe import RlConfig, TrainConfig
from schemas.scene import SceneSpec
from stages.assemble import assemble
from stages.gate import gate
from stages.train import train

LAPS = 1000
"""Seeds of training between two runs, so that no lap meets the robots and starts of another."""


def rl_of(run: ArmRun) -> RlConfig:
    """What the recipe says of reinforcement learning.

    Raises:
        ConfigError: it says nothing.
    """
    if run.recipe.rl is None:
        raise ConfigError(f"recipe {run.recipe.name!r} says nothing of reinforcement learning", where="rl",
                          mend="give it a section rl, as datasets/recipes/biped.yaml has one")
    return run.recipe.rl


def assembled(run: ArmRun, generation: int) -> Made:
    """The curriculum of a lap: kinds of start that are drawn, and the starts of all falls so far."""
    rl_of(run)
    parent = run.material.version(generation - 1) if generation else None
    cases = [c for c in run.store.hard_cases(run=run.run) if c.generation < generation and c.start is not None]
    attempts = run.store.episodes({c.episode for c in cases})
    usable = {e.id: e for e in run.material.usable(attempts)}
    version = assemble([c for c in cases if c.episode in usable], usable, run.recipe, store=run.store.root,
                       generation=generation, parent=parent, consents=run.material.consents())
    lesson = Lesson.read(run.store.path(version.path))
    hard, held = len(lesson.curriculum.starts), len(lesson.held_out)
    says = f"starts of {hard} falls in {lesson.curriculum.hard_share:.0%} of the attempts, {held} for the gate alone"
    return Made((version.id,), says if hard else f"drawn starts alone: {', '.join(lesson.curriculum.kinds)}",
                {"hard": hard, "held_out": held}, lambda tx: tx.add_version(version))


def trained(run: ArmRun, generation: int, progress: Progress) -> Made:
    """The candidate: PPO from nothing at first, later from the champion on."""
    version = run.material.version(generation)
    data = policy_kind(run.recipe.train.policy).load(run.store.path(version.path), run.material.consents())
    config, champion = lap_config(run, generation), run.store.champion(run.run)
    if generation and champion is not None:
        config = config.model_copy(update={"goes_on": champion.policy})
        data = replace(data, champion=run.store.path(run.store.policy(champion.policy).checkpoint))
    policy = train(version, data, config, seed=run.seed * LAPS + generation, store=run.store.root,
                   progress=lambda done, total, reward: progress(done, total))
    begins = f", from {config.goes_on} on" if config.goes_on else ""
    return Made((policy.id,), f"{config.steps:,} steps of PPO{begins}, ONNX within {policy.onnx_error:.0e}",
                {"goes_on": config.goes_on},
                lambda tx: tx.add_policy(policy))


def lap_config(run: ArmRun, generation: int) -> TrainConfig:
    """The numbers that a lap trains by."""
    rl, config = rl_of(run), run.recipe.train
    if not generation:
        return config
    return config.model_copy(update={"steps": rl.lap_steps, "learning_rate": rl.lap_learning_rate})


def judged(run: ArmRun, generation: int, progress: Progress) -> Made:
    """Candidate against champion in the training-side simulation, at drawn starts and at falls that nobody learnt."""
    candidate, champion, recipe, rl = run.candidate(generation), run.store.champion(run.run), run.recipe, rl_of(run)
    policies = {p: run.policy(p) for p in {candidate, *((champion.policy,) if champion else ())}}
    hard = Lesson.read(run.store.path(run.material.version(generation).path)).held_out

    def scenes(start: int, stop: int) -> list[SceneSpec]:
        return legged_gate_scenes(recipe.task, recipe.robot, seed=run.seed, generation=generation, start=start,
                                  stop=stop, hard=hard, hard_share=recipe.gate.rare_share, widen=rl.vary)

    verdict = gate(candidate, champion.policy if champion else None, generation=generation, scenes=scenes,
                   evaluate=lambda p, s: play(policies[p], s, threads=recipe.threads), config=recipe.gate,
                   progress=progress)
    p = "" if verdict.p is None else f", p of a gain {verdict.p:.2g}"
    return Made((verdict.id,), f"{verdict.decision} after {verdict.scenes} scenes{p}", {},
                lambda tx: tx.add_verdict(verdict))


def nothing(says: str) -> Made:
    """What a stage leaves that has nothing to do for a legged robot."""
    return Made((), says, {}, no_rows)
