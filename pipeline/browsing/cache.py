"""Recordings for browsing, made once: files in the store's folder `browse`, which anybody may delete at any time."""

import os
import secrets
from collections.abc import Generator
from contextlib import contextmanager, suppress
from importlib.metadata import version
from pathlib import Path

from pipeline.files import short_id, source_hash
from schemas.episode import Episode

FOLDER = "browse"
"""Below the store's root; gc lists it, and whoever forgets an episode deletes it whole."""


class Cache:
    """Where recordings for browsing are kept.

    Args:
        root: the store's.
    """

    def __init__(self, root: Path) -> None:
        self.folder = root / FOLDER
        self._code = short_id(source_hash(Path(__file__).parent.glob("*.py")), version("rerun-sdk"))

    def place(self, episode: Episode, layer: str, *of: object, suffix: str = ".rrd") -> Path:
        """Where a layer of an episode lies; another recording, record or code gives another place.

        Args:
            episode: its record, with the hash of its recording.
            layer: as 'base'.
            of: whatever else decides the bytes, as the id of a policy.
            suffix: of the file.
        """
        key = short_id(layer, episode.model_dump_json(), self._code, *of)
        return self.folder / f"{episode.id}.{layer}.{key}{suffix}"

    def has(self, *paths: Path) -> bool:
        """Whether all are there; they count as used now, so that gc leaves them to whoever looks at them."""
        try:
            for path in paths:
                os.utime(path)
        except FileNotFoundError:
            return False
        return True

    @contextmanager
    def making(self, path: Path) -> Generator[Path]:
        """A place to write to that becomes `path` when the body ends well, and is gone when it does not."""
        self.folder.mkdir(exist_ok=True)
        part = path.with_name(f".{path.name}.{secrets.token_hex(4)}")
        try:
            yield part
            part.replace(path)
        finally:
            with suppress(FileNotFoundError):
                part.unlink()
