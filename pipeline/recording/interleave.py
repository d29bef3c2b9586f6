"""All messages of all ticks in one array: the columns of an episode woven into MCAP message records."""

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from pipeline.recording.columns import Column
from pipeline.recording.records import MESSAGE_FIELDS, MESSAGE_HEAD, Op

type Block = NDArray[np.uint8]


def interleave(columns: Sequence[Column], numbers: Mapping[str, int],
               stamps: NDArray[np.uint64]) -> tuple[Block, list[int]]:
    """Every message record of every tick in one array (m, bytes a tick), and where each topic's record starts.

    One tick's bytes are a template with everything that never changes; the rest is written column by
    column through a structured view, so that no Python runs per message.
    """
    template, starts = bytearray(), list[int]()
    slots: list[tuple[str, object, int]] = []
    fill: list[NDArray[np.generic]] = []
    ticks = len(stamps)
    heads = np.empty(ticks, np.dtype([("sequence", "<u4"), ("log", "<u8"), ("publish", "<u8")]))
    heads["sequence"], heads["log"], heads["publish"] = np.arange(ticks), stamps, stamps
    clock = np.column_stack(np.divmod(stamps, np.uint64(1_000_000_000))).astype("<u4")

    def slot(kind: object, offset: int, data: NDArray[np.generic]) -> None:
        slots.append((f"f{len(slots)}", kind, offset))
        fill.append(data)

    for column in columns:
        layout, start = column.layout, len(template)
        starts.append(start)
        size = MESSAGE_FIELDS + len(layout.template)
        template += MESSAGE_HEAD.pack(Op.MESSAGE, size, numbers[column.topic], 0, 0, 0) + layout.template
        slot(heads.dtype, start + 11, heads)
        payload = start + MESSAGE_HEAD.size
        for offset in layout.stamps:
            slot(("<u4", 2), payload + offset, clock)
        for (offset, count), values in zip(layout.floats, column.values, strict=True):
            slot(("<f8", (count,)), payload + offset, values)
    names, kinds, offsets = zip(*slots, strict=True)
    dtype = np.dtype({"names": names, "formats": kinds, "offsets": offsets, "itemsize": len(template)})
    block = np.empty((ticks, len(template)), np.uint8)
    block[:] = np.frombuffer(template, np.uint8)
    view = block.view(dtype)[:, 0]
    for name, data in zip(names, fill, strict=True):
        view[name] = data
    return block, starts
