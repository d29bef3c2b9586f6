"""hardcase worth: which batch is meant, judged by retraining with it and without it, and what is said of it."""

import os
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from pydantic import JsonValue
from rich.console import Console, Group
from rich.table import Table

from flows.arm_run import ArmRun, Made, no_rows
from flows.by_hand import stage_bar
from flows.consents import consents_now
from flows.deriving import named_version
from flows.steps_api import Progress
from pipeline.errors import ConfigError, StoreError
from pipeline.lerobot_view.opened import FIELDS, open_version
from pipeline.lerobot_view.training_data import TrainingData
from pipeline.query import parse
from pipeline.recipes import recipe_from
from pipeline.store import Store, store_root
from pipeline.worth.trials import PROCESSES
from schemas.dataset import DatasetVersion
from schemas.recipe import Recipe
from schemas.worth import LEAST_SEEDS, BatchWorth, WorthPart
from stages.worth import SCENES, indicative, worth

LAP = re.compile(r"[0-9]{1,3}")
FOLDER = "worth"
"""Where finished trainings are kept, relative to the store's root."""


@dataclass(frozen=True, slots=True)
class Batch:
    """What is to be judged."""

    version: DatasetVersion
    episodes: tuple[str, ...]
    says: str
    recipe: Recipe
    seed: int
    """Of the run; decides the scenes."""
    rare: tuple[str, ...]
    """Kinds of start harvested before the version was built."""


@dataclass(frozen=True, slots=True)
class Order:
    """What a person asked for."""

    batch: str | None = None
    where: str | None = None
    episodes: Sequence[str] = ()
    seeds: int = LEAST_SEEDS
    scenes: int = SCENES


def run_worth(order: Order, *, as_json: bool) -> int:
    """Judge a batch, keep the verdict, print it; the exit code: 1 where the batch hurts.

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
    if as_json:
        Console(soft_wrap=True, highlight=False).print(found.model_dump_json(), markup=False)
    else:
        Console().print(shown(found))
    return int(found.hurts)


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


def indicated(run: ArmRun, generation: int) -> BatchWorth | None:
    """What the lap's new episodes are worth by one extra training, beside the candidate that it trained anyway.

    It decides nothing and is kept nowhere: `1 seed, indicative`. None where the lap added nothing.
    """
    batch = of_lap(run, generation)
    if batch is None:
        return None
    policy = run.store.policy(run.candidate(generation))
    return indicative(batch.version, data_of(run.store, batch), batch.episodes, run.recipe, run.policy(policy.id),
                      trained_with=policy.seed, says=batch.says, rare=batch.rare, seed=run.seed,
                      keep=run.store.root / FOLDER)


def batch_of(store: Store, order: Order) -> Batch:
    """The batch that a person means: what a lap or version added, or the episodes that were named or asked for.

    Raises:
        StoreError, ConfigError: no such version, lap or episode; a query that finds nothing; everything at once.
    """
    version = _version(store, order.batch)
    run, recipe, seed = _ground(store, version)
    rare = _harvested(store, run, version.generation)
    where = f"version {version.id}"
    if order.episodes or order.where is not None:
        chosen, says = _chosen(store, version, order)
    else:
        chosen, says = _new(store, version), _added(version)
        if not chosen:
            raise ConfigError("it added no episode to the version before it", where=where,
                              mend="choose some of its episodes: hardcase worth VERSION --where 'source == corrected'")
    if len(chosen) == len(version.episodes):
        raise ConfigError("the batch is the whole version: there is nothing to compare it with", where=where,
                          mend="choose a part: hardcase worth VERSION --where 'source == corrected'")
    return Batch(version, chosen, f"{says}: {_counted(store, chosen)}", recipe, seed, rare)


def shown(found: BatchWorth) -> Group:
    """The verdict for a terminal."""
    table = Table("", "scenes", "without", "with", "points", "95 %", "p, corrected", box=None, pad_edge=False)
    for part in found.parts:
        table.add_row(part.name, str(part.scenes), *_row(part))
    for part in found.families:
        if part.p_holm is not None and part.p_holm <= 0.05:
            table.add_row(f"ended {part.name}", str(part.scenes), *_row(part))
    seeds = f"{len(found.seeds_with)} + {len(found.seeds_without)} training seeds"
    lines = [f"{found.decision}: {found.reason}", f"  {found.says}", f"  {seeds}, verdict {found.id}"]
    if found.hurts:
        lines.append("  it is left out of every later version; what learnt from it is not released")
    return Group("\n".join(lines), table)


def _row(part: WorthPart) -> tuple[str, ...]:
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


def of_lap(run: ArmRun, generation: int) -> Batch | None:
    """What a lap added to the version before; None where it added nothing."""
    version = run.material.version(generation)
    new = _new(run.store, version)
    rare = _harvested(run.store, run.run, generation)
    says = f"{_added(version)}: {_counted(run.store, new)}"
    return Batch(version, new, says, run.recipe, run.seed, rare) if new and version.parent else None


def _version(store: Store, name: str | None) -> DatasetVersion:
    """A version by id, by lap of the newest run, or the newest that added something."""
    if name is not None and not LAP.fullmatch(name):
        return named_version(store, name)
    invoked = store.query("SELECT run FROM invocation ORDER BY rowid DESC LIMIT 1")
    run = str(invoked[0][0]) if invoked else ""
    laps = [v for v in store.versions(run=run) if v.parent] if invoked else []
    chosen = [v for v in laps if (str(v.generation) == name if name is not None else _new(store, v))]
    if not chosen:
        what = f"lap {name} of run {run} built no version on another" if name is not None else \
            "no version added anything to one before it"
        raise StoreError(what, where=store.root, mend="turn another lap: hardcase loop; or name a version: "
                                                      "hardcase datasets")
    return chosen[-1]


def _ground(store: Store, version: DatasetVersion) -> tuple[str, Recipe, int]:
    """Run, recipe and seed that a version belongs to, by its nearest ancestor where it was derived."""
    here = version
    while not (rows := store.query("SELECT run FROM member WHERE kind = 'version' AND id = ?", (here.id,))):
        if here.parent is None:
            raise ConfigError("the version comes from no run, so no recipe says how to train and play",
                              where=f"version {version.id}",
                              mend="add it to a version of a run: hardcase derive VERSION --add " + version.id)
        here = store.version(here.parent)
    run = str(rows[0][0])
    info = store.run(run)
    return run, recipe_from(dict(info.recipe), f"run {run}"), info.seed


def _harvested(store: Store, run: str, generation: int) -> tuple[str, ...]:
    met = {c.stratum for c in store.hard_cases(run=run) if c.generation < generation}
    return tuple(sorted(met - {"common"}))


def _new(store: Store, version: DatasetVersion) -> tuple[str, ...]:
    before = set(store.version(version.parent).episodes) if version.parent else set[str]()
    return tuple(e for e in version.episodes if e not in before)


def _added(version: DatasetVersion) -> str:
    return f"what lap {version.generation} added to version {version.id[:8]}"


def _chosen(store: Store, version: DatasetVersion, order: Order) -> tuple[tuple[str, ...], str]:
    """The episodes that were named or asked for, and how."""
    if order.episodes and order.where is not None:
        raise ConfigError("a batch is named or asked for, not both", where=f"--where {order.where!r}",
                          mend="give either --where or --episode")
    if order.where is not None:
        opened = open_version(store.path(version.path), version)
        mask = parse(order.where, FIELDS).mask(opened.asked)
        if not mask.any():
            raise ConfigError(f"none of {len(opened)} episodes fits the query", where=f"--where {order.where!r}",
                              mend=f"see what there is: hardcase datasets {version.id}")
        return tuple(opened.ids[int(k)] for k in np.flatnonzero(mask)), f"{order.where} in version {version.id[:8]}"
    named = [_episode(version, e) for e in order.episodes]
    return tuple(dict.fromkeys(named)), f"named episodes of version {version.id[:8]}"


def _episode(version: DatasetVersion, name: str) -> str:
    found = [e for e in version.episodes if len(name) >= 8 and e.startswith(name)]
    if len(found) != 1:
        what = f"{len(found)} episodes begin with {name}" if found else f"episode {name} is not in the version"
        raise ConfigError(what, where=f"--episode {name}",
                          mend=f"use one of: {', '.join((found or list(version.episodes))[:5])}, ...")
    return found[0]


def _counted(store: Store, episodes: Sequence[str]) -> str:
    counts = Counter(str(e.origin) for e in store.episodes(episodes))
    return f"{len(episodes)} episodes ({', '.join(f'{n} {name}' for name, n in counts.most_common())})"
