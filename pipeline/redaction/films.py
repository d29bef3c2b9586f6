"""Videos hidden by a map: looked through, filled, encoded, looked through again; what cannot be cleaned is refused."""

import json
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass, replace
from itertools import islice
from pathlib import Path
from typing import Any

from pipeline.errors import DatasetError
from pipeline.files import atomic, sha256, source_hash
from pipeline.footage import Picture
from pipeline.lerobot_view import pixels, video
from pipeline.lerobot_view.clips import Clip, Clips
from pipeline.lerobot_view.filmed import ByCamera
from pipeline.lerobot_view.plan import Plan
from pipeline.redaction import covering, detector, regions
from pipeline.redaction.covering import covered
from pipeline.redaction.detector import FIRST, SECOND, Detector, Look
from pipeline.redaction.regions import Box, Regions, filled, regions_of
from schemas.redaction import RedactionMap

type Progress = Callable[[str], None]


def silent(_: str) -> None:
    """Nobody is told."""


@dataclass(frozen=True, slots=True)
class Seen:
    """What was found and hidden in one video."""

    regions: int = 0
    """Regions of the map that count in it."""
    faces: int = 0
    """Finds of the first look, added up over frames."""
    frames_with_faces: int = 0
    """Of the first look."""
    frames_covered: int = 0
    """Frames in which something is hidden for a face, carried places included."""
    frames_blanked: int = 0
    """Frames hidden whole, because the second look still found a face."""
    looks: int = 0
    """How often all of it was looked through."""


@dataclass(frozen=True)
class Hiding:
    """How the pictures of a version are hidden.

    Args:
        map: what is hidden.
        store: root of the store; videos that were encoded once are found again below it.
        fps: frames a second.
        part: where to encode to, on the store's file system.
        eyes: finds faces; may be None where the map asks for none.
        progress: told which video is at hand.
    """

    map: RedactionMap
    store: Path
    fps: int
    part: Path
    eyes: Detector | None
    progress: Progress = silent

    def clips(self, plan: Plan, clips: ByCamera) -> tuple[ByCamera, dict[tuple[str, str], Seen]]:
        """The videos as they are released, and what was done to each, by episode and camera.

        A video in which nothing is hidden is the same file as before, unless the file holds more than the episode: what
        was trimmed off is not handed out with what is left.

        Raises:
            ConfigError: a region does not fit the camera.
            DatasetError: a face is still found at the third look, or a video cannot be read.
        """
        made: dict[str, list[Clip]] = {camera: list(many) for camera, many in clips.items()}
        seen: dict[tuple[str, str], Seen] = {}
        for camera, many in clips.items():
            rule = self.map.cameras.get(camera)
            for k, (id, clip) in enumerate(zip(plan.ids, many, strict=True)):
                here = regions_of(rule, id, height=clip.height, width=clip.width, frames=clip.frames,
                                  where=f"redaction map, cameras.{camera}") if rule is not None else Regions((), ())
                faces, cut = rule is not None and rule.faces, _holds_more(clip)
                if here or faces or cut:
                    self.progress(f"camera {camera}, episode {k + 1} of {len(plan.ids)}")
                    looked = _Video(self, clip, here, faces, cut, f"episode {id}, camera {camera}")
                    made[camera][k], seen[id, camera] = looked.released()
        return made, seen


def _holds_more(clip: Clip) -> bool:
    """Whether a file has pictures that the episode has not."""
    import av
    from av.error import FFmpegError

    packets = 0
    try:
        with av.open(str(clip.file)) as container:
            packets = sum(1 for packet in container.demux(container.streams.video[0]) if packet.size)
    except (FFmpegError, IndexError) as error:
        raise DatasetError(f"the video cannot be read: {error}", where=clip.file, mend="drop the episode") from error
    return packets != clip.frames


def code_hash() -> str:
    """Hash of every source file that decides which pixels are hidden."""
    modules = (covering, detector, regions, video, pixels)
    return source_hash([Path(__file__), *(Path(m.__file__ or "") for m in modules)])


@dataclass(frozen=True)
class _Video:
    """One video on its way to being released."""

    how: Hiding
    clip: Clip
    regions: Regions
    faces: bool
    cut: bool
    """Whether it is encoded in any case, because the file holds more than the episode."""
    where: str

    def released(self) -> tuple[Clip, Seen]:
        key = self._key()
        note = self.how.store / "videos" / f"{key}.seen.json"
        clips = Clips(self.how.store)
        if (known := _noted(note)) is not None:
            seen, sha = known
            if sha == self.clip.sha256:
                return self.clip, seen
            if (clip := clips.find(key)) is not None and clip.sha256 == sha:
                return replace(clip, repeated=self.clip.repeated), seen
        try:
            clip, seen = self._made(key)
            if clip is not self.clip:
                clip = replace(clips.add(self.how.part, clip), repeated=self.clip.repeated)
        finally:
            self.how.part.unlink(missing_ok=True)
        with atomic(note) as stream:
            stream.write(json.dumps({"source": clip.source, "sha256": clip.sha256, "seen": asdict(seen)}).encode())
        return clip, seen

    def _made(self, key: str) -> tuple[Clip, Seen]:
        """What is released, encoded to `part` unless it is the clip itself; looked through until it is clean."""
        nothing: list[list[Box]] = [[] for _ in range(self.clip.frames)]
        found = self._look(FIRST, self.clip) if self.faces else nothing
        hidden = covered(found, self.how.map.faces)
        seen = Seen(len(self.regions), sum(map(len, found)), sum(map(bool, found)), looks=int(self.faces))
        made = self._encoded(key, hidden, frozenset()) if self.cut or self.regions or any(hidden) else self.clip
        if not self.faces:
            return made, seen
        # of a video that was not encoded the first look is known: it found nothing
        left = self._left(made) if made is not self.clip else self._look(SECOND, made)
        whole = frozenset(k for k, boxes in enumerate(left) if boxes)
        if whole:  # what was missed here was perhaps missed beside, too: its place is hidden there as well
            hidden = [a + b for a, b in zip(hidden, covered(left, self.how.map.faces), strict=True)]
            made = self._encoded(key, hidden, whole)
        seen = replace(seen, frames_covered=sum(map(bool, hidden)), frames_blanked=len(whole), looks=3 if whole else 2)
        if whole and any(still := self._left(made)):
            first = next(k for k, boxes in enumerate(still) if boxes)
            raise DatasetError(f"a face is still found in frame {first} with {len(whole)} frames hidden whole",
                               where=self.where, mend="nothing is released: draw a region over it, raise "
                                                      "faces.threshold if it is none, or drop the episode")
        return made, seen

    def _left(self, clip: Clip) -> list[list[Box]]:
        """Where faces are still found in each frame, looked at in two ways."""
        return [a + b for a, b in zip(self._look(FIRST, clip), self._look(SECOND, clip), strict=True)]

    def _pictures(self, clip: Clip) -> Iterator[Picture]:
        return islice(video.decoded(clip.file), clip.first, clip.first + clip.frames)

    def _look(self, look: Look, clip: Clip) -> list[list[Box]]:
        assert self.how.eyes is not None, "the map asks for faces, so there is a detector"
        threshold = self.how.map.faces.threshold
        found = [self.how.eyes.faces(p, look, threshold) for p in self._pictures(clip)]
        if len(found) != clip.frames:
            raise DatasetError(f"{len(found)} of {clip.frames} pictures could be looked at", where=self.where,
                               mend="drop the episode")
        return found

    def _encoded(self, key: str, hidden: list[list[Box]], blank: frozenset[int]) -> Clip:
        counts = pixels.empty()
        pictures = pixels.counted(self._hidden(hidden, blank), counts)
        self.how.part.parent.mkdir(parents=True, exist_ok=True)
        frames, height, width = video.encode(pictures, self.how.part, fps=self.how.fps, where=self.where)
        if frames != self.clip.frames:
            raise DatasetError(f"{frames} of {self.clip.frames} pictures could be read", where=self.where,
                               mend="drop the episode")
        return Clip(self.how.part, "", key, f"{self.clip.source} hidden in {self.clip.sha256}", height, width, frames,
                    counts)

    def _hidden(self, hidden: list[list[Box]], blank: frozenset[int]) -> Iterator[Picture]:
        colour, whole = self.how.map.fill, (0.0, 0.0, float(self.clip.width), float(self.clip.height))
        for k, picture in enumerate(self._pictures(self.clip)):
            yield filled(picture, self.regions.at(k), [whole] if k in blank else hidden[k], colour)

    def _key(self) -> str:
        """Hash of everything that decides which video is released."""
        masks = [[sha256(m.tobytes()), *span] for m, span in zip(self.regions.masks, self.regions.spans, strict=True)]
        eyes = self.how.eyes.about if self.faces and self.how.eyes is not None else None
        how = [self.how.map.faces.model_dump() if self.faces else None, list(self.how.map.fill), eyes]
        clip = [self.clip.sha256, self.clip.first, self.clip.frames]
        encoder = [self.how.fps, video.CODEC, video.PIX_FMT, video.OPTIONS]
        return sha256(json.dumps([clip, masks, how, encoder, code_hash()], sort_keys=True).encode())


def _noted(note: Path) -> tuple[Seen, str] | None:
    """What was found when this video was looked through before, and the hash of what came of it."""
    try:
        told: Mapping[str, Any] = json.loads(note.read_bytes())
        return Seen(**told["seen"]), str(told["sha256"])
    except (OSError, ValueError, KeyError, TypeError):
        return None
