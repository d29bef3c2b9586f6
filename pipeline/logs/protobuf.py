"""Protobuf messages decoded by columns, from the FileDescriptorSet that the log carries.

Source: the MCAP specification's registry, "protobuf": the schema is a FileDescriptorSet, its name the message's.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import chain
from operator import attrgetter
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from google.protobuf import descriptor_pb2, duration_pb2, timestamp_pb2
from google.protobuf.descriptor import Descriptor, FieldDescriptor
from google.protobuf.descriptor_pool import DescriptorPool
from google.protobuf.message import DecodeError, Message
from google.protobuf.message_factory import GetMessageClass

from pipeline.errors import RecordingError
from pipeline.logs.columns import Columns
from pipeline.logs.fields import Fields, Numbers

if TYPE_CHECKING:
    from pipeline.logs.batch import Batch, Channel

MAX_FIELDS = 4096
"""Fields of one type, nested ones counted: far above any robot's."""
_MEND = "record with the complete FileDescriptorSet, or leave the topic out of the map"
_NS = 1_000_000_000
_TIMES = ("google.protobuf.Timestamp", "google.protobuf.Duration")
_DTYPES = MappingProxyType({
    FieldDescriptor.CPPTYPE_INT32: "i4", FieldDescriptor.CPPTYPE_INT64: "i8", FieldDescriptor.CPPTYPE_UINT32: "u4",
    FieldDescriptor.CPPTYPE_UINT64: "u8", FieldDescriptor.CPPTYPE_FLOAT: "f4", FieldDescriptor.CPPTYPE_DOUBLE: "f8",
    FieldDescriptor.CPPTYPE_BOOL: "?", FieldDescriptor.CPPTYPE_ENUM: "i4",
})


@dataclass(frozen=True, slots=True)
class Leaf:
    """A field, reached from a message by `get`."""

    path: str
    get: Callable[[Any], Any]
    field: FieldDescriptor
    inner: "tuple[Leaf, ...]" = ()
    """Leaves of the elements, for a sequence of messages."""


class ProtobufDecoder:
    """Decodes one channel of protobuf, its types in a pool of their own."""

    def __init__(self, channel: "Channel") -> None:
        try:
            descriptor = _pool(channel.schema).FindMessageTypeByName(channel.schema_name)
            self._class: type[Message] = GetMessageClass(descriptor)
        except (KeyError, TypeError, ValueError, DecodeError, RecursionError) as error:
            reason = " ".join(str(error).split())[:200]
            raise RecordingError(f"the schema of {channel.schema_name} cannot be used: {reason}", where=channel.topic,
                                 mend=_MEND) from None
        self._leaves = _Planner(channel.schema_name, channel.topic).leaves(descriptor)

    def decode(self, batch: "Batch", /) -> Fields:
        """See Decoder."""
        messages: list[Message] = []
        rows: list[int] = []
        bad: list[tuple[int, str]] = []
        parse = self._class.FromString
        for row in range(len(batch.starts)):
            try:
                messages.append(parse(bytes(batch.payload(row))))
                rows.append(row)
            except DecodeError as error:
                bad.append((row, f"is no {self._class.DESCRIPTOR.full_name}: {error}"))
        columns = Columns()
        try:
            _fill(columns, self._leaves, messages)
        except (ValueError, OverflowError):  # one message at least has a time or text that cannot be
            columns, fits = Columns(), [self._fits(message) for message in messages]
            bad += [(row, reason) for row, reason in zip(rows, fits, strict=True) if reason]
            rows = [row for row, reason in zip(rows, fits, strict=True) if not reason]
            _fill(columns, self._leaves, [m for m, reason in zip(messages, fits, strict=True) if not reason])
        return columns.fields(np.array(rows, np.intp), bad)

    def _fits(self, message: Message) -> str:
        """Why a message cannot be a row, empty if it can."""
        try:
            _fill(Columns(), self._leaves, [message])
        except (ValueError, OverflowError) as error:
            return str(error)
        return ""


def _pool(schema: bytes) -> DescriptorPool:
    """The schema's files in a pool, each after those that it imports."""
    files = {file.name: file for file in descriptor_pb2.FileDescriptorSet.FromString(schema).file}
    for known in (timestamp_pb2, duration_pb2):  # some writers leave out what every program has
        file = descriptor_pb2.FileDescriptorProto.FromString(known.DESCRIPTOR.serialized_pb)
        files.setdefault(file.name, file)
    pool, added = DescriptorPool(), set[str]()
    waiting = [(name, False) for name in files]
    while waiting:
        name, ready = waiting.pop()
        if name in added or name not in files:
            continue
        if ready:
            pool.Add(files[name])
            added.add(name)
        else:
            waiting.append((name, True))
            missing = [other for other in files[name].dependency if other not in added]
            if any((other, True) in waiting for other in missing):
                raise ValueError(f"{name} imports itself")
            waiting += [(other, False) for other in missing]
    return pool


class _Planner:
    """Lists the leaves of a type; a field that would hold a type that it lies in is left out."""

    def __init__(self, name: str, where: object) -> None:
        self._name, self._where, self._left = name, where, MAX_FIELDS

    def leaves(self, kind: Descriptor, above: tuple[str, ...] = (), names: tuple[str, ...] = ()) -> tuple[Leaf, ...]:
        """The leaves of `kind`, whose own path is `names`."""
        found: list[Leaf] = []
        above = (*above, kind.full_name)
        for field in kind.fields:
            self._left -= 1
            if self._left < 0:
                raise RecordingError(f"{self._name} has more than {MAX_FIELDS} fields", where=self._where, mend=_MEND)
            path = (*names, field.name)
            inner: Descriptor | None = field.message_type
            leaf = Leaf(".".join(path), attrgetter(".".join(path)), field)
            if inner is None or inner.full_name in _TIMES:
                found.append(leaf)
            elif inner.full_name in above:
                continue
            elif field.is_repeated:
                if inner.GetOptions().map_entry and [f.name for f in inner.fields] != ["key", "value"]:
                    raise RecordingError(f"{inner.full_name} is a map without key and value", where=self._where,
                                         mend=_MEND)
                found.append(Leaf(leaf.path, leaf.get, field, self.leaves(inner, above)))
            else:
                found += self.leaves(inner, above, path)
        return tuple(found)


class _Entry(NamedTuple):
    """One entry of a map, as its type names the fields."""

    key: Any
    value: Any


def _fill(columns: Columns, leaves: Sequence[Leaf], messages: Sequence[Any]) -> None:
    """Add the columns of messages of one type; ValueError or OverflowError on a value that has no place in one."""
    for leaf in leaves:
        cells: list[Any] = list(map(leaf.get, messages))
        if leaf.field.is_repeated:
            _sequence(columns, leaf, cells)
        elif leaf.field.type == FieldDescriptor.TYPE_BYTES:
            columns.blobs[leaf.path] = list(map(memoryview, cells))
        elif leaf.field.type == FieldDescriptor.TYPE_STRING:
            columns.texts[leaf.path] = cells
        else:
            columns.values[leaf.path] = _numbers(leaf, cells)
            if leaf.field.message_type is not None:
                columns.times.add(leaf.path)


def _sequence(columns: Columns, leaf: Leaf, cells: Sequence[Any]) -> None:
    field, path, inner_type = leaf.field, leaf.path, leaf.field.message_type
    counts = list(map(len, cells))
    if field.type == FieldDescriptor.TYPE_BYTES:
        columns.blobs[path] = [memoryview(b"".join(cell)) for cell in cells]
    elif field.type == FieldDescriptor.TYPE_STRING:
        columns.names[path] = list(map(tuple, cells))
    elif leaf.inner:
        inner = Columns()
        if inner_type is not None and inner_type.GetOptions().map_entry:  # sorted, since a map has no order
            _fill(inner, leaf.inner, [_Entry(key, cell[key]) for cell in cells for key in sorted(cell)])
        else:
            _fill(inner, leaf.inner, list(chain.from_iterable(cells)))
        columns.nest(inner, counts, f"{path}.")
    elif inner_type is None or inner_type.full_name in _TIMES:
        columns.split(path, _numbers(leaf, list(chain.from_iterable(cells))), counts)
        columns.times.update([path] if inner_type else [])


def _numbers(leaf: Leaf, cells: Sequence[Any]) -> Numbers:
    if leaf.field.message_type is None:
        return np.array(cells, _DTYPES[leaf.field.cpp_type])
    return np.array([cell.seconds * _NS + cell.nanos for cell in cells], np.int64)
