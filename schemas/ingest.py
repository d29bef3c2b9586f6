"""IngestMap: how topics and fields of somebody else's log become the features of a dataset."""

from typing import Annotated, Literal, Self

from pydantic import ConfigDict, Discriminator, Field, Tag, field_validator, model_validator

from schemas.base import Frozen, Name

type Clock = Literal["log", "publish", "header"]
type Rule = Literal["hold", "nearest", "linear"]
type Unit = Literal["deg_to_rad", "rad_to_deg", "mm_to_m", "cm_to_m", "ms_to_s"]
type Value = bool | int | float | str
type FeatureName = Annotated[str, Field(pattern=r"^[a-z][a-z0-9_]*(\.[a-z0-9_]+)*$")]
type Path = Annotated[str, Field(pattern=r"^[A-Za-z_]\w*(\.[A-Za-z_]\w*)*(\[\d+(:\d+)?\])?$")]
"""A dotted path into a message, with the elements of an array: `position`, `pose.position.x`, `data[0:6]`."""

TAKEN = frozenset({"timestamp", "frame_index", "episode_index", "index", "task_index", "intervention", "task"})
"""Columns that every dataset version has already."""


class Declared(Frozen):
    """A value that a person writes down: NaN and infinity are no numbers here."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class Source(Declared):
    """Values of one topic, in the order of `fields`, and how they reach the frames' clock."""

    topic: str = Field(min_length=1, description="as the log spells it, with or without a leading slash")
    fields: tuple[Path, ...] = Field(min_length=1, description="number fields, side by side")
    joints: tuple[str, ...] = Field(
        default=(), description="take array elements by these names, in this order, whatever order a message has"
    )
    joints_field: Path = Field(default="name", description="where a message lists the names of its elements")
    names: tuple[str, ...] = Field(default=(), description="names of the values; default: joints, else the paths")
    clock: Clock | None = Field(default=None, description="default: the map's")
    resample: Rule = "hold"
    max_skew_s: float = Field(
        default=0.1, gt=0, description="farthest that a sample may lie from the frame that uses it [s]"
    )
    wrap: bool = Field(default=False, description="linear only: angles [rad], interpolated over the shorter arc")
    unit: Unit | None = Field(default=None, description="conversion by name, before scale and offset")
    scale: float | tuple[float, ...] = Field(default=1.0, description="factor: one, or one a value")
    offset: float | tuple[float, ...] = Field(default=0.0, description="added after the factor: one, or one a value")

    @model_validator(mode="after")
    def names_fit_what_is_taken(self) -> Self:
        """Joint names pick elements of whole arrays; no name is there twice; only linear interpolation wraps."""
        if self.joints and any("[" in path for path in self.fields):
            raise ValueError(f"joints with elements by index in {list(self.fields)}: select one way, not both")
        for path in self.fields:
            first, _, last = path.partition("[")[2].rstrip("]").partition(":")
            if last and int(last) <= int(first):
                raise ValueError(f"{path!r} takes no element")
        for field in ("joints", "names"):
            values: tuple[str, ...] = getattr(self, field)
            if twice := sorted({v for v in values if values.count(v) > 1}):
                raise ValueError(f"{field} has {twice[0]!r} twice")
        if self.joints and self.names and len(self.names) != len(self.joints) * len(self.fields):
            raise ValueError(f"{len(self.names)} names for {len(self.joints) * len(self.fields)} values")
        if self.wrap and self.resample != "linear":
            raise ValueError(f"wrap with resample {self.resample!r}: only linear interpolation wraps angles")
        return self


class Camera(Declared):
    """Images of one topic."""

    topic: str = Field(min_length=1)
    field: Path = Field(default="data", description="where a message holds the image's bytes")
    clock: Clock | None = Field(default=None, description="default: the map's")
    resample: Literal["hold", "nearest"] = "nearest"
    max_skew_s: float = Field(default=0.1, gt=0, description="farthest that an image may lie from its frame [s]")


class WholeFile(Declared):
    """The whole log is one episode."""

    by: Literal["file"] = "file"


class Marker(Declared):
    """A topic says where episodes begin and end; a value that repeats says nothing new."""

    by: Literal["marker"]
    topic: str = Field(min_length=1)
    field: Path = "data"
    start: tuple[Value, ...] = Field(min_length=1, description="values that begin an episode")
    stop: tuple[Value, ...] = Field(default=(), description="values that end it; none: the next start does")
    clock: Clock | None = Field(default=None, description="default: the map's")

    @model_validator(mode="after")
    def start_is_not_stop(self) -> Self:
        """No value begins and ends an episode."""
        if both := [v for v in self.start if v in self.stop]:
            raise ValueError(f"{both[0]!r} is in start and in stop")
        return self


class Gap(Declared):
    """Silence parts episodes."""

    by: Literal["gap"]
    longer_than_s: float = Field(gt=0, description="silence that ends an episode [s]")
    topic: str | None = Field(default=None, description="whose silence; default: that of all features together")


type Boundaries = Annotated[WholeFile | Marker | Gap, Field(discriminator="by")]


class SaidOutcome(Declared):
    """How every episode of these logs ended, said by whoever writes the map."""

    label: Literal["success", "failure", "unknown"]


class TopicOutcome(Declared):
    """How an episode ended, from the last value on a topic before the next episode begins."""

    topic: str = Field(min_length=1)
    field: Path = "data"
    success: tuple[Value, ...] = Field(min_length=1, description="values that mean success")
    failure: tuple[Value, ...] = Field(default=(), description="values that mean failure; any other: unknown")
    clock: Clock | None = Field(default=None, description="default: the map's")


def _outcome_kind(value: object) -> str:
    """A constant names a label, everything else is looked for on a topic; so that an error speaks of one of them."""
    keys = set(value) if isinstance(value, dict) else {*getattr(value, "model_fields_set", ())}  # pyright: ignore[reportUnknownArgumentType, reportUnknownVariableType]
    return "said" if "label" in keys or "topic" not in keys else "from_topic"


type AnyOutcome = Annotated[
    Annotated[SaidOutcome, Tag("said")] | Annotated[TopicOutcome, Tag("from_topic")], Discriminator(_outcome_kind)
]


class IngestMap(Declared):
    """One way to read logs of one robot: declared once, applied to any number of files, hashed into what it makes."""

    name: Name
    robot: Name
    task: str = Field(min_length=1, max_length=500, description="what the robot was asked to do, in words")
    fps: int = Field(gt=0, le=1000, description="frames a second [Hz]")
    clock: Clock = Field(default="log", description="log: recorder; publish: producer; header: stamp in the message")
    missing: Literal["cut", "refuse"] = Field(
        default="cut", description="a frame without an admissible sample: part the episode there, or refuse it"
    )
    min_frames: int = Field(default=2, ge=1, description="shorter episodes are left out, and counted")
    features: dict[FeatureName, tuple[Source, ...]] = Field(
        min_length=1, description="feature -> one source, or several side by side"
    )
    cameras: dict[Name, Camera] = Field(default={}, description="camera -> where its images are")
    episodes: Boundaries = WholeFile()
    outcome: AnyOutcome = SaidOutcome(label="unknown")
    consent: str | None = Field(default=None, description="id of the consent record of the person recorded")
    operator: Name | None = Field(default=None, description="pseudonym of who operated the robot")
    site: Name | None = Field(default=None, description="where it was recorded")

    @field_validator("features", mode="before")
    @classmethod
    def one_source_needs_no_list(cls, value: object) -> object:
        """A feature of a single topic may be written without the dash."""
        if not isinstance(value, dict):
            return value
        return {name: [source] if isinstance(source, dict) else source for name, source in value.items()}  # pyright: ignore[reportUnknownVariableType]

    @model_validator(mode="after")
    def consent_names_its_person(self) -> Self:
        """A consent is of somebody: the pseudonym stands in the map, and the record must have the same."""
        if self.consent is not None and self.operator is None:
            raise ValueError(f"consent {self.consent!r} without operator: name the pseudonym that the record has")
        return self

    @model_validator(mode="after")
    def silence_is_that_of_a_feature(self) -> Self:
        """Gaps are looked for where samples are taken."""
        if isinstance(self.episodes, Gap) and self.episodes.topic is not None:
            known = sorted({source.topic for sources in self.features.values() for source in sources})
            if self.episodes.topic not in known:
                raise ValueError(f"episodes.topic = {self.episodes.topic!r}: use the topic of a feature: "
                                 f"{', '.join(known)}")
        return self

    @model_validator(mode="after")
    def feature_names_are_free(self) -> Self:
        """No feature is called as a column that every version has, or as a skew."""
        for name, sources in self.features.items():
            if name in TAKEN or name.startswith(("skew.", "stats.")):
                raise ValueError(f"a feature cannot be called {name!r}: the name is taken")
            if not sources:
                raise ValueError(f"{name} has no source")
        return self
