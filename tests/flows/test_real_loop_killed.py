"""The real loop killed and resumed, held against another, and turned by hand."""

import json
import re
import subprocess
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from pipeline.store import Store

pytestmark = pytest.mark.xdist_group("lerobot")

LAP = ("augment", "build", "train", "gate", "release", "exam", "deploy", "harvest")


def kill(process: subprocess.Popen[str], when: Callable[[], object], what: str) -> None:
    """Kill -9 as soon as `when` holds."""
    end = time.monotonic() + 240
    while not when():
        assert process.poll() is None, f"it ended before {what}: {process.communicate()[1]}"
        assert time.monotonic() < end, f"{what} did not come"
        time.sleep(0.001)
    process.kill()
    process.communicate()


def test_a_loop_killed_at_any_point_ends_where_an_unbroken_one_does(turned, run, real):
    def done(generation: int, stage: str) -> Callable[[], object]:
        return lambda: (run, generation, stage) in real.manifests()

    def there(pattern: str) -> Callable[[], object]:
        return lambda: next(real.store.glob(pattern), None)

    moments = {
        "inside collect": there(f"tmp/{run}/*.mcap*"),
        "after collect": done(0, "collect"),
        "inside train, a checkpoint written": there("policies/.*.training/step-*"),
        "after train": done(0, "train"),
        "inside deploy": lambda: done(0, "exam")() and there(f"tmp/{run}/*.mcap*")(),
        "inside harvest": lambda: done(0, "deploy")() and there(f"tmp/{run}/*.mcap*")(),
        "after build": done(1, "build"),
    }
    first = ("loop", "--recipe", "smoke")
    for moment, when in moments.items():
        before = real.manifests()
        kill(real.start(*first), when, moment)
        first = ("loop", "--resume")
        after = real.manifests()
        assert before.items() <= after.items(), f"{moment}: a finished stage was done again"
    before = real.manifests()
    last = real.run("loop", "--resume", "--json", str(real.folder / "result.json"))
    assert last.returncode == 0, last.stderr
    assert before.items() <= real.manifests().items()
    assert real.says(run) == turned.says(run)
    for one, other in zip(real.result().generations, turned.result().generations, strict=True):
        assert one.model_copy(update={"wall_s": {}}) == other.model_copy(update={"wall_s": {}})
    with Store.open(real.store) as broken, Store.open(turned.store) as whole:
        assert broken.versions(run=run) == whole.versions(run=run)
        assert broken.policies(run=run) == whole.policies(run=run)
        assert broken.releases(run) == whole.releases(run)
        assert broken.hard_cases(run=run) == whole.hard_cases(run=run)
        assert broken.verify() == []


def test_a_second_loop_on_one_store_is_refused_and_told_who_holds_it(real):
    holder = real.start("loop", "--recipe", "smoke", "--generations", "0")
    try:
        while not real.manifests():
            assert holder.poll() is None, holder.communicate()[1]
            time.sleep(0.01)
        refused = real.run("loop", "--recipe", "smoke", "--seed", "1")
    finally:
        holder.terminate()
        holder.communicate(timeout=240)
    assert refused.returncode == 2
    assert str(holder.pid) in refused.stderr
    assert re.search(r"^  mend: ", refused.stderr, re.MULTILINE)
    assert "Traceback" not in refused.stderr


def test_each_stage_by_hand_does_what_the_loop_does(turned, run, real):
    began = [real.run("collect", "--recipe", "smoke", "--json") for _ in range(2)]
    assert [json.loads(b.stdout)["resumed"] for b in began] == [False, True]
    early = real.run("deploy")
    assert early.returncode == 2
    assert early.stderr.splitlines() == [
        "nothing is released yet", f"  at:   run {run}", "  mend: hardcase gate && hardcase release"]
    for stage in (*LAP, "report"):
        done = real.run(stage, "--json")
        assert done.returncode == 0, done.stderr
        assert done.stderr == ""
        told = json.loads(done.stdout)
        assert (told["stage"], told["resumed"]) == (stage, False)
    assert real.says(run) == [said for said in turned.says(run) if said[0] == 0]
    assert Path(told["ids"][0]).read_text().startswith("<!")
    ahead = real.run("exam")
    assert ahead.returncode == 2
    assert ahead.stderr.splitlines() == [
        "release of generation 1 is not finished", f"  at:   run {run}", "  mend: run it first: hardcase release"]
