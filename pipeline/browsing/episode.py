"""Episodes as Rerun recordings: every curve, body, lane and camera as columns, not row by row."""
# rerun's columns are typed by what they accept, not by what they are
# pyright: reportUnknownMemberType=false

from collections.abc import Generator, Mapping
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from pipeline.browsing.shown import Body, Shape, Shown
from pipeline.trace import Rows

APPLICATION = "hardcase"
TIME, TICK = "seconds", "tick"
"""Names of the time lines: from the start of the attempt, and the control's own count."""

COLOURS: Mapping[str, tuple[int, int, int]] = {
    "state": (96, 165, 250), "command": (251, 146, 60), "sent": (251, 146, 60), "predicted": (192, 132, 252),
}
"""Last part of a curve's path -> its colour; others get one of Rerun's."""
HUES = ((226, 232, 240), (96, 165, 250), (251, 146, 60), (74, 222, 128), (192, 132, 252), (244, 114, 182))
"""Attempt 0, 1, 2, ... of several on one time line -> its hue."""
LANES: Mapping[str, tuple[int, int, int]] = {
    "demonstration": (74, 222, 128), "autonomous": (96, 165, 250), "intervention": (251, 191, 36),
}
"""First word of a lane's state -> its colour."""
LEVELS: Mapping[int, str] = {10: "DEBUG", 20: "INFO", 30: "WARN", 40: "ERROR", 50: "CRITICAL"}


@contextmanager
def recording(path: Path, id: str) -> Generator[rr.RecordingStream]:
    """A Rerun recording that is written to `path` while the body runs.

    Args:
        path: where; the caller sees to it that nobody takes half a file for a whole one.
        id: of the recording; what has the same one is shown together, as layers of one episode.
    """
    stream = rr.RecordingStream(APPLICATION, recording_id=id, send_properties=False)
    stream.save(path)
    try:
        yield stream
    finally:
        stream.flush()
        stream.disconnect()


def draw(stream: rr.RecordingStream, shown: Shown, prefix: str = "", number: int | None = None) -> None:
    """Send an attempt.

    Args:
        stream: where to.
        shown: the attempt.
        prefix: entity that everything goes below, as '/champion'; '' for the only attempt.
        number: of the attempt, where several share a plot: its curves are named after it and have its hue.
    """
    _lines(stream, shown, prefix, number)
    for body in shown.bodies:
        _body(stream, shown, body, f"{prefix}/world/{body.name}")
    if len(shown.path):
        strip = rr.LineStrips3D([shown.path], colors=[(251, 146, 60, 110)], radii=0.0012)
        stream.log(f"{prefix}/world/path", strip, static=True)
    for lane, changed in shown.states.items():
        lane_entity = f"{prefix}/states/{_part(lane)}"
        ticks = np.array([k for k in changed if k < len(shown)])
        names = [changed[int(k)] for k in ticks]
        if coloured := {n: LANES[n.split()[0]] for n in names if n.split() and n.split()[0] in LANES}:
            lanes = rr.StateConfiguration(values=list(coloured), colors=list(coloured.values()))
            stream.log(lane_entity, lanes, static=True)
        if len(ticks):
            stream.send_columns(lane_entity, times(shown.seconds, ticks), rr.StateChange.columns(state=names))
    if shown.events:
        ticks = np.array([min(e.tick, len(shown) - 1) for e in shown.events])
        text = rr.TextLog.columns(text=[f"{e.name}: {e.text}" for e in shown.events],
                                  level=[LEVELS.get(e.level, "INFO") for e in shown.events])
        stream.send_columns(f"{prefix}/events", times(shown.seconds, ticks), text)
    for camera, pictures in shown.pictures.items():
        ticks = np.clip(np.searchsorted(shown.seconds, pictures.seconds + 1e-6, "right") - 1, 0, None)
        at = [rr.TimeColumn(TIME, duration=pictures.seconds), rr.TimeColumn(TICK, sequence=ticks)]
        stream.send_columns(f"{prefix}/cameras/{_part(camera)}", at,
                            rr.EncodedImage.columns(blob=list(pictures.blobs)))
    if shown.facts:
        about = rr.TextDocument(shown.facts, media_type=rr.MediaType.MARKDOWN)
        stream.log(f"{prefix}/about", about, static=True)


def times(seconds: Rows, ticks: NDArray[np.intp] | None = None) -> list[rr.TimeColumn]:
    """Both time lines of all ticks, or of some."""
    chosen = np.arange(len(seconds)) if ticks is None else ticks
    return [rr.TimeColumn(TIME, duration=seconds[chosen]), rr.TimeColumn(TICK, sequence=chosen)]


def curve(stream: rr.RecordingStream, path: str, at: list[rr.TimeColumn], values: Rows, *, prefix: str = "",
          hue: tuple[int, int, int] | None = None) -> None:
    """One curve, named and coloured by the last part of its path, or by its attempt where that has a hue."""
    kind = path.rsplit("/", 1)[-1]
    name, colour, width = kind, COLOURS.get(kind), 1.5
    if hue is not None:
        asked = kind in ("command", "sent")
        attempt = prefix.strip("/").replace("/", " ")
        name = attempt if kind in ("state", "sent") else f"{attempt} {kind}"
        colour, width = (*hue, 110) if asked else (*hue, 255), 1.0 if asked else 2.0
    entity = prefix + "/" + "/".join(map(_part, path.strip("/").split("/")))
    stream.log(entity, rr.SeriesLines(names=name, colors=colour, widths=width), static=True)
    stream.send_columns(entity, at, rr.Scalars.columns(scalars=values))


def _lines(stream: rr.RecordingStream, shown: Shown, prefix: str, number: int | None) -> None:
    at, hue = times(shown.seconds), None if number is None else HUES[number % len(HUES)]
    for path, values in shown.lines.items():
        curve(stream, path, at, values, prefix=prefix, hue=hue)


def _part(name: str) -> str:
    return rr.escape_entity_path_part(name)


def _body(stream: rr.RecordingStream, shown: Shown, body: Body, entity: str) -> None:
    xyz, xyzw = body.poses[:, :3], body.poses[:, [4, 5, 6, 3]]
    if len(body.poses) == 1:
        stream.log(entity, rr.Transform3D(translation=xyz[0], quaternion=xyzw[0]), static=True)
    else:
        stream.send_columns(entity, times(shown.seconds), rr.Transform3D.columns(translation=xyz, quaternion=xyzw))
    for (kind, solid), shapes in _by_kind(body.shapes).items():
        stream.log(f"{entity}/{kind}", _shapes(kind, shapes, solid=solid), static=True)


def _by_kind(shapes: tuple[Shape, ...]) -> dict[tuple[str, bool], list[Shape]]:
    found: dict[tuple[str, bool], list[Shape]] = {}
    for shape in shapes:
        found.setdefault((shape.kind, shape.solid), []).append(shape)
    return found


def _shapes(kind: str, shapes: list[Shape], *, solid: bool) -> rr.AsComponents:
    centers = [s.xyz for s in shapes]
    turns = [rr.Quaternion(xyzw=(*s.turn[1:], s.turn[0])) for s in shapes]
    colours, fill = [s.colour for s in shapes], "solid" if solid else "majorwireframe"
    if kind == "box":
        return rr.Boxes3D(half_sizes=[s.size for s in shapes], centers=centers, quaternions=turns, colors=colours,
                          fill_mode=fill)
    if kind == "cylinder":
        return rr.Cylinders3D(radii=[s.size[0] for s in shapes], lengths=[2 * s.size[2] for s in shapes],
                              centers=centers, quaternions=turns, colors=colours, fill_mode=fill)
    return rr.Ellipsoids3D(radii=[s.size[0] for s in shapes], centers=centers, colors=colours, fill_mode=fill)
