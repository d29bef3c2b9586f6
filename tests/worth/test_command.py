"""`hardcase worth` as a person types it, and what was cut off."""

import json

import pytest

from pipeline.store import Store
from schemas.worth import BatchWorth

SMALL = ("--seeds", 1, "--scenes", 20)


@pytest.fixture
def version(root):
    with Store.open(root) as store:
        return next(v for v in store.versions() if v.parent)


def test_what_the_last_lap_added_is_judged_its_recordings_by_themselves_and_the_verdicts_kept(root, version, hardcase):
    code, out, err = hardcase("worth", *SMALL)
    assert code == 0, err
    assert out.startswith("INCONCLUSIVE: ") and "1 seed, indicative" in out
    assert "  what lap 1 added" in out and "  the recordings in what lap 1 added" in out and "(3 corrected)" in out
    with Store.open(root) as store:
        whole, recorded = store.worths()
        assert whole.version == version.id and len(whole.episodes) == len(version.episodes) - 13
        assert len(recorded.episodes) == 3 and set(recorded.episodes) < set(whole.episodes)
        assert recorded.parts[0].with_batch == whole.parts[0].with_batch, "both compare with the same policies"
    code, told, _ = hardcase("why", whole.id)
    assert code == 0 and "INCONCLUSIVE" in told and version.id in told
    code, told, _ = hardcase("why", version.id)
    assert f"{whole.id} INCONCLUSIVE" in told
    done = {f: f.stat().st_mtime_ns for f in (root / "worth").iterdir()}
    lost, *kept = done
    lost.unlink()  # as if it had been cut off in the last training
    assert hardcase("worth", *SMALL)[1] == out
    assert {f for f in (root / "worth").iterdir()} == set(done)
    assert all(f.stat().st_mtime_ns == done[f] for f in kept), "finished trainings are not done again"


def test_a_query_and_named_episodes_choose_a_batch_and_json_holds_the_whole_verdict(root, version, hardcase):
    """Two seeds a side: four trainings, two at a time in processes of their own."""
    code, out, err = hardcase("worth", 1, "--where", "source == corrected", "--seeds", 2, "--scenes", 20, "--json")
    assert code == 0, err
    (asked,) = [BatchWorth.model_validate(w) for w in json.loads(out)]
    assert len(asked.episodes) == 3 and asked.parts[0].name == "all" and len(asked.seeds_with) == 2
    words = [w for e in asked.episodes for w in ("--episode", e[:8])]
    code, out, err = hardcase("worth", version.id[:8], *words, *SMALL, "--json")
    assert code == 0, err
    (named,) = json.loads(out)
    assert named["batch"] == asked.batch and named["parts"][0]["without"] == list(asked.parts[0].without[:1])


@pytest.mark.parametrize(("words", "told"), [
    (("worth", 7), "mend: turn another lap: hardcase loop"),
    (("worth", "--where", "source == teleop"), "mend: see what there is: hardcase datasets"),
    (("worth", "--where", "frames > 0"), "mend: choose a part: hardcase worth VERSION --where"),
    (("worth", "--where", "frames > 0", "--episode", "00000000"), "mend: give either --where or --episode"),
    (("worth", "--episode", "00000000"), "mend: use one of: "),
    (("worth", "ffffffffffffffff"), "mend: "),
], ids=["no such lap", "a query without an answer", "the whole version", "asked and named", "a stranger",
        "no such version"])
def test_a_batch_that_cannot_be_judged_is_refused_with_a_mend(root, hardcase, words, told):
    code, out, err = hardcase(*words)
    assert code == 2 and told in err and "Traceback" not in err + out


def test_without_a_store_it_says_how_to_begin_one(tmp_path, monkeypatch, hardcase):
    monkeypatch.setenv("HARDCASE_STORE", str(tmp_path / "nowhere"))
    code, _, err = hardcase("worth")
    assert code == 2 and "begin one with `hardcase loop`" in err
