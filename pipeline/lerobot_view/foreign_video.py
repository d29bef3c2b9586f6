"""Pictures of a foreign dataset: cut out of its videos packet by packet where that is exact, else encoded again."""

import hashlib
from collections.abc import Iterator
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import DatasetError
from pipeline.footage import LEAST, Picture
from pipeline.lerobot_view import pixels, video
from pipeline.lerobot_view.clips import Clip, Clips, key_of
from pipeline.lerobot_view.foreign import MEND, Span
from schemas.recipe import CameraConfig

AV1 = ("libdav1d", "libaom-av1", "av1")
"""What PyAV calls a decoder of AV1."""


@dataclass(frozen=True)
class ForeignFootage:
    """One episode of one camera in a foreign video; see pipeline.footage.Footage."""

    span: Span
    frames: int
    fps: int
    digest: str
    """Over the packets of the span."""

    @property
    def source(self) -> str:
        """What the pictures follow from."""
        return f"{self.digest} imported {self.frames}"

    @property
    def skew_s(self) -> NDArray[np.float32]:
        """A foreign dataset tells none."""
        return np.zeros(self.frames, np.float32)

    @property
    def repeated(self) -> int:
        """A foreign dataset tells none."""
        return 0

    def pictures(self) -> Iterator[Picture]:
        """A picture a frame."""
        import av

        half, count = 0.5 / self.fps, 0
        with av.open(str(self.span.file)) as container:
            stream = container.streams.video[0]
            container.seek(max(0, int((self.span.start_s - half) / float(stream.time_base or 1))), stream=stream)
            for frame in container.decode(stream):
                if frame.time < self.span.start_s - half:
                    continue
                if frame.time >= self.span.stop_s - half or count == self.frames:
                    break
                count += 1
                yield cast(Picture, frame.to_ndarray(format="rgb24"))
        if count != self.frames:
            raise DatasetError(f"the video holds {count} pictures for {self.frames} frames", where=self.span.file,
                               mend=MEND)


def footage_of(span: Span, frames: int, fps: int, packets: list[Any]) -> ForeignFootage:
    """Footage whose identity is the content of its packets."""
    digest = hashlib.sha256()
    for packet in _within(packets, span, fps):
        digest.update(bytes(packet))
    return ForeignFootage(span, frames, fps, digest.hexdigest())


def packets_of(file: Path) -> list[Any]:
    """Every packet of a video, in order; nothing is decoded.

    Raises:
        DatasetError: no video.
    """
    import av
    from av.error import FFmpegError

    found: list[Any] = []
    try:
        with av.open(str(file)) as container:
            found.extend(p for p in container.demux(container.streams.video[0]) if p.size)
    except (FFmpegError, IndexError) as error:
        raise DatasetError(f"the video cannot be read: {error}", where=file, mend=MEND) from error
    return found


def keep_copy(clips: Clips, footage: ForeignFootage, packets: list[Any], part: Path) -> bool:
    """Put the packets of an episode into a file of their own among the clips; False where that would not be exact.

    It is where the video is AV1 as ours are, the episode begins with a keyframe and has a packet a frame. What is
    not copied is encoded again when the version is built.
    """
    chosen = _within(packets, footage.span, footage.fps)
    key = key_of(footage, CameraConfig(), footage.fps)
    if len(chosen) != footage.frames or not chosen[0].is_keyframe or (clips.folder / f"{key}.json").exists():
        return False
    part.parent.mkdir(parents=True, exist_ok=True)
    try:
        if (size := _copy(footage, chosen, part)) is None:
            return False
        video.check(part, footage.frames, fps=footage.fps, where=footage.span.file)
        counts = pixels.empty()
        for _ in pixels.counted(video.decoded(part), counts):
            pass
        clips.add(part, Clip(part, "", key, footage.source, *size, footage.frames, counts))
    finally:
        part.unlink(missing_ok=True)
    return True


def _copy(footage: ForeignFootage, chosen: list[Any], part: Path) -> tuple[int, int] | None:
    """Write packets as they are into a file on the exact grid; height and width, or None for another kind of video."""
    import av

    with av.open(str(footage.span.file)) as source:
        of: Any = source.streams.video[0]
        even = of.height % 2 == of.width % 2 == 0 and min(of.height, of.width) >= LEAST
        if of.codec_context.name not in AV1 or of.pix_fmt != video.PIX_FMT or not even:
            return None
        with part.open("w+b") as stream, av.open(stream, "w", format="mp4") as container:
            to: Any = cast(Any, container).add_stream_from_template(of, opaque=True)  # by codec, not decoder
            to.time_base = Fraction(1, footage.fps)
            for n, packet in enumerate(chosen):
                copied: Any = av.Packet(bytes(packet))
                copied.pts = copied.dts = n
                copied.duration, copied.time_base, copied.stream = 1, Fraction(1, footage.fps), to
                copied.is_keyframe = packet.is_keyframe
                container.mux(copied)
        return int(of.height), int(of.width)


def _within(packets: list[Any], span: Span, fps: int) -> list[Any]:
    """Packets whose moment lies in a span, in order of it."""
    half = 0.5 / fps
    timed = [(float(p.pts * cast(Fraction, p.time_base)), p) for p in packets if p.pts is not None]
    return [p for at, p in sorted(timed, key=lambda pair: pair[0]) if span.start_s - half <= at < span.stop_s - half]
