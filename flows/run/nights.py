"""Nights: the training side of the nightly gate, wired to the store: budget, fresh scenes, regression set, anchor."""

from collections.abc import Sequence
from dataclasses import dataclass

from flows.run.arm_run import ArmRun, Made
from flows.run.steps_api import Progress
from pipeline.policies.table import policy_kind
from pipeline.simulation.evaluation import evaluate
from pipeline.simulation.night_scenes import (
    ANCHOR,
    CANDIDATE,
    night_mix,
    night_scenes,
    played_again,
    selection_scenes,
)
from pipeline.statistics.budget import Purse, carried, stake
from pipeline.store import Transaction
from schemas.night import Account, Night
from schemas.policy import PolicyRecord
from schemas.recipe import NightlyConfig
from schemas.release import Release
from schemas.scene import SceneSpec
from schemas.verdict import Selection, Verdict
from stages.nightly import judge_tonight
from stages.release import return_to

SELECTION_SCENES = 200
SEEDS_APART = 10_000_000
"""Between the seeds of one candidate's trainings: more than the seeds of all laps of any run."""


@dataclass(frozen=True, slots=True)
class Books:
    """The ledger as tonight finds it."""

    day: int
    candidates: Purse
    anchors: Purse
    anchor: str
    promotions: int


def training_seeds(run: ArmRun, generation: int) -> list[int]:
    """Seed of every training of a lap's candidate; the first is the one that there always was."""
    return [1000 * run.seed + generation + SEEDS_APART * k for k in range(run.recipe.gate.seeds)]


def choose(run: ArmRun, generation: int, trained: Sequence[PolicyRecord]) -> Selection:
    """The training that solves the most selection scenes, the first of equals: a rule that saw no test scene."""
    recipe = run.recipe
    scenes = selection_scenes(recipe.task, recipe.robot, recipe.scene, seed=run.seed, generation=generation,
                              n=recipe.gate.selection or SELECTION_SCENES, mix=_mix(run))
    opened = {p.id: policy_kind(p.kind).open(run.store.path(p.checkpoint) / "policy.onnx") for p in trained}
    solved = {id: int(evaluate(policy, scenes, threads=recipe.threads).success.sum()) for id, policy in opened.items()}
    return Selection(scenes=len(scenes), solved=solved, chosen=max(solved, key=lambda p: solved[p]))


def judged(run: ArmRun, generation: int, champion: str, progress: Progress) -> Made:
    """Tonight's candidate against the champion, and, at every tenth promotion, against the anchor."""
    night = run.recipe.gate.nightly
    assert night is not None
    found = books(run, generation, champion, night)
    even = night.false_promotions * (1 - night.anchor_share)
    staked = stake(found.candidates, found.day, budget=even, days=night.nights, most=night.most_stake)
    verdict = _play(run, generation, champion, staked, CANDIDATE, progress)
    promoted = verdict.decision == "PASS"
    again = promoted and found.promotions + 1 >= night.anchor_every and found.anchor != verdict.candidate
    anchor = _against_anchor(run, generation, found, night, progress) if again else None
    row = _night(run, generation, found, verdict, anchor)
    says = f"{verdict.decision} after {verdict.scenes} scenes, stake {staked:.2g}, {row.candidates.after:.3f} left"
    if anchor is not None:
        says += f"; against the anchor {anchor.decision}" + (", roll back" if row.roll_back_to else "")

    def write(tx: Transaction) -> None:
        if anchor is not None:
            tx.add_verdict(anchor)
        tx.add_verdict(verdict)
        tx.add_night(row)

    ids = (verdict.id,) if anchor is None else (verdict.id, anchor.id)
    return Made(ids, says, {"day": found.day, "stake": staked}, write)


def returned(run: ArmRun, generation: int, new: Release) -> Release | None:
    """The release back to the anchor that tonight's ledger names, after that of the candidate; None on all others."""
    row = next((n for n in run.store.nights(run.run) if n.generation == generation), None)
    if row is None or row.roll_back_to is None or row.anchor_verdict is None:
        return None
    return return_to([*run.store.releases(run.run), new], row.roll_back_to, row.anchor_verdict)


def rolled_back(new: Release, back: Release) -> Made:
    """Both movements of the pointer in one step: the promotion that tonight earned, and the return that followed."""

    def write(tx: Transaction) -> None:
        tx.add_release(new)
        tx.add_release(back)

    says = f"PASS: release {new.number}, which lost against the anchor; back to it: release {back.number}"
    return Made((back.policy,), says, {"released": False}, write)


def books(run: ArmRun, generation: int, champion: str, night: NightlyConfig) -> Books:
    """Where budget and anchor stand; a run by hand has a night a lap, one by the clock a day number."""
    last = next(reversed(run.store.nights(run.run)), None)
    day = run.day if run.day is not None else last.day + 1 if last else generation
    parts = (night.false_promotions * (1 - night.anchor_share), night.false_promotions * night.anchor_share)
    before = (None, None) if last is None else (Purse(last.since, last.candidates.after),
                                                Purse(last.since, last.anchors.after))
    candidates, anchors = (carried(purse, day, budget=part, days=night.nights)
                           for purse, part in zip(before, parts, strict=True))
    return Books(day, candidates, anchors, (last.anchor if last else None) or champion, last.promotions if last else 0)


def _play(run: ArmRun, generation: int, against: str, staked: float, sequence: int, progress: Progress) -> Verdict:
    """One test of the candidate on scenes that nothing else plays."""
    recipe, candidate, mix = run.recipe, run.candidate(generation), _mix(run)
    policies = {p: run.policy(p) for p in (candidate, against)}
    told = run.material.outputs(generation, "train").get("selection")
    kept = run.store.regression_scenes(run=run.run)

    def scenes(start: int, stop: int) -> list[SceneSpec]:
        return night_scenes(recipe.task, recipe.robot, recipe.scene, seed=run.seed, generation=generation,
                            sequence=sequence, start=start, stop=stop, mix=mix)

    return judge_tonight(
        candidate, against, generation=generation, stake=staked, families=tuple(mix), scenes=scenes,
        evaluate=lambda p, s: evaluate(policies[p], s, threads=recipe.threads).success, config=recipe.gate,
        regression=[s.scene for s in kept], again=played_again, named={s.scene.seed: s.family for s in kept},
        progress=progress,
        selection=Selection.model_validate(told) if told else None)


def _against_anchor(run: ArmRun, generation: int, books: Books, night: NightlyConfig, progress: Progress) -> Verdict:
    """The candidate that was just promoted against the champion that was frozen."""
    staked = stake(books.anchors, books.day, budget=night.false_promotions * night.anchor_share, days=night.nights,
                   most=night.most_stake, every=night.anchor_every)
    return _play(run, generation, books.anchor, staked, ANCHOR, progress)


def _night(run: ArmRun, generation: int, books: Books, verdict: Verdict, anchor: Verdict | None) -> Night:
    """The new row of the ledger: a confirmed champion becomes the anchor, one that lost against it makes way for it."""
    promoted = verdict.decision == "PASS"
    frozen, promotions, back = books.anchor, books.promotions + promoted, None
    if anchor is not None and anchor.decision == "PASS":
        frozen, promotions = verdict.candidate, 0
    elif anchor is not None and anchor.decision == "FAIL":
        promotions, back = 0, books.anchor
    return Night(run=run.run, generation=generation, day=books.day, since=books.candidates.since,
                 candidates=_account(books.candidates, verdict), anchors=_account(books.anchors, anchor),
                 verdict=verdict.id, promoted=promoted, anchor=frozen, promotions=promotions,
                 anchor_verdict=anchor.id if anchor else None, roll_back_to=back)


def _account(purse: Purse, verdict: Verdict | None) -> Account:
    """What a test did with a purse."""
    tonight = verdict.tonight if verdict else None
    if tonight is None:
        return Account(before=purse.money, after=purse.money)
    return Account(before=purse.money, stake=tonight.stake,
                   after=max(0.0, purse.money - tonight.stake + tonight.given_back))


def _mix(run: ArmRun) -> dict[str, float]:
    """Families of the night's scenes, fixed by what was harvested before."""
    recipe = run.recipe
    return night_mix(recipe.task, run.material.harvested_strata(), recipe.gate.rare_share)
