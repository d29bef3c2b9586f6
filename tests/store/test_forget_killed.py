"""kill -9 while an episode is forgotten: the next call finishes, whatever was done already."""

import os
import shutil
import signal
import subprocess
from datetime import UTC, datetime
from pathlib import Path

import pytest

from pipeline.errors import StoreError
from pipeline.store import Store
from pipeline.store.erasure_plan import plan_erasure
from stages.forget import forget

NOW = datetime(2026, 11, 24, tzinfo=UTC)
STEPS = ((os, "fsync"), (os, "link"), (Path, "rename"), (Path, "replace"), (Path, "unlink"), (shutil, "rmtree"))


def forget_it(root, demo, fault=lambda name: None):
    """What the command does: finish what was begun, else begin."""
    with Store.open(root, fault=fault) as store:
        plan = next(iter(store.unfinished_erasures()), None) or plan_erasure(store, demo, "asked", NOW)
        with store.lease(plan.id, erases=True) as lease:
            forget(store, lease, plan, fault=fault)


def counted(count, at=0, note=None):
    """Notes each step that reaches the disk, and ends the process just before one of them."""
    def step(name):
        count.append(name)
        if note is not None:
            note(name)
        if len(count) == at:
            os.kill(os.getpid(), signal.SIGKILL)

    for owner, name in STEPS:
        def deadly(*args, _real=getattr(owner, name), _name=name, **kwargs):
            step(_name)
            return _real(*args, **kwargs)
        setattr(owner, name, deadly)
    return step


def test_an_erasure_killed_at_any_kind_of_step_is_finished_by_the_next_call(live, tmp_path, in_child):
    lived = live(tmp_path / "whole")

    def copy(name):
        subprocess.run(["cp", "-a", lived.root, tmp_path / name], check=True)  # hard links stay hard links
        return tmp_path / name

    root, log = copy("0"), tmp_path / "log"
    assert in_child(lambda: forget_it(root, lived.demo, counted([], note=lambda n: log.open("a").write(n + "\n")))) == 0
    steps = log.read_text().splitlines()
    assert {"commit", "write shard", "write version", "erase blob", "delete copy", "rename", "rmtree"} <= set(steps)
    whole = {p.relative_to(root).as_posix() for p in root.rglob("*") if p.is_file()}
    at = {k for name in dict.fromkeys(steps) for k in (steps.index(name), len(steps) - steps[::-1].index(name) - 1)}
    for k in sorted(at | {k for k, name in enumerate(steps) if name == "rename"}):
        root = copy(str(k + 1))
        ended = in_child(lambda root=root, k=k: forget_it(root, lived.demo, counted([], at=k + 1)))
        assert ended == -signal.SIGKILL, f"step {k}, {steps[k]}"
        with Store.open(root) as store:
            done = not store.unfinished_erasures() and bool(store.erased([lived.demo]))
            if store.unfinished_erasures():
                with pytest.raises(StoreError, match=r"was cut off(.|\n)*mend: finish it: hardcase forget .* --yes"), \
                        store.lease("0" * 16):
                    pass
        if not done:
            forget_it(root, lived.demo)
        assert _others_alone(lived, root), f"killed at step {k}, {steps[k]}"
        with Store.open(root) as store:
            assert not store.unfinished_erasures() and store.verify() == []
        assert {p.relative_to(root).as_posix() for p in root.rglob("*") if p.is_file()} == whole, steps[k]
        shutil.rmtree(root)


def _others_alone(lived, root):
    """The attempt and its correction hold the canary on their own account; nothing else may."""
    with Store.open(root) as store:
        mine = [e for e in store.episodes() if e.origin in ("deployed", "corrected")]
    held = {f"blobs/{e.blob}" for e in mine}
    found = lived.canary.found(root)
    return set(found) - held <= {f"versions/{lived.later}/data/chunk-000/file-000.parquet"}
