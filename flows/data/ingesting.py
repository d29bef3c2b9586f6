"""hardcase ingest, log by log: bring them into the store, convert what is new, note the episodes."""

import threading
from collections.abc import Callable, Generator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from shutil import rmtree
from tempfile import mkdtemp

from pipeline.errors import RecordingError
from pipeline.logs.child import Children
from pipeline.logs.convert import CAMERA, FRAMES, PROGRESS, PROGRESS_S
from pipeline.logs.identity import camera_hashes, code_hash, conversion_id
from pipeline.recording.quarantine import QUARANTINE, note_refused
from pipeline.store import Store
from schemas.conversion import CameraFile, Conversion, RawLog
from schemas.episode import Episode
from schemas.ingest import IngestMap
from stages.ingest import episodes_of, ingest, lasts

MAGIC = b"\x89MCAP0\r\n"
BEGIN = "name MCAP recordings; rosbag2 folders of another kind are converted first: ros2 bag convert"

type Watch = Callable[[int, int], None]
"""Told from another thread how many bytes of how many were read of the log that is converted now."""


@dataclass(frozen=True, slots=True)
class Taken:
    """What became of one log."""

    path: Path
    conversion: Conversion
    episodes: tuple[Episode, ...] = ()
    kept: bool = False
    """It was converted so before; nothing was done again."""


class Ingest:
    """One run of the command over any number of logs; use it in a `with`.

    Args:
        store: where everything goes; a loop may run on it meanwhile.
        declared: how the logs are read, and what is said about them.
        accept_truncated: keep what comes before the first damage or missing byte of a log.
    """

    def __init__(self, store: Store, declared: IngestMap, *, accept_truncated: bool = False) -> None:
        self._store, self._declared, self._accept = store, declared, accept_truncated
        self._children = Children()

    def __enter__(self) -> "Ingest":
        return self

    def __exit__(self, *_: object) -> None:
        self._children.close()

    def take(self, path: Path, watch: Watch | None = None) -> Taken:
        """Store a log untouched, convert it unless that was done before, and note its episodes.

        Raises:
            RecordingError: it is no MCAP file; nothing is stored.
            StoreError: the disk is full, or the store refuses.
        """
        refuse_other_files(path)
        sha = self._store.put_blob(path)
        self._store.add_raw_log(RawLog(id=sha, size_bytes=path.stat().st_size, source=str(path)))
        known = self._store.conversion(conversion_id(sha, self._declared, accept_truncated=self._accept))
        made = known or self._convert(sha, watch)
        if made.state == "quarantined" and known is None:
            note_refused(path, RecordingError(made.reason, where=path, mend=made.mend), self._store.root / QUARANTINE)
        if FRAMES not in made.files:
            return Taken(path, made, kept=known is not None)
        ingestion, episodes = episodes_of(made, self._declared)
        self._store.add_ingestion(ingestion, episodes)
        return Taken(path, made, tuple(episodes), kept=known is not None)

    def _convert(self, sha: str, watch: Watch | None) -> Conversion:
        """Convert the stored bytes, which are those that were hashed, whatever happens to the file meanwhile."""
        folder, log = Path(mkdtemp(dir=self._store.tmp, prefix="ingest-")), self._store.blob(sha)
        try:
            known, kept = self._known_cameras(sha)
            with _watched(folder / PROGRESS, log.stat().st_size, watch):
                made = ingest(log, self._declared, sha=sha, folder=folder, children=self._children,
                              accept_truncated=self._accept, known=known)
            if made.state == "converted":
                names = [FRAMES, *(CAMERA + name for name in self._declared.cameras)]
                there = [name for name in names if (folder / name).is_file()]
                shas = self._store.put_blobs([folder / name for name in there], move=True)
                made = made.model_copy(update={"files": dict(zip(there, shas, strict=True)) | kept})
            if lasts(made):
                self._store.add_conversion(made)
            return made
        finally:
            rmtree(folder, ignore_errors=True)


    def _known_cameras(self, sha: str) -> tuple[dict[str, tuple[Path, CameraFile]], dict[str, str]]:
        """Images that were taken of this log already, by the same code: camera -> file, and file name -> blob."""
        wanted = camera_hashes(self._declared, accept_truncated=self._accept)
        known: dict[str, tuple[Path, CameraFile]] = {}
        blobs: dict[str, str] = {}
        for made in self._store.conversions(sha):
            if made.result is None or made.code != code_hash():
                continue
            for name, before in made.made_from.items():
                for file in [f for f, hash in wanted.items() if hash == before and name in made.files]:
                    blobs[file] = made.files[name]
                    known[file.removeprefix(CAMERA)] = (self._store.blob(blobs[file]),
                                                        made.result.cameras[name.removeprefix(CAMERA)])
        return known, blobs


def refuse_other_files(path: Path) -> None:
    """Raise RecordingError for what is no MCAP file, before a byte of it is stored."""
    try:
        with path.open("rb") as stream:
            head = stream.read(len(MAGIC))
    except OSError as error:
        raise RecordingError(f"cannot be read: {error.strerror}", where=path, mend=BEGIN) from error
    if head != MAGIC:
        raise RecordingError("not an MCAP file (bad magic at byte 0)", where=path, mend=BEGIN)


@contextmanager
def _watched(file: Path, size: int, watch: Watch | None) -> Generator[None]:
    """Tell `watch` what the child writes about its progress while the body runs."""
    if watch is None:
        yield
        return
    over, tell = threading.Event(), watch

    def look() -> None:
        while not over.wait(PROGRESS_S):
            with suppress(OSError, ValueError):
                tell(int(file.read_text(encoding="ascii")), size)

    thread = threading.Thread(target=look, daemon=True)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join()
