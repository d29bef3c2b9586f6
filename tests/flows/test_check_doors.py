"""What a loop is about to learn from is checked first: recordings that contradict themselves do not teach."""

import numpy as np
import pytest

from flows.run import learning
from flows.run.arm_run import ArmRun, run_id
from flows.run.arms import LOOP
from flows.run.facts import software
from pipeline.selftest import values
from pipeline.selftest.log import Log
from pipeline.store import Store
from schemas.finding import CheckVerdict
from schemas.recipe import AugmentConfig, CollectConfig, Recipe
from stages.collect import collect

RECIPE = Recipe(name="doors", collect=CollectConfig(demonstrations=4), augment=AugmentConfig(replays=0, retargets=0))
SPOILT = {"turned around": values.turned_actions, "in random order": values.shuffled_actions,
          "late": values.late_actions}


@pytest.fixture(scope="module")
def demonstrations(tmp_path_factory):
    made = collect(RECIPE, seed=0, folder=tmp_path_factory.mktemp("demonstrations"), software=software("collect"))
    return [r for r in made if r.episode.outcome.label == "success"][:2]


@pytest.fixture
def build(tmp_path, demonstrations):
    """What the first lap of a loop builds of two demonstrations, the second of them as `spoil` leaves it."""
    run = run_id(RECIPE, 0, 4, LOOP)
    with Store.open(tmp_path / "store", create=True) as store, store.lease(run) as lease:
        arm = ArmRun(store, lease, RECIPE, 0, 4, LOOP)

        def building(spoil=None, verdict=None):
            log = Log.read(demonstrations[1].path)
            if spoil is not None:
                spoil(log, np.random.default_rng(0))
            log.write(tmp_path / "second.mcap")
            blobs = [store.put_blob(p) for p in (demonstrations[0].path, tmp_path / "second.mcap")]
            episodes = [d.episode.model_copy(update={"blob": b}) for d, b in zip(demonstrations, blobs, strict=True)]
            if verdict is not None:
                store.add_check(verdict(blobs[1]))
            with store.commit(lease) as tx:
                tx.add_episodes(episodes)
                for stage, ids in (("collect", [e.id for e in episodes]), ("augment", [])):
                    tx.finish_step(0, stage, outputs={"ids": ids, "says": ""})
            made = learning.built(arm, 0)
            with store.commit(lease) as tx:
                made.write(tx)
            return store, episodes, store.version(made.ids[0]), made.says

        yield building


def test_clean_demonstrations_are_checked_and_teach(build):
    store, episodes, version, says = build()
    assert set(version.episodes) == {e.id for e in episodes} and "failed" not in says
    assert all(store.checks([e.blob])[e.blob].passed for e in episodes)


@pytest.mark.parametrize("how", SPOILT)
def test_actions_that_the_motion_contradicts_do_not_teach(build, how):
    store, (good, bad), version, says = build(SPOILT[how])
    assert version.episodes == (good.id,)
    assert says.endswith("; 1 left out, they failed their check")
    assert {f.check for f in store.checks([bad.blob])[bad.blob].findings} <= {"answer", "lag"}


def test_a_verdict_that_somebody_asked_for_is_not_overruled(build):
    def passed(blob):
        return CheckVerdict(id="1" * 16, subject=blob, name="second", kind="recording", passed=True, findings=(),
                            checks=("finite",), skipped={}, contract="0" * 64, code="0" * 64)

    store, (_, bad), version, _ = build(values.turned_actions, passed)
    assert bad.id in version.episodes and store.checks([bad.blob])[bad.blob].id == "1" * 16
