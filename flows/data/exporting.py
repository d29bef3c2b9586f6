"""hardcase export: a version as a plain folder of real copies, for tools that change what they are given."""

import shutil
from pathlib import Path
from typing import Any

from flows.data.consents import consents_now
from flows.data.deriving import named_version
from pipeline.errors import DatasetError
from pipeline.files import sync_folder
from pipeline.lerobot_view.hub import check_repository, push
from pipeline.lerobot_view.layout import files_in
from pipeline.lerobot_view.manifest import load_version
from pipeline.lerobot_view.opened import open_version
from pipeline.store import Store, store_root


def export_version(name: str, folder: Path, push_to: str | None = None, root: Path | None = None) -> dict[str, Any]:
    """Copy a version; the folder is there whole or not at all.

    Args:
        name: id of the version, or its first digits.
        folder: where to; must not be there, or be empty.
        push_to: USER/NAME on the Hub to upload the copy to as well.
        root: the store; the one of HARDCASE_STORE by default.

    Raises:
        StoreError: there is no such version.
        ConsentError: an episode rests on a consent that does not hold.
        DatasetError: the folder is taken, the version is damaged, the disk is full, or the upload failed.
    """
    if push_to is not None:
        check_repository(push_to)
    if folder.is_symlink() or (folder.exists() and (not folder.is_dir() or any(folder.iterdir()))):
        raise DatasetError("there is something here already", where=folder, mend="name a folder that is not there yet")
    with Store.open(root or store_root()) as store:
        version = named_version(store, name, f"VERSION {name}")
        source = store.path(version.path)
        opened = open_version(source, version)
        people = dict(zip(opened.ids, (str(t or "") for t in opened.texts("consents")), strict=True))
        consents_now(store).check_needs({id: text.split(",") for id, text in people.items() if text}, folder)
        load_version(source)  # every byte is what was built, or nothing leaves the store
        _copy(source, folder)
    size = sum(p.stat().st_size for p in files_in(folder))
    told: dict[str, Any] = {"version": version.id, "folder": str(folder), "bytes": size, "pushed": None}
    told["says"] = f"{folder}: {len(version.episodes)} episodes, {version.frames} frames, {size / 1e6:.1f} MB"
    if push_to is not None:
        told["pushed"] = push(folder, push_to, version.id)
        told["says"] += f"\npushed to {told['pushed']}"
    return told


def _copy(source: Path, folder: Path) -> None:
    part = folder.with_name(f".{folder.name}.part")
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        shutil.rmtree(part, ignore_errors=True)
        shutil.copytree(source, part, copy_function=shutil.copyfile)  # contents alone: the copies may be written
        part.replace(folder)
        sync_folder(folder.parent)
    except OSError as error:
        shutil.rmtree(part, ignore_errors=True)
        raise DatasetError(f"the version cannot be copied: {error.strerror}", where=folder,
                           mend="name a folder on a disk with room that you may write to") from error
