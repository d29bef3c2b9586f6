"""BatchWorth: what a batch of episodes is worth, with every number needed to check it by hand."""

from typing import Literal, Self

from pydantic import Field, model_validator

from schemas.base import Frozen, ShortId

LEAST_SEEDS = 8
"""Training seeds on each side below which nothing is decided."""


class WorthPart(Frozen):
    """With the batch against without it on some of the scenes; differences are with minus without."""

    name: str = Field(description="'all', a kind of start, or a failure family")
    scenes: int = Field(gt=0)
    with_batch: tuple[int, ...] = Field(description="scenes solved by each seed; of a family: failed in this way")
    without: tuple[int, ...]
    difference: float = Field(ge=-1, le=1, description="in shares of scenes")
    low: float | None = Field(default=None, description="95 % interval over new seeds and scenes; None with one seed")
    high: float | None = None
    p: float | None = Field(default=None, description="two-sided, not yet corrected")
    p_holm: float | None = Field(default=None, description="corrected over the parts of its kind")


class BatchWorth(Frozen):
    """The verdict on one batch: policies retrained with and without it, on the same scenes."""

    id: ShortId = Field(description="follows from version, batch, seeds, scenes and code")
    version: ShortId = Field(description="the version that holds the batch")
    batch: ShortId = Field(description="follows from the episodes")
    says: str = Field(description="what the batch is, in words")
    episodes: tuple[ShortId, ...] = Field(min_length=1)
    decision: Literal["HELPS", "HURTS", "INCONCLUSIVE"]
    reason: str
    seeds_with: tuple[int, ...] = Field(min_length=1, description="training seeds; no seed trains on both sides")
    seeds_without: tuple[int, ...] = Field(min_length=1)
    parts: tuple[WorthPart, ...] = Field(min_length=1, description="'all' first, then every kind of start")
    families: tuple[WorthPart, ...] = Field(default=(), description="failure families; they decide nothing")
    more_seeds: int | None = Field(default=None, description="further seeds a side that would decide; "
                                                             "INCONCLUSIVE only")

    @property
    def hurts(self) -> bool:
        """Whether the batch is kept out of later versions."""
        return self.decision == "HURTS"

    @model_validator(mode="after")
    def few_seeds_decide_nothing(self) -> Self:
        """With fewer than 8 seeds on a side the decision is INCONCLUSIVE."""
        if self.decision != "INCONCLUSIVE" and min(len(self.seeds_with), len(self.seeds_without)) < LEAST_SEEDS:
            raise ValueError(f"{self.decision} by {len(self.seeds_with)} and {len(self.seeds_without)} seeds: fewer "
                             f"than {LEAST_SEEDS} on a side decide nothing")
        return self
