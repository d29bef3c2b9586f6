"""Tracks: the samples of each topic that makes a feature or shows a camera's images, checked for sound time."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import ConfigError
from pipeline.frames import Features
from pipeline.logs.intake import CameraIntake, StateIntake
from pipeline.logs.mapping import EXAMPLE
from pipeline.logs.resample import NS, only, pick, values
from pipeline.logs.spool import Samples, Stamps
from pipeline.logs.tables import IMAGE, Column
from schemas.ingest import Rule

SKEW = "skew."
"""Columns skew.FEATURE and skew.camera.NAME: frame minus sample [s], one value a topic."""


@dataclass(frozen=True, slots=True)
class Track:
    """The samples of one topic for one feature or camera, and how frames use them."""

    name: str
    """Feature, or camera.NAME."""
    topic: str
    clock: str
    rule: Rule
    max_skew_s: float
    wrap: bool
    samples: Samples
    column: str
    """Where its values go."""
    first: int
    """First of its values in the column."""
    place: int
    """Its value in the column of skews."""

    def fill(self, at: Stamps, columns: Mapping[str, Column]) -> NDArray[np.bool_]:
        """Write values and skews of frames at rising times [ns] into columns; says which frames have a sample."""
        picks = pick(self.samples, at, self.rule, self.max_skew_s)
        ok = picks.admissible
        columns[SKEW + self.name][:, self.place] = picks.skew_ns / NS
        told = values(self.samples, picks if ok.all() else only(picks, ok), wrap=self.wrap)
        with np.errstate(over="ignore"):  # what is too large for float32 becomes Inf, and that is refused
            columns[self.column][ok, self.first:self.first + told.shape[1]] = told
        return ok

    def silent_at(self, time_ns: int) -> bool:
        """Whether a frame at this time has no sample."""
        return not pick(self.samples, np.array([time_ns], np.int64), self.rule, self.max_skew_s).admissible[0]


@dataclass(frozen=True, slots=True)
class Tracks:
    """All tracks of a log."""

    states: tuple[Track, ...]
    cameras: tuple[Track, ...]
    features: Features
    """Feature -> names of its values; after the features, the skews."""

    @property
    def all(self) -> tuple[Track, ...]:
        """States first."""
        return (*self.states, *self.cameras)

    def blank(self, frames: int) -> dict[str, Column]:
        """Columns for so many frames."""
        columns: dict[str, Column] = {n: np.zeros((frames, len(v)), np.float32) for n, v in self.features.items()}
        return columns | {track.column: np.zeros((frames, 1), np.int64) for track in self.cameras}


def tracks(states: Sequence[StateIntake], cameras: Sequence[CameraIntake], log: Path, problems: list[str]) -> Tracks:
    """The tracks of what was taken; what is odd about their stamps is added to `problems`.

    Raises:
        ConfigError: stamps that are all 0, or that go back farther than a frame may lie from its sample.
    """
    features: dict[str, tuple[str, ...]] = {}
    topics: dict[str, tuple[str, ...]] = {}
    made: list[Track] = []
    for intake in states:
        source, name = intake.source, intake.feature
        assert intake.spool is not None, "a log without samples was refused before"
        made.append(Track(name, source.topic, intake.clock, source.resample, source.max_skew_s, source.wrap,
                          intake.spool.finish(), name, len(features.get(name, ())), len(topics.get(name, ()))))
        features[name] = (*features.get(name, ()), *intake.taker.names)
        topics[name] = (*topics.get(name, ()), source.topic)
    seen: list[Track] = []
    for intake in cameras:
        camera, name = intake.camera, f"camera.{intake.name}"
        seen.append(Track(name, camera.topic, intake.clock, camera.resample, camera.max_skew_s, False,
                          intake.spool.finish(), IMAGE + intake.name, 0, 0))
        topics[name] = (camera.topic,)
    for track, intake in zip((*made, *seen), (*states, *cameras), strict=True):
        problems += _odd(track, intake, log)
    skews = {SKEW + name: value for name, value in topics.items()}
    return Tracks(tuple(made), tuple(seen), {**features, **skews})


def _odd(track: Track, intake: StateIntake | CameraIntake, log: Path) -> list[str]:
    """What is odd about the stamps of a track; raises where they cannot be used."""
    spool, samples = intake.spool, track.samples
    assert spool is not None
    if not spool.count:
        reasons = "; ".join(f"{reason} ({n} messages)" for reason, n in intake.refused.most_common(3))
        raise ConfigError(f"no message of {track.topic} can be used: {reasons}", where=log, mend=EXAMPLE)
    if not len(samples):
        raise ConfigError(f"all {spool.count} messages of {track.topic} have {track.clock} time 0", where=log,
                             mend="declare another clock for this topic: log, publish or header")
    back = spool.back
    if track.clock != "log" and back.by_ns > round(track.max_skew_s * NS):
        raise ConfigError(f"{track.topic} goes back {back.by_ns / NS:.3g} s at message {back.message}, by its "
                             f"{track.clock} time", where=log,
                             mend="declare clock: log for this topic, or cut the log where its clock was set back")
    told: list[str] = []
    if back.by_ns:
        told.append(f"{track.topic}: messages are out of order by up to {back.by_ns / NS:.3g} s; put in order")
    if samples.dropped:
        told.append(f"{track.topic}: {samples.dropped} messages have {track.clock} time 0 (latched); not used")
    if spool.repeated:
        told.append(f"{track.topic}: {spool.repeated} messages repeat the {track.clock} time of another; "
                    "the last one counts")
    return told
