"""Lesson: what one lap of a legged robot learns from, as a folder of the store: a dataset version of starts.

The folder holds `curriculum.json` and the manifest that every version has: lineage, listing and erasure treat it as
they treat versions of frames.
"""

from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any, Self

from pydantic import Field, ValidationError

from pipeline.consent import NO_CONSENTS, Consents
from pipeline.errors import DatasetError
from pipeline.files import atomic
from pipeline.lerobot_view.incomplete import CURRICULUM, refuse_incomplete
from pipeline.lerobot_view.layout import MANIFEST
from pipeline.lerobot_view.manifest import load_version, read_manifest
from pipeline.lerobot_view.sealing import building, seal, write_manifest
from pipeline.locomotion.curriculum import Curriculum, HardStart
from pipeline.locomotion.tasks import LeggedTask
from schemas.base import Frozen, ShortId


class Lesson(Frozen):
    """A curriculum, and which robot is to do what."""

    body: str = Field(description="key of LEGGED")
    name: str = Field(description="of the task")
    task: LeggedTask
    curriculum: Curriculum
    vary: float = Field(default=0.0, ge=0, description="how much the robots of a training differ")
    held_out: tuple[HardStart, ...] = Field(default=(), description="hard starts that only the gate plays")
    needs: dict[ShortId, tuple[str, ...]] = Field(
        default={}, description="episode -> consent records that its start rests on; those that need none are left out")

    @classmethod
    def load(cls, folder: Path, consents: Consents = NO_CONSENTS) -> Self:
        """Read a version folder.

        Args:
            folder: where the version lies.
            consents: the consent records, and the moment of this use.

        Raises:
            ConsentError: a start comes from an attempt of a person who did not consent, or does not any more.
            DatasetError: the folder is no curriculum, was changed after it was built, or lost an episode that was
                forgotten.
        """
        refuse_incomplete(load_version(folder), folder)
        lesson = cls.read(folder)
        consents.check_needs(lesson.needs, folder)
        return lesson

    @classmethod
    def read(cls, folder: Path) -> Self:
        """What the folder holds, whoever asks.

        Raises:
            DatasetError: it is no curriculum.
        """
        try:
            return cls.model_validate_json((folder / CURRICULUM).read_bytes())
        except (OSError, ValidationError) as error:
            raise DatasetError("not a curriculum of a legged robot", where=folder / CURRICULUM,
                               mend="give a version that hardcase build has made for a recipe with rl") from error

    def write(self, target: Path, manifest: Mapping[str, object], *, aside: Path) -> None:
        """Write the folder of a version, whole or not at all.

        Args:
            target: the folder, which must not exist yet.
            manifest: what meta/hardcase.json says besides the digests of files.
            aside: a folder for unfinished things, on the same file system.
        """
        with building(target, aside) as folder:
            (folder / MANIFEST).parent.mkdir()
            with atomic(folder / CURRICULUM) as stream:
                stream.write(self.model_dump_json(indent=1).encode() + b"\n")
            write_manifest(folder, manifest, {})
            seal(folder)

    def without(self, episodes: frozenset[str]) -> Self:
        """The lesson without the starts that come from these episodes."""
        curriculum = self.curriculum
        starts = tuple(s for s in curriculum.starts if s.episode not in episodes)
        share = curriculum.hard_share if starts else 0.0
        return self.model_copy(update={
            "curriculum": curriculum.model_copy(update={"starts": starts, "hard_share": share}),
            "held_out": tuple(s for s in self.held_out if s.episode not in episodes),
            "needs": {e: n for e, n in self.needs.items() if e not in episodes}})


def write_without(new: Path, old: Path, episodes: frozenset[str], hashes: Collection[str]) -> None:
    """Write a curriculum's folder once more without the starts of some episodes; its manifest says what it lost.

    Args:
        new: the folder, which must not exist yet.
        old: the curriculum as it is.
        episodes: what goes.
        hashes: of recordings that go.
    """
    lesson, manifest = Lesson.read(old), read_manifest(old)
    version: dict[str, Any] = dict(manifest["version"])
    cases = {s.case for s in (*lesson.curriculum.starts, *lesson.held_out) if s.episode in episodes}
    lost = [id for id in version["episodes"] if id in episodes]
    version |= {"episodes": [id for id in version["episodes"] if id not in episodes],
                "held_out": [id for id in version["held_out"] if id not in episodes],
                "inputs": [sha for sha in version["inputs"] if sha not in hashes],
                "starts": [id for id in version["starts"] if id not in cases],
                "erased": [*version.get("erased", ()), *lost]}
    said = {name: value for name, value in manifest.items() if name not in ("files", "version")}
    lesson.without(episodes).write(new, {**said, "version": version}, aside=new.parent)
