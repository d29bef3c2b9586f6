"""Material: what the finished steps of a run hold, as the next stages need it."""

from collections.abc import Iterable, Iterator, Mapping
from functools import lru_cache
from typing import Any

from flows.data.consents import consents_now
from pipeline.check.door import Verdicts
from pipeline.consent import Consents
from pipeline.errors import StoreError
from pipeline.frames import Frames
from pipeline.recording import read_episode, read_frames
from pipeline.shards import read_shard
from pipeline.store import Store
from pipeline.trace import Trace
from pipeline.triggers import stratum_of
from pipeline.worth.door import Worths
from schemas.dataset import DatasetVersion
from schemas.episode import VARIANTS, Episode
from schemas.recipe import Recipe

NEEDS: Mapping[str, tuple[str, ...]] = {
    "augment": ("collect",), "build": ("augment",), "train": ("build",), "gate": ("train",), "release": ("gate",),
    "exam": ("train", "release"), "deploy": ("release",), "harvest": ("deploy",),
}
"""Stage -> stages of the same lap whose ids it reads."""


def ancestors_of(store: Store, episodes: Iterable[Episode]) -> list[Episode]:
    """What these episodes were made from, through any number of steps, without themselves."""
    waiting, found = list(episodes), list[Episode]()
    known = {e.id for e in waiting}
    while grown := list(dict.fromkeys(e.parent for e in waiting if e.parent and e.parent not in known)):
        waiting = store.episodes(grown)
        known |= {e.id for e in waiting}
        found += waiting
    return found


class Material:
    """Reads one run from its store.

    Args:
        store: where the run is kept.
        run: its id.
    """

    def __init__(self, store: Store, run: str) -> None:
        self._store, self._run = store, run
        self._shard = lru_cache(maxsize=8)(lambda blob: read_shard(store.blob(blob)))
        self._recording = lru_cache(maxsize=512)(lambda blob: read_frames(store.blob(blob))[1])

    def outputs(self, generation: int, stage: str) -> dict[str, Any]:
        """What a finished step says of itself; StoreError where it is not finished."""
        step = self._store.step(self._run, generation, stage)
        if step is None:
            raise StoreError(f"{stage} of generation {generation} is not finished", where=f"run {self._run}",
                             mend=f"run it first: hardcase {stage}")
        return step.outputs

    def ids(self, generation: int, stage: str) -> list[str]:
        """What a finished step made, without what was forgotten since."""
        ids = [str(i) for i in self.outputs(generation, stage)["ids"]]
        gone = self._store.erased(ids)
        return [i for i in ids if i not in gone]

    def inputs(self, generation: int, stage: str) -> dict[str, str]:
        """Name -> ids that a stage read."""
        before = [(g, s) for s in NEEDS.get(stage, ()) for g in (generation,)]
        if stage == "augment" and generation:
            before = [(0, "collect"), (generation - 1, "harvest")]
        return {s: ",".join(self.ids(g, s)[:64]) for g, s in before
                if self._store.step(self._run, g, s) is not None}

    def fresh(self, generation: int) -> list[Episode]:
        """Recorded episodes that this lap sees for the first time."""
        stage = (0, "collect") if generation == 0 else (generation - 1, "harvest")
        return self._store.episodes(self.ids(*stage))

    def episodes(self, generation: int) -> list[Episode]:
        """Everything that may enter this lap's version, and the attempts that corrections grew from."""
        found: list[Episode] = []
        for g in range(generation + 1):
            found += self.fresh(g)
            found += self._store.episodes(self.ids(g, "augment"))
        return found + self.ancestors(found)

    def driven(self, recipe: Recipe) -> list[Episode]:
        """Attempts of this store that people drove on the recipe's robot and task, at its rate, and that may teach now.

        They belong to no lap: whoever asks for them in dataset.sources gets all that there are. An attempt that
        nobody but a policy drove teaches nothing; one without a consent that holds is kept, and left out here.
        """
        consents, hz = self.consents(), self.fresh(0)[0].control_hz
        return [e for e in self._store.episodes(origin="teleop")
                if (e.scene.robot, e.scene.task, e.control_hz) == (recipe.robot, recipe.task, hz)
                and any(s.kind != "autonomous" for s in e.segments) and consents.flaw(e) is None]

    def ancestors(self, episodes: Iterable[Episode]) -> list[Episode]:
        """What these episodes were made from, through any number of steps, without themselves."""
        return ancestors_of(self._store, episodes)

    def usable(self, episodes: Iterable[Episode]) -> list[Episode]:
        """Those of the episodes that may teach: they passed their check, hurt nothing, and their consent holds.

        Raises:
            ConsentError: a person in an episode never consented.
        """
        consents, chosen = self.consents(), list(episodes)
        known = self.ancestors(chosen)
        standing = consents.standing(chosen, known)
        consents.check(standing, known)
        return self.worths().spared(self.verdicts([*known, *standing]).passing(standing, known), known)

    def consents(self) -> Consents:
        """The consent records as they are, for a use at this moment."""
        return consents_now(self._store)

    def verdicts(self, episodes: Iterable[Episode], version: DatasetVersion | None = None) -> Verdicts:
        """What the checks found of these episodes, and of a version."""
        subjects = [e.blob for e in episodes if e.blob] + ([version.digest] if version else [])
        return Verdicts(self._store.checks(dict.fromkeys(subjects)))

    def worths(self) -> Worths:
        """The batches that were judged to hurt."""
        return Worths(self._store.hurting())

    def frames(self, episode: Episode) -> Frames:
        """The frames of an episode, from its recording or its shard."""
        if episode.blob is None:
            raise StoreError(f"episode {episode.id} keeps no frames", where=f"run {self._run}",
                             mend="it is a rejected variant: make it again from its parent, draws and seed")
        if episode.origin in VARIANTS:
            return self._shard(episode.blob)[episode.id]
        return self._recording(episode.blob)

    def failed_attempts(self, generation: int) -> list[tuple[Episode, Trace]]:
        """Deployed attempts that a trigger stopped, whole and restorable."""
        failed = [e for e in self._store.episodes(self.ids(generation, "deploy")) if e.outcome.label == "failure"]
        return self._whole(failed)

    def deployed_attempts(self, generation: int) -> list[tuple[Episode, Trace]]:
        """All deployed attempts of a lap, whole and restorable."""
        return self._whole(self._store.episodes(self.ids(generation, "deploy")))

    def _whole(self, episodes: list[Episode]) -> list[tuple[Episode, Trace]]:
        usable = self.usable(episodes)  # what is corrected is taught
        return [(e, read_episode(self._store.blob(str(e.blob)))[1]) for e in usable]

    def version(self, generation: int) -> DatasetVersion:
        """The dataset version of a lap."""
        return self._store.version(self.ids(generation, "build")[0])

    def harvested_strata(self) -> list[str]:
        """Rare kinds of start met so far, as perceived: those of hard cases, or of a control's demonstrations."""
        met = [c.stratum for c in self._store.hard_cases(run=self._run)]
        later = [s.generation for s in self._store.steps(self._run) if s.stage == "harvest"]
        shown = [e for g in later for e in self._store.episodes(self.ids(g, "harvest")) if e.origin == "scripted"]
        met += [stratum_of(self.frames(e).environment[0]) for e in shown]
        return [s for s in dict.fromkeys(met) if s != "common"]

    def exams(self) -> Iterator[tuple[str, dict[str, Any]]]:
        """Policy -> exam result, of every policy that this run has examined."""
        for step in self._store.steps(self._run):
            if step.stage == "exam":
                results: dict[str, Any] = dict(step.outputs["results"])  # type: ignore[arg-type]
                yield from results.items()

    def riders(self, champion: str, count: int) -> list[str]:
        """Policies to ride in the champion's shadow: the newest others of this run, the newest first."""
        return [p.id for p in reversed(self._store.policies(run=self._run)) if p.id != champion][:count]
