"""`hardcase film`: pictures of a recording that was made without them, or through other cameras."""

from collections.abc import Sequence
from pathlib import Path

from pipeline.errors import ConfigError, RecordingError
from pipeline.recording.copying import add_pictures
from pipeline.recording.read import open_recording


def film(source: Path, target: Path, cameras: Sequence[str], size: tuple[int, int]) -> str:
    """Write a recording again with pictures of its scene's cameras, and say what was done.

    Raises:
        HardcaseError: the recording cannot be read or shown again, or nothing renders here.
    """
    from pipeline.simulation.refilm import SceneFilm

    if not cameras:
        raise ConfigError("no camera to film through", where="--camera", mend="--camera front --camera top")
    opened = open_recording(source, required=())
    if "scene.xml" not in opened.attachments:
        raise RecordingError("no scene.xml in the recording", where=source, mend="record it with its scene attached")
    half_m, (width, height) = opened.episode.scene.object_half_m, size
    with SceneFilm(opened.attachments["scene.xml"], half_m, cameras, width=width, height=height) as scene:
        count = add_pictures(source, target, scene.render, cameras)
    return f"{target}: {count} pictures of {', '.join(cameras)}\nlook at it: rerun {target}"
