"""A version folder comes into being: built aside, made durable and read-only, then named in one step."""

import errno
import json
import os
import shutil
from collections.abc import Collection, Generator, Mapping
from contextlib import contextmanager
from pathlib import Path

from pipeline.errors import DatasetError
from pipeline.files import sha256_file, sync_folder
from pipeline.lerobot_view import layout

FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EROFS)


@contextmanager
def building(target: Path, aside: Path) -> Generator[Path]:
    """An empty folder beside, which becomes `target` once the body has filled and sealed it.

    Whoever looks at `target` sees nothing or all of it. What a killed writer left behind is removed by the next.

    Args:
        target: the folder, which must not exist yet.
        aside: a folder for unfinished things, on the same file system.

    Raises:
        DatasetError: the disk is full or read-only; nothing is left behind.
    """
    folder = aside / f"version-{target.name}"
    try:
        if folder.exists():
            shutil.rmtree(folder)
        folder.mkdir(parents=True)
        target.parent.mkdir(parents=True, exist_ok=True)
        yield folder
        folder.rename(target)
        sync_folder(target.parent)
    except BaseException as error:
        shutil.rmtree(folder, ignore_errors=True)
        if isinstance(error, OSError) and error.errno in FULL:
            raise DatasetError(f"the version cannot be written: {os.strerror(error.errno)}", where=target,
                               mend="free space (hardcase gc), then build again") from error
        raise


def link(source: Path, target: Path) -> None:
    """One file under two names; a copy where the file system cannot do that."""
    target.parent.mkdir(parents=True, exist_ok=True)
    try:
        os.link(source, target)
    except OSError:
        shutil.copyfile(source, target)


def write_manifest(folder: Path, content: Mapping[str, object], known: Mapping[str, str]) -> dict[str, str]:
    """Write the manifest with the digest of every other file; returns all digests, that of the manifest included.

    Args:
        folder: a version whose other files are all there.
        content: what else the manifest says.
        known: digests of files that need not be read, because a manifest vouches for them already.
    """
    files = {name: known.get(name) or sha256_file(path) for path in layout.files_in(folder)
             for name in (path.relative_to(folder).as_posix(),)}
    write_json(folder / layout.MANIFEST, {**content, "files": files})
    return {**files, layout.MANIFEST: sha256_file(folder / layout.MANIFEST)}


def write_json(path: Path, content: Mapping[str, object]) -> None:
    """A JSON file that people can read; NaN and infinity are errors."""
    path.write_text(json.dumps(content, indent=1, ensure_ascii=False, allow_nan=False) + "\n", encoding="utf-8")


def seal(folder: Path, durable: Collection[str] = ()) -> None:
    """Take the right to write from every file, and wait until files and names are on the disk.

    Args:
        folder: a version with its manifest.
        durable: files that are sealed and on the disk already, under another name.
    """
    for path in layout.files_in(folder):
        if path.relative_to(folder).as_posix() in durable and path.stat().st_nlink > 1:
            continue  # a copy, where links are impossible, is as new as any other file
        path.chmod(0o444)
        with path.open("rb") as stream:
            os.fsync(stream.fileno())
    for path in sorted((p for p in folder.rglob("*") if p.is_dir()), reverse=True):
        sync_folder(path)
    sync_folder(folder)
