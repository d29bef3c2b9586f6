"""Recipe: every number that decides how one loop runs, read from datasets/recipes/*.yaml."""

from typing import Literal, Self

from pydantic import Field, model_validator

from schemas.base import Frozen, Name, ShortId
from schemas.counterfactual import JudgeConfig


def _none_given(value: object) -> bool:
    """Nothing is the same as no word about it: the ids of recipes that do not speak of it stay as they were."""
    return not value


def _one_alone(riders: object) -> bool:
    """One rider is what there was before recipes could ask for more: their ids stay as they were."""
    return riders == 1


def _off(flag: object) -> bool:
    """A switch that is off says nothing, for the same reason."""
    return not flag


def _as_ever(rule: object) -> bool:
    """What every recipe did before it could be named."""
    return rule in ("in-turn", "trigger")


def _a_quarter(shrink: object) -> bool:
    """The default of a number that only one kind of policy reads says nothing, either."""
    return shrink == 4


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
    appearance: bool = Field(default=False, exclude_if=_off, description="cameras see each variant in light, on a "
                                                                          "table and from a place of its own")


class CameraConfig(Frozen):
    """What a dataset version keeps of one camera's pictures."""

    width: int | None = Field(default=None, ge=16, le=8192, multiple_of=2,
                              description="[px]; the camera's own, made even, where it is not given")
    height: int | None = Field(default=None, ge=16, le=8192, multiple_of=2, description="[px], as width")
    crop: tuple[int, int, int, int] | None = Field(
        default=None, description="left, top, width, height of what is kept of each picture, before it is scaled [px]")
    max_skew_s: float = Field(
        default=0.5, gt=0, description="how old a picture of a recording may be when a frame shows it [s]")
    rendered: bool = Field(default=False, exclude_if=_off, description="what was simulated without this camera is "
                                                                       "rendered from its replayed states")

    @model_validator(mode="after")
    def both_sizes_or_none(self) -> Self:
        """Width and height are given together, and a crop has a place and a size."""
        if (self.width is None) != (self.height is None):
            raise ValueError(f"width {self.width} and height {self.height}: give both or none")
        if self.crop is not None and (min(self.crop[:2]) < 0 or min(self.crop[2:]) < 1):
            raise ValueError(f"crop {self.crop}: left and top are 0 or more, width and height 1 or more")
        return self

    @model_validator(mode="after")
    def rendered_as_it_is_kept(self) -> Self:
        """What is rendered has a size, and nothing is cut off it."""
        if self.rendered and (self.width is None or self.crop is not None):
            raise ValueError(f"rendered with width {self.width} and crop {self.crop}: give a size, and no crop")
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


class PpoNumbers(Frozen):
    """Numbers of PPO that a recipe names; those it does not name stay as the task has them, see PPO_CONFIGS."""

    attempts: int | None = Field(default=None, ge=1, exclude_if=_none_given, description="attempts side by side")
    ticks: int | None = Field(default=None, ge=2, exclude_if=_none_given, description="ticks between two updates")
    epochs: int | None = Field(default=None, ge=1, exclude_if=_none_given,
                               description="times that the ticks between two updates are used")
    gamma: float | None = Field(default=None, gt=0, lt=1, exclude_if=_none_given,
                                description="worth of the next tick's reward today")
    last_rate: float | None = Field(default=None, gt=0, le=1, exclude_if=_none_given,
                                    description="learning rate at the end, as a share")
    entropy: float | None = Field(default=None, ge=0, exclude_if=_none_given, description="weight of the entropy")
    log_std: float | None = Field(default=None, exclude_if=_none_given, description="logarithm of the action's "
                                  "standard deviation at the start; a training that goes on keeps what it had")


class TrainConfig(Frozen):
    """Behaviour cloning, or PPO for robots that learn by trying; `chunk`, `width` and `depth` mean nothing to PPO."""

    policy: Name = "chunked"
    chunk: int = Field(default=8, ge=1, description="actions predicted at once")
    width: int = Field(default=256, ge=8)
    depth: int = Field(default=2, ge=1)
    shrink: Literal[1, 2, 4, 8] = Field(default=4, exclude_if=_a_quarter,
                                        description="act: how many times fewer channels than ResNet18 sees with")
    steps: int = Field(default=1500, ge=1)
    batch: int = Field(default=256, ge=1)
    learning_rate: float = Field(default=1e-3, gt=0)
    checkpoint_every: int = Field(default=500, ge=1, description="steps between resumable checkpoints")
    ppo: PpoNumbers | None = Field(default=None, exclude_if=_none_given, description="ppo: its other numbers; steps "
                                   "are then ticks of all attempts together")
    goes_on: ShortId | None = Field(default=None, exclude_if=_none_given, description="ppo: policy whose weights and "
                                    "normaliser it begins with; a loop names its champion here")


class NightlyConfig(Frozen):
    """A gate that may be asked every night: an error budget for a year, and scenes until the answer is sure."""

    false_promotions: float = Field(default=0.1, gt=0, lt=1, description="expected number a year, at most")
    nights: int = Field(default=365, ge=1, description="length of a budget year [d]")
    most_stake: float = Field(default=4.0, ge=1, description="largest stake of a night, in even parts of the budget")
    batch: int = Field(default=50, ge=1, description="scenes between two decisions")
    most_scenes: int = Field(default=3000, ge=1, description="scenes of a night at most")
    anchor_every: int = Field(default=10, ge=1, description="promotions until the champion meets the anchor again")
    anchor_share: float = Field(default=0.1, gt=0, lt=1, description="part of the budget for tests against the anchor")
    regression_seeds: int = Field(default=8, ge=1, description="times that each regression scene is played")
    regression_lost: int = Field(
        default=2, ge=0, description="a scene that the champion always solves is lost at so few successes, seen twice")

    @model_validator(mode="after")
    def batches_fill_the_night(self) -> Self:
        """The night is a whole number of batches, and a lost regression scene is one that is mostly failed."""
        if self.most_scenes % self.batch or self.regression_lost >= self.regression_seeds:
            raise ValueError(f"most_scenes {self.most_scenes} must be a multiple of batch {self.batch}, and "
                             f"regression_lost {self.regression_lost} below regression_seeds {self.regression_seeds}")
        return self


class GateConfig(Frozen):
    """The sequential paired test of a candidate."""

    looks: tuple[int, ...] = Field(default=(200, 400, 1000), description="scenes at each look, fixed beforehand")
    alpha: float = Field(default=0.05, gt=0, lt=0.5, description="error over all looks and strata together")
    margin: float = Field(default=0.05, gt=0, lt=1, description="largest loss that a stratum may hide")
    bootstrap_success: float = Field(default=0.5, ge=0, le=1, description="lower Wilson bound generation 0 must reach")
    rare_share: float = Field(default=0.5, gt=0, lt=1, description="share of gate scenes from harvested strata")
    seeds: int = Field(default=1, ge=1, exclude_if=_one_alone, description="trainings a candidate; one is chosen")
    selection: int | None = Field(default=None, ge=1, exclude_if=_none_given,
                                  description="scenes of their own that choose among them; 200 where not given")
    nightly: NightlyConfig | None = Field(default=None, exclude_if=_none_given,
                                          description="the gate for every night, in place of the looks")

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


class LastingConfig(Frozen):
    """A disagreement that lasts, as a trigger: no candidate in the champion's shadow means what the champion does."""

    apart: float = Field(default=0.05, gt=0, description="distance that every candidate which answers keeps [scales]")
    ticks: int = Field(default=15, ge=1, description="for so long [ticks]")


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
    disagreement: LastingConfig | None = Field(
        default=None, exclude_if=_none_given, description="a disagreement that lasts stops an attempt too")
    order: Literal["in-turn", "value", "random"] = Field(
        default="in-turn", exclude_if=_as_ever, description="which failures are corrected: in turn from every kind of "
        "start, by expected value (docs/mining.md), or any: the control")
    aim: Literal["trigger", "subtask"] = Field(
        default="trigger", exclude_if=_as_ever, description="where a correction begins: where the attempt was stopped, "
        "or where the subtask began in which it went wrong; what went wrong on the way to the mark is then multiplied "
        "near that mark, too")
    worth_seeds: int = Field(
        default=0, ge=0, exclude_if=_none_given, description="trainings with and without what a lap added, which "
        "judge it before a release: 8 decide; 0 asks for one after the last lap, which decides nothing")
    judge: JudgeConfig | None = Field(
        default=None, exclude_if=_none_given, description="correct where the policy in the champion's shadow or the "
        "champion was judged wrong, and nowhere else; where a trigger fired if not given")


class ExamConfig(Frozen):
    """The same twin starts in every generation, read by the report and by no decision."""

    common: int = Field(default=300, ge=1)
    rare: int = Field(default=100, ge=1)


class RlConfig(Frozen):
    """What a loop teaches a legged robot after generation 0: falls become starts."""

    lap_steps: int = Field(default=300_000, ge=1, description="ticks of all attempts together in a later lap; "
                                                              "train.steps are those of generation 0")
    lap_learning_rate: float = Field(default=5e-4, gt=0)
    vary: float = Field(default=1.0, ge=0, le=3, description="how much the robots of training and gate differ, see "
                        "pipeline/locomotion/varied.py; 0: all are the nominal one")
    hard_share: float = Field(default=0.5, ge=0, lt=1, description="of the attempts of a later lap, those that begin "
                                                                   "where a robot stood before it fell")
    before_s: float = Field(default=0.6, gt=0, le=10, description="how long before the fall that is [s]")
    kept: int = Field(default=400, ge=1, description="hard starts that teach, at most; the newest stay")
    recency: float = Field(default=1.0, gt=0, le=1, description="weight of a hard start beside one of the next lap")
    families: Literal["even", "as-met"] = Field(
        default="even", description="every family of falls begins as many attempts, or each as many as it has")
    spread: float = Field(default=0.0, ge=0, le=10, description="how far attempts are spread about a hard start: 1 is "
                          "0.03 rad of lean, 0.05 rad a joint, 0.1 m/s, 0.2 rad/s, as standard deviations")
    held_out: float = Field(default=0.25, ge=0, lt=1, description="share of the falls that only the gate plays")


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
    rl: RlConfig | None = Field(default=None, exclude_if=_none_given, description="of legged robots alone")
