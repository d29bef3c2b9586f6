"""What is left of a version after an episode of it was forgotten, and why it teaches nothing more."""

from pipeline.errors import DatasetError
from schemas.dataset import DatasetVersion


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
