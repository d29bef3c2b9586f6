"""Arrow as the rest of the house sees it: a library without types, and the two conversions we need of it."""

from typing import Any

import numpy as np
import pyarrow  # pyright: ignore[reportMissingTypeStubs]
import pyarrow.ipc  # pyright: ignore[reportMissingTypeStubs, reportUnusedImport]
import pyarrow.parquet  # pyright: ignore[reportMissingTypeStubs, reportUnusedImport]
from numpy.typing import NDArray

pa: Any = pyarrow
"""pyarrow ships no types; as Any it does not drown the rest in warnings."""


def to_arrow(values: NDArray[Any]) -> Any:
    """Rows of shape (n, d) as one Arrow column: scalars if d is 1, else fixed-size lists of d."""
    flat = pa.array(np.ascontiguousarray(values).reshape(-1))
    return flat if values.shape[1] == 1 else pa.FixedSizeListArray.from_arrays(flat, values.shape[1])


def to_rows(column: Any, width: int) -> NDArray[Any]:
    """An Arrow column of scalars, or of lists that all hold `width` values, as rows of shape (n, width).

    Raises:
        ValueError: a value is missing, or the lists are of another length.
    """
    if column.null_count:
        raise ValueError(f"{column.null_count} values are missing")
    nested = pa.types.is_nested(column.type)
    values = column.combine_chunks() if isinstance(column, pa.ChunkedArray) else column
    flat: NDArray[Any] = (values.flatten() if nested else values).to_numpy(zero_copy_only=False)
    if flat.size != len(column) * width:
        raise ValueError(f"{flat.size} values in {len(column)} rows, {width} in each were expected")
    return flat.reshape(len(column), width)
