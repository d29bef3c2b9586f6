"""Edits: the few things that may be done to a dataset version to derive another from it."""

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from schemas.base import Frozen, ShortId
from schemas.redaction import RedactionMap, told

type Label = Literal["success", "failure", "unknown"]


class Drop(Frozen):
    """These episodes leave."""

    kind: Literal["drop"] = "drop"
    episodes: tuple[ShortId, ...] = Field(min_length=1)
    reason: str = Field(default="", description="the query that chose them; empty where they were named")


class Add(Frozen):
    """These episodes of another version come in, after all that are there."""

    kind: Literal["add"] = "add"
    version: ShortId
    episodes: tuple[ShortId, ...] = Field(min_length=1)
    share: float | None = Field(
        default=None, gt=0, lt=1, description="of every training batch; None: their groups join those of the same name")


class Reweight(Frozen):
    """These episodes are drawn `factor` times as often, beside those that are not named."""

    kind: Literal["reweight"] = "reweight"
    episodes: tuple[ShortId, ...] = Field(min_length=1)
    factor: float = Field(gt=0, le=1000)
    reason: str = ""


class Trim(Frozen):
    """Of an episode only the frames [start, stop) stay, counted as they are in the parent."""

    kind: Literal["trim"] = "trim"
    episode: ShortId
    start: int = Field(ge=0)
    stop: int = Field(gt=0)

    @model_validator(mode="after")
    def something_stays(self) -> Self:
        """At least one frame stays."""
        if self.stop <= self.start:
            raise ValueError(f"frames {self.start} to {self.stop} hold none")
        return self


class Relabel(Frozen):
    """An episode ended otherwise than was recorded; a person says so."""

    kind: Literal["relabel"] = "relabel"
    episode: ShortId
    outcome: Label


class Redact(Frozen):
    """What a map names is hidden, in all that is there after the edits before; nothing comes after it."""

    kind: Literal["redact"] = "redact"
    map: RedactionMap


type Edit = Annotated[Drop | Add | Reweight | Trim | Relabel | Redact, Field(discriminator="kind")]
"""One edit; a version is derived by several, one after the other."""


def line(edit: Edit) -> str:
    """An edit in one line, for people."""
    match edit:
        case Drop():
            return f"dropped {_named(edit.episodes)}{edit.reason and ': ' + edit.reason}"
        case Add():
            share = "" if edit.share is None else f", {edit.share:g} of every batch"
            return f"added {_named(edit.episodes)} of version {edit.version}{share}"
        case Reweight():
            return f"weighed {_named(edit.episodes)} {edit.factor:g} times{edit.reason and ': ' + edit.reason}"
        case Trim():
            return f"trimmed {edit.episode} to frames {edit.start} to {edit.stop}"
        case Relabel():
            return f"relabelled {edit.episode} as {edit.outcome}"
        case Redact():
            return f"redacted: {told(edit.map)}"


def _named(episodes: tuple[str, ...]) -> str:
    return f"episode {episodes[0]}" if len(episodes) == 1 else f"{len(episodes)} episodes"
