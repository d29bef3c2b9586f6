"""An MCAP recording, ours or anybody's, as the signals that checks read: one path through pipeline.logs."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from hashlib import blake2b
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError

from pipeline.check.own_time import in_own_time
from pipeline.check.pictures import Grey, compressed, raw_picture
from pipeline.check.signals import THUMB, Camera, Column, Signals, Subject, Topic
from pipeline.errors import RecordingError
from pipeline.files import sha256_file
from pipeline.logs.decode import Decoder, Fields, decoder
from pipeline.logs.stream import Batch, Channel, LogReader, open_log
from schemas.episode import Episode

MAX_WIDTH = 64
"""Numbers a message above which a field is no signal but a cloud, a map or a state: it is left out."""
UNSEEN = ("/sim/", "/tf", "/reward/", "/policy/", "/signal/", "/joint_commands/asked")
"""Topics whose numbers no robot senses or is sent, or no dataset takes; their stamps are checked all the same."""


def read_recording(path: Path, *, name: str | None = None) -> Subject:
    """Everything of one MCAP file that checks look at.

    A file that ends early or whose summary lies is read as far as it goes, and what is wrong becomes a finding.

    Args:
        path: the file.
        name: what it is called in findings; the file's name by default.

    Raises:
        RecordingError: not an MCAP file, hostile, or damaged before the first whole message.
    """
    called = name or path.name
    with open_log(path, accept_truncated=True) as log:
        topics, pictures = _gather(log)
        faults = _faults(log)
        metadata = dict(log.metadata())
        attachments = _attachments(log, faults)
    signals = Signals(
        called, {t.name: t.topic() for t in topics.values()}, {n: p.camera(n) for n, p in pictures.items()},
        _episode(metadata), metadata, attachments, faults)
    return Subject(called, sha256_file(path), (in_own_time(signals),))


def _gather(log: LogReader) -> "tuple[dict[str, _Parts], dict[str, _Pictures]]":
    topics: dict[str, _Parts] = {}
    pictures: dict[str, _Pictures] = {}
    decoders: dict[int, Decoder | None] = {}
    for batch in log.batches():
        channel = batch.channel
        parts = topics.setdefault(channel.topic, _Parts(channel.topic, channel.schema_name))
        if channel.number not in decoders:
            decoders[channel.number] = _decoder(channel)
        decode = decoders[channel.number]
        fields = None if decode is None else decode.decode(batch)
        parts.add(batch, fields, values=not channel.topic.startswith(UNSEEN))
        if fields is not None and fields.blobs and _is_image(channel):
            pictures.setdefault(channel.topic, _Pictures()).add(batch, fields)
    return topics, pictures


def _decoder(channel: Channel) -> Decoder | None:
    try:
        return decoder(channel)
    except RecordingError:
        return None  # its messages are counted as undecoded


def _is_image(channel: Channel) -> bool:
    return channel.schema_name.rsplit("/", 1)[-1].rsplit(".", 1)[-1] in ("Image", "CompressedImage")


def _faults(log: LogReader) -> dict[str, str]:
    """What the reader noticed, by the check that tells it."""
    names = {"damage": "truncated", "summary": "summary"}
    found: dict[str, str] = {}
    for problem in log.problems:
        if problem.kind in names:
            found.setdefault(names[problem.kind], problem.what)
    return found


def _attachments(log: LogReader, faults: dict[str, str]) -> dict[str, bytes]:
    try:
        return {name: content for name, _, content in log.attachments()}
    except RecordingError as error:
        faults.setdefault("truncated", error.what)
        return {}


def _episode(metadata: dict[str, dict[str, str]]) -> Episode | None:
    record = metadata.get("episode") or metadata.get("episode_start") or {}  # a recording that was never closed
    text = record.get("episode_json")
    try:
        return Episode.model_validate_json(text) if text else None
    except ValidationError:
        return None  # somebody else's record of that name


@dataclass(slots=True)
class _Parts:
    """The batches of one topic on their way to a Topic."""

    name: str
    type: str
    log: list[NDArray[np.int64]] = field(default_factory=list[NDArray[np.int64]])
    publish: list[NDArray[np.int64]] = field(default_factory=list[NDArray[np.int64]])
    header: list[NDArray[np.int64]] = field(default_factory=list[NDArray[np.int64]])
    sequence: list[NDArray[np.int64]] = field(default_factory=list[NDArray[np.int64]])
    values: dict[str, list[NDArray[Any]]] = field(default_factory=dict[str, list[NDArray[Any]]])
    names: dict[str, tuple[str, ...]] = field(default_factory=dict[str, tuple[str, ...]])
    odd: set[str] = field(default_factory=set[str])
    """Fields that some message lacks or has in another length: no columns."""
    undecoded: int = 0

    def add(self, batch: Batch, fields: Fields | None, *, values: bool) -> None:
        """Take a batch in; of messages that cannot be decoded only the stamps."""
        self.log.append(batch.log_ns)
        self.publish.append(batch.publish_ns)
        self.sequence.append(batch.sequence.astype(np.int64))
        if fields is None or len(fields) < len(batch):
            self.undecoded += len(batch) - (0 if fields is None else len(fields))
            self.odd |= set(self.values)
            return
        if fields.header_ns is not None:
            self.header.append(fields.header_ns)
        if values:
            self._take(fields)

    def _take(self, fields: Fields) -> None:
        first = len(self.log) == 1
        labels = _labels(fields)
        found: set[str] = set()
        for path, array in fields.values.items():
            rows = array.reshape(len(array), -1)
            stamp = path.endswith(("stamp", "timestamp")) or path.startswith("layout.")
            if rows.dtype.kind not in "fiub" or rows.shape[1] > MAX_WIDTH or not rows.shape[1] or stamp:
                continue
            if not first and (path not in self.values or self.values[path][0].shape[1] != rows.shape[1]):
                self.odd.add(path)
                continue
            found.add(path)
            self.values.setdefault(path, []).append(rows)
            if first:
                self.names[path] = _names(path, rows.shape[1], labels)
        self.odd |= set(self.values) - found

    def topic(self) -> Topic:
        """All batches as one; latched messages at time 0 are left out unless there is nothing else."""
        log = np.concatenate(self.log)
        kept = log != 0 if log.any() else np.ones(len(log), bool)
        whole = bool(self.header) and sum(map(len, self.header)) == len(log)
        columns = {path: Column(np.concatenate(parts).astype(np.float64)[kept], self.names[path])
                   for path, parts in self.values.items() if path not in self.odd}
        return Topic(self.name, self.type, log[kept], np.concatenate(self.publish)[kept],
                     np.concatenate(self.header)[kept] if whole else None, np.concatenate(self.sequence)[kept],
                     columns, self.undecoded)


def _labels(fields: Fields) -> Sequence[str]:
    """Names of the values, as the first message gives them: JointState's, or a MultiArray's label."""
    for path, names in fields.names.items():
        if names and (path == "name" or path.endswith(("joint_names", ".name", "names"))):
            return names[0]
    for path, names in fields.names.items():
        if path == "layout.dim.label" and names and names[0]:
            return names[0][0].split()
    return ()


def _names(path: str, width: int, labels: Sequence[str]) -> tuple[str, ...]:
    if width == 1 and len(labels) != 1:
        return (path.rsplit(".", 1)[-1],)
    if len(labels) == width:
        return tuple(labels)
    return tuple(f"{path}[{k}]" for k in range(width))


@dataclass(slots=True)
class _Pictures:
    """The pictures of one topic on their way to a Camera."""

    stamps: list[NDArray[np.int64]] = field(default_factory=list[NDArray[np.int64]])
    thumbs: list[Grey] = field(default_factory=list[Grey])
    prints: list[bytes] = field(default_factory=list[bytes])
    size: tuple[int, int] = (0, 0)
    broken: int = 0
    frame: str = ""

    def add(self, batch: Batch, fields: Fields) -> None:
        """Decode the pictures of a batch."""
        self.stamps.append(batch.log_ns[fields.rows] if fields.header_ns is None else fields.header_ns)
        self.frame = self.frame or next(iter(fields.texts.get("header.frame_id", ())), "")
        for k, blob in enumerate(next(iter(fields.blobs.values()))):
            found = self._decoded(fields, k, blob)
            if found is None:
                self.broken += 1
            elif self.size == (0, 0):
                self.size = found[1]
            self.thumbs.append(np.zeros(THUMB[::-1], np.uint8) if found is None else found[0])
            self.prints.append(blake2b(blob, digest_size=8).digest())

    def _decoded(self, fields: Fields, k: int, blob: memoryview) -> tuple[Grey, tuple[int, int]] | None:
        if "encoding" not in fields.texts:
            return compressed(blob)
        width, height, step = (int(fields.values[name][k]) for name in ("width", "height", "step"))
        return raw_picture(blob, fields.texts["encoding"][k], width, height, step)

    def camera(self, name: str) -> Camera:
        """All pictures as one camera."""
        return Camera(name, np.concatenate(self.stamps), np.stack(self.thumbs), tuple(self.prints), self.size,
                      self.broken, self.frame)
