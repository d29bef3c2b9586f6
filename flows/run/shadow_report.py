"""The shadow report of a run: judge what was recorded, write the page, keep the hard cases."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from rich.console import Console, Group
from rich.table import Table

from flows.run.judging import judged_at, sensed_at
from flows.run.opening import open_order, recall, refuse_legged
from flows.run.steps import Steps
from pipeline.counterfactual.cases import cases_of
from pipeline.errors import PolicyError, StoreError
from pipeline.files import atomic
from pipeline.report.shadow import ORDER, change, shadow_page
from schemas.counterfactual import JudgeConfig, ShadowReport
from schemas.hardcase import HardCase


@dataclass(frozen=True, slots=True)
class Written:
    """A report, where its page lies, and the hard cases that came of it."""

    report: ShadowReport
    page: Path
    cases: tuple[HardCase, ...]


def judge_candidate(root: Path, candidate: str, *, run: str | None, generation: int | None, config: JudgeConfig,
                    keep: bool, estimated: bool = False) -> Written:
    """Judge a candidate by the deployments of a run's champion, and write the page beside the loop's own report.

    Args:
        root: the store.
        candidate: id of a policy of this store, whatever run it is of; its first digits are enough.
        run: the newest loop where None.
        generation: lap whose deployment is judged; the last that was deployed where None.
        config: what counts as a lasting disagreement, and the number of draws.
        estimated: read nothing of the recordings but what the robot sensed, and play in the simulation of training.
        keep: put the hard cases into the store; those that are there stay as they are.

    Raises:
        StoreError: no such run or policy, or nothing was deployed.
        PolicyError: the candidate is the champion itself.
    """
    with open_order(recall(root, run), root) as steps:
        assert isinstance(steps, Steps)
        refuse_legged(steps.recipe, "judging disagreements")
        id, lap = _policy(steps, candidate), deployed_lap(steps, generation)
        champion = str(steps.store.episode(steps.material.ids(lap, "deploy")[0]).policy)
        if id == champion:
            raise PolicyError(f"policy {id} was the champion itself in generation {lap}", where=f"run {steps.run}",
                              mend=f"name another: {_others(steps, champion)}")
        report = (sensed_at(steps, lap, champion, id, config) if estimated
                  else judged_at(steps, lap, champion, id, config)[1])
        cases = cases_of(report.judgements, lap, steps.name)
        if keep:
            with steps.store.commit(steps.lease, steps.run) as tx:
                tx.add_hard_cases(_new(steps, cases))
        name = f"shadow-{steps.run}-{lap}-{id}" + "-estimated" * estimated
        page = steps.store.root / "reports" / f"{name}.html"
        with atomic(page) as stream:
            stream.write(shadow_page(report).encode())
    return Written(report, page, tuple(cases))


def _policy(steps: Steps, prefix: str) -> str:
    table, id = steps.store.find(prefix)
    if table != "policy":
        raise StoreError(f"{id} is no policy, but of the table {table}", where=steps.store.root,
                         mend=f"name a policy: {_others(steps, None)}")
    return id


def _others(steps: Steps, champion: str | None) -> str:
    return ", ".join(p.id for p in steps.store.policies(run=steps.run) if p.id != champion) or "none is trained yet"


def deployed_lap(steps: Steps, generation: int | None) -> int:
    """The lap that was asked for, or the last one whose champion was deployed.

    Raises:
        StoreError: it was not deployed.
    """
    laps = [s.generation for s in steps.store.steps(steps.run) if s.stage == "deploy" and s.outputs["ids"]]
    if not laps or (generation is not None and generation not in laps):
        what = "nothing was deployed" if generation is None else f"generation {generation} was not deployed"
        mend = f"use one of --generation {', '.join(map(str, laps))}" if laps else "run it first: hardcase deploy"
        raise StoreError(what, where=f"run {steps.run}", mend=mend)
    return laps[-1] if generation is None else generation


def _new(steps: Steps, cases: list[HardCase]) -> list[HardCase]:
    """Cases that the store does not hold yet: one that was corrected since keeps its correction."""
    known = {c.id for c in steps.store.hard_cases(run=steps.run)}
    return [c for c in cases if c.id not in known]


def replayed(report: ShadowReport) -> str:
    """How well the stand-in reproduced what was sensed: the median over the moments with something before them."""
    later = [j for j in report.judgements if j.tick > 0]
    told = f"estimated from sensors alone; {len(report.judgements) - len(later)} begin at the first tick"
    if not later:
        return f"{told}, nothing was replayed"
    joints, cube = (float(np.median([getattr(j, name) for j in later]))
                    for name in ("replay_error_rad", "replay_error_m"))
    return (f"{told}, before the others the replay misses the joints by {joints:.4f} rad and the object by "
            f"{1000 * cube:.1f} mm (median of RMS, noise of perception included)")


def show(written: Written, *, kept: bool) -> None:
    """Print the report in short."""
    report, console = written.report, Console()
    rows = Table("start", "attempts", "apart", "judged", "right", "change of success",
                 title=f"{report.candidate} in the shadow of {report.champion}, generation {report.generation}")
    for r in report.rows:
        right = ", ".join(f"{v} {r.right[v]}" for v in ORDER if v in r.right)
        doubt = f" ({r.undecided} undecided)" if r.undecided else ""
        rows.add_row(r.stratum, str(r.attempts), str(r.apart), str(r.judged), right + doubt, change(r.change))
    check = f"from the start, {report.checked} attempts: {change(report.from_start)}; missed {change(report.missed)}"
    stored = "in the store" if kept else "not kept: add --keep"
    if report.estimated:
        check += "\n" + replayed(report)
    console.print(Group(rows, check, f"{len(report.refusals)} refused, {len(written.cases)} hard cases ({stored})",
                        f"{report.verdict}: {report.reason}", str(written.page)), soft_wrap=True)
    for refusal in report.refusals[:5]:
        console.print(f"refused: episode {refusal.episode} at tick {refusal.tick}: {refusal.reason}", soft_wrap=True)
