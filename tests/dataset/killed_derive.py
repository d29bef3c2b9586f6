"""Derives a version and is killed on the way; see killed_build.py, whose ways of dying it shares."""

import importlib.util
import json
import os
import shutil
import sys
from pathlib import Path

from schemas.edits import Drop, Relabel, Reweight, Trim
from schemas.recipe import Recipe
from stages.build import build, load_version
from stages.derive import derive

spec = importlib.util.spec_from_file_location("killed_build", Path(__file__).with_name("killed_build.py"))
other = importlib.util.module_from_spec(spec)
spec.loader.exec_module(other)

DEMOS = other.DEMOS
EDITS = [Drop(episodes=(DEMOS[1].id,)), Trim(episode=DEMOS[2].id, start=1, stop=6),
         Relabel(episode=DEMOS[3].id, outcome="failure"), Reweight(episodes=(DEMOS[0].id,), factor=2)]


def main(root):
    reports = []
    for count in range(1, 200):
        store = root / str(count)
        parent = build(DEMOS, other.made.frames_of, Recipe(name="test"), store=store, task=other.made.TASK,
                       generation=0)
        if not (child := os.fork()):
            other.dies_at(count)
            derive(parent, EDITS, store=store)
            os._exit(0)
        _, status = os.waitpid(child, 0)
        left = sorted(p.name for p in (store / "versions").iterdir())
        whole = [load_version(store / "versions" / name).id for name in left]
        again = derive(parent, EDITS, store=store)
        reports.append({"killed": os.WIFSIGNALED(status), "whole": whole == left, "parent": parent.id in left,
                        "left": len(left), "id": again.id, "digest": again.digest,
                        "unfinished": [p.name for p in (store / "tmp").iterdir()]})
        shutil.rmtree(store)
        if not os.WIFSIGNALED(status):
            break
    print(json.dumps(reports))


if __name__ == "__main__":
    main(Path(sys.argv[1]))
