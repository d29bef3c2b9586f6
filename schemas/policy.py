"""PolicyRecord: a trained policy and its proof of origin."""

from pydantic import Field

from schemas.base import Frozen, Name, Sha256, ShortId


class PolicyRecord(Frozen):
    """One trained policy; the id follows from dataset, config, seed and training code."""

    id: ShortId
    kind: Name = Field(description="key of POLICIES")
    dataset: ShortId
    seed: int = Field(ge=0)
    generation: int = Field(ge=0)
    steps: int = Field(gt=0)
    config: Sha256 = Field(description="hash of the training config")
    code: Sha256 = Field(description="hash of the training source files")
    checkpoint: str = Field(description="lerobot checkpoint folder, relative to the store's root")
    files: dict[str, Sha256] = Field(description="every file of the checkpoint folder, ONNX included")
    train_loss: tuple[tuple[int, float], ...] = Field(description="(step, smooth L1 on normalised actions)")
    held_out_loss: tuple[tuple[int, float], ...]
    onnx_error: float = Field(ge=0, description="largest |torch - ONNX| over the parity batch, action units")
    metrics: dict[str, float] = Field(default={})
