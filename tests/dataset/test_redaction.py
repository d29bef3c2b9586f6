"""Redacted fields, the signed statement, and what people type: derive --redact, redaction verify, why, diff, forget."""

import json
import re
import shutil
import subprocess
import warnings
from datetime import UTC, datetime

import numpy as np
import pyarrow.parquet as pq
import pytest
import yaml
from PIL import Image, ImageDraw

from flows.data.consents import consents_now
from pipeline.errors import DatasetError, StoreError
from pipeline.lerobot_view.filmed import clips_in
from pipeline.lerobot_view.manifest import load_version
from pipeline.lerobot_view.video import decoded
from pipeline.redaction.keys import FILE, public_pem, store_key
from pipeline.store import Store
from pipeline.store.erasure_plan import plan_erasure
from schemas.consent import Consent
from schemas.edits import Drop, Redact
from schemas.recipe import CameraConfig, DatasetConfig
from schemas.redaction import RedactionMap
from stages.build import build
from stages.derive import derive
from stages.forget import forget

EPISODES = "meta/episodes/chunk-000/file-000.parquet"
DATA = "data/chunk-000/file-000.parquet"
ADA, CANARY = "ada-lovelace", "bring the cup to Ada Lovelace, room 12"
MAP = {
    "fields": {"task": {"do": "replace", "to": "bring the cup"}, "actor": {"do": "pseudonym", "to": "operator"},
               "transform": "blank", "observation.environment_state": "remove",
               "observation.state": {"do": "blank", "values": ["state_0"]}, "stratum": "remove"},
    "cameras": {"front": {"regions": [{"mask": "plate.png"}]}, "top": "remove"}}


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    return tmp_path_factory.mktemp("redaction")


@pytest.fixture(scope="module")
def base(place, episode, smooth, footage, recipe):
    """A store with a version of four episodes, two operators and two cameras; with the episodes."""
    with Store.open(place / "store", create=True, reserve_mb=1) as store:
        demos = []
        for k in range(4):
            one = episode(f"demo {k}", length=8 + k, transform=f"by {ADA}", consent="form-12",
                          blob=store.put_blob(f"demo {k}".encode()))
            actor = ADA if k != 2 else "grace"
            demos.append(one.model_copy(update={"segments": tuple(
                s.model_copy(update={"actor": actor}) for s in one.segments)}))
        wanted = recipe.model_copy(update={"dataset": DatasetConfig(
            cameras={"front": CameraConfig(), "top": CameraConfig()})})
        store.add_consent(Consent.model_validate({
            "id": "form-12", "operator": ADA, "site": "lab", "purposes": ("training",), "given": "2020-01-01",
            "expires": "2999-12-31"}))
        version = build(demos, smooth, wanted, store=store.root, task=CANARY, generation=0, footage=footage,
                        consents=consents_now(store))
        store.add_version(version, demos)
    return version, demos


@pytest.fixture
def run(place, hardcase, monkeypatch):
    """Types a command line at the store."""
    monkeypatch.setenv("HARDCASE_STORE", str(place / "store"))
    return hardcase


def names(place, version, feature):
    info = json.loads((place / "store" / version.path / "meta/info.json").read_text())
    return info["features"][feature]["names"]


@pytest.fixture(scope="module")
def written(place, base):
    """The file of the map, beside its mask."""
    drawn = Image.new("L", (64, 48))
    ImageDraw.Draw(drawn).ellipse((10, 8, 40, 30), fill=255)
    drawn.save(place / "plate.png")
    map = json.loads(json.dumps(MAP))
    map["fields"]["observation.state"]["values"] = names(place, base[0], "observation.state")[:1]
    (place / "map.yaml").write_text(yaml.safe_dump(map))
    return place / "map.yaml"


@pytest.fixture
def made(base, written, run, place):
    """The redacted version; every test but the first finds it again."""
    code, out, err = run("derive", base[0].id, "--redact", str(written), "--json")
    assert code == 0, err
    with Store.open(place / "store") as store:
        return store.version(json.loads(out)["id"])


def every_text(folder):
    """All bytes of all files, and what is packed in Parquet as text."""
    for path in (p for p in folder.rglob("*") if p.is_file()):
        yield path, path.read_bytes()
        if path.suffix == ".parquet":
            yield path, json.dumps(pq.read_table(path).to_pydict(), default=str).encode()


def test_what_was_hidden_is_in_no_byte_of_the_version(base, made, place):
    def holding(version):
        folder = place / "store" / version.path
        return {p.relative_to(folder).as_posix() for p, text in every_text(folder)
                if any(word.lower().encode() in text.lower() for word in ("lovelace", "grace", "room 12"))}

    assert holding(base[0]) >= {EPISODES, "meta/tasks.parquet", "meta/hardcase.json"}
    assert holding(made) == set()


def test_fields_are_what_the_map_says_and_the_format_is_whole(base, made, place):
    folder = place / "store" / made.path
    table, before = pq.read_table(folder / EPISODES).to_pydict(), pq.read_table(place / "store" / base[0].path / DATA)
    assert table["tasks"] == [["bring the cup"]] * 4
    assert [json.loads(s)[0][3] for s in table["segments"]] == ["operator-1", "operator-1", "operator-2", "operator-1"]
    assert table["transform"] == ["redacted"] * 4
    assert not [c for c in table if "environment_state" in c or "images.top" in c or c in ("stratum", "repeated.top")]
    rows = pq.read_table(folder / DATA)
    state, old = (np.stack(t.column("observation.state").to_pylist()) for t in (rows, before))
    assert (state[:, 0] == 0).all() and (state[:, 1:] == old[:, 1:]).all() and old[:, 0].any()
    assert rows.column("action").equals(before.column("action"))
    stats = json.loads((folder / "meta/stats.json").read_text())
    assert "observation.environment_state" not in stats and "observation.images.top" not in stats
    np.testing.assert_allclose(stats["observation.state"]["std"], state.astype(float).std(0), atol=1e-7)
    assert load_version(folder) == made


def test_lerobot_opens_it_without_a_warning(made, place):
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    with warnings.catch_warnings():
        warnings.simplefilter("error")
        dataset = LeRobotDataset("hardcase/redacted", root=place / "store" / made.path, video_backend="pyav")
        sample = dataset[len(dataset) - 1]
    assert sample["task"] == "bring the cup" and dataset.meta.camera_keys == ["observation.images.front"]
    assert sample["observation.state"][0] == 0 and "observation.environment_state" not in sample


def test_a_mask_is_filled_and_its_statistics_are_exact(base, made, place):
    inside = np.asarray(Image.open(place / "plate.png").convert("L")) > 0
    clip = clips_in(place / "store" / made.path)[base[1][1].id, "front"]
    shown = np.stack(list(decoded(clip.file)))
    y, x = np.mgrid[:48, :64]
    deep = ((x - 25) / 11) ** 2 + ((y - 19) / 7) ** 2 <= 1
    assert len(shown) == 9 and shown[:, deep].max() <= 12, "black; at the edge the codec mixes in what is outside"
    assert (clip.histogram[:, 0] >= 9 * inside.sum()).all() and clip.histogram.sum() == 3 * 9 * 64 * 48


def test_derive_datasets_diff_and_why_name_the_redaction(base, made, written, run):
    said = "redacted: pseudonym actor, remove observation.environment_state"
    out = run("derive", base[0].id, "--redact", str(written))[1]
    assert said in out and "signed; 8 of 8 videos changed" in out
    assert "redacted, signed" in run("datasets")[1]
    diff = run("diff", base[0].id, made.id)[1]
    assert said in diff and "pictures of front" in diff and "tasks" in diff
    assert said in run("why", made.id)[1]


def test_an_export_is_verified_anywhere_and_by_the_key_that_one_trusts(made, run, place, tmp_path, monkeypatch):
    assert run("export", made.id, str(tmp_path / "out"))[0] == 0
    code, out, _ = run("redaction", "verify", str(tmp_path / "out"))
    assert code == 0 and "(this store), every file as it was signed" in out
    assert "8 of 8 videos changed" in out and "hashes before: as in version" in out
    monkeypatch.setenv("HARDCASE_STORE", str(tmp_path / "elsewhere"))
    told = json.loads(run("redaction", "verify", str(tmp_path / "out"), "--json")[1])
    assert told["known"].startswith("nobody here") and told["counts"]["regions"] == 4
    key = tmp_path / "their.pub"
    shutil.copy(tmp_path / "out/meta/redaction.pub", key)
    assert run("redaction", "verify", str(tmp_path / "out"), "--key", str(key))[0] == 0
    code, _, err = run("redaction", "verify", str(tmp_path / "out"), "--key", str(place / "map.yaml"))
    assert code == 2 and "no public key in this file" in err


def test_the_key_is_its_owners_alone_and_no_part_of_any_version(made, place):
    key = place / "store/keys/redaction.pem"
    assert key.stat().st_mode & 0o777 == 0o600
    secret = key.read_bytes().splitlines()[1]
    assert not [p for p, text in every_text(place / "store/versions") if secret in text or b"PRIVATE KEY" in text]


def changed(path, change):
    path.write_bytes(change(path.read_bytes()))


SPOILT = {
    "data": (lambda f: changed(f / DATA, lambda b: b[:-9] + b"x" + b[-8:]),
             f"{DATA} was changed since the statement was signed"),
    "video": (lambda f: changed(f / "videos/observation.images.front/chunk-000/file-001.mp4", lambda b: b + b"x"),
              r"file-001.mp4 \(episode [0-9a-f]{16}\) was changed"),
    "added": (lambda f: (f / "data/more.bin").write_bytes(b"x"), "data/more.bin was added"),
    "missing": (lambda f: (f / "meta/tasks.parquet").unlink(), "meta/tasks.parquet is missing"),
    "manifest": (lambda f: changed(f / "meta/hardcase.json", lambda b: b.replace(b"bring the cup", b"bring the box")),
                 "meta/hardcase.json was changed"),
    "statement": (lambda f: changed(f / "meta/redaction.json", lambda b: b.replace(b'"faces": 0', b'"faces": 1', 1)),
                  "the signature is not of this statement by this key"),
    "key": (lambda f: (f / "meta/redaction.pub").write_text("no key"), "the public key cannot be read"),
    "unsigned": (lambda f: (f / "meta/redaction.sig").unlink(), "the signature or its public key is missing"),
    "none": (lambda f: (f / "meta/redaction.json").unlink(), "no signed statement"),
    "garbage": (lambda f: (f / "meta/redaction.json").write_text("{}"), "the statement cannot be read"),
}


def test_what_differs_is_said_in_one_line_with_exit_code_2(made, run, place, tmp_path):
    for name, (spoil, says) in SPOILT.items():
        folder = tmp_path / name
        shutil.copytree(place / "store" / made.path, folder, copy_function=shutil.copyfile)
        spoil(folder)
        code, out, err = run("redaction", "verify", str(folder))
        assert code == 2 and not out and "Traceback" not in err, name
        assert re.search(says, err.splitlines()[0]), f"{name}: {err}"
        assert "mend:" in err


def test_verify_tells_a_version_without_a_statement_which_one_has_it(base, made, run):
    code, _, err = run("redaction", "verify", base[0].id)
    assert code == 2 and "this is no redacted version" in err and f"hardcase derive {base[0].id} --redact" in err
    child = json.loads(run("derive", made.id, "--drop", base[1][3].id, "--json")[1])["id"]
    code, _, err = run("redaction", "verify", child)
    assert code == 2 and f"it comes from redacted version {made.id}" in err


BAD = {
    "unknown field": ({"fields": {"taks": "blank"}}, "unknown field 'taks'", "use one of: task"),
    "kept": ({"fields": {"consents": "blank"}}, "'consents' cannot be hidden: a consent that is revoked", "use one of"),
    "action": ({"fields": {"action": "blank"}}, "'action' cannot be hidden: policies would learn", "use one of"),
    "no task": ({"fields": {"task": "remove"}}, "'task' cannot be removed", "blank it, replace it"),
    "camera as field": ({"fields": {"observation.images.front": "blank"}}, "is a camera", "cameras: {front: faces}"),
    "unknown camera": ({"cameras": {"fornt": "faces"}}, "camera 'fornt' is not in version", "use one of: front"),
    "value": ({"fields": {"observation.state": {"do": "blank", "values": ["elbow"]}}}, "has no value 'elbow'", "use"),
    "number": ({"fields": {"task": {"do": "replace", "to": 3}}}, "'task' holds texts, not 3.0", "text in quotes"),
    "nothing": ({}, "a map hides something", "docs/redaction.md"),
    "typo": ({"fields": {"task": {"do": "blank", "wiht": 1}}}, "unknown key 'fields.task.wiht'", "use one of: do"),
    "rule": ({"fields": {"task": "blur"}}, "fields.task.do = 'blur'", "docs/redaction.md"),
    "no shape": ({"cameras": {"front": {"regions": [{"frames": [0, 3]}]}}}, "one of rectangle, polygon, mask", "docs"),
    "mask file": ({"cameras": {"front": {"regions": [{"mask": "gone.png"}]}}}, "the mask gone.png cannot be read",
                  "PNG"),
    "mask size": ({"cameras": {"front": {"regions": [{"mask": "big.png"}]}}}, "a mask of 70x48, the camera has 64x48",
                  "draw it 64x48"),
    "empty mask": ({"cameras": {"front": {"regions": [{"mask": "black.png"}]}}}, "the region hides nothing", "white"),
}


def test_a_map_that_cannot_be_meant_is_refused_in_one_line(base, written, run, place):
    Image.new("L", (70, 48), 255).save(place / "big.png")
    Image.new("L", (64, 48)).save(place / "black.png")
    versions = sorted(p.name for p in (place / "store/versions").iterdir())
    for name, (map, says, mend) in BAD.items():
        (place / "bad.yaml").write_text(yaml.safe_dump(map))
        code, out, err = run("derive", base[0].id, "--redact", str(place / "bad.yaml"))
        assert code == 2 and not out and "Traceback" not in err, f"{name}: {err}"
        assert says in err.splitlines()[0], f"{name}: {err}"
        assert mend in err.split("mend:")[1], f"{name}: {err}"
    assert sorted(p.name for p in (place / "store/versions").iterdir()) == versions


def test_a_text_that_still_stands_elsewhere_is_refused(base, run, place):
    (place / "half.yaml").write_text(yaml.safe_dump({"fields": {"actor": "blank"}}))
    code, _, err = run("derive", base[0].id, "--redact", str(place / "half.yaml"))
    assert code == 2 and "what was hidden in 'actor' still stands in" in err.splitlines()[0]
    assert "column transform" in err.splitlines()[0] and "lovelace" not in err.lower()


def test_fields_of_some_episodes_leave_the_others_as_they_were(base, run, place):
    version, demos = base
    chosen = [demos[1].id, demos[3].id]
    (place / "some.yaml").write_text(yaml.safe_dump({"fields": {
        "task": {"do": "replace", "to": "another", "episodes": chosen},
        "observation.state": {"do": "replace", "to": 2.5, "episodes": chosen[:1]}}}))
    id = json.loads(run("derive", version.id, "--redact", str(place / "some.yaml"), "--json")[1])["id"]
    folder = place / "store/versions" / id
    table = pq.read_table(folder / EPISODES).to_pydict()
    assert table["tasks"] == [[CANARY], ["another"], [CANARY], ["another"]]
    rows, tasks = pq.read_table(folder / DATA).to_pydict(), pq.read_table(folder / "meta/tasks.parquet").to_pydict()
    named = dict(zip(tasks["task_index"], tasks["task"], strict=True))
    for row in range(len(rows["index"])):
        assert [named[rows["task_index"][row]]] == table["tasks"][rows["episode_index"][row]]
        assert (np.array(rows["observation.state"][row]) == 2.5).all() == (rows["episode_index"][row] == 1)
    for camera in ("front", "top"):
        one, two = (clips_in(f)[demos[1].id, camera].file for f in (folder, place / "store" / version.path))
        assert one.samefile(two)


def test_pictures_that_were_trimmed_off_are_not_handed_out(base, run, place):
    """Also of a camera that the map does not name: its file would hold what was cut."""
    (place / "task.yaml").write_text(yaml.safe_dump({"fields": {"task": "blank"}}))
    version, demos = base
    code, out, err = run("derive", version.id, "--trim", f"{demos[0].id}:0:5", "--trim", f"{demos[1].id}:3:7",
                         "--redact", str(place / "task.yaml"), "--json")
    assert code == 0, err
    clips, old = (clips_in(place / "store" / p) for p in (json.loads(out)["path"], version.path))
    for demo, kept in ((demos[0], slice(0, 5)), (demos[1], slice(3, 7))):
        shown = np.stack(list(decoded(clips[demo.id, "top"].file))).astype(int)
        before = np.stack(list(decoded(old[demo.id, "top"].file)))[kept].astype(int)
        assert len(shown) == kept.stop - kept.start and np.abs(shown - before).mean() < 4
    assert clips[demos[2].id, "top"].file.samefile(old[demos[2].id, "top"].file)


def test_a_redaction_is_the_last_edit(base, place):
    version, demos = base
    hide = Redact(map=RedactionMap.model_validate({"fields": {"task": "blank"}}))
    with pytest.raises(DatasetError, match=r"a redaction comes last(.|\n)*put it at the end"):
        derive(version, [hide, Drop(episodes=(demos[0].id,))], store=place / "store")


def test_a_key_that_others_may_read_signs_nothing(tmp_path):
    key = store_key(tmp_path)
    assert public_pem(store_key(tmp_path)) == public_pem(key)
    (tmp_path / FILE).chmod(0o644)
    with pytest.raises(StoreError, match=r"others may read the key(.|\n)*chmod 600"):
        store_key(tmp_path)
    (tmp_path / FILE).chmod(0o600)
    (tmp_path / FILE).write_text("no key")
    with pytest.raises(StoreError, match="is damaged"):
        store_key(tmp_path)


def test_data_files_before_the_first_change_are_shared(episode, smooth, recipe, tmp_path):
    demos = [episode(f"demo {k}", length=9) for k in range(4)]
    first = build(demos[:2], smooth, recipe, store=tmp_path, task="lift", generation=0)
    both = build(demos, smooth, recipe, store=tmp_path, task="lift", generation=1, parent=first)
    rule = {"do": "blank", "episodes": [demos[3].id]}
    map = RedactionMap.model_validate({"fields": {"observation.state": rule, "task": {**rule}}})
    made = derive(both, [Redact(map=map)], store=tmp_path)
    one, two = ("data/chunk-000/file-000.parquet", "data/chunk-000/file-001.parquet")
    assert (tmp_path / made.path / one).samefile(tmp_path / both.path / one)
    rows, old = (pq.read_table(tmp_path / v.path / two) for v in (made, both))
    state, before = (np.stack(t.column("observation.state").to_pylist()) for t in (rows, old))
    assert not state[9:].any() and (state[:9] == before[:9]).all()
    assert rows.column("task_index").to_pylist() == [0] * 9 + [1] * 9
    stats = json.loads((tmp_path / made.path / "meta/stats.json").read_text())
    every = np.concatenate([smooth(d).state for d in demos[:3]] + [np.zeros((9, before.shape[1]))])
    np.testing.assert_allclose(stats["observation.state"]["mean"], every.mean(0), atol=1e-6)


def test_forgetting_reaches_the_redacted_version_and_signs_it_again(base, made, run, place, tmp_path, monkeypatch):
    _, demos = base
    subprocess.run(["cp", "-a", str(place / "store"), str(tmp_path / "store")], check=True)  # links stay links
    monkeypatch.setenv("HARDCASE_STORE", str(tmp_path / "store"))
    with Store.open(tmp_path / "store") as store:
        plan = plan_erasure(store, demos[1].id, "asked by the person", datetime(2026, 11, 24, tzinfo=UTC))
        with store.lease(plan.id, erases=True) as lease:
            forget(store, lease, plan)
    code, out, err = run("redaction", "verify", made.id)
    assert code == 0, err
    assert "3 episodes, 1 forgotten since" in out and "hashes before: as in version" in out
    said = json.loads((tmp_path / "store" / made.path / "meta/redaction.json").read_text())
    assert demos[1].id not in said["episodes"] and said["counts"]["videos"] == 6
    assert "incomplete: erased (1 episodes); redacted, signed" in run("datasets")[1]
    notes = [json.loads(p.read_text()) for p in (tmp_path / "store/videos").glob("*.json")]
    assert notes and not [n for n in notes if demos[1].blob in n["source"]]
