"""ROS 2 messages (CDR) decoded by whole columns."""

from typing import TYPE_CHECKING

import numpy as np

from pipeline.logs.columns import Columns, Rows, merge
from pipeline.logs.fields import Fields
from pipeline.logs.ros2_columns import Block, each
from pipeline.logs.ros2_idl import parse_idl
from pipeline.logs.ros2_layout import SLACK, Layout, Walk, compile_type
from pipeline.logs.ros2_types import parse, short

if TYPE_CHECKING:
    from pipeline.logs.batch import Batch, Channel

MAX_KNOWN = 8
"""Layouts kept from batch to batch: a topic has two or three, one for each node that writes to it."""
MAX_ALONE = 4
"""So many layouts that fit one message only, and the rest of the batch is read message by message."""


class Ros2Decoder:
    """Decodes one channel of plain CDR, either byte order.

    The first message is walked; all that are laid out alike are read as columns; then the next that is not.
    """

    def __init__(self, channel: "Channel") -> None:
        name = short(channel.schema_name)
        text = channel.schema.decode("utf-8", "replace")
        reader = parse if channel.schema_encoding == "ros2msg" else parse_idl
        self._plan = compile_type(name, reader(name, text, channel.topic), channel.topic)
        self._known: list[Layout] = []

    def decode(self, batch: "Batch", /) -> Fields:
        """See Decoder."""
        parts: list[tuple[Rows, Columns]] = []
        bad: list[tuple[int, str]] = []
        todo = np.arange(len(batch.starts))
        for layout in self._known:
            if todo.size:
                todo = _take(layout, batch, todo, parts, bad)
        alone, single = 0, dict[bool, list[tuple[int, Walk]]]()
        while todo.size:
            row = int(todo[0])
            try:
                walk = self._walk(bytes(batch.payload(row)))
            except ValueError as error:
                bad.append((row, str(error)))
                todo = todo[1:]
                continue
            if alone < MAX_ALONE:
                layout = walk.layout()
                rest = _take(layout, batch, todo, parts, bad)
                alone += rest.size == todo.size - 1
                self._known = [layout, *self._known[: MAX_KNOWN - 1]]
            else:
                single.setdefault(walk.big, []).append((row, walk))
                rest = todo[1:]
            todo = rest
        parts += [each(batch, found, bad) for found in single.values()]
        rows, columns = merge([part for part in parts if part[0].size])
        return columns.fields(rows, bad)

    def _walk(self, payload: bytes) -> Walk:
        try:
            return Walk(self._plan, payload)
        except ValueError:
            if not any(leaf.kind == "wide" for leaf in self._plan.leaves):
                raise
            return Walk(self._plan, payload, wide=2)  # no standard says how wide; both are in use


def _take(layout: Layout, batch: "Batch", todo: Rows, parts: list[tuple[Rows, Columns]],
          bad: list[tuple[int, str]]) -> Rows:
    """Read the messages that have this layout into a part; returns the others."""
    sizes = batch.sizes[todo]
    least = layout.end if layout.tail < 0 else layout.runs[layout.tail][0][0]
    mask = (sizes >= least) & (sizes <= layout.end + SLACK) if layout.tail < 0 else sizes >= least
    if not mask.any():
        return todo
    block = Block(layout, batch, todo[mask])
    alike = block.alike()
    if not alike.any():
        return todo
    mask[mask] = alike
    block = block.keep(alike)
    texts, wrong = block.texts()
    if wrong:
        bad += [(int(block.rows[k]), reason) for k, reason in wrong]
        fine = np.ones(block.rows.size, np.bool_)
        fine[[k for k, _ in wrong]] = False
        block = block.keep(fine)
        texts, _ = block.texts()
    if block.rows.size:
        parts.append((block.rows, block.columns(texts)))
    return todo[~mask]
