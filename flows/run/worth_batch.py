"""Which episodes are meant by a batch: what a lap or version added, a query, or ids; and what it is compared by."""

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from flows.data.deriving import named_version
from flows.run.arm_run import ArmRun
from pipeline.errors import ConfigError, StoreError
from pipeline.lerobot_view.incomplete import refuse_starts
from pipeline.lerobot_view.opened import FIELDS, open_version
from pipeline.query import parse
from pipeline.recipes import recipe_from
from pipeline.store import Store
from schemas.dataset import DatasetVersion
from schemas.episode import VARIANTS
from schemas.recipe import Recipe
from schemas.worth import LEAST_SEEDS
from stages.worth import SCENES

LAP = re.compile(r"[0-9]{1,3}")


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


def batch_of(store: Store, order: Order) -> Batch:
    """The batch that a person means: what a lap or version added, or the episodes that were named or asked for.

    Raises:
        StoreError, ConfigError: no such version, lap or episode; a query that finds nothing; everything at once.
        DatasetError: the version is a curriculum of a legged robot.
    """
    version = _version(store, order.batch)
    refuse_starts(store.path(version.path))
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


def parts_of(store: Store, batch: Batch) -> tuple[Batch, ...]:
    """A batch, and by itself what of it was recorded.

    Variants begin where the recordings do, and may help so much that bad recordings among them are not seen
    (docs/results.md): so what people and robots gave has to stand on its own.
    """
    recorded = tuple(e.id for e in store.episodes(batch.episodes) if e.origin not in VARIANTS)
    if not 0 < len(recorded) < len(batch.episodes):
        return (batch,)
    says = f"the recordings in {batch.says.partition(':')[0]}: {_counted(store, recorded)}"
    return batch, replace(batch, episodes=recorded, says=says)


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
