"""Train: a dataset version becomes a policy: lerobot checkpoint, ONNX file, and the record of both."""

import shutil
from pathlib import Path
from typing import TYPE_CHECKING

import pipeline
from pipeline.errors import PolicyError
from pipeline.files import atomic, sha256, sha256_file, short_id, source_hash, sync_folder
from pipeline.policies.resuming import newest
from pipeline.policies.table import Progress, policy_kind
from schemas.dataset import DatasetVersion
from schemas.policy import PolicyRecord
from schemas.recipe import TrainConfig

if TYPE_CHECKING:
    from pipeline.policies.act_training import FittedAct
    from pipeline.policies.training import Fitted

FOLDER = "policies"
"""Where policies lie, relative to the store's root."""

ONNX = "policy.onnx"
"""Name of the released form inside a checkpoint folder."""

RECORD = "hardcase.json"
"""Name of the policy's record inside its folder; the one file that it does not name itself."""


def train(version: DatasetVersion, data: object, config: TrainConfig, *, seed: int, store: Path,
          progress: Progress | None = None) -> PolicyRecord:
    """Train the policy that config and seed ask for, or return it if it is already there.

    The id follows from version, config, seed and code. A training that was killed goes on from its last
    whole checkpoint and ends in the same bits; a folder store/policies/ID is whole or absent.

    Args:
        version: what is learnt from.
        data: its frames in memory, as the kind of policy loads them: policy_kind(config.policy).load.
        config: kind and size of the policy, steps, learning rate.
        seed: decides weights and batches.
        store: root of the store.
        progress: called as (steps done, steps in all, last training loss).

    Raises:
        ConfigError: there is no such kind of policy; lists those there are.
        PolicyError: training diverges, the export differs, or the finished policy was changed since.
    """
    kind = policy_kind(config.policy)
    code = code_hash(config)
    policy = short_id("policy", version.id, config.model_dump_json(), seed, code)
    target = store / FOLDER / policy
    if target.exists():
        return load_policy(target)
    work, part = (store / FOLDER / f".{policy}.{name}" for name in ("training", "part"))
    fitted = kind.fit(data, config, seed, resume_from=newest(work), checkpoints=work, progress=progress)
    shutil.rmtree(part, ignore_errors=True)
    kind.write(part, fitted, config)
    error = kind.export(fitted, part / ONNX)
    record = PolicyRecord(
        id=policy, kind=config.policy, dataset=version.id, seed=seed, generation=version.generation,
        steps=config.steps, config=sha256(config.model_dump_json().encode()), code=code,
        checkpoint=f"{FOLDER}/{policy}", files=_hashes(part), train_loss=fitted.train_loss,
        held_out_loss=fitted.held_out_loss, onnx_error=error, metrics=_metrics(fitted),
    )
    with atomic(part / RECORD) as stream:
        stream.write(record.model_dump_json(indent=2).encode())
    part.rename(target)
    sync_folder(target.parent)
    shutil.rmtree(work, ignore_errors=True)
    return record


def load_policy(folder: Path) -> PolicyRecord:
    """The record of a finished policy, after its files were compared with it.

    Raises:
        PolicyError: a file is missing, changed or too many, or the record is gone.
    """
    mend = f"remove it and train again, the same seed gives the same policy: rm -r {folder} && hardcase train"
    try:
        record = PolicyRecord.model_validate_json((folder / RECORD).read_bytes())
    except (OSError, ValueError) as error:
        raise PolicyError("the policy's record is missing or damaged", where=folder / RECORD, mend=mend) from error
    held = _hashes(folder)
    if changed := sorted(name for name, _ in held.items() ^ record.files.items()):
        raise PolicyError(f"policy {record.id}: {changed[0]} is not what was trained", where=folder, mend=mend)
    return record


def code_hash(config: TrainConfig) -> str:
    """Hash of every source file that decides what is learnt from a version."""
    root = Path(pipeline.__path__[0])
    return source_hash([Path(__file__), *(root / name for name in policy_kind(config.policy).sources)])


def _hashes(folder: Path) -> dict[str, str]:
    return {path.name: sha256_file(path) for path in sorted(folder.iterdir()) if path.name != RECORD}


def _metrics(fitted: "Fitted | FittedAct") -> dict[str, float]:
    losses = {"train_loss": fitted.train_loss, "held_out_loss": fitted.held_out_loss}
    return {name: curve[-1][1] for name, curve in losses.items() if curve} | {
        "parameters": float(sum(weights.size for weights in fitted.weights.values()))}
