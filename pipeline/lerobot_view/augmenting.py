"""Pictures changed at random before a policy sees them: shifted, and in other light. Numpy alone."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import ConfigError

GREY = np.array([0.299, 0.587, 0.114], np.float32)
"""Weight of each channel in how bright a pixel is. Source: ITU-R BT.601, 2.5.1."""


@dataclass(frozen=True, slots=True)
class Augment:
    """Random shift and colour of pictures; a sample's pictures are all changed alike."""

    shift_px: int = 0
    """Farthest shift along each axis [px]; the edge is repeated. Source: Kostrikov et al. 2020, DrQ."""
    brightness: float = 0.0
    """Pixels times 1 - b to 1 + b."""
    contrast: float = 0.0
    """Distance to the picture's mean brightness times 1 - c to 1 + c."""
    saturation: float = 0.0
    """Distance to the pixel's own grey times 1 - s to 1 + s."""

    def __post_init__(self) -> None:
        for name in ("brightness", "contrast", "saturation"):
            if not 0 <= getattr(self, name) <= 1:
                raise ConfigError(f"{name} {getattr(self, name)}", where="Augment", mend="give 0 to 1")
        if self.shift_px < 0:
            raise ConfigError(f"shift_px {self.shift_px}", where="Augment", mend="give 0 or more pixels")

    def __call__(self, pictures: NDArray[np.uint8], rng: np.random.Generator, together: int = 1) -> NDArray[np.uint8]:
        """Changed copies.

        Args:
            pictures: RGB, shape (b, height, width, 3).
            rng: the only source of randomness; a picture's numbers do not depend on the other pictures.
            together: so many pictures after each other belong to one sample.
        """
        samples = len(pictures) // together
        shifts = rng.integers(-self.shift_px, self.shift_px + 1, (samples, 2)).repeat(together, axis=0)
        spread = np.array([self.brightness, self.contrast, self.saturation], np.float32)
        factors = 1 + spread * rng.uniform(-1, 1, (samples, 3)).astype(np.float32).repeat(together, axis=0)
        changed = np.empty_like(pictures)
        for k, picture in enumerate(pictures):
            changed[k] = _coloured(_shifted(picture, *shifts[k].tolist()), *factors[k].tolist())
        return changed


def _shifted(picture: NDArray[np.uint8], down: int, right: int) -> NDArray[np.uint8]:
    if not down and not right:
        return picture
    height, width = picture.shape[:2]
    rows, columns = (np.clip(np.arange(n) - by, 0, n - 1) for n, by in ((height, down), (width, right)))
    return picture[rows[:, None], columns]


def _coloured(picture: NDArray[np.uint8], brightness: float, contrast: float, saturation: float) -> NDArray[np.uint8]:
    if (brightness, contrast, saturation) == (1, 1, 1):
        return picture
    light = picture.astype(np.float32) * brightness
    grey = light @ GREY
    light = grey[..., None] + (light - grey[..., None]) * saturation
    middle = grey.mean()
    light = middle + (light - middle) * contrast
    return np.clip(np.rint(light), 0, 255).astype(np.uint8)
