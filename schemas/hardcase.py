"""HardCase: a failure worth learning from, whole and restorable."""

from schemas.base import Frozen, ShortId


class HardCase(Frozen):
    """A deployed attempt that a trigger stopped, and what became of it."""

    id: ShortId
    episode: ShortId
    trigger: str
    tick: int
    family: str
    stratum: str
    generation: int
    correction: ShortId | None = None
    corrected: bool = False
