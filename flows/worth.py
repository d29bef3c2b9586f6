"""hardcase worth: a batch is judged by retraining with it and without it, the verdict kept and told."""

import os

import numpy as np
from pydantic import JsonValue

from flows.arm_run import ArmRun, Made, no_rows
from flows.by_hand import stage_bar
from flows.consents import consents_now
from flows.steps_api import Progress
from flows.worth_batch import Batch, Order, batch_of, of_lap
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

    Raises:
        HardcaseError: no such batch, or nothing to compare it with.
    """
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    with Store.open(store_root()) as store, stage_bar("worth") as progress:
        batch = batch_of(store, order)
        task = progress.add_task("worth", total=None)
        found = judge(store, batch, seeds=order.seeds, scenes=order.scenes,
                      progress=lambda done, total: progress.update(task, completed=done, total=total))
        store.add_worth(found)
    return found.model_dump_json() if as_json else shown(found), int(found.hurts)


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


def judged_batch(run: ArmRun, generation: int, progress: Progress, *, seeds: int = LEAST_SEEDS) -> Made | None:
    """Judge what a lap added to its version; None where it added nothing.

    What hurts is left out of the next version, and a candidate that learnt from it is not released.
    """
    batch = of_lap(run, generation)
    if batch is None:
        return None
    found = judge(run.store, batch, seeds=seeds, progress=progress)
    run.store.add_worth(found)
    return Made((found.id,), f"{found.decision}: {found.reason}", _numbers(found), no_rows)


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


def _numbers(found: BatchWorth) -> dict[str, JsonValue]:
    return {"worth": found.id, "decision": found.decision, "points": round(100 * found.parts[0].difference, 2)}


def data_of(store: Store, batch: Batch) -> TrainingData:
    """The frames of the version that holds a batch; ConfigError where its policies do not see the state."""
    if batch.recipe.train.policy != "chunked":
        raise ConfigError("the worth of a batch is measured by policies that see the state, not by "
                          f"{batch.recipe.train.policy!r}", where=f"recipe {batch.recipe.name}: train.policy",
                          mend="judge it in a run whose recipe says train.policy: chunked")
    return TrainingData.load(store.path(batch.version.path), consents_now(store))


