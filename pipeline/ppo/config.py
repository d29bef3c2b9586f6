"""PpoConfig: every number of a training, and the tuned ones of each task."""

from types import MappingProxyType

from pydantic import Field

from pipeline.files import short_id
from pipeline.locomotion.curriculum import Curriculum
from pipeline.locomotion.tasks import LeggedTask
from schemas.base import Frozen, Sha256


class PpoConfig(Frozen):
    """Proximal policy optimization (Schulman et al. 2017, arXiv 1707.06347); names as that paper has them."""

    steps: int = Field(default=3_000_000, ge=1, description="environment steps of all attempts together")
    attempts: int = Field(default=128, ge=1, description="attempts side by side")
    ticks: int = Field(default=32, ge=2, description="ticks of each attempt in an iteration")
    batch: int = Field(default=1024, ge=2, description="samples of a gradient step")
    epochs: int = Field(default=5, ge=1, description="times that an iteration's samples are used")
    learning_rate: float = Field(default=1e-3, gt=0, description="of Adam at the start; falls evenly to `last_rate`")
    last_rate: float = Field(default=0.1, gt=0, le=1, description="learning rate at the end, as a share")
    gamma: float = Field(default=0.98, ge=0, lt=1, description="worth of the next tick's reward today")
    gae_lambda: float = Field(default=0.95, ge=0, le=1, description="of the generalized advantage estimate")
    clip: float = Field(default=0.2, gt=0, description="change of a probability beyond which nothing is gained")
    entropy: float = Field(default=0.0, ge=0, description="weight of the action's entropy")
    value: float = Field(default=0.5, ge=0, description="weight of the critic's loss")
    gradient: float = Field(default=0.5, gt=0, description="largest norm of a gradient")
    reward_scale: float = Field(default=0.02, gt=0, description="what rewards are multiplied by, so that returns are "
                                                               "near 1 and the critic does not drown the actor")
    hidden: tuple[int, ...] = Field(default=(64, 64), description="widths of the hidden layers of actor and critic")
    log_std: float = Field(default=-1.0, description="logarithm of the action's standard deviation at the start")
    torch_threads: int = Field(default=1, ge=1, le=2, description="threads of the networks; another number rounds "
                                                                 "otherwise, so it belongs to the config")

    @property
    def iteration(self) -> int:
        """Environment steps between two updates."""
        return self.attempts * self.ticks


PPO_CONFIGS: MappingProxyType[str, PpoConfig] = MappingProxyType(
    {"stand": PpoConfig(steps=2_000_000), "walk": PpoConfig()})
"""Task -> its tuned numbers; other tasks begin with those of a plain PpoConfig()."""


def _nothing(value: object) -> bool:
    """Orders that do not speak of it keep the ids that they had before they could."""
    return not value


class Order(Frozen):
    """One training: the same order gives the same weights."""

    body: str = Field(description="key of LEGGED, or a path")
    name: str = Field(description="of the task")
    task: LeggedTask
    stratum: str | None = Field(default=None, description="kind of start; the task's first where None")
    curriculum: Curriculum | None = Field(default=None, exclude_if=_nothing, description="kinds of start and hard "
                                          "starts, in place of one kind")
    vary: float = Field(default=0.0, ge=0, exclude_if=_nothing, description="how much robots differ, see "
                        "pipeline.locomotion.varied; 0: every one is the nominal one")
    goes_on: Sha256 | None = Field(default=None, exclude_if=_nothing, description="hash of the file of weights that it "
                                   "begins with, see pipeline.ppo.weights")
    ppo: PpoConfig = PpoConfig()
    seed: int = Field(default=0, ge=0)

    @property
    def id(self) -> str:
        """What the checkpoints of this training are known by."""
        return short_id(self.model_dump_json())
