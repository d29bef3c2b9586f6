"""hardcase worth: a batch is judged by retraining with it and without it, the verdict kept and told."""

import os
from collections.abc import Sequence

import numpy as np

from flows.commands.by_hand import stage_bar
from flows.data.consents import consents_now
from flows.run.arm_run import ArmRun, Made, no_rows
from flows.run.steps_api import Progress
from flows.run.worth_batch import Batch, Order, batch_of, of_lap, parts_of
from pipeline.errors import ConfigError
from pipeline.lerobot_view.training_data import TrainingData
from pipeline.store import Store, store_root
from pipeline.worth.judging import ALPHA
from pipeline.worth.trials import PROCESSES
from schemas.worth import LEAST_SEEDS, BatchWorth, WorthPart
from stages.worth import SCENES, indicative, worth

FOLDER = "worth"
"""Where finished trainings are kept, relative to the store's root."""


def run_worth(order: Order, *, as_json: bool) -> tuple[str, int]:
    """Judge a batch and keep the verdict; what to print, and the exit code: 1 where the batch hurts.

    What a lap or version added is judged as a whole, and its recordings once more by themselves.

    Raises:
        HardcaseError: no such batch, or nothing to compare it with.
    """
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    with Store.open(store_root()) as store, stage_bar("worth") as shown_bar:
        batch = batch_of(store, order)
        asked = order.where is not None or bool(order.episodes)
        task = shown_bar.add_task("worth", total=None)
        found = judge_all(store, (batch,) if asked else parts_of(store, batch), seeds=order.seeds,
                          scenes=order.scenes,
                          progress=lambda done, total: shown_bar.update(task, completed=done, total=total))
    text = f"[{','.join(w.model_dump_json() for w in found)}]" if as_json else "\n\n".join(map(shown, found))
    return text, int(any(w.hurts for w in found))


def list_worths(*, as_json: bool) -> str:
    """The last verdict on every batch that was judged, and how much each keeps out."""
    with Store.open(store_root()) as store:
        found = store.worths()
    if as_json:
        return f"[{','.join(w.model_dump_json() for w in found)}]"
    lines = [f"{w.id}  {w.decision}  {w.says}\n    {w.reason}"
             + (f"; {len(w.episodes)} episodes are kept out" if w.hurts else "") for w in found]
    return "\n".join(lines) or "no batch was judged yet: hardcase worth"


def judge(store: Store, batch: Batch, *, seeds: int = LEAST_SEEDS, scenes: int = SCENES, processes: int = PROCESSES,
          progress: Progress | None = None) -> BatchWorth:
    """Retrain with a batch and without it; see stages.worth. The verdict is not kept yet."""
    return worth(batch.version, data_of(store, batch), batch.episodes, batch.recipe, says=batch.says, rare=batch.rare,
                 seed=batch.seed, keep=store.root / FOLDER, seeds=seeds, scenes=scenes, processes=processes,
                 progress=progress)


def judge_all(store: Store, batches: Sequence[Batch], *, seeds: int = LEAST_SEEDS, scenes: int = SCENES,
              progress: Progress | None = None) -> list[BatchWorth]:
    """Judge batches of one version and keep the verdicts; what they have in common is trained once."""
    found: list[BatchWorth] = []
    for k, batch in enumerate(batches):
        found.append(judge(store, batch, seeds=seeds, scenes=scenes, progress=_part(progress, k, len(batches))))
        store.add_worth(found[-1])
    return found


def judged_batch(run: ArmRun, generation: int, progress: Progress, *, seeds: int = LEAST_SEEDS,
                 scenes: int = SCENES) -> Made | None:
    """Judge what a lap added to its version, and its recordings by themselves; None where it added nothing.

    What hurts is left out of the next version, and a candidate that learnt from it is not released.
    """
    batch = of_lap(run, generation)
    if batch is None:
        return None
    found = judge_all(run.store, parts_of(run.store, batch), seeds=seeds, scenes=scenes, progress=progress)
    says = "; ".join(f"{w.says.partition(':')[0]} {w.decision}: {w.reason}" for w in found)
    return Made(tuple(w.id for w in found), says, {
        "decisions": [w.decision for w in found], "points": [round(100 * w.parts[0].difference, 2) for w in found],
    }, no_rows)


def _part(progress: Progress | None, k: int, n: int) -> Progress | None:
    """Progress of one of n batches as progress of all."""
    return None if progress is None else lambda done, total: progress(k * total + done, n * total)


def indicated(run: ArmRun, generation: int, *, scenes: int = SCENES) -> BatchWorth | None:
    """What the lap's new episodes are worth by one extra training, beside the candidate that it trained anyway.

    It decides nothing and is kept nowhere: `1 seed, indicative`. None where the lap added nothing.
    """
    batch = of_lap(run, generation)
    if batch is None:
        return None
    policy = run.store.policy(run.candidate(generation))
    return indicative(batch.version, data_of(run.store, batch), batch.episodes, run.recipe, run.policy(policy.id),
                      trained_with=policy.seed, says=batch.says, rare=batch.rare, seed=run.seed,
                      keep=run.store.root / FOLDER, scenes=scenes)


def shown(found: BatchWorth) -> str:
    """The verdict for a terminal: the decision, then a line for every kind of start and family that changed."""
    rows = [("", "without", "with", "points", "95 %", "p, corrected")]
    rows += [(part.name, *_cells(part)) for part in found.parts]
    rows += [(f"ended {part.name}", *_cells(part)) for part in found.families
             if part.p_holm is not None and part.p_holm <= ALPHA]
    widths = [max(len(row[k]) for row in rows) for k in range(len(rows[0]))]
    table = ["  " + "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip()
             for row in rows]
    lines = [f"{found.decision}: {found.reason}", f"  {found.says}",
             f"  {len(found.seeds_with)} + {len(found.seeds_without)} training seeds, {found.parts[0].scenes} scenes, "
             f"verdict {found.id}"]
    if found.hurts:
        lines.append("  it is left out of every later version, and what learnt from it is not released")
    return "\n".join([*lines, *table])


def _cells(part: WorthPart) -> tuple[str, ...]:
    rates = (np.mean(side) / part.scenes for side in (part.without, part.with_batch))
    interval = "" if part.low is None or part.high is None else f"{100 * part.low:+.1f} {100 * part.high:+.1f}"
    return (*(f"{rate:.3f}" for rate in rates), f"{100 * part.difference:+.1f}", interval,
            "" if part.p_holm is None else f"{part.p_holm:.2g}")


def data_of(store: Store, batch: Batch) -> TrainingData:
    """The frames of the version that holds a batch; ConfigError where its policies do not see the state."""
    if batch.recipe.train.policy != "chunked":
        raise ConfigError("the worth of a batch is measured by policies that see the state, not by "
                          f"{batch.recipe.train.policy!r}", where=f"recipe {batch.recipe.name}: train.policy",
                          mend="judge it in a run whose recipe says train.policy: chunked")
    return TrainingData.load(store.path(batch.version.path), consents_now(store))


