"""An MCAP recording as it is drawn: the arm's in full, any other robot's joints, all with their pictures."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from pipeline.browsing.attempts import about, by_joint, of_trace, segments
from pipeline.browsing.legged import of_legged
from pipeline.browsing.shown import Pictures, Shown, even
from pipeline.recording import cdr
from pipeline.recording.dialect import FRAME_TOPICS, every_tick
from pipeline.recording.errors import reading
from pipeline.recording.read import Opened, open_recording
from pipeline.recording.series import Series
from pipeline.trace import Rows
from schemas.episode import Episode

CAMERA, IMAGE = "/camera/", "/image/compressed"


def of_recording(path: Path, episode: Episode | None = None) -> tuple[Shown, Opened]:
    """What a recording of the dialect holds; ticks and pictures lie where their stamps say.

    Args:
        path: the file.
        episode: its record in the catalog, which may know more by now; the recording's own where None.

    Raises:
        RecordingError: damaged, hostile, incomplete or not of the dialect.
    """
    opened = open_recording(path, wanted=_drawn, required=())
    topics, record = opened.decoder.topics, episode or opened.episode
    first = topics.get("/joint_states")
    start_ns, seconds = _clock(first, opened.episode)
    if all(topic in topics for topic in FRAME_TOPICS):
        shown = of_trace(record, opened.decoder.trace(), opened.attachments, seconds=seconds)
    elif record.scene.legged is not None:
        shown = of_legged(record, opened.decoder.trace(), opened.attachments, seconds=seconds)
    else:
        shown = Shown(f"{record.origin} {record.id[:8]}", seconds, _joints(topics, len(seconds)),
                      states=segments(record), events=opened.decoder.events(), facts=about(record))
    return replace(shown, pictures=_pictures(topics, start_ns)), opened


def _drawn(topic: str) -> bool:
    return every_tick(topic) or topic in ("/task/phase", "/events") or topic.startswith(CAMERA)


def _clock(series: Series | None, episode: Episode) -> tuple[int, Rows]:
    """When the recording begins [ns], and when each tick was [s]; without joints the control rate tells."""
    if series is None or not len(series):
        return 0, even(episode.frames, episode.control_hz)
    stamps = series.heads["publish"][:episode.frames].astype(np.int64)
    return int(stamps[0]), (stamps - stamps[0]) / 1e9


def _joints(topics: Mapping[str, Series], m: int) -> dict[str, Rows]:
    """State and command of every joint that has a name, shape (m,) each."""
    lines: dict[str, Rows] = {}
    for topic, kind in (("/joint_states", "state"), ("/joint_commands", "command")):
        series = topics.get(topic)
        if series is None or len(series) < m:
            continue
        with reading(series.where, f"message 0 on {topic}"):
            cursor = cdr.Cursor(series.payload(0))
            cursor.stamp()
            cursor.text()
            names = [cursor.text() for _ in range(min(cursor.u32(), 10_000))]
            widths = list[int]()
            for _ in range(3):
                widths.append(min(cursor.u32(), 10_000))
                cursor.floats(widths[-1])
        if widths[0] == len(names):
            layout = cdr.joint_state(names, velocity=widths[1] > 0, effort=widths[2] > 0)
            lines |= by_joint(names, series.floats(layout, m)[0], kind)
    return lines


def _pictures(topics: Mapping[str, Series], start_ns: int) -> dict[str, Pictures]:
    found: dict[str, Pictures] = {}
    for topic, series in sorted(topics.items()):
        if topic.startswith(CAMERA) and topic.endswith(IMAGE):
            stamps = series.heads["publish"].astype(np.int64)
            blobs = tuple(_image(series, k) for k in range(len(series)))
            begin = start_ns or (int(stamps[0]) if len(stamps) else 0)
            found[topic.removeprefix(CAMERA).removesuffix(IMAGE)] = Pictures((stamps - begin) / 1e9, blobs)
    return found


def _image(series: Series, k: int) -> bytes:
    payload = series.payload(k)
    with reading(series.where, f"message {k} on {series.topic}"):
        cursor = cdr.Cursor(payload)
        cursor.stamp()
        cursor.text()
        cursor.text()
        size = cursor.u32()
        if size > len(payload):
            raise ValueError(f"image of {size} B in a message of {len(payload)}")
    return payload[len(payload) - size:]
