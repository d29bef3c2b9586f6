"""ROS 2 messages of random types: what rosbags wrote is what the decoder reads, field by field."""

from collections.abc import Iterator
from typing import Any

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from pipeline.logs.decode import decoder

DTYPES = {"bool": "?", "byte": "u1", "char": "u1", "int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2",
          "int32": "i4", "uint32": "u4", "int64": "i8", "uint64": "u8", "float32": "f4", "float64": "f8"}
TEXTS = ["", "a", "arm/joint_1", "größe", "日本", "x" * 40]

type Types = list[list[tuple[str, str]]]

counts = st.sampled_from(["", "", "", "[]", "[<=4]", "[3]", "[1]"])


@st.composite
def definitions(draw: st.DrawFn) -> Types:
    """Types as (field type, count); type k holds only later types."""
    made: Types = []
    total = draw(st.integers(1, 3))
    for k in range(total):
        others = [f"T{j}" for j in range(k + 1, total)]
        kinds = st.sampled_from([*DTYPES, "string", "string", "builtin_interfaces/Time", "uint8", *others * 3])
        made.append(draw(st.lists(st.tuples(kinds, counts), min_size=1, max_size=6)))
    return made


def text_of(types: Types) -> str:
    """The definitions as a log carries them, with what parsers stumble over."""
    parts = []
    for k, fields in enumerate(types):
        lines = [f"{kind}{count} f{n}  # f{n}[] is no field" for n, (kind, count) in enumerate(fields)]
        lines.insert(0, "uint8 LIMIT = 3  # a constant\n\n# a comment")
        parts.append(f"MSG: p/T{k}\n" * (k > 0) + "\n".join(lines) + "\n")
    time = f"{'=' * 80}\nMSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n"
    return f"{'=' * 80}\n".join(parts) + time


def value_of(store: Any, types: Types, kind: str, count: str, rng: np.random.Generator) -> Any:
    """A random value of one member, as rosbags takes it."""
    if count:
        length = int(count[1:-1]) if count[1:-1].isdigit() else int(rng.integers(0, 4))
        if kind in DTYPES:
            raw = rng.integers(0, 256, 8 * length, np.uint8)
            raw %= {"bool": 2, "byte": 128}.get(kind, 255)  # rosbags takes a byte for signed
            return raw.view(DTYPES[kind])[:length]
        return [value_of(store, types, kind, "", rng) for _ in range(length)]
    if kind in DTYPES:
        return value_of(store, types, kind, "[1]", rng)[0].item()
    if kind == "string":
        return TEXTS[rng.integers(len(TEXTS))]
    if kind == "builtin_interfaces/Time":
        return store.types["builtin_interfaces/msg/Time"](int(rng.integers(-5, 2**31)), int(rng.integers(10**9)))
    fields = types[int(kind[1:])]
    return store.types[f"p/msg/{kind}"](*(value_of(store, types, *field, rng) for field in fields))


def flat(types: Types, kind: str, path: str, values: list[Any]) -> Iterator[tuple[str, str, list[Any]]]:
    """(path, kind, values of one message laid end to end)."""
    if not kind.startswith("T"):
        yield path, kind, values
        return
    for n, (inner, count) in enumerate(types[int(kind[1:])]):
        below = [getattr(value, f"f{n}") for value in values]
        name = f"{path}.f{n}" if path else f"f{n}"
        yield from flat(types, inner, name, [x for some in below for x in some] if count else below)


@settings(max_examples=150, deadline=None)
@given(types=definitions(), seed=st.integers(0, 2**32 - 1), count=st.integers(1, 12), big=st.sampled_from([0, 0, 3]))
def test_whatever_rosbags_writes_is_read_field_by_field(types, seed, count, big, channel_of, batch_of):
    store, rng = get_typestore(Stores.EMPTY), np.random.default_rng(seed)
    for k in reversed(range(len(types))):
        body = "\n".join(f"{kind}{size} f{n}" for n, (kind, size) in enumerate(types[k])).replace(" T", " p/T")
        store.register(get_types_from_msg(body, f"p/msg/T{k}"))
    store.register(get_types_from_msg("int32 sec\nuint32 nanosec", "builtin_interfaces/msg/Time"))
    kinds = [value_of(store, types, "T0", "", rng) for _ in range(3)]
    messages = [kinds[rng.integers(3)] if rng.random() < 0.7 else value_of(store, types, "T0", "", rng)
                for _ in range(count)]
    payloads = [bytes(store.serialize_cdr(message, "p/msg/T0", little_endian=k % 4 >= big))
                for k, message in enumerate(messages)]
    channel = channel_of("p/msg/T0", text_of(types))
    found = decoder(channel).decode(batch_of(channel, payloads))
    assert found.bad == ()
    assert found.rows.tolist() == list(range(count))
    for row, message in enumerate(messages):
        for path, kind, values in flat(types, "T0", "", [message]):
            check(found, row, path, kind, values)


def check(found: Any, row: int, path: str, kind: str, values: list[Any]) -> None:
    """One field of one message, wherever the decoder put it."""
    if path in found.texts or path in found.names:
        got = [found.texts[path][row]] if path in found.texts else list(found.names[path][row])
        assert got == values
        return
    if path in found.blobs:
        assert bytes(found.blobs[path][row]) == bytes(values)
        return
    got = np.atleast_1d(found.values[path][row] if path in found.values else found.ragged[path][row])
    if kind == "builtin_interfaces/Time":
        assert got.tolist() == [time.sec * 10**9 + time.nanosec for time in values]
        return
    assert got.dtype == np.dtype(DTYPES[kind])
    assert got.tobytes() == np.array(values, DTYPES[kind]).tobytes()
