"""The training side of a lap, from demonstrations to the release; nothing here knows the twin."""

from collections.abc import Mapping

from flows.data.checking import look_at_new
from flows.run import facts, nights, regression
from flows.run.arm_run import ArmRun, Made, no_rows
from flows.run.footage import filming, shown
from flows.run.steps_api import Progress
from flows.run.worth_door import held_back, spared
from pipeline.errors import GateError
from pipeline.mining.happened import MARKED
from pipeline.policies.table import policy_kind
from pipeline.shards import write_shard
from pipeline.simulation.evaluation import evaluate, gate_scenes
from pipeline.simulation.tasks import load_task
from pipeline.store import Transaction
from schemas.consent import SIMULATED
from schemas.episode import Episode
from schemas.policy import PolicyRecord
from schemas.scene import SceneSpec
from stages.augment import augment
from stages.build import build
from stages.collect import collect
from stages.gate import gate
from stages.release import release
from stages.train import train


def collected(run: ArmRun) -> Made:
    """Demonstrations of the scripted expert."""
    recorded = collect(run.recipe, seed=run.seed, folder=run.folder(), software=facts.software("collect"))
    good = sum(r.episode.outcome.label == "success" for r in recorded)
    return run.recorded(recorded, f"{good} of {len(recorded)} demonstrations succeeded", {})


def augmented(run: ArmRun, generation: int, progress: Progress) -> Made:
    """Variants of the first demonstrations: of their own kinds of start at first, later near what is new.

    A correction's commands answer what the policy had left behind: played elsewhere they fail, and carried over
    they approach the object in another style than all other data. So in later laps its start is what spreads.
    """
    config = run.recipe.augment
    parents, near = _successes(run, 0), _successes(run, generation) if generation else []
    replays, retargets = (0, config.per_correction * len(near)) if generation else (config.replays, config.retargets)
    if not parents or replays + retargets == 0:
        return Made((), "nothing new to multiply", {}, no_rows)
    made = augment([(e, run.material.frames(e)) for e in parents], config, replays=replays, retargets=retargets,
                   seed=run.seed, generation=generation, threads=run.recipe.threads,
                   strata=() if generation else _aims(run), near=[(e, run.material.frames(e)) for e in near],
                   same_mark=_on_the_way(run),
                   arm=run.name, progress=progress)
    kept = {e.id: made.frames[e.id] for e in made.episodes if config.keep_rejected or e.outcome.label == "success"}
    blob = None
    if kept:
        shard = run.folder() / f"variants-{run.run}-{generation}.arrow"
        write_shard(shard, kept)
        blob = run.store.put_blob(shard, move=True)
    consent = {e.id: e.consent for e in [*parents, *near]}
    episodes = [e.model_copy(update={"blob": blob if e.id in kept else None, "consent": _consent(e, consent)})
                for e in made.episodes]
    says = f"{len(kept)} of {len(episodes)} variants kept"
    return Made(tuple(kept), says, {"report": made.report.model_dump(mode="json")},
                lambda tx: tx.add_episodes(episodes))


def _on_the_way(run: ArmRun) -> set[str]:
    """Corrections of what went wrong on the way to the mark, where the recipe aims at the subtask."""
    if run.recipe.harvest.aim != "subtask":
        return set()
    return {str(c.correction) for c in run.store.hard_cases(run=run.run) if c.subtask in MARKED and c.correction}


def _consent(variant: Episode, consent: Mapping[str, str]) -> str:
    """Whose consent a variant rests on: that of a person at whose start it begins, else its parent's."""
    near = consent.get((variant.transform or "").rpartition(" ")[2], SIMULATED)
    return consent[str(variant.parent)] if near == SIMULATED else near


def _successes(run: ArmRun, generation: int) -> list[Episode]:
    """What was new in a lap, succeeded, and may still teach."""
    return run.material.usable(e for e in run.material.fresh(generation) if e.outcome.label == "success")


def _aims(run: ArmRun) -> tuple[str, ...]:
    """Kinds of start that demonstrations are carried over to; only those of a cube that the demonstrator held."""
    task = load_task(run.recipe.task)
    if not run.arm.whole_workspace:
        return task.common
    half_m = task.strata[task.common[0]].half_m
    return (*task.common, *(name for name in task.rare if task.strata[name].half_m == half_m))


def built(run: ArmRun, generation: int) -> Made:
    """The dataset version of everything so far."""
    parent = run.material.version(generation - 1) if generation else None
    consents, everything = run.material.consents(), run.material.episodes(generation)
    if "teleop" in run.recipe.dataset.sources:
        known = {e.id for e in everything}
        everything += [e for e in run.material.driven(run.recipe) if e.id not in known]
    standing = consents.standing(everything)
    teaching = [e for e in standing if e.outcome.label == "success" or not run.recipe.dataset.only_success]
    look_at_new(run.store, teaching, run.material.verdicts(teaching).by_subject.keys())
    verdicts = run.material.verdicts(standing)
    passing = verdicts.passing(standing)
    sound, hurting = spared(run, passing)
    with filming(run.store, run.recipe, run.material.frames, sound) as footage:
        seen = shown(sound, footage, run.recipe)
        version = build(seen, run.material.frames, run.recipe, store=run.store.root,
                        task=load_task(run.recipe.task).instruction, generation=generation, parent=parent,
                        consents=consents, verdicts=verdicts, footage=footage)
    says = f"{len(version.episodes)} episodes, {version.frames} frames"
    if out := len(everything) - len(standing):
        says += f"; {out} left out, their consent has ended"
    wanted = run.recipe.dataset.sources
    if failed := sum(e.origin in wanted for e in standing) - sum(e.origin in wanted for e in passing):
        says += f"; {failed} left out, they failed their check"
    says += hurting
    if dark := len(sound) - len(seen):
        says += f"; {dark} left out, a camera of the recipe has no pictures of them"
    return Made((version.id,), says, {"frames": version.frames}, lambda tx: tx.add_version(version))


def trained(run: ArmRun, generation: int, progress: Progress) -> Made:
    """The candidate."""
    version = run.material.version(generation)
    episodes = run.store.episodes(version.episodes)
    parents = run.store.episodes({e.parent for e in episodes if e.parent})
    run.material.verdicts([*parents, *episodes], version).check_version(version, episodes, parents)
    data = policy_kind(run.recipe.train.policy).load(run.store.path(version.path), run.material.consents())
    seeds, made = nights.training_seeds(run, generation), list[PolicyRecord]()
    for k, seed in enumerate(seeds):
        made.append(train(version, data, run.recipe.train, seed=seed, store=run.store.root,
                          progress=lambda done, total, loss, k=k: progress(done + k * total, total * len(seeds))))
    choice = nights.choose(run, generation, made) if len(made) > 1 else None
    policy = next(p for p in made if choice is None or p.id == choice.chosen)
    says = f"loss {policy.train_loss[-1][1]:.3f}, ONNX within {policy.onnx_error:.0e}"
    if choice is not None:
        says += f", best of {len(made)}: {choice.solved[policy.id]} of {choice.scenes} selection scenes"

    def write(tx: Transaction) -> None:
        for each in made:
            tx.add_policy(each)

    ids = (policy.id, *(p.id for p in made if p is not policy))
    return Made(ids, says, {"selection": choice.model_dump(mode="json")} if choice else {}, write)


def judged(run: ArmRun, generation: int, progress: Progress) -> Made:
    """Candidate against champion in the training-side simulation."""
    candidate, champion, recipe = run.candidate(generation), run.store.champion(run.run), run.recipe
    if recipe.gate.nightly is not None and champion is not None:
        return nights.judged(run, generation, champion.policy, progress)
    rare = run.material.harvested_strata()
    policies = {p: run.policy(p) for p in {candidate, *((champion.policy,) if champion else ())}}

    def scenes(start: int, stop: int) -> list[SceneSpec]:
        return gate_scenes(recipe.task, recipe.robot, recipe.scene, seed=run.seed, generation=generation,
                           start=start, stop=stop, rare=rare, rare_share=recipe.gate.rare_share,
                           appearance=bool(recipe.dataset.cameras))

    verdict = gate(candidate, champion.policy if champion else None, generation=generation, scenes=scenes,
                   evaluate=lambda p, s: evaluate(policies[p], s, threads=recipe.threads).success,
                   config=recipe.gate, progress=progress)
    p = "" if verdict.p is None else f", p of a gain {verdict.p:.2g}"
    return Made((verdict.id,), f"{verdict.decision} after {verdict.scenes} scenes{p}", {},
                lambda tx: tx.add_verdict(verdict))


def released(run: ArmRun, generation: int) -> Made:
    """The champion after the verdict."""
    verdict = run.store.verdict(run.material.ids(generation, "gate")[0])
    champion = run.store.champion(run.run)
    if verdict.decision in ("PASS", "BOOTSTRAP"):
        if (held := held_back(run, verdict)) is not None:
            return held
        new = release(verdict, champion, run.store.policy(verdict.candidate))
        back = nights.returned(run, generation, new)
        kept = regression.checked(run, generation, new.policy if back is None else back.policy)
        if back is not None:
            return kept.joined(nights.rolled_back(new, kept.mark(back)))
        new = kept.mark(new)
        return kept.joined(Made((new.policy,), f"{verdict.decision}: release {new.number}", {"released": True},
                                lambda tx: tx.add_release(new)))
    if champion is None:
        raise GateError(f"generation 0 is not good enough to deploy: {verdict.reason}", where=f"run {run.run}",
                        mend=f"{'raise train.steps' if run.recipe.rl else 'collect more demonstrations'}, "
                             "or lower gate.bootstrap_success in the recipe")
    return Made((champion.policy,), f"{verdict.decision}: the champion stays", {"released": False}, no_rows)
