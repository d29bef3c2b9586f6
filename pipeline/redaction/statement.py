"""The signed statement of a redacted version: written with it, written again when an episode is forgotten, verified."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from pipeline.errors import DatasetError
from pipeline.files import sha256, sha256_file
from pipeline.lerobot_view.filmed import ByCamera, clips_in
from pipeline.lerobot_view.layout import MANIFEST, files_in
from pipeline.lerobot_view.opened import Opened
from pipeline.lerobot_view.plan import Plan
from pipeline.redaction.content import as_built, data_of, meta_of
from pipeline.redaction.films import Seen
from pipeline.redaction.keys import Blind, public_pem, store_key, verify
from schemas.redaction import RedactionMap
from schemas.statement import Change, EpisodeChange, Statement, VideoChange

STATEMENT, SIGNATURE, PUBLIC_KEY = "meta/redaction.json", "meta/redaction.sig", "meta/redaction.pub"
OWN = (STATEMENT, SIGNATURE, PUBLIC_KEY, MANIFEST)
PACKAGES = ("hardcase", "av", "numpy", "pillow", "pyarrow")
NOTHING = Seen()


@dataclass(frozen=True)
class Done:
    """What a redaction did, before it is written down."""

    store: Path
    map: RedactionMap
    detector: dict[str, str] | None
    originals: Sequence[Opened]
    """The sources of the derivation as they lie in the store."""
    plan: Plan
    before: Mapping[tuple[str, str], str]
    """Episode and camera -> sha256 of the parent's video."""
    clips: ByCamera
    seen: Mapping[tuple[str, str], Seen]


def write_statement(folder: Path, known: Mapping[str, str], content: Mapping[str, Any], done: Done) -> None:
    """Write and sign what was done into a version that is whole but for its manifest.

    Args:
        folder: the version.
        known: digests of files that need not be read.
        content: what the manifest will say.
        done: what was done.

    Raises:
        StoreError: the key of the store cannot be used.
    """
    key = store_key(done.store)
    told, files = content["version"], _hashes(folder, known)
    blind, built = Blind(key, told["id"]), as_built(folder, told, files)
    draft = done.plan.draft
    episodes: dict[str, EpisodeChange] = {}
    for k, (id, (_, s, row, _)) in enumerate(zip(done.plan.ids, draft.walk(), strict=True)):
        old = done.originals[s]
        episodes[id] = EpisodeChange(
            data=Change(before=blind(data_of(old, row)), after=sha256(data_of(built, k))),
            meta=Change(before=blind(meta_of(old, row)), after=sha256(meta_of(built, k))),
            videos=_videos(done, id, k))
    parent = draft.parent.version
    _sign(folder, key, Statement(
        version=told["id"], parent=parent.id, parent_digest=blind(parent.digest.encode()), code=told["code"],
        map=done.map, detector=done.detector, software=_software(), counts=_counts(episodes), episodes=episodes,
        files=files, manifest=manifest_hash(content)))


def _videos(done: Done, id: str, k: int) -> dict[str, VideoChange]:
    found: dict[str, VideoChange] = {}
    for (episode, camera), before in done.before.items():
        if episode == id:
            after = done.clips[camera][k].sha256 if camera in done.clips else None
            found[camera] = VideoChange(before=before, after=after, **asdict(done.seen.get((id, camera), NOTHING)))
    return found


def sign_again(folder: Path, known: Mapping[str, str], content: Mapping[str, Any], *, store: Path, old: Path) -> None:
    """Write the statement of a version that lost episodes into its new folder; without one in the old, nothing.

    Raises:
        DatasetError: the old statement cannot be read.
        StoreError: the key of the store cannot be used.
    """
    if not (old / STATEMENT).is_file():
        return
    said = read_statement(old)
    left = set(content["version"]["episodes"])
    episodes = {id: change for id, change in said.episodes.items() if id in left}
    gone = tuple(content["version"]["erased"])
    _sign(folder, store_key(store), said.model_copy(update={
        "episodes": episodes, "counts": _counts(episodes), "files": _hashes(folder, known), "erased": gone,
        "manifest": manifest_hash(content)}))


def read_statement(folder: Path) -> Statement:
    """The statement of a folder, unverified.

    Raises:
        DatasetError: there is none, or it cannot be read.
    """
    path = folder / STATEMENT
    try:
        return Statement.model_validate_json(path.read_bytes())
    except OSError as error:
        raise DatasetError("no signed statement: this is no redacted version", where=path,
                           mend="derive one: hardcase derive VERSION --redact MAP.yaml") from error
    except ValidationError as error:
        raise DatasetError("the statement cannot be read", where=path, mend="ask for the version again") from error


def verify_folder(folder: Path) -> tuple[Statement, str]:
    """Check signature and hashes of a redacted version, in the store or exported; the statement and the key as PEM.

    That the key is the one of whom you think is not checked: it lies beside.

    Raises:
        DatasetError: the first thing that differs.
    """
    said = read_statement(folder)
    mend = "do not trust the folder; ask whoever gave it for the version again"
    try:
        pem, signature = ((folder / name).read_text(encoding="ascii") for name in (PUBLIC_KEY, SIGNATURE))
    except (OSError, UnicodeDecodeError) as error:
        raise DatasetError("the signature or its public key is missing", where=folder, mend=mend) from error
    verify(pem, signature, (folder / STATEMENT).read_bytes(), folder / STATEMENT)
    found, order = _hashes(folder, {}), list(said.episodes)
    for name in sorted(said.files.keys() | found.keys()):
        if said.files.get(name) != found.get(name):
            how = "is missing" if name not in found else "was added" if name not in said.files else "was changed"
            raise DatasetError(f"{name}{_whose(name, order)} {how} since the statement was signed", where=folder,
                               mend=mend)
    try:
        content: dict[str, Any] = json.loads((folder / MANIFEST).read_bytes())
        promised = {n: sha for n, sha in content.pop("files").items() if n not in OWN}
    except (OSError, ValueError, KeyError, AttributeError) as error:
        raise DatasetError(f"{MANIFEST} is missing or cannot be read", where=folder, mend=mend) from error
    if manifest_hash(content) != said.manifest or promised != said.files:
        raise DatasetError(f"{MANIFEST} was changed since the statement was signed", where=folder, mend=mend)
    return said, pem


def verify_before(said: Statement, parent: Opened, store: Path) -> list[str]:
    """Compare the keyed hashes with the parent in the store that signed; the episodes that differ.

    Episodes that were added from other versions, or that the parent has lost since, are passed over.
    """
    blind, place = Blind(store_key(store), said.version), {id: k for k, id in enumerate(parent.ids)}
    videos = clips_in(parent.folder)
    wrong: list[str] = []
    for id, change in said.episodes.items():
        if (k := place.get(id)) is None:
            continue
        same = (change.data.before, change.meta.before) == (blind(data_of(parent, k)), blind(meta_of(parent, k)))
        if not same or any(videos[id, camera].sha256 != v.before for camera, v in change.videos.items()):
            wrong.append(id)
    return wrong


def manifest_hash(content: Mapping[str, Any]) -> str:
    """Hash of what a manifest says besides the digests of files."""
    return sha256(json.dumps(content, sort_keys=True, ensure_ascii=False).encode())


def _sign(folder: Path, key: Any, said: Statement) -> None:
    data = (said.model_dump_json(indent=1) + "\n").encode()
    (folder / STATEMENT).write_bytes(data)
    (folder / SIGNATURE).write_text(key.sign(data).hex() + "\n", encoding="ascii")
    (folder / PUBLIC_KEY).write_text(public_pem(key), encoding="ascii")


def _hashes(folder: Path, known: Mapping[str, str]) -> dict[str, str]:
    """sha256 of every file that a statement speaks of."""
    names = {path.relative_to(folder).as_posix(): path for path in files_in(folder)}
    return {name: known.get(name) or sha256_file(path) for name, path in names.items() if name not in OWN}


def _counts(episodes: Mapping[str, EpisodeChange]) -> dict[str, int]:
    videos = [v for change in episodes.values() for v in change.videos.values()]
    counted = ("regions", "faces", "frames_with_faces", "frames_covered", "frames_blanked")
    changed = sum(v.before != v.after for v in videos)
    return {"episodes": len(episodes), "videos": len(videos), "videos_changed": changed,
            **{name: sum(getattr(v, name) for v in videos) for name in counted}}


def _software() -> dict[str, str]:
    found: dict[str, str] = {}
    for name in PACKAGES:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            found[name] = "unknown"
    return found


def _whose(name: str, order: Sequence[str]) -> str:
    """The episode whose video a file is, in words."""
    parts = name.split("/")
    if parts[0] != "videos" or not parts[-1].startswith("file-"):
        return ""
    number = int(parts[-2].removeprefix("chunk-")) * 1000 + int(parts[-1].removeprefix("file-").removesuffix(".mp4"))
    return f" (episode {order[number]})" if number < len(order) else ""
