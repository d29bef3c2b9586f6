"""DatasetVersion: an immutable LeRobot v3 folder and everything that made it."""

from pydantic import Field

from schemas.base import Frozen, Name, Sha256, ShortId


class DatasetVersion(Frozen):
    """One version; the id follows from recipe, inputs and code, the digest from the bytes."""

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
    frames: int = Field(gt=0)
