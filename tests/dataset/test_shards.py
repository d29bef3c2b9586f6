"""Shards: what goes in comes out, and the same input gives the same bytes."""

from contextlib import suppress

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pipeline.errors import DatasetError, HardcaseError
from pipeline.frames import FEATURES, Frames
from pipeline.shards import read_shard, write_shard

lengths = st.dictionaries(st.text("0123456789abcdef", min_size=16, max_size=16), st.integers(1, 30), max_size=8)


def some_frames(length: int, seed: int = 0) -> Frames:
    rng = np.random.default_rng(seed)
    return Frames(*(rng.standard_normal((length, len(names))).astype(np.float32) for names in FEATURES.values()))


@settings(deadline=None)
@given(lengths=lengths)
def test_a_shard_gives_back_every_bit(lengths, tmp_path_factory):
    path = tmp_path_factory.mktemp("shard") / "a.arrow"
    episodes = {name: some_frames(n, seed) for seed, (name, n) in enumerate(lengths.items())}
    write_shard(path, episodes)
    back = read_shard(path)
    assert list(back) == sorted(episodes)
    for name, frames in episodes.items():
        for ours, theirs in zip(frames.columns().values(), back[name].columns().values(), strict=True):
            assert ours.tobytes() == theirs.tobytes() and ours.shape == theirs.shape


def test_the_order_of_the_input_leaves_no_trace(tmp_path):
    episodes = {"b" * 16: some_frames(5, 1), "a" * 16: some_frames(7, 2)}
    write_shard(tmp_path / "1", episodes)
    write_shard(tmp_path / "2", dict(reversed(episodes.items())))
    assert (tmp_path / "1").read_bytes() == (tmp_path / "2").read_bytes()


def test_a_damaged_shard_is_refused_with_the_mend(tmp_path):
    write_shard(tmp_path / "a", {"a" * 16: some_frames(50)})
    whole = (tmp_path / "a").read_bytes()
    for name, content in {"cut": whole[:-200], "empty": b"", "text": b"hello" * 100}.items():
        (tmp_path / name).write_bytes(content)
        with pytest.raises(DatasetError, match=r"not a whole shard .*\n.*\n  mend: .*hardcase augment"):
            read_shard(tmp_path / name)
    with pytest.raises(DatasetError, match="no such shard"):
        read_shard(tmp_path / "absent")


def test_mutated_shards_never_crash_the_reader(tmp_path):
    """Bytes may change values (the store's digest guards those), but only our own error may come out."""
    write_shard(tmp_path / "a", {"a" * 16: some_frames(4)})
    whole = (tmp_path / "a").read_bytes()
    rng = np.random.default_rng(7)
    for _ in range(300):
        mutant = bytearray(whole)
        mutant[rng.integers(len(mutant))] = rng.integers(256)
        (tmp_path / "mutant").write_bytes(mutant)
        with suppress(DatasetError):
            read_shard(tmp_path / "mutant")


def test_a_value_that_is_not_finite_is_refused_by_name(tmp_path):
    frames = some_frames(20)
    frames.action[17, 3] = np.nan
    with pytest.raises(HardcaseError, match=r"action\[3\] is nan at frame 17\n  at:   episode abc"):
        write_shard(tmp_path / "a", {"abc": frames})
    assert list(tmp_path.iterdir()) == []


def test_double_precision_is_refused_instead_of_rounded(tmp_path):
    frames = some_frames(3)
    wide = Frames(frames.state.astype(np.float64), frames.environment, frames.action, frames.joint_action)
    with pytest.raises(DatasetError, match=r"observation.state is float64.*\n.*\n  mend: .*Trace.frames"):
        write_shard(tmp_path / "a", {"abc": wide})
