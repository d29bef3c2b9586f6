"""A derivation's redaction from draft to signed folder: fields, then pictures, then the search, then the statement."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Self

from pipeline.files import source_hash
from pipeline.footage import FEATURE
from pipeline.lerobot_view.deriving import Last
from pipeline.lerobot_view.draft import Draft
from pipeline.lerobot_view.filmed import ByCamera, clips_in
from pipeline.lerobot_view.opened import Opened
from pipeline.lerobot_view.plan import Plan
from pipeline.redaction import content, fields, films, keys, leaks, names, statement
from pipeline.redaction.detector import Detector, centerface
from pipeline.redaction.fields import Texts, redacted
from pipeline.redaction.films import Hiding, Progress, Seen, silent
from pipeline.redaction.leaks import refuse_leaks
from pipeline.redaction.names import refuse_unknown
from pipeline.redaction.statement import Done, write_statement
from schemas import redaction
from schemas import statement as statement_schema
from schemas.redaction import RedactionMap


@dataclass(frozen=True)
class Redaction:
    """One map on its way into one version."""

    map: RedactionMap
    store: Path
    part: Path
    """Where videos are encoded to, on the store's file system."""
    eyes: Detector | None
    words: Texts
    originals: tuple[Opened, ...]
    """The sources of the draft as they lie in the store."""
    draft: Draft
    """Of versions that do not show their hidden fields any more."""
    progress: Progress = silent
    seen: dict[tuple[str, str], Seen] = field(default_factory=dict[tuple[str, str], Seen])

    @classmethod
    def of(cls, map: RedactionMap, store: Path, version: str, draft: Draft, progress: Progress = silent) -> Self:
        """Make ready; where faces are asked for, the detector is loaded and tried before anything else happens.

        Args:
            map: what is hidden.
            store: root of the store.
            version: id of the version that it becomes.
            draft: what it holds.
            progress: told which video is at hand.

        Raises:
            ConfigError: the map names what is not there or must stay.
            DatasetError: faces are asked for and there is no detector that works.
        """
        refuse_unknown(map, draft)
        eyes, words = centerface() if map.asks_for_faces else None, Texts(map)
        hidden = replace(draft, sources=tuple(redacted(source, map, words) for source in draft.sources))
        return cls(map, store, store / "tmp" / f"redacted-{version}.mp4", eyes, words, draft.sources, hidden,
                   progress)

    def clips(self, plan: Plan, clips: ByCamera) -> ByCamera:
        """The videos as they are released; see Hiding."""
        how = Hiding(self.map, self.store, plan.draft.parent.fps, self.part, self.eyes, self.progress)
        made, seen = how.clips(plan, clips)
        self.seen.update(seen)
        return made

    def last(self, plan: Plan, clips: ByCamera, content: Mapping[str, Any]) -> Last:
        """What is done when all files but the manifest are there: the search for texts, then the statement."""
        known = [clips_in(source.folder) for source in self.originals]
        cameras = [c.removeprefix(FEATURE) for c in self.originals[0].cameras]
        before = {(id, camera): known[s][id, camera].sha256
                  for id, (_, s, _, _) in zip(plan.ids, plan.draft.walk(), strict=True) for camera in cameras}
        done = Done(self.store, self.map, self.eyes.about if self.eyes is not None else None, self.originals, plan,
                    before, clips, self.seen)

        def write(folder: Path, hashes: Mapping[str, str]) -> None:
            refuse_leaks(folder, content, self.words.originals())
            write_statement(folder, hashes, content, done)

        return write


def code_hash() -> str:
    """Hash of every source file that decides what a redaction makes of a version."""
    modules = (content, fields, keys, leaks, names, statement, redaction, statement_schema)
    return source_hash([Path(__file__), *(Path(m.__file__ or "") for m in modules)]) + films.code_hash()
