"""Where a store may live."""

from pathlib import Path

import pytest

from pipeline.errors import StoreError
from pipeline.store import Store, store_root
from pipeline.store.folder import file_system, refuse_network

MOUNTS = """\
22 1 254:0 / / rw,relatime - ext4 /dev/vda rw
30 22 0:40 / {base}/nas rw,relatime shared:1 - nfs4 server:/export rw,vers=4.2
31 22 0:41 / {base}/my\\040share rw - cifs //server/share rw
32 30 254:1 / {base}/nas/local rw - xfs /dev/vdb rw
33 22 0:42 / {base}/ssh rw - fuse.sshfs me@server: rw
34 22 254:2 / {base}/hidden rw - nfs server:/old rw
35 22 254:3 / {base}/hidden rw - ext4 /dev/vdc rw
"""


@pytest.fixture
def mounts(tmp_path: Path) -> Path:
    table = tmp_path / "mountinfo"
    table.write_text(MOUNTS.format(base=tmp_path))
    return table


@pytest.mark.parametrize("folder, kind", [("nas/store", "nfs4"), ("my share/store", "cifs"), ("ssh", "fuse.sshfs")])
def test_a_network_file_system_is_refused_by_name(tmp_path, mounts, folder, kind):
    (tmp_path / folder).mkdir(parents=True)
    with pytest.raises(StoreError, match=rf"network file system \({kind}\)(.|\n)*HARDCASE_STORE="):
        refuse_network(tmp_path / folder, mounts)


@pytest.mark.parametrize("folder, kind", [("nas/local/store", "xfs"), ("nasty", "ext4"), ("hidden", "ext4")])
def test_a_local_disk_below_or_beside_it_is_not(tmp_path, mounts, folder, kind):
    (tmp_path / folder).mkdir(parents=True)
    refuse_network(tmp_path / folder, mounts)
    assert file_system(tmp_path / folder, mounts) == kind


def test_this_machine_tells_the_file_system_of_a_folder(tmp_path):
    assert file_system(tmp_path) not in {"", "nfs4"}


def test_a_store_begins_only_when_it_is_told_to(root):
    with pytest.raises(StoreError, match=r"no store here(.|\n)*hardcase loop(.|\n)*HARDCASE_STORE"):
        Store.open(root)
    assert not root.exists()


def test_too_little_space_is_refused_before_the_start(root, small):
    with pytest.raises(StoreError, match=r"MB free, 999999999999 MB are kept in reserve(.|\n)*hardcase gc"):
        Store.open(root, create=True, reserve_mb=999_999_999_999)
    Store.open(root, create=True).close()
    store = Store.open(root, reserve_mb=999_999_999_999)  # gc has to open it
    with store, pytest.raises(StoreError, match="kept in reserve"), store.lease(small.run):
        pass


def test_a_folder_that_is_a_file_is_refused(root):
    root.write_text("a file")
    with pytest.raises(StoreError, match="mend: "):
        Store.open(root, create=True)


def test_a_read_only_disk_is_refused():
    with pytest.raises(StoreError, match=r"cannot be written(.|\n)*HARDCASE_STORE="):
        Store.open(Path("/sys/hardcase"), create=True)


def test_the_environment_names_the_store(monkeypatch, tmp_path):
    monkeypatch.setenv("HARDCASE_STORE", str(tmp_path))
    assert store_root() == tmp_path
    monkeypatch.delenv("HARDCASE_STORE")
    assert store_root() == Path("datasets/store")
