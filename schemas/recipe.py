"""Recipe: every number that decides how one loop runs, read from datasets/recipes/*.yaml."""

from typing import Literal, Self

from pydantic import Field, model_validator

from schemas.base import Frozen, Name


def _none_given(cameras: object) -> bool:
    """No camera is the same as no word about cameras: the ids of recipes without any stay as they were."""
    return not cameras


def _one_alone(riders: object) -> bool:
    """One rider is what there was before recipes could ask for more: their ids stay as they were."""
    return riders == 1


class CollectConfig(Frozen):
    """Scripted demonstrations of generation 0."""

    demonstrations: int = Field(default=50, ge=1)
    max_ticks: int = Field(default=150, ge=20, description="length limit of an attempt [ticks]")


class AugmentConfig(Frozen):
    """How demonstrations and corrections are multiplied."""

    replays: int = Field(default=150, ge=0, description="variants by replayed commands, at generation 0")
    retargets: int = Field(default=250, ge=0, description="variants by object-centric retargeting, at generation 0")
    per_correction: int = Field(
        default=30, ge=0, description="variants near the start of every new episode that succeeded, in later laps")
    widen: float = Field(default=1.0, gt=0, le=5, description="factor on every range; above 1 the filter has work")
    keep_rejected: bool = Field(default=False, description="control arm: failed variants are left in")


class CameraConfig(Frozen):
    """What a dataset version keeps of one camera's pictures."""

    width: int | None = Field(default=None, ge=16, le=8192, multiple_of=2,
                              description="[px]; the camera's own, made even, where it is not given")
    height: int | None = Field(default=None, ge=16, le=8192, multiple_of=2, description="[px], as width")
    crop: tuple[int, int, int, int] | None = Field(
        default=None, description="left, top, width, height of what is kept of each picture, before it is scaled [px]")
    max_skew_s: float = Field(
        default=0.5, gt=0, description="how old a picture of a recording may be when a frame shows it [s]")

    @model_validator(mode="after")
    def both_sizes_or_none(self) -> Self:
        """Width and height are given together, and a crop has a place and a size."""
        if (self.width is None) != (self.height is None):
            raise ValueError(f"width {self.width} and height {self.height}: give both or none")
        if self.crop is not None and (min(self.crop[:2]) < 0 or min(self.crop[2:]) < 1):
            raise ValueError(f"crop {self.crop}: left and top are 0 or more, width and height 1 or more")
        return self


class DatasetConfig(Frozen):
    """Sources, filter, weights and split of a dataset version."""

    sources: tuple[str, ...] = ("scripted", "replayed", "retargeted", "corrected")
    weights: dict[str, float] = Field(
        default={"base": 0.8, "corrections": 0.2},
        description="share of each training batch; renormalised over what exists; variants are base",
    )
    held_out: float = Field(default=0.1, ge=0, lt=0.5, description="share of lineages in the validation split")
    only_success: bool = True
    cameras: dict[Name, CameraConfig] = Field(
        default={}, exclude_if=_none_given, description="cameras whose pictures are kept as videos, by name")

    @model_validator(mode="after")
    def weights_are_shares(self) -> Self:
        """Weights are positive and there is at least one."""
        if not self.weights or any(w <= 0 for w in self.weights.values()):
            raise ValueError(f"weights {self.weights}: every weight must be above 0")
        return self


class TrainConfig(Frozen):
    """Behaviour cloning."""

    policy: Name = "chunked"
    chunk: int = Field(default=8, ge=1, description="actions predicted at once")
    width: int = Field(default=256, ge=8)
    depth: int = Field(default=2, ge=1)
    steps: int = Field(default=1500, ge=1)
    batch: int = Field(default=256, ge=1)
    learning_rate: float = Field(default=1e-3, gt=0)
    checkpoint_every: int = Field(default=500, ge=1, description="steps between resumable checkpoints")


class GateConfig(Frozen):
    """The sequential paired test of a candidate."""

    looks: tuple[int, ...] = Field(default=(200, 400, 1000), description="scenes at each look, fixed beforehand")
    alpha: float = Field(default=0.05, gt=0, lt=0.5, description="error over all looks and strata together")
    margin: float = Field(default=0.05, gt=0, lt=1, description="largest loss that a stratum may hide")
    bootstrap_success: float = Field(default=0.5, ge=0, le=1, description="lower Wilson bound generation 0 must reach")
    rare_share: float = Field(default=0.5, gt=0, lt=1, description="share of gate scenes from harvested strata")

    @model_validator(mode="after")
    def looks_rise(self) -> Self:
        """The scene counts of the looks rise."""
        if not self.looks or list(self.looks) != sorted(set(self.looks)):
            raise ValueError(f"looks {self.looks} must rise")
        return self


class DeployConfig(Frozen):
    """Robot time on the twin."""

    episodes: int = Field(default=150, ge=1)
    rare_share: float = Field(default=0.12, ge=0, le=1)
    shadow: bool = True
    riders: int = Field(default=1, ge=1, le=16, exclude_if=_one_alone,
                        description="how many candidates ride in the champion's shadow, the newest first")


class HarvestConfig(Frozen):
    """Triggers and corrections."""

    corrections: int = Field(default=12, ge=0, description="a generation")
    stall_ticks: int = Field(default=30, ge=1)
    stall_progress_m: float = Field(default=0.004, gt=0)
    closed_gap_m: float = Field(default=0.012, gt=0, description="finger opening below which nothing is held [m]")
    closed_ticks: int = Field(default=8, ge=1)
    operator_delay_ticks: int = Field(default=4, ge=0)
    operator_aim_sd_m: float = Field(default=0.004, ge=0)
    operator_gross_error: float = Field(default=0.1, ge=0, le=1)
    oracle: bool = Field(
        default=False, description="rewind and correct from true state: a labelled arm, never the default"
    )
    rewind_ticks: int = Field(default=10, ge=0, description="oracle arm only")


class ExamConfig(Frozen):
    """The same twin starts in every generation, read by the report and by no decision."""

    common: int = Field(default=300, ge=1)
    rare: int = Field(default=100, ge=1)


class Recipe(Frozen):
    """One loop, whole."""

    name: Name
    robot: Name = "arm"
    scene: Name = "table"
    task: Name = "pick-place"
    generations: int = Field(default=3, ge=0, description="after generation 0")
    engine: Literal["local"] = "local"
    threads: int = Field(default=2, ge=1)
    collect: CollectConfig = CollectConfig()
    augment: AugmentConfig = AugmentConfig()
    dataset: DatasetConfig = DatasetConfig()
    train: TrainConfig = TrainConfig()
    gate: GateConfig = GateConfig()
    deploy: DeployConfig = DeployConfig()
    harvest: HarvestConfig = HarvestConfig()
    exam: ExamConfig = ExamConfig()
