"""Arrow as the rest of the house sees it: a library without types, and the few conversions we need of it."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow  # pyright: ignore[reportMissingTypeStubs]
import pyarrow.ipc  # pyright: ignore[reportMissingTypeStubs, reportUnusedImport]
import pyarrow.parquet  # pyright: ignore[reportMissingTypeStubs, reportUnusedImport]
from numpy.typing import NDArray

pa: Any = pyarrow
"""pyarrow ships no types; as Any it does not drown the rest in warnings."""


def scalars(values: NDArray[Any]) -> Any:
    """Numbers of shape (n,) as an Arrow column that shares their memory.

    Made from the buffer, because `pyarrow.array` imports pandas: 0.4 s that no command should wait for.
    """
    values = np.ascontiguousarray(values)
    return pa.Array.from_buffers(pa.from_numpy_dtype(values.dtype), values.size, [None, pa.py_buffer(values)])


def texts(values: Sequence[str | None]) -> Any:
    """Texts, some of which may be missing, as an Arrow column."""
    encoded = [(value or "").encode() for value in values]
    offsets = np.concatenate([[0], np.cumsum([len(text) for text in encoded])]).astype(np.int32)
    there = np.packbits([value is not None for value in values], bitorder="little")
    buffers = [pa.py_buffer(there), pa.py_buffer(offsets), pa.py_buffer(b"".join(encoded))]
    return pa.Array.from_buffers(pa.string(), len(values), buffers)


def lists(column: Any, width: int) -> Any:
    """Every `width` values of a column as one list of no fixed size."""
    return pa.ListArray.from_arrays(scalars(np.arange(0, len(column) + 1, width, dtype=np.int32)), column)


def to_arrow(values: NDArray[Any]) -> Any:
    """Rows of shape (n, d) as one Arrow column: scalars if d is 1, else fixed-size lists of d."""
    flat = scalars(values.reshape(-1))
    return flat if values.shape[1] == 1 else pa.FixedSizeListArray.from_arrays(flat, values.shape[1])


def opened(file: Path, kind: str) -> tuple[Any, list[int]]:
    """An Arrow file mapped into memory whose metadata say that it is of this format, and the rows of each batch.

    Raises:
        ValueError: it is an Arrow file of another format.
        OSError: it cannot be read.
        ArrowException: it is no Arrow file; Arrow's own errors may also be one of the others.
    """
    reader: Any = pa.ipc.open_file(pa.memory_map(str(file)))
    metadata: dict[bytes, bytes] = reader.schema.metadata or {}
    if metadata.get(b"format") != kind.encode():
        raise ValueError(f"its header does not say {kind}")
    return reader, [reader.get_batch(k).num_rows for k in range(reader.num_record_batches)]


def to_rows(column: Any, width: int) -> NDArray[Any]:
    """An Arrow column of scalars, or of lists that all hold `width` values, as read-only rows of shape (n, width).

    Raises:
        ValueError: a value is missing, or the lists are of another length.
    """
    if column.null_count:
        raise ValueError(f"{column.null_count} values are missing")
    nested = pa.types.is_nested(column.type)
    values = column.combine_chunks() if isinstance(column, pa.ChunkedArray) else column
    flat = values.flatten() if nested else values
    if len(flat) != len(column) * width:
        raise ValueError(f"{len(flat)} values in {len(column)} rows, {width} in each were expected")
    return _numbers(flat).reshape(len(column), width)


def _numbers(column: Any) -> NDArray[Any]:
    """The numbers of an Arrow array without copy; `to_numpy` would import pandas."""
    kind: type[Any] = column.type.to_pandas_dtype()
    if not len(column):
        return np.empty(0, kind)
    return np.frombuffer(column.buffers()[1], kind, len(column), column.offset * column.type.byte_width)


def read_parquet(path: Path, columns: Sequence[str] | None = None) -> Any:
    """A Parquet file as a table; `pyarrow.parquet.read_table` would import pandas and the dataset layer."""
    with pa.parquet.ParquetFile(path) as file:
        return file.read(columns=columns and list(columns), use_threads=False)
