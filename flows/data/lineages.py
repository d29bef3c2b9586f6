"""hardcase why: from anything back to its causes and forward to what used it, as text, JSON or a picture."""

from pathlib import Path

from pipeline.errors import ConfigError
from pipeline.store import Store, store_root


def explain(id: str, *, forward: bool = False, as_json: bool = False, svg: Path | None = None) -> str:
    """The chain behind a thing and in front of it; `svg` names a file for the picture of both.

    Raises:
        StoreError: nothing or several things have such an id.
        ConfigError: the picture cannot be written.
    """
    from pipeline.store.lineage import locate, render, to_json, why

    with Store.open(store_root()) as store:
        lineage = why(store, id, full=as_json, back=not forward)
        if svg is not None:
            _draw(store, *locate(store, id), svg)
    return to_json(lineage) if as_json else render(lineage)


def _draw(store: Store, kind: str, id: str, path: Path) -> None:
    from pipeline.files import atomic
    from pipeline.report.lineage import picture
    from pipeline.store.graph import graph_of

    if path.suffix != ".svg":
        raise ConfigError(f"{path.name!r} is no name of a picture", where=f"--svg {path}", mend="write --svg why.svg")
    drawn = picture(graph_of(store, kind, id)).encode()
    try:
        with atomic(path) as stream:
            stream.write(drawn)
    except OSError as error:
        raise ConfigError(f"the picture cannot be written: {error.strerror or error}", where=path,
                          mend="name a file in a folder you may write to, on a disk with space") from error
