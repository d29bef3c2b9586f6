"""hardcase export and import: plain copies out, foreign datasets in."""

import json
import shutil
from datetime import date

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from flows.browse.making import Making
from flows.browse.material import Showing
from pipeline.lerobot_view.foreign import read_foreign
from pipeline.lerobot_view.manifest import load_version
from pipeline.store import Store
from schemas.consent import Consent
from stages.build import build
from stages.importing import identified
from stages.importing import imported as imported_as


@pytest.fixture
def store(tmp_path, monkeypatch):
    monkeypatch.setenv("HARDCASE_STORE", str(tmp_path / "store"))
    with Store.open(tmp_path / "store", create=True, reserve_mb=1) as opened:
        yield opened


@pytest.fixture
def run(store, hardcase):
    """Types a command line at this store."""
    return hardcase


@pytest.fixture
def version(store, smooth, episode, recipe, task):
    """A version of six smooth demonstrations in the store."""
    episodes = [episode(f"demo {k}", length=30 + k, blob=store.put_blob(f"demo {k}".encode())) for k in range(6)]
    made = build(episodes, smooth, recipe, store=store.root, task=task, generation=0)
    store.add_version(made, episodes)
    return made


@pytest.fixture
def foreign(version, store, tmp_path):
    """What a stranger would hand over: the same rows, without our manifest and columns."""
    folder = tmp_path / "strange arm"
    shutil.copytree(store.path(version.path), folder, copy_function=shutil.copyfile)
    (folder / "meta/hardcase.json").unlink()
    table = folder / "meta/episodes/chunk-000/file-000.parquet"
    columns = pq.read_table(table)
    ours = {"episode_id", "source", "parent", "transform", "policy", "outcome", "trigger", "family", "stratum", "blob",
            "segments", "lineage", "split", "group", "consents", "generation", "weight"}
    pq.write_table(columns.drop_columns(sorted(ours)), table)
    return folder


@pytest.fixture
def agreed(run):
    code, _, err = run("consent", "add", "--operator", "ada", "--site", "lab", "--purpose", "training", "--id",
                       "form-1", "--expires", "2999-12-31")
    assert code == 0, err
    return "form-1"


def imported(run, *words):
    code, out, err = run("import", *words, "--json")
    assert code == 0, err
    return json.loads(out)


def test_an_export_is_a_copy_that_may_be_changed(version, store, run, tmp_path):
    code, out, err = run("export", version.id[:8], tmp_path / "out")
    assert (code, err) == (0, "") and "6 episodes" in out
    for file in (tmp_path / "out").rglob("*.*"):
        if file.is_file():
            assert file.stat().st_nlink == 1 and file.stat().st_mode & 0o200
            file.write_bytes(b"changed")
    assert load_version(store.path(version.path)) == version


def test_an_export_never_overwrites(version, run, tmp_path):
    (tmp_path / "out").mkdir()
    (tmp_path / "out/mine").write_text("mine")
    code, _, err = run("export", version.id, tmp_path / "out")
    assert code == 2 and "there is something here already" in err
    assert [p.name for p in (tmp_path / "out").iterdir()] == ["mine"]


def test_a_push_without_the_network_leaves_the_copy_and_says_so(version, run, tmp_path, monkeypatch):
    monkeypatch.setattr("huggingface_hub.constants.HF_HUB_OFFLINE", True)
    code, _, err = run("export", version.id, tmp_path / "out", "--push-to", "ada/arm")
    assert code == 2 and err.startswith("the upload failed") and "hf auth login" in err
    assert (tmp_path / "out/meta/info.json").is_file()


def test_a_push_to_no_repository_is_refused_before_anything(version, run, tmp_path):
    code, _, err = run("export", version.id, tmp_path / "out", "--push-to", "arm")
    assert code == 2 and err.splitlines()[0] == "'arm' is no USER/NAME of the Hub"
    assert not (tmp_path / "out").exists()


def test_a_foreign_dataset_comes_in_with_its_frames(version, store, foreign, agreed, run):
    told = imported(run, foreign, "--consent", agreed, "--weight", "0.3")
    made = store.version(told["version"])
    assert (told["new"], len(made.episodes), made.frames, made.recipe) == (6, 6, version.frames, "strange-arm")
    mine, theirs = (pq.read_table(store.path(v.path) / "data/chunk-000/file-000.parquet") for v in (version, made))
    for name in ("observation.state", "action", "timestamp", "index"):
        assert mine.column(name).equals(theirs.column(name))
    assert {(e.origin, e.consent) for e in store.episodes(made.episodes)} == {("imported", "form-1")}


def test_an_episode_is_known_again_by_what_it_holds_wherever_it_lies(foreign, tmp_path):
    shutil.copytree(foreign, tmp_path / "elsewhere")
    ids = identified(read_foreign(foreign), {})
    assert ids == identified(read_foreign(tmp_path / "elsewhere"), {}) and len(set(ids)) == 6
    seen = identified(read_foreign(foreign), {(2, "front"): "pictures"})
    assert [a == b for a, b in zip(ids, seen, strict=True)] == [True, True, False, True, True, True]
    change(foreign / "data/chunk-000/file-000.parquet", "action", row=31, by=1e-3)
    assert [a == b for a, b in zip(ids, identified(read_foreign(foreign), {}), strict=True)].count(False) == 1


def test_only_episodes_that_are_new_are_stored(foreign):
    found, kept = read_foreign(foreign), []
    ids = identified(found, {})
    consent = Consent(id="form-1", operator="ada", site="lab", purposes=("training",), given=date(2026, 1, 1),
                      expires=date(2999, 1, 1))

    def keep(files):
        kept.extend(files)
        return [f"{k:064x}" for k in range(len(kept))]

    first = imported_as(found, ids, consent, known={}, keep=keep)
    assert [(e.id, e.frames, e.segments[0].actor) for e in first] == [(id, 30 + k, "ada") for k, id in enumerate(ids)]
    assert pa.ipc.open_file(kept[3]).read_all().num_rows == 33 and len(kept) == 6
    kept.clear()
    again = imported_as(found, ids, consent, known={e.id: e for e in first[:4]}, keep=keep)
    assert again[:4] == first[:4] and len(kept) == 2


def test_an_imported_episode_can_be_browsed(store, foreign, agreed, run):
    told = imported(run, foreign, "--consent", agreed)
    episode = store.episodes(store.version(told["version"]).episodes)[1]
    made = Making(store).episode(episode)
    assert made.entry.layers["base"].stat().st_size > 0 and made.robot == "arm"
    shown, _ = Showing(store).episode(episode)
    theirs = pq.read_table(foreign / "data/chunk-000/file-000.parquet").slice(30, 31)
    recorded = np.stack(theirs.column("observation.state").to_pylist())[:, 2]
    np.testing.assert_array_equal(shown.lines["joints/joint3/state"], recorded)
    assert len(shown) == 31 and shown.states == {"who": {0: "demonstration (ada)"}}


def test_importing_twice_adds_nothing(store, foreign, agreed, run):
    first = imported(run, foreign, "--consent", agreed)
    before = len(store.episodes()), len(store.versions()), sorted(p.name for p in (store.root / "blobs").iterdir())
    second = imported(run, foreign, "--consent", agreed)
    assert (second["new"], second["version"]) == (0, first["version"])
    assert before == (len(store.episodes()), len(store.versions()),
                      sorted(p.name for p in (store.root / "blobs").iterdir()))


def test_an_imported_version_mixes_with_its_weight(version, store, foreign, agreed, run):
    told = imported(run, foreign, "--consent", agreed, "--weight", "0.3", "--name", "other")
    code, out, err = run("derive", version.id, "--add", told["version"], "--json")
    assert code == 0, err
    mixed = json.loads(out)
    assert mixed["weights"]["other"] == pytest.approx(0.3) and len(mixed["episodes"]) == 12


def test_an_unchanged_export_is_known_again(version, run, tmp_path):
    assert run("export", version.id, tmp_path / "out")[0] == 0
    told = imported(run, tmp_path / "out")
    assert (told["version"], told["new"]) == (version.id, 0)


def test_nobody_is_learnt_from_without_consent(foreign, store, run):
    code, _, err = run("import", foreign)
    assert code == 2 and "needs the consent of whoever drove the robot" in err and "hardcase consent add" in err
    code, _, err = run("import", foreign, "--consent", "form-9")
    assert code == 2 and "form-9" in err
    assert not [e for e in store.episodes() if e.origin == "imported"]


def test_a_consent_that_was_taken_back_stops_export_and_derivation(store, foreign, agreed, run, tmp_path):
    told = imported(run, foreign, "--consent", agreed)
    assert run("consent", "revoke", agreed)[0] == 0
    for words in (("export", told["version"], tmp_path / "out"), ("derive", told["version"], "--keep-where",
                                                                  "frames > 30")):
        code, _, err = run(*words)
        assert code == 2 and "was revoked on" in err
    assert not (tmp_path / "out").exists()


def plain(folder):
    path = folder / "meta/info.json"
    return path, json.loads(path.read_text())


def image(folder):
    path, info = plain(folder)
    info["features"]["picture"] = {"dtype": "image", "shape": [64, 64, 3], "names": None}
    path.write_text(json.dumps(info))


def older(folder):
    path, info = plain(folder)
    path.write_text(json.dumps({**info, "codebase_version": "v2.1"}))


def not_finite(folder):
    change(folder / "data/chunk-000/file-000.parquet", "action", row=7, by=np.nan)


def change(file, name, *, row, by):
    """Add something to one value of a data file."""
    table = pq.read_table(file)
    rows = np.array(table.column(name).to_pylist(), np.float32)
    rows[row, 2] += by
    flat = pa.FixedSizeListArray.from_arrays(pa.array(rows.ravel()), rows.shape[1])
    pq.write_table(table.set_column(table.column_names.index(name), name, flat), file)


@pytest.mark.parametrize(("spoil", "words", "line"), [
    (lambda f: (f / "meta/info.json").unlink(), (), "not a LeRobot dataset (no meta/info.json)"),
    (older, (), "a LeRobot dataset of format 'v2.1', v3.0 is read"),
    (image, (), "feature picture is image of shape [64, 64, 3]; numbers in one row are taken, and videos"),
    (not_finite, (), "the dataset failed its check: finite: "),
    (lambda f: None, ("--weight", "1.5"), "a share of 1.5 is not between 0 and 1"),
    (lambda f: (f / "meta/tasks.parquet").unlink(), (), "not a LeRobot v3.0 dataset that can be read: "),
], ids=["no info", "older format", "images", "NaN", "weight", "no tasks"])
def test_what_cannot_be_imported_is_refused_in_one_line(foreign, store, agreed, run, spoil, words, line):
    spoil(foreign)
    code, out, err = run("import", foreign, "--consent", agreed, *words)
    assert (code, out) == (2, "") and err.startswith(line), err
    assert "  mend: " in err and not [e for e in store.episodes() if e.origin == "imported"]


def test_features_that_do_not_fit_are_named(version, foreign, agreed, run):
    path, info = plain(foreign)
    info["features"]["action"]["names"][0] = "left"
    path.write_text(json.dumps(info))
    code, _, err = run("import", foreign, "--consent", agreed, "--like", version.id)
    assert code == 2 and err.splitlines()[0] == "action[0] is 'left', robot 'arm' expects 'dx'"
    told = imported(run, foreign, "--consent", agreed)
    code, _, err = run("derive", version.id, "--add", told["version"])
    assert code == 2 and err.startswith("feature action has names ['left'"), err
