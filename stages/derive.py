"""Derive: a dataset version and some edits become another version, which shares with it all that did not change.

The id follows from the parent's id, the edits and the code. So a derivation that was killed and started again ends in
the same version, and the same edits make the same version on every machine.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any

from pipeline import arrow, query
from pipeline.check.door import NO_VERDICTS, Verdicts
from pipeline.consent import NO_CONSENTS, Consents
from pipeline.errors import DatasetError
from pipeline.files import sha256, short_id, source_hash
from pipeline.lerobot_view import (
    clips,
    derived_table,
    deriving,
    draft,
    exact,
    filmed,
    layout,
    manifest,
    moved,
    opened,
    pixels,
    plan,
    reweighing,
    sealing,
    tables,
    video,
)
from pipeline.lerobot_view.draft import drafted
from pipeline.lerobot_view.manifest import digest_of, load_version
from pipeline.lerobot_view.opened import Opened, open_version, refuse_other_features
from pipeline.lerobot_view.plan import Plan, planned
from pipeline.redaction import redacting
from pipeline.redaction.films import Progress, silent
from pipeline.redaction.redacting import Redaction
from schemas import edits as edit_schemas
from schemas.dataset import DatasetVersion
from schemas.edits import Add, Edit, Redact
from schemas.episode import Episode

FOLDER = "versions"
"""Where versions lie, relative to the store's root."""

NO_OTHERS: Mapping[str, DatasetVersion] = MappingProxyType({})

type EpisodesOf = Callable[[Sequence[str]], tuple[Iterable[Episode], Iterable[Episode]]]
"""Ids -> those episodes, and everything that they were made from."""


def derive(parent: DatasetVersion, edits: Sequence[Edit], *, store: Path,
           others: Mapping[str, DatasetVersion] = NO_OTHERS, consents: Consents = NO_CONSENTS,
           verdicts: Verdicts = NO_VERDICTS, episodes_of: EpisodesOf | None = None,
           progress: Progress = silent) -> DatasetVersion:
    """Make the version that the edits ask for, or return it if it is already there.

    Nothing is encoded again but videos that a redaction changes.

    Args:
        parent: the version that is edited; it does not change.
        edits: at least one, in the order in which they count; a redaction is the last.
        store: root of the store; the version becomes store/versions/ID.
        others: the versions that Add edits name, by id.
        consents: who agrees at this moment; an episode of somebody who does not is refused.
        verdicts: what the checks found; an episode that failed is refused.
        episodes_of: looks episodes up, asked only where a verdict is a failure.
        progress: told which video is being redacted.

    Raises:
        ConsentError: an episode that is left rests on a consent that does not hold.
        ConfigError: a redaction names what is not there or must stay.
        DatasetError: an edit asks for what is not there, nothing is left, features differ, an episode failed its
            check, a file of the parent is damaged, or a redaction cannot be vouched for.
    """
    if not edits:
        raise DatasetError("no edit was asked for", where=f"version {parent.id}",
                           mend="say what is to change: hardcase derive --help")
    redact = _redact(parent, edits)
    code = code_hash() if redact is None else sha256(f"{code_hash()} {redacting.code_hash()}".encode())
    gone = [(v.id, v.erased) for v in (parent, *others.values()) if v.erased]
    id = short_id("derived version", parent.id, code, *gone, *(e.model_dump_json() for e in edits))
    if (target := store / FOLDER / id).exists():
        return load_version(target)
    draft = drafted(open_version(store / parent.path, parent), [e for e in edits if e is not redact],
                    _opened(parent, edits, others, store))
    redaction = Redaction.of(redact.map, store, id, draft, progress) if redact is not None else None
    made = planned(redaction.draft if redaction is not None else draft)
    _refuse_people(made, consents)
    if episodes_of is not None and any(not v.passed for v in verdicts.by_subject.values()):
        verdicts.check(*episodes_of(made.ids))
    videos = deriving.clips_of(made)
    videos = redaction.clips(made, videos) if redaction is not None else videos
    content = _content(parent, edits, made, {"id": id, "code": code, "path": f"{FOLDER}/{id}"})
    hashes = deriving.write_derived(target, made, content, aside=store / "tmp", clips=videos, last=redaction and
                                    redaction.last(made, videos, content))
    return DatasetVersion.model_validate({**content["version"], "digest": digest_of(hashes)})


def _redact(parent: DatasetVersion, edits: Sequence[Edit]) -> Redact | None:
    """The redaction among the edits."""
    found = [edit for edit in edits if isinstance(edit, Redact)]
    if found and (len(found) > 1 or edits[-1] is not found[0]):
        raise DatasetError("a redaction comes last, and once: what comes after it would not be hidden",
                           where=f"version {parent.id}", mend="put it at the end of the edits, in one map")
    return found[0] if found else None


def code_hash() -> str:
    """Hash of every source file that decides what an edit makes of a version."""
    modules = (arrow, query, clips, derived_table, deriving, draft, exact, filmed, layout, manifest, moved, opened,
               pixels, plan, reweighing, sealing, tables, video, edit_schemas)
    return source_hash([Path(__file__), *(Path(m.__file__ or "") for m in modules)])


def _opened(parent: DatasetVersion, edits: Sequence[Edit], others: Mapping[str, DatasetVersion],
            store: Path) -> dict[str, Opened]:
    """The versions that episodes are added from, each with the features of the parent."""
    found: dict[str, Opened] = {}
    for edit in edits:
        if isinstance(edit, Add) and edit.version not in found:
            other = others[edit.version]
            found[other.id] = open_version(store / other.path, other)
            refuse_other_features(found[other.id].info, open_version(store / parent.path, parent).info,
                                  where=f"version {other.id} beside version {parent.id}")
    return found


def _refuse_people(made: Plan, consents: Consents) -> None:
    texts: list[str | None] = made.draft.gathered("consents")
    needed = {id: tuple(text.split(",")) for id, text in zip(made.ids, texts, strict=True) if text}
    consents.check_needs(needed, f"a version derived from {made.draft.parent.version.id}")


def _content(parent: DatasetVersion, edits: Sequence[Edit], made: Plan, facts: Mapping[str, object]) -> dict[str, Any]:
    """What the manifest says: the parent's words, with what the version is and whose side each lineage is on."""
    before = {key: value for key, value in made.draft.parent.manifest.items() if key != "files"}
    blobs: list[str | None] = made.draft.gathered("blob")
    sides: dict[str, str] = {}
    for source in made.draft.sources:
        for side in ("held_out", "train"):
            for lineage in source.manifest["lineages"][side]:
                sides.setdefault(lineage, side)
    version = {
        **facts, "recipe": parent.recipe, "parent": parent.id,
        "generation": max(source.version.generation for source in made.draft.sources), "episodes": made.ids,
        "held_out": [id for id, side in zip(made.ids, made.split, strict=True) if side == "held_out"],
        "weights": made.weighed.shares, "inputs": list(dict.fromkeys(filter(None, blobs))),
        "frames": made.frames, "edits": [e.model_dump(mode="json") for e in edits]}
    return {**before, "version": version, "task": made.tasks[0] if len(made.tasks) == 1 else made.tasks,
            "lineages": {side: sorted(one for one, its in sides.items() if its == side)
                         for side in ("held_out", "train")}}
