"""Versions that lack what others have: those that an episode was forgotten of, and those that hold no frames."""

from pathlib import Path

from pipeline.errors import DatasetError
from schemas.dataset import DatasetVersion

CURRICULUM = "curriculum.json"
"""What a version holds that is made of starts instead of frames, see pipeline.locomotion.lesson."""


def refuse_incomplete(version: DatasetVersion, where: object) -> None:
    """Return for a version that holds all that it was built from.

    A policy's id follows from its version's id, and this id promises the erased episodes: two policies that saw
    different data would have one id.

    Raises:
        DatasetError: an episode of it was forgotten.
    """
    if version.erased:
        raise DatasetError(f"version {version.id} is incomplete: erased ({len(version.erased)} episodes)", where=where,
                           mend="build a new version without them, hardcase build; a run that stands between build and "
                                "train begins anew: hardcase loop --seed N")


def refuse_starts(folder: Path) -> None:
    """Return for a version of frames.

    Raises:
        DatasetError: it is a curriculum.
    """
    if (folder / CURRICULUM).is_file():
        raise DatasetError("a curriculum of a legged robot holds starts, no frames", where=folder,
                           mend=f"name a version of frames; where these starts come from: hardcase why {folder.name}")
