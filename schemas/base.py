"""The one base of every schema, and the shapes of identifiers."""

from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field

type Sha256 = Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]
type ShortId = Annotated[str, Field(pattern=r"^[0-9a-f]{16}$")]
type Name = Annotated[str, Field(pattern=r"^[a-z0-9][a-z0-9_-]{0,63}$")]


class Frozen(BaseModel):
    """A value: it never changes, and a field that it does not know is an error."""

    model_config = ConfigDict(frozen=True, extra="forbid")
