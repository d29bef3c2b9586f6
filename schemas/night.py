"""Night: one asking of the nightly gate in the ledger of its run; the last one says what the budget holds."""

from pydantic import Field

from schemas.base import Frozen, ShortId


class Account(Frozen):
    """Money for false promotions: what a night found, staked and left."""

    before: float = Field(ge=0)
    stake: float = Field(default=0.0, ge=0, description="0 where nothing was tested")
    after: float = Field(ge=0)


class Night(Frozen):
    """What one night did with the error budget, and where the anchor stands."""

    run: ShortId
    generation: int = Field(ge=0, description="the lap that was judged: each is one night's candidate")
    day: int = Field(ge=0, description="number of the day, 1970-01-01 being 0 [d]")
    since: int = Field(ge=0, description="first day of the budget year [d]")
    candidates: Account = Field(description="for tonight's candidate against the champion")
    anchors: Account = Field(description="for every tenth champion against the anchor")
    verdict: ShortId
    promoted: bool
    anchor: ShortId | None = Field(description="the frozen policy from tomorrow on; None before the first release")
    promotions: int = Field(ge=0, description="since the anchor was frozen")
    anchor_verdict: ShortId | None = Field(default=None, description="of tonight's candidate against the anchor")
    roll_back_to: ShortId | None = Field(default=None, description="the anchor, where the candidate lost against it")
