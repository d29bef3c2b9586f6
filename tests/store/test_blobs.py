"""Bytes by their hash."""

from pathlib import Path
from tempfile import TemporaryDirectory

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from pipeline.errors import StoreError
from pipeline.files import sha256


@settings(max_examples=30, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(many=st.lists(st.binary(max_size=200), max_size=12))
def test_every_blob_comes_back_and_equal_ones_share_a_file(store, many):
    before = len(list((store.root / "blobs").iterdir()))
    new = {d for d in many if not (store.root / "blobs" / sha256(d)).exists()}
    shas = store.put_blobs(many)
    assert [store.blob(sha).read_bytes() for sha in shas] == many
    assert shas == [sha256(d) for d in many] == [store.put_blob(d) for d in many]
    assert len(list((store.root / "blobs").iterdir())) == before + len(new)


def test_a_file_is_copied_or_moved_in(store, tmp_path):
    file = tmp_path / "a.mcap"
    file.write_bytes(b"recording" * 300_000)
    sha = store.put_blob(file)
    assert file.exists() and store.blob(sha).read_bytes() == file.read_bytes()
    assert store.put_blob(file, move=True) == sha and not file.exists()
    file.write_bytes(b"another")
    inode = file.stat().st_ino
    assert store.blob(store.put_blob(file, move=True)).stat().st_ino == inode
    assert not file.exists()


def test_a_file_from_another_disk_is_copied_and_then_removed(store):
    with TemporaryDirectory(dir="/dev/shm") as folder:
        file = Path(folder) / "a.mcap"
        file.write_bytes(b"far away")
        assert store.blob(store.put_blob(file, move=True)).read_bytes() == b"far away"
        assert not file.exists()


def test_a_link_is_stored_by_what_it_points_to(store, tmp_path):
    (tmp_path / "real").write_bytes(b"data")
    (tmp_path / "link").symlink_to(tmp_path / "real")
    path = store.blob(store.put_blob(tmp_path / "link", move=True))
    assert path.read_bytes() == b"data" and not path.is_symlink()
    assert (tmp_path / "real").exists() and not (tmp_path / "link").exists()


def test_blobs_are_read_only(store):
    assert store.blob(store.put_blob(b"for ever")).stat().st_mode & 0o222 == 0


def test_a_damaged_blob_is_found_and_mended(store, small):
    small.lap(store)
    sha = store.episodes(origin="scripted")[0].blob
    path = store.blob(sha)
    data = path.read_bytes()
    path.chmod(0o644)
    path.write_bytes(b"X" + data[1:])
    (damage,) = store.verify()
    assert f"blob {sha[:12]} is damaged" in str(damage) and f"rm -f {path}" in damage.mend
    path.unlink()
    (damage,) = store.verify()
    assert "is not in the store" in str(damage) and "hardcase loop --resume" in damage.mend
    store.put_blob(data)
    assert store.verify() == []


def test_a_cut_blob_is_written_anew(store):
    path = store.blob(store.put_blob(b"whole"))
    path.chmod(0o644)
    path.write_bytes(b"wh")
    store.put_blob(b"whole")
    assert path.read_bytes() == b"whole"


def test_a_changed_policy_file_is_found(store, small):
    policy = small.lap(store)
    (store.path(policy.checkpoint) / "policy.onnx").write_bytes(b"another network")
    (damage,) = store.verify()
    assert f"policy {policy.id} is damaged" in str(damage)


def test_a_missing_source_is_said_in_one_error(store, tmp_path):
    with pytest.raises(StoreError, match=r"No such file(.|\n)*mend: "):
        store.put_blob(tmp_path / "none")
