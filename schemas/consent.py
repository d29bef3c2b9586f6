"""Consent: what a person allowed to be done with the recordings of them, and for how long."""

from datetime import date
from typing import Literal, Self

from pydantic import AwareDatetime, Field, field_validator, model_validator

from schemas.base import Frozen, Name

type Purpose = Literal["training", "evaluation", "review"]

SIMULATED, NO_CONSENT = "simulated", "none"
"""Stand in place of a consent's id: no person was recorded; a person was, and gave none. No record has these ids."""


class Consent(Frozen):
    """One person's consent; it names the person by a pseudonym only."""

    id: Name = Field(description="number of the form, or a hash of what it says")
    operator: Name = Field(description="pseudonym; who that is stands nowhere in the store")
    site: Name = Field(description="where the recordings are made")
    purposes: tuple[Purpose, ...] = Field(min_length=1, description="what the recordings may be used for")
    given: date = Field(description="first day on which it holds [UTC]")
    expires: date = Field(description="last day on which it holds [UTC]")
    revoked: AwareDatetime | None = Field(default=None, description="when it was taken back; None while it stands")

    @field_validator("id")
    @classmethod
    def a_record_has_an_id_of_its_own(cls, id: str) -> str:
        """The words that stand for no record are no record's id."""
        if id in (SIMULATED, NO_CONSENT):
            raise ValueError(f"{id!r} marks episodes without a consent record; choose another id")
        return id

    @model_validator(mode="after")
    def it_ends_after_it_begins(self) -> Self:
        """The last day is not before the first."""
        if self.expires < self.given:
            raise ValueError(f"expires {self.expires} is before given {self.given}")
        return self
