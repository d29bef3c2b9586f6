"""An episode of a foreign log is forgotten with its log, or not at all; and the log does not come back."""

import json
from datetime import date

import pytest
import yaml

from pipeline.store import Store
from schemas.consent import Consent

MAP = {
    "name": "theirs", "robot": "g1", "task": "walk to the door", "fps": 20,
    "features": {"observation.state": {"topic": "/cmd", "fields": ["data"]},
                 "action": {"topic": "/cmd", "fields": ["data"]}},
    "episodes": {"by": "gap", "longer_than_s": 1}, "consent": "form-1", "operator": "op-7", "site": "lab-2",
}


@pytest.fixture
def call(tmp_path, monkeypatch, hardcase):
    """The command line in this process, on a store with a consent: exit code, standard output and error."""
    monkeypatch.setenv("HARDCASE_STORE", str(tmp_path / "store"))
    monkeypatch.setenv("HF_HOME", str(tmp_path / "hf"))
    with Store.open(tmp_path / "store", create=True) as store:
        store.add_consent(Consent(id="form-1", operator="op-7", site="lab-2", purposes=("training",),
                                  given=date(2020, 1, 1), expires=date(2099, 1, 1)))
    (tmp_path / "map.yaml").write_text(yaml.safe_dump(MAP, sort_keys=False))

    return hardcase


@pytest.fixture
def log(foreign_log):
    with foreign_log() as made:
        for start in (0, 5, 10):
            for k in range(41):
                made.json("/cmd", start + k / 20, {"data": [start + k / 20, 1.0]})
    return made.path


def test_a_log_goes_whole_or_stays_and_never_comes_back(call, log, tmp_path):
    ingest = ("ingest", log, "--map", tmp_path / "map.yaml", "--dataset", "walks", "--json")
    code, out, err = call(*ingest)
    assert code == 0, err
    with Store.open(tmp_path / "store") as store:
        first, *others = [e.id for e in store.episodes()]
        made = store.query("SELECT id, log FROM conversion")[0]
        version = store.versions()[0]
    assert len(others) == 2
    code, out, err = call("forget", first, "--reason", "asked")
    assert (code, out) == (2, "")
    assert f"episode {first} lies in a raw log; the log goes with it, and all 3 episodes made of it" in err
    assert f"mend: agree to that: hardcase forget {first} --with-log" in err

    told = json.loads(call("why", made[1], "--json")[1])
    assert [u["kind"] for u in told["used_by"]] == ["conversion", "episode", "version"]
    assert json.loads(call("why", made[0], "--json")[1])["children"][0]["id"] == made[1]

    code, out, err = call("forget", first, "--reason", "asked", "--with-log", "--yes")
    assert code == 0, err
    assert "forgotten: 3 episodes" in out and f"raw logs: {made[1][:12]}" in out
    left = {p.name for p in (tmp_path / "store/blobs").iterdir()}
    assert not left, "log, frames: all of it is gone"
    with Store.open(tmp_path / "store") as store:
        assert store.raw_log(made[1]) is None and store.conversions(made[1]) == [] and store.verify() == []
        assert len(store.version(version.id).erased) == 3
        assert store.query("SELECT count(*) FROM ingestion") == [(0,)]
    code, out, err = call(*ingest)
    assert code != 0 and "was forgotten on" in out + err
    assert not list((tmp_path / "store/blobs").iterdir())
