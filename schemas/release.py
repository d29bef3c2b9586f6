"""Release: one movement of the champion pointer."""

from typing import Literal

from pydantic import Field

from schemas.base import Frozen, ShortId


def _none_lost(lost: object) -> bool:
    """Releases that lose nothing stay as they were."""
    return not lost


class Release(Frozen):
    """The champion from this number on; numbers only grow, also when rolling back."""

    number: int = Field(ge=1)
    policy: ShortId
    previous: ShortId | None
    verdict: ShortId | None
    kind: Literal["bootstrap", "promotion", "rollback"]
    onnx: str = Field(description="the released ONNX file, relative to the store's root")
    lost: tuple[ShortId, ...] = Field(default=(), exclude_if=_none_lost, description="regression scenes that an "
                                      "earlier release had fixed and this one hardly ever solves")
