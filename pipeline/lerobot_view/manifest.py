"""The lineage of a version, read back from its folder and checked against the bytes."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from pipeline.errors import DatasetError
from pipeline.files import sha256, sha256_file
from pipeline.lerobot_view.layout import MANIFEST, files_in
from schemas.dataset import DatasetVersion

FORMAT = "hardcase-version-1"


def write_content(version: dict[str, object], **more: object) -> dict[str, object]:
    """What a manifest holds besides the digests of files; `version` is a DatasetVersion without its digest."""
    return {"format": FORMAT, "version": version, **more}


def read_manifest(folder: Path) -> dict[str, Any]:
    """The content of meta/hardcase.json.

    Raises:
        DatasetError: there is none, or it is not one of ours.
    """
    mend = "give the folder of a dataset version, or build it again: hardcase build"
    try:
        manifest = json.loads((folder / MANIFEST).read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise DatasetError("not a dataset version (no readable meta/hardcase.json)", where=folder, mend=mend) from error
    if not isinstance(manifest, dict) or manifest.get("format") != FORMAT:  # pyright: ignore[reportUnknownMemberType]
        raise DatasetError(f"meta/hardcase.json is not of format {FORMAT}", where=folder, mend=mend)
    return manifest  # pyright: ignore[reportUnknownVariableType]


def digest_of(files: Mapping[str, str]) -> str:
    """The digest of a folder from those of its files, by relative path."""
    return sha256("".join(f"{name}\0{files[name]}\n" for name in sorted(files)).encode())


def load_version(folder: Path) -> DatasetVersion:
    """The version that lies in a folder, its digest taken from the bytes that are there now.

    Raises:
        DatasetError: no version, or a file is missing, was added or was changed since it was built.
    """
    manifest = read_manifest(folder)
    files = {p.relative_to(folder).as_posix(): sha256_file(p) for p in files_in(folder)}
    digest = digest_of(files)
    try:
        promised: dict[str, str] = {**manifest["files"], MANIFEST: files[MANIFEST]}
        version = DatasetVersion.model_validate({**manifest["version"], "digest": digest})
    except (KeyError, TypeError, ValidationError) as error:
        raise DatasetError("meta/hardcase.json does not describe a version", where=folder,
                           mend="build the version again: hardcase build") from error
    if wrong := sorted(name for name in promised.keys() | files.keys() if promised.get(name) != files.get(name)):
        kind = "is missing" if wrong[0] not in files else "was added" if wrong[0] not in promised else "was changed"
        raise DatasetError(f"{wrong[0]} {kind} after the version was built", where=folder,
                           mend=f"remove the folder and build the version again: rm -r {folder} && hardcase build")
    return version
