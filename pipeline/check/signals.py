"""One view of whatever is checked: a recording's topics, or a dataset's episodes, as columns over time."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from schemas.dataset import DatasetVersion
from schemas.episode import Episode

type Ns = NDArray[np.int64]
type Rows = NDArray[np.float64]
type Pictures = NDArray[np.uint8]

BURST = 6
"""Intervals that are looked at together: a whole number of bursts of 2 and of 3 messages."""
EVENTS = "rcl_interfaces/msg/Log"
"""Type of what is told when it happens, several at a time: it has no rhythm, however often it speaks."""
THUMB = (16, 12)
"""Width and height of the grey pictures that camera checks look at [px]."""


@dataclass(frozen=True, slots=True)
class Column:
    """One field of a topic: rows of numbers with a name each."""

    rows: Rows
    """Shape (n, d)."""
    names: tuple[str, ...]
    """d names; 'x0', 'x1', ... where the log gives none."""


@dataclass(frozen=True)
class Topic:
    """Everything that one topic said, message by message; or one feature of an episode, row by row."""

    name: str
    type: str
    log_ns: Ns
    """When the recorder took it, shape (n,) [ns]."""
    publish_ns: Ns
    header_ns: Ns | None
    """When it was measured, by the message's own header; None without one."""
    sequence: Ns | None
    """Running number; None where there is none."""
    columns: Mapping[str, Column] = field(default_factory=dict[str, Column])
    """Field -> numbers; fields whose length changes are left out."""
    undecoded: int = 0
    """Messages whose content could not be read."""
    tabled: bool = False
    """Rows of a dataset: their stamps follow from the row number and say nothing of clocks."""

    def __len__(self) -> int:
        return len(self.log_ns)

    @property
    def seconds(self) -> Rows:
        """When each message was measured, by its header if it has one, else by the recorder [s], from 0."""
        stamps = self.log_ns if self.header_ns is None else self.header_ns
        return (stamps - stamps[0]) / 1e9 if len(stamps) else np.empty(0)

    @cached_property
    def period_s(self) -> float:
        """Usual interval of the recorder's stamps [s]; NaN with fewer than 3 messages.

        The median over BURST intervals in a row, so that messages which arrive two or three at a time have the period
        at which they were sent.
        """
        return float(np.median(self._spans_s)) if len(self) > 2 else float("nan")

    @cached_property
    def _spans_s(self) -> Rows:
        width = min(BURST, len(self) - 1)
        return (self.log_ns[width:] - self.log_ns[:-width]) / width / 1e9

    @cached_property
    def steady(self) -> bool:
        """Whether it speaks at a rate, not at events: 8 messages and more, most spans near the usual one."""
        if len(self) < 8 or not self.period_s > 0 or self.type == EVENTS:
            return False
        return float(np.mean(np.abs(self._spans_s - self.period_s) < 0.5 * self.period_s)) > 0.7


@dataclass(frozen=True, slots=True)
class Camera:
    """The pictures of one camera, small and grey."""

    name: str
    stamps_ns: Ns
    """When each was taken, shape (n,) [ns]."""
    thumbs: Pictures
    """Shape (n, 12, 16)."""
    prints: tuple[bytes, ...]
    """Hash of the bytes of each picture: equal ones are the same picture to the bit."""
    size: tuple[int, int]
    """Width and height of the full picture [px]."""
    broken: int = 0
    """Pictures that do not decode; black in `thumbs`."""
    frame: str = ""
    """The frame that the pictures' headers name."""
    video: bool = False
    """Out of a video, whose encoder repeats a picture where little changes."""

    def changes(self) -> Rows:
        """How much each part of each picture differs from the one before, noise taken off, shape (n - 1, 12, 16).

        Half of all parts change by noise alone: three times their change is taken off everywhere.
        """
        change = np.abs(np.diff(self.thumbs.astype(np.float64), axis=0))
        noise = 3 * float(np.median(change)) if change.size else 0.0
        return np.maximum(change - noise, 0.0)

    def energy(self) -> Rows:
        """How much each picture differs from the one before [grey values], shape (n,), 0 at first."""
        return np.concatenate([np.zeros(min(1, len(self.thumbs))), self.changes().mean(axis=(1, 2))])


@dataclass(frozen=True)
class Signals:
    """One recording, or one episode of a dataset."""

    name: str
    """File name or id; 'episode 3' within a dataset."""
    topics: Mapping[str, Topic]
    cameras: Mapping[str, Camera] = field(default_factory=dict[str, Camera])
    episode: Episode | None = None
    """What our own recordings say of themselves."""
    metadata: Mapping[str, Mapping[str, str]] = field(default_factory=dict[str, Mapping[str, str]])
    attachments: Mapping[str, bytes] = field(default_factory=dict[str, bytes])
    faults: Mapping[str, str] = field(default_factory=dict[str, str])
    """What the reader had to say of the file: truncated, summary, ... -> the fact."""
    lineage: str = ""
    """Id shared by everything made from one demonstration; empty where nothing says so."""
    split: str = ""
    """train, held_out or another name of a split."""
    index: int = 0
    """episode_index within a dataset."""

    @cached_property
    def start_ns(self) -> int:
        """Earliest log time of a topic that speaks steadily, else of any; latched messages may lie at 0 [ns]."""
        firsts = [int(t.log_ns.min()) for t in self.topics.values() if t.steady]
        return min(firsts or [int(t.log_ns.min()) for t in self.topics.values() if len(t)], default=0)

    @cached_property
    def stop_ns(self) -> int:
        """Latest log time of a topic that speaks steadily, else of any [ns]."""
        lasts = [int(t.log_ns.max()) for t in self.topics.values() if t.steady]
        return max(lasts or [int(t.log_ns.max()) for t in self.topics.values() if len(t)], default=0)

    def at_s(self, stamp_ns: int) -> float:
        """Seconds from the recording's start."""
        return (stamp_ns - self.start_ns) / 1e9

    def find(self, reference: str) -> tuple[Topic, str, Column] | None:
        """Topic, field and column of TOPIC.FIELD, or of a topic or feature with a single field."""
        for name in sorted(self.topics, key=len, reverse=True):
            topic = self.topics[name]
            if reference == name and len(topic.columns) == 1:
                only = next(iter(topic.columns))
                return topic, only, topic.columns[only]
            field_name = reference.removeprefix(name + ".")
            if field_name != reference and field_name in topic.columns:
                return topic, field_name, topic.columns[field_name]
        return None

    def numbers(self) -> Iterator[tuple[str, Topic, Column]]:
        """Every column with its reference, TOPIC.FIELD; a feature's is its name."""
        for name, topic in self.topics.items():
            for part, column in topic.columns.items():
                yield (f"{name}.{part}" if part else name), topic, column


@dataclass(frozen=True, slots=True)
class Tables:
    """What a LeRobot folder says of itself, to be held against its rows."""

    info: Mapping[str, Any]
    stats: Mapping[str, Any]
    """Feature -> measure -> numbers; empty where the file is missing."""
    episodes: Mapping[str, list[Any]]
    """Columns of the episodes table, the statistics left out."""
    frames: Mapping[str, NDArray[Any]]
    """Feature -> rows (n, d) over all episodes."""
    videos: Mapping[tuple[str, int], int]
    """(camera feature, episode_index) -> pictures that are there."""
    version: DatasetVersion | None = None
    """Ours, if the folder is one of our versions."""
    manifest: Mapping[str, Any] = field(default_factory=dict[str, Any])
    damage: str = ""
    """Why it does not hold what its manifest promises."""


@dataclass(frozen=True, slots=True)
class Subject:
    """What is checked: one recording, or one dataset with its episodes."""

    name: str
    digest: str
    """sha256 of the file, or over the files of a dataset."""
    recordings: tuple[Signals, ...]
    tables: Tables | None = None

    @property
    def kind(self) -> Literal["recording", "dataset"]:
        """'recording' or 'dataset'."""
        return "recording" if self.tables is None else "dataset"
