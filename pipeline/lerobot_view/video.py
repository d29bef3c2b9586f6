"""Videos of a version: pictures in, one mp4 out with a picture a frame on the exact grid; and back again."""

import os
from collections.abc import Generator, Iterable, Iterator
from contextlib import contextmanager
from fractions import Fraction
from pathlib import Path
from typing import Any, cast

import numpy as np

from pipeline.errors import DatasetError
from pipeline.footage import Picture
from pipeline.lerobot_view.scheduling import fair

CODEC, PIX_FMT = "libsvtav1", "yuv420p"
OPTIONS = {"crf": "30", "preset": "12", "g": "2"}
"""Those of lerobot's default. A keyframe every second frame keeps random reading quick for lerobot; ten frames apart
would take 20 to 40 % less time and half of the space."""

SMALL = 256 * 256
"""Pictures up to so many pixels are encoded at level 2 of parallelism, larger ones at level 1: the bytes are the same
at every level, and this takes the least CPU time, a fifth less for 128x128."""

GRID_S = 1e-4
"""How far a frame may stand from its place on the 1/fps grid, as lerobot tolerates it [s]."""

AGAIN = "remove the file and build the version again: hardcase build"


def encode(pictures: Iterable[Picture], file: Path, *, fps: int, where: object,
           parallel: int | None = None) -> tuple[int, int, int]:
    """Write one mp4 of AV1 with every picture as a frame; returns frames, height and width.

    Every picture waits until the encoder has taken the one before: nothing is dropped, however slow it is. The file
    is read again before this returns.

    Args:
        pictures: at least one, RGB of one even size.
        file: where to write; what is there is replaced.
        fps: frames a second.
        where: what to name in errors.
        parallel: level of parallelism of the encoder, 1 to 6; the cheapest where None. It changes no byte.

    Raises:
        DatasetError: no picture, pictures of different sizes, or a file that does not hold a packet a frame.
        OSError: the disk is full or read-only.
    """
    import av

    frames, shape, video, opening = 0, (0, 0, 3), None, cast(Any, av.open)
    with _quiet(), fair() as calm, file.open("w+b") as stream, opening(stream, "w", format="mp4") as container:
        for picture in pictures:
            if video is None:
                shape = picture.shape
                video = _stream(container, shape[0], shape[1], fps, parallel)
            elif picture.shape != shape:
                raise DatasetError(f"picture {frames} has {picture.shape[1]}x{picture.shape[0]}, the first "
                                   f"{shape[1]}x{shape[0]}", where=where,
                                   mend="give the camera a width and height in the recipe: dataset.cameras")
            frame: Any = av.VideoFrame.from_ndarray(picture, format="rgb24")
            frame.pts, frame.time_base = frames, Fraction(1, fps)
            container.mux(video.encode(frame))
            if not frames:
                calm()  # the first frame opens the encoder and starts its threads
            frames += 1
        if video is None:
            raise DatasetError("no picture at all", where=where, mend="leave the episode out")
        container.mux(video.encode())
    check(file, frames, fps=fps, where=where)
    return frames, shape[0], shape[1]


def _stream(container: Any, height: int, width: int, fps: int, parallel: int | None) -> Any:
    level = parallel or (2 if height * width <= SMALL else 1)
    stream = container.add_stream(CODEC, rate=fps, options={**OPTIONS, "svtav1-params": f"lp={level}"})
    stream.pix_fmt, stream.codec_context.thread_count = PIX_FMT, 1
    stream.height, stream.width = height, width
    return stream


def check(file: Path, frames: int, *, fps: int, where: object) -> None:
    """Return when a video holds one packet a frame, each in its place on the grid, the first a keyframe.

    Raises:
        DatasetError: it does not; says what it holds.
    """
    with _opened(file) as container:
        stream = container.streams.video[0]
        packets = [p for p in container.demux(stream) if p.size]
        base = float(stream.time_base)
    if len(packets) != frames:
        raise DatasetError(f"the video holds {len(packets)} pictures of {frames}", where=where, mend=AGAIN)
    stamps = np.sort([float(-1 if p.pts is None else p.pts) * base for p in packets])
    apart = np.abs(stamps - np.arange(frames) / fps)
    if apart.max() > GRID_S or not packets[0].is_keyframe:
        raise DatasetError(f"a picture of the video stands {apart.max():.4f} s from its frame", where=where, mend=AGAIN)


def decoded(file: Path) -> Iterator[Picture]:
    """Every picture of a video in order, RGB of shape (height, width, 3), as lerobot's PyAV reader gives it.

    Raises:
        DatasetError: the file is damaged or no video.
    """
    with _opened(file) as container:
        stream = container.streams.video[0]
        stream.codec_context.thread_count = 1  # more would wake for every small picture
        for frame in container.decode(stream):
            yield frame.to_ndarray(format="rgb24")


def about(height: int, width: int, fps: int) -> dict[str, object]:
    """The `info` of a video feature in info.json; Source: lerobot 0.6.1 datasets/video_utils.py get_video_info."""
    return {
        "video.height": height, "video.width": width, "video.codec": "av1", "video.pix_fmt": PIX_FMT,
        "video.fps": fps, "video.channels": 3, "has_audio": False, "video.g": int(OPTIONS["g"]),
        "video.crf": int(OPTIONS["crf"]), "video.preset": int(OPTIONS["preset"]), "is_depth_map": False,
    }


@contextmanager
def _opened(file: Path) -> Generator[Any]:
    import av
    from av.error import FFmpegError

    try:
        with av.open(str(file)) as container:
            yield container
    except (FFmpegError, IndexError) as error:
        raise DatasetError(f"the video cannot be read: {error}", where=file, mend=AGAIN) from error


@contextmanager
def _quiet() -> Generator[None]:
    """SVT-AV1 tells its version on stderr unless its own variable asks for errors only."""
    before = os.environ.get("SVT_LOG")
    os.environ["SVT_LOG"] = "1"
    try:
        yield
    finally:
        if before is None:
            os.environ.pop("SVT_LOG", None)
        else:
            os.environ["SVT_LOG"] = before
