"""A recording again, with more in it: every message copied, new ones laid beside the simulator state they belong to."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pipeline.files import atomic
from pipeline.recording import fields
from pipeline.recording.dialect import every_tick
from pipeline.recording.errors import reading, refuse
from pipeline.recording.live_file import LiveFile
from pipeline.recording.live_recover import Kept, messages_of
from pipeline.recording.pictures import image_message
from pipeline.recording.read import open_recording
from pipeline.recording.scan import Scan, load, scan
from pipeline.recording.strings import attached_files
from pipeline.recording.verify import verify
from pipeline.recording.write import named

STATE = "/sim/state"

type Render = Callable[[NDArray[np.float64]], Mapping[str, NDArray[np.uint8]]]
"""The simulator's state of one tick -> camera -> picture, RGB."""


def add_pictures(source: Path, target: Path, render: Render, cameras: Sequence[str]) -> int:
    """Write a recording again with pictures of every tick, and return how many.

    Stamps, sequence numbers, metadata and attachments are those of the source, which is not touched; the target is
    another file with another hash, of the same episode.

    Args:
        source: a whole recording with simulator state.
        target: where to write; read again as a whole before it gets its name.
        render: makes the pictures.
        cameras: those it renders.

    Raises:
        RecordingError: the source cannot be read, has pictures of these cameras already or no simulator state, or
            the disk refuses.
    """
    _check(source, target, cameras)
    width = open_recording(source).decoder.trace().sim_state.shape[1]
    if not width:
        raise refuse(f"no {STATE}: it cannot be shown from elsewhere again", source,
                     "film while recording: hardcase record --camera, hardcase teleop --camera")
    found, kept, added = scan(load(source), source), Kept(), 0
    file: LiveFile | None = None
    with named(target), atomic(target) as stream:
        for sequence, topic, log_ns, publish_ns, payload, ends in messages_of(found, kept):
            if file is None:
                file = LiveFile(_metadata(found), attached_files(found), log_ns)
            file.add(topic, sequence, log_ns, publish_ns, payload)
            if topic == STATE:
                for camera, picture in render(np.frombuffer(payload[-8 * width :], "<f8")).items():
                    message = image_message(camera, picture, publish_ns)
                    file.add(f"/camera/{camera}/image/compressed", sequence, log_ns, publish_ns, message)
                    added += 1
            if ends:
                file.seal()
                stream.write(file.take())
        assert file is not None
        file.end({})
        stream.write(file.take())
        stream.flush()
        verify(Path(stream.name), file.assembly.counts, file.numbers)
    return added


def _check(source: Path, target: Path, cameras: Sequence[str]) -> None:
    if target.exists():
        raise refuse("recording is already there", target, "name another file, or move this one away")
    seen = set[str]()
    open_recording(source, wanted=lambda topic: bool(seen.add(topic)) or every_tick(topic), required=())
    for camera in cameras:
        if f"/camera/{camera}/image/compressed" in seen:
            raise refuse(f"it has pictures of camera {camera!r} already", source, "name another camera")


def _metadata(found: Scan) -> dict[str, dict[str, str]]:
    records: dict[str, dict[str, str]] = {}
    for start, stop in found.metadata:
        with reading(found.where, f"metadata at byte {start - 9}"):
            name, at = fields.text(found.data, start, stop)
            records[name] = fields.pairs(found.data, at, stop)[0]
    return records
