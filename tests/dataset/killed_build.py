"""Builds a version and is killed on the way: run as `python killed_build.py STORE [camera]`, prints what was left.

Every step that reaches the disk is counted; for each count a child is forked that builds and sends
itself SIGKILL there. Reported is, as JSON, one entry a kill: the call, the folders that were left, and
the version that the rerun ended in.
"""

import importlib.util
import json
import os
import shutil
import signal
import sys
from pathlib import Path

from schemas.recipe import DatasetConfig, Recipe
from stages.build import build, load_version

spec = importlib.util.spec_from_file_location("episodes", Path(__file__).with_name("conftest.py"))
made = importlib.util.module_from_spec(spec)
spec.loader.exec_module(made)

DEMOS = [made.make_episode(f"demo {k}", length=8) for k in range(4)]
FIXES = [made.make_episode(f"fix {k}", "corrected", parent=f"attempt {k}", generation=1, takeover=4) for k in range(3)]


def versions(store, camera):
    """A base version, and what grows from it."""
    cameras = {"front": {"width": 32, "height": 16}} if camera else {}
    recipe = Recipe(name="test", dataset=DatasetConfig(cameras=cameras))
    how = {"store": store, "task": made.TASK, "footage": made.footage_of if camera else None}
    fixes = FIXES[:1] if camera else FIXES
    base = build(DEMOS[:2] if camera else DEMOS, made.frames_of, recipe, generation=0, **how)
    return base, lambda: build([*(DEMOS[:2] if camera else DEMOS), *fixes], made.frames_of, recipe, generation=1,
                               parent=base, **how)


def dies_at(count):
    """Let the process be killed just before its count-th step that reaches the disk; returns a list of the calls."""
    calls = []

    def deadly(owner, name):
        real = getattr(owner, name)

        def step(*args, **kwargs):
            calls.append(name)
            if len(calls) == count:
                os.write(2, f"{name}\n".encode())
                os.kill(os.getpid(), signal.SIGKILL)
            return real(*args, **kwargs)

        setattr(owner, name, step)

    for owner, name in ((os, "fsync"), (os, "link"), (os, "mkdir"), (Path, "rename"), (Path, "chmod"),
                        (Path, "write_text"), (Path, "replace")):
        deadly(owner, name)
    return calls


def main(root, camera):
    reports = []
    for count in range(1, 200):
        store = root / str(count)
        parent, grow = versions(store, camera)
        if not (child := os.fork()):
            dies_at(count)
            grow()
            os._exit(0)
        _, status = os.waitpid(child, 0)
        left = sorted(p.name for p in (store / "versions").iterdir())
        whole = [load_version(store / "versions" / name).id for name in left]
        again = grow()
        unfinished = [p.name for p in (store / "tmp").iterdir()]
        reports.append({"killed": os.WIFSIGNALED(status), "whole": whole == left, "parent": parent.id in left,
                        "left": len(left), "id": again.id, "digest": again.digest, "unfinished": unfinished})
        shutil.rmtree(store)
        if not os.WIFSIGNALED(status):
            break
    print(json.dumps(reports))


if __name__ == "__main__":
    main(Path(sys.argv[1]), "camera" in sys.argv)
