"""The second look for texts: what a map took out is searched for in everything that the version says."""

import json
import re
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

from pipeline.arrow import pa, read_parquet
from pipeline.errors import DatasetError
from pipeline.lerobot_view.layout import MANIFEST, files_in

SHORTEST = 3
"""Texts of fewer letters are not searched for: they stand in everything."""

RECIPE = f"{MANIFEST}: recipe"
"""Its keys are words of ours, such as `common`; what stands behind them is searched."""


def refuse_leaks(folder: Path, content: Mapping[str, Any], originals: Mapping[str, Iterable[str]]) -> None:
    """Return when none of these texts stands in the folder any more, as a word of its own, in any case of letters.

    Args:
        folder: a version without its manifest.
        content: what the manifest will say.
        originals: field -> the texts that were taken out of it.

    Raises:
        DatasetError: one is there; names the field and the place, not the text.
    """
    fields = {text.casefold(): name for name, found in originals.items() for text in found if len(text) >= SHORTEST}
    if not fields:
        return
    longest = sorted(fields, key=len, reverse=True)
    pattern = re.compile(rf"(?<!\w)({'|'.join(map(re.escape, longest))})(?!\w)")
    for place, text in (*_json(MANIFEST, content), *_tables(folder)):
        if (hit := pattern.search(text.casefold())) is not None:
            raise DatasetError(f"what was hidden in {fields[hit[1]]!r} still stands in {place}", where=folder.name,
                               mend="hide that field, too, or drop the episode; nothing is released")


def _tables(folder: Path) -> Iterator[tuple[str, str]]:
    for path in files_in(folder):
        name = path.relative_to(folder).as_posix()
        if path.suffix == ".json":
            yield from _json(name, json.loads(path.read_bytes()))
        elif path.suffix == ".parquet":
            yield from _texts(name, read_parquet(path))


def _texts(name: str, table: Any) -> Iterator[tuple[str, str]]:
    for column, values in zip(table.column_names, table.columns, strict=True):
        while pa.types.is_list(values.type):
            values = pa.chunked_array([chunk.flatten() for chunk in values.chunks], type=values.type.value_type)
        yield name, str(column)
        if pa.types.is_string(values.type):
            yield from ((f"{name}, column {column}", text) for text in dict.fromkeys(values.to_pylist()) if text)


def _json(place: str, value: Any) -> Iterator[tuple[str, str]]:
    if isinstance(value, dict):
        for key, item in value.items():  # pyright: ignore[reportUnknownVariableType]
            if RECIPE not in place:
                yield place, str(key)  # pyright: ignore[reportUnknownArgumentType]
            yield from _json(f"{place}: {key}" if ":" not in place else f"{place}.{key}", item)
    elif isinstance(value, list):
        for item in value:  # pyright: ignore[reportUnknownVariableType]
            yield from _json(place, item)
    elif isinstance(value, str):
        yield place, value
