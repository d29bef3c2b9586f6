"""The catalog: Rerun's server with the episodes of a question as a table that is sorted, filtered and clicked."""
# pyright: reportUnknownMemberType=false

import threading
from collections.abc import Generator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import rerun as rr
import rerun.blueprint as rrb
from rerun.catalog import OnDuplicateSegmentLayer
from rerun.server import Server

from pipeline.browsing.episode import APPLICATION
from pipeline.browsing.layers import COLUMNS, PROPERTY, TEXTS

LOCAL = "127.0.0.1"
_END_S = 3.0


@dataclass(frozen=True, slots=True)
class Entry:
    """One episode's files: the recording itself, and layers that are laid over it."""

    id: str
    layers: Mapping[str, Path]
    """Layer -> recording of the same id; 'base' is the episode."""


class Catalog:
    """A running server; see `serving`."""

    def __init__(self, server: Server) -> None:
        self._server = server
        self.url = server.url()
        """Where viewers connect, as rerun+http://127.0.0.1:PORT."""
        self._client: Any = None

    def add(self, dataset: str, entries: Sequence[Entry]) -> None:
        """Put episodes into a dataset, or lay further layers over what is there."""
        target = self._client_now().create_dataset(dataset, exist_ok=True)
        files = [(path, layer) for entry in entries for layer, path in entry.layers.items()]
        if files:
            target.register([path.absolute().as_uri() for path, _ in files], layer_name=[layer for _, layer in files],
                            on_duplicate=OnDuplicateSegmentLayer.REPLACE).wait()

    def arrange(self, dataset: str, blueprint: rrb.Blueprint, folder: Path) -> None:
        """Say how episodes of a dataset, and the table of them, look at once; `folder` keeps the two files."""
        target = self._client_now().create_dataset(dataset, exist_ok=True)
        views, table = folder / f"{dataset}.rbl", folder / f"{dataset}-table.rbl"
        blueprint.save(APPLICATION, views)
        table_blueprint().save(APPLICATION, table)
        target.register_blueprint(views.absolute().as_uri())
        target.register_blueprint(table.absolute().as_uri(), segment_table=True)

    def page(self, dataset: str, episode: str | None = None) -> str:
        """Where a viewer finds a dataset, or one episode of it."""
        target = self._client_now().get_dataset(dataset)
        return str(target.segment_url(episode)) if episode else f"{self.url}/entry/{target.id}"

    def rows(self, dataset: str) -> list[dict[str, object]]:
        """The table of a dataset, as the viewer shows it."""
        return self._client_now().get_dataset(dataset).segment_table().to_pylist()

    def _client_now(self) -> Any:
        if self._client is None:
            self._client = self._server.client()
        return self._client


@contextmanager
def serving() -> Generator[Catalog]:
    """A catalog that only this machine reaches, gone when the body ends."""
    server = Server(host=LOCAL)
    try:
        yield Catalog(server)
    finally:
        # it waits for its last call; a viewer that somebody else connected may never end one
        ending = threading.Thread(target=server.shutdown, daemon=True)
        ending.start()
        ending.join(_END_S)


def table_blueprint() -> rrb.table.TableBlueprint:
    """The columns by which people choose, in their order; Rerun's own bookkeeping is hidden."""
    shown = [rrb.table.Column("recording link", name="episode"),  # the one column of the viewer that opens a recording
             *(rrb.table.Column(f"property:{PROPERTY}:{name}", name=name,
                                column_type=rr.components.Text if name in TEXTS else None) for name in COLUMNS)]
    hidden = [rrb.table.Column(name, visible=False) for name in
              ("rerun_segment_id", "rerun_layer_names", "rerun_storage_urls", "rerun_last_updated_at",
               "rerun_num_chunks", "rerun_size_bytes")]
    return rrb.table.TableBlueprint(table_layout=rrb.table.TableLayout(columns=[*shown, *hidden]))
