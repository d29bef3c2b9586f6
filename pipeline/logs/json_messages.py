"""JSON messages decoded by columns: what is there decides the fields, a schema only says which texts are bytes."""

import base64
import json
from collections import Counter
from collections.abc import Iterator, Sequence
from itertools import chain
from types import MappingProxyType, NoneType
from typing import TYPE_CHECKING, Any, cast

import numpy as np
import orjson

from pipeline.errors import RecordingError
from pipeline.logs.columns import Columns
from pipeline.logs.fields import Fields, Numbers
from pipeline.logs.ros2_layout import compile_type
from pipeline.logs.ros2_types import parse, short

if TYPE_CHECKING:
    from pipeline.logs.batch import Batch, Channel

MAX_FIELDS = 4096
"""Different paths of one batch: far above any robot's."""
MAX_DEPTH = 32
"""Objects and lists in each other, also of a schema."""
ALONE = "data"
"""Path of the value where a message is no object."""
_NS = 1_000_000_000
_TIMES = ({"sec", "nsec"}, {"sec", "nanosec"}, {"secs", "nsecs"})
_PICTURES = ("CompressedImage", "CompressedVideo", "Image", "PointCloud", "PointCloud2", "RawImage")


class _Absent:
    """Stands where a message lacks what others have."""


_ABSENT = _Absent()
_KINDS = MappingProxyType({bool: "number", int: "number", float: "number", str: "text", list: "list", dict: "object"})


def _kind(cell: object) -> str:
    """number, text, list or object; empty where nothing is there."""
    return _KINDS.get(cast(type, type(cell)), "")


class JsonDecoder:
    """Decodes one channel of JSON, under any schema or none."""

    def __init__(self, channel: "Channel") -> None:
        self._coded = _coded(channel)

    def decode(self, batch: "Batch", /) -> Fields:
        """See Decoder. Where a message lacks a number that others of the batch have, it is NaN; a text is empty."""
        cells: list[Any] = []
        rows: list[int] = []
        bad: dict[int, str] = {}
        for row in range(len(batch.starts)):
            try:
                cells.append(_loaded(bytes(batch.payload(row))))
                rows.append(row)
            except (ValueError, RecursionError) as error:
                bad[row] = f"is no JSON: {error}"
        columns, odd = self._columns(cells, rows)
        if len(odd) == len(rows) > 1:  # one message may have spoilt it for all
            odd = {row: why for cell, row in zip(cells, rows, strict=True)
                   for why in self._columns([cell], [row])[1].values()}
            cells = [cell for cell, row in zip(cells, rows, strict=True) if row not in odd]
            rows = [row for row in rows if row not in odd]
            bad |= odd
            columns, odd = self._columns(cells, rows)
        if odd:
            columns = columns.keep(np.array([row not in odd for row in rows], np.bool_))
            rows = [row for row in rows if row not in odd]
        return columns.fields(np.array(rows, np.intp), (bad | odd).items())

    def _columns(self, cells: Sequence[Any], rows: Sequence[int]) -> tuple[Columns, dict[int, str]]:
        """The columns of some messages, and why some of them are none: message -> reason."""
        columns, table = Columns(), _Table(self._coded)
        try:
            table.add(columns, "", cells, rows)
        except ValueError as error:
            return Columns(), dict.fromkeys(rows, str(error))
        return columns, table.odd


def _loaded(payload: bytes) -> Any:
    """The value of one message; ValueError where there is none, or its text has half a character."""
    try:
        return orjson.loads(payload)
    except orjson.JSONDecodeError:  # strict: Python and JavaScript also write NaN and Infinity, which are no JSON
        message = json.loads(payload.decode())
    if b"\\ud" in payload or b"\\uD" in payload:  # a half can be written down only so
        json.dumps(message, ensure_ascii=False).encode()
    return message


class _Table:
    """Turns cells, one a message or one an element of a sequence, into columns."""

    def __init__(self, coded: frozenset[str]) -> None:
        self._coded, self._left = coded, MAX_FIELDS
        self.odd: dict[int, str] = {}
        """Message -> why it does not fit the others."""

    def add(self, columns: Columns, path: str, cells: Sequence[Any], owners: Sequence[int], depth: int = 0) -> None:
        """Add what lies at `path`; owners are the messages that the cells are of.

        Raises:
            ValueError: too many fields, or too deep ones.
        """
        self._left -= 1
        if self._left < 0:
            raise ValueError(f"more than {MAX_FIELDS} different fields in one batch")
        if depth > MAX_DEPTH:
            raise ValueError(f"nested more than {MAX_DEPTH} deep")
        kind, cells = self._settle(path, cells, owners)
        name = path or ALONE
        if kind == "object":
            self._object(columns, path, cells, owners, depth)
        elif kind and path in self._coded:
            columns.blobs[name] = [memoryview(self._bytes(path, *pair)) for pair in zip(cells, owners, strict=True)]
        elif kind == "number":
            columns.values[name] = _numbers(cells)
        elif kind == "text":
            columns.texts[name] = [cell if isinstance(cell, str) else "" for cell in cells]
        elif kind == "list":
            self._list(columns, name, cells, owners, depth)

    def _settle(self, path: str, cells: Sequence[Any], owners: Sequence[int]) -> tuple[str, Sequence[Any]]:
        """The kind of most cells, empty where nothing is there; cells of another kind are taken out."""
        kinds = {_KINDS[kind] for kind in set(map(type, cells)) - {NoneType, _Absent}}
        if len(kinds) < 2:
            return next(iter(kinds), ""), cells
        each = [_kind(cell) for cell in cells]
        main = Counter(kind for kind in each if kind).most_common(1)[0][0]
        wrong = [k for k, kind in enumerate(each) if kind not in ("", main)]
        for k in wrong:
            self.odd.setdefault(owners[k], f"{path or 'the message'} is of kind {each[k]}, in most messages {main}")
        return main, [_ABSENT if kind not in ("", main) else cell for kind, cell in zip(each, cells, strict=True)]

    def _object(self, columns: Columns, path: str, cells: Sequence[Any], owners: Sequence[int], depth: int) -> None:
        objects = cast(list[dict[str, Any]], [cell if type(cell) is dict else {} for cell in cells])
        keys = list(dict.fromkeys(chain.from_iterable(objects)))
        if set(keys) in _TIMES and (time := _time(objects, keys)) is not None:
            columns.values[path] = time
            columns.times.add(path)
            return
        for key in keys:
            inner: list[Any] = [cell.get(key, _ABSENT) for cell in objects]
            self.add(columns, f"{path}.{key}" if path else key, inner, owners, depth + 1)

    def _list(self, columns: Columns, path: str, cells: Sequence[Any], owners: Sequence[int], depth: int) -> None:
        """Sequences; those within sequences are laid end to end."""
        lists: list[list[Any]] = [cell if type(cell) is list else [] for cell in cells]
        counts = list(map(len, lists))
        flat: list[Any] = list(chain.from_iterable(lists))
        if (kinds := set(map(type, flat))) <= {int, float}:
            columns.split(path, _numbers(flat), counts)
            return
        of = [owner for owner, count in zip(owners, counts, strict=True) for _ in range(count)]
        if kinds == {str}:
            columns.names[path] = list(map(tuple, lists))
            return
        inner = Columns()
        self.add(inner, path, flat, of, depth + 1)
        columns.nest(inner, counts)

    def _bytes(self, path: str, cell: object, owner: int) -> bytes:
        try:
            if isinstance(cell, str):
                return base64.b64decode(cell, validate=True)
            return bytes(cast(list[int], cell)) if isinstance(cell, list) else b""
        except (ValueError, TypeError) as error:
            self.odd.setdefault(owner, f"{path}: {error}")
            return b""


def _numbers(cells: Sequence[Any]) -> Numbers:
    kinds = set(map(type, cells))
    if kinds == {bool}:
        return np.array(cells, np.bool_)
    if not kinds <= {bool, int, float}:
        cells = [cell if type(cell) in (bool, int, float) else np.nan for cell in cells]
    if kinds and kinds <= {bool, int} and all(-(1 << 63) <= cell < 1 << 63 for cell in cells):
        return np.array(cells, np.int64)
    try:
        return np.array(cells, np.float64)
    except OverflowError:  # an integer beyond 1e308
        return np.array([float(str(cell)) for cell in cells], np.float64)


def _time(cells: Sequence[dict[str, Any]], keys: Sequence[str]) -> Numbers | None:
    """Seconds and nanoseconds as one [ns]; None where they are no such integers."""
    seconds, rest = sorted(keys, key=lambda key: "n" in key[:1])
    pairs = [(cell.get(seconds), cell.get(rest)) for cell in cells]
    if any(type(s) is not int or type(ns) is not int for s, ns in pairs):
        return None
    totals = [s * _NS + ns for s, ns in cast(list[tuple[int, int]], pairs)]
    return np.array(totals, np.int64) if all(-(1 << 63) <= total < 1 << 63 for total in totals) else None


def _coded(channel: "Channel") -> frozenset[str]:
    """Paths whose texts are base64, or whose numbers are bytes."""
    pictures = {"data"} if short(channel.schema_name).split("/")[-1].split(".")[-1] in _PICTURES else set[str]()
    try:
        if channel.schema_encoding == "jsonschema":
            return frozenset(pictures | set(_contents(json.loads(channel.schema), "", MAX_DEPTH)))
        if channel.schema_encoding == "ros2msg":
            name = short(channel.schema_name)
            plan = compile_type(name, parse(name, str(channel.schema, "utf-8"), channel.topic), channel.topic)
            return frozenset(pictures | {leaf.path for leaf in plan.leaves if leaf.kind == "blob"})
    except (RecordingError, ValueError, RecursionError):
        pass  # JSON says itself what it holds
    return frozenset(pictures)


def _contents(schema: object, path: str, depth: int) -> Iterator[str]:
    if not isinstance(schema, dict) or not depth:
        return
    node = cast(dict[str, Any], schema)
    if node.get("contentEncoding") == "base64":
        yield path
    properties: object = node.get("properties")
    if isinstance(properties, dict):
        for key, inner in cast(dict[str, Any], properties).items():
            yield from _contents(inner, f"{path}.{key}" if path else key, depth - 1)
    yield from _contents(node.get("items"), path, depth - 1)
