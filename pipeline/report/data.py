"""ReportData: everything the report shows, gathered by whoever asks for it."""

import base64
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from schemas.dataset import DatasetVersion
from schemas.hardcase import HardCase
from schemas.mining import Family
from schemas.policy import PolicyRecord
from schemas.recipe import Recipe
from schemas.summary import Lap, LoopResult
from schemas.verdict import Verdict

if TYPE_CHECKING:
    from pipeline.report.learned import Learned

SIGNATURES = ((b"\x89PNG\r\n\x1a\n", "image/png"), (b"\xff\xd8\xff", "image/jpeg"), (b"RIFF", "image/webp"))
"""First bytes of the picture formats that every browser shows."""


@dataclass(frozen=True, slots=True)
class FilmStrip:
    """Frames of one attempt side by side, first at the left."""

    image: bytes
    """PNG, JPEG or WebP; other bytes are left out of the report."""
    labels: tuple[str, ...]
    """What to write under each frame, left to right: its time, or what happened there."""

    @property
    def source(self) -> str | None:
        """The picture as a data: address; None where the bytes are no picture."""
        for signature, kind in SIGNATURES:
            if self.image.startswith(signature):
                return f"data:{kind};base64,{base64.b64encode(self.image).decode()}"
        return None


@dataclass(frozen=True, slots=True)
class ShownCase:
    """A hard case with its pictures, where they could be rendered."""

    case: HardCase
    strip: FilmStrip | None = None


@dataclass(frozen=True, slots=True)
class ReportData:
    """One loop, whole; everything but recipe, command and result may be missing."""

    recipe: Recipe
    command: str
    """The exact command line that ran the loop."""
    result: LoopResult
    laps: tuple[Lap, ...] = ()
    policies: tuple[PolicyRecord, ...] = ()
    """Every candidate, released or not."""
    verdicts: tuple[Verdict, ...] = ()
    versions: tuple[DatasetVersion, ...] = ()
    hard_cases: tuple[ShownCase, ...] = ()
    families: tuple[Family, ...] = ()
    """Failure families that were found among them."""
    episodes_by_source: Mapping[str, Mapping[str, int]] = field(default_factory=dict[str, Mapping[str, int]])
    """Dataset version id -> origin -> episodes."""
    learned: "tuple[Learned, ...]" = ()
    """Trainings by reinforcement, of the laps in their order; policies that learnt from demonstrations have losses."""
    software: Mapping[str, str] = field(default_factory=dict[str, str])
    """Package -> version."""
    store: Mapping[str, int] = field(default_factory=dict[str, int])
    """What the store holds -> how many."""
    notes: tuple[str, ...] = ()
    """What a reader must know, such as why there are no film strips."""
