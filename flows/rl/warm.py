"""Where a training begins that goes on from another: weights out of a clone, a training, or a file of them."""

from pathlib import Path

from pipeline.errors import PolicyError
from pipeline.files import sha256_file

WEIGHTS = "weights.safetensors"
"""What a clone leaves in its folder, and what is taken out of the last checkpoint of a training."""


def weights_of(source: Path) -> tuple[Path, str]:
    """The file of weights that is meant, and its hash; of a training without one it is written now.

    Args:
        source: a folder of `hardcase rl clone` or `hardcase rl train`, or a file of weights.

    Raises:
        PolicyError: there are no weights.
    """
    from pipeline.policies.resuming import newest

    if source.is_dir() and (checkpoint := newest(source)) is not None:
        return _out_of(checkpoint)
    file = source / WEIGHTS if source.is_dir() else source
    if not file.is_file() or file.suffix != ".safetensors":
        raise PolicyError("no weights to go on from", where=source,
                          mend="name a folder that hardcase rl clone or hardcase rl train has left")
    return file, sha256_file(file)


def _out_of(checkpoint: Path) -> tuple[Path, str]:
    """Weights and normaliser of a checkpoint as a file beside it; the same checkpoint gives the same bytes."""
    from pipeline.ppo.checkpoint import load
    from pipeline.ppo.normaliser import Normaliser
    from pipeline.ppo.weights import write_weights

    saved = load(checkpoint)
    try:
        normaliser = Normaliser(len(saved.arrays["normaliser"]["mean"]))
        normaliser.load(saved.arrays["normaliser"])
        weights = saved.arrays["weights"]
    except (KeyError, TypeError) as error:
        raise PolicyError(f"checkpoint without {error}", where=checkpoint,
                          mend="name a folder that hardcase rl train has left") from error
    path = checkpoint.with_name(WEIGHTS)
    return path, write_weights(path, weights, normaliser)
