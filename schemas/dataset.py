"""DatasetVersion: an immutable folder, a LeRobot v3 dataset or a curriculum, and everything that made it."""

from pydantic import Field

from schemas.base import Frozen, Name, Sha256, ShortId
from schemas.edits import Edit


def _no_starts(starts: object) -> bool:
    """Versions of frames say nothing of starts: they stay as they were."""
    return not starts


class DatasetVersion(Frozen):
    """One version, of frames or of starts; the id follows from recipe, inputs and code, the digest from the bytes."""

    id: ShortId
    digest: Sha256 = Field(description="sha256 over the content of every file of the folder")
    recipe: Name
    parent: ShortId | None = None
    generation: int = Field(ge=0)
    path: str = Field(description="folder, relative to the store's root")
    episodes: tuple[ShortId, ...] = Field(description="in the order of episode_index")
    held_out: tuple[ShortId, ...] = Field(description="episodes of the validation split")
    weights: dict[str, float] = Field(description="share of each training batch by source")
    inputs: tuple[Sha256, ...] = Field(description="blobs that were read")
    code: Sha256 = Field(description="hash of the source files that transform the inputs")
    frames: int = Field(ge=0, description="0 where every episode was forgotten, and in a "
                                          "curriculum")
    erased: tuple[ShortId, ...] = Field(default=(), description="episodes that it held and that were forgotten since; "
                                                                "with any, it is incomplete and teaches nothing")
    edits: tuple[Edit, ...] = Field(default=(), description="what made it of its parent; empty where it was built from "
                                                            "recordings")
    starts: tuple[ShortId, ...] = Field(default=(), exclude_if=_no_starts, description="hard cases whose starts a "
                                        "curriculum of a legged robot holds, those for the gate included")
