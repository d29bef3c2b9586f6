"""Versions: the same input gives the same id and bytes, nothing is written twice, bad input is refused."""

import errno
import json
from datetime import UTC, date, datetime

import numpy as np
import pyarrow.parquet as pq
import pytest

from pipeline.consent import Consents
from pipeline.errors import ConfigError, DatasetError, HardcaseError, RecordingError
from pipeline.frames import Frames
from schemas.consent import Consent
from schemas.recipe import DatasetConfig
from stages.build import build, load_version


def contents(folder):
    return {p.relative_to(folder).as_posix(): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


@pytest.fixture
def demos(episode):
    return [episode(f"demo {k}", length=8 + k) for k in range(6)]


@pytest.fixture
def make(recipe, task, tmp_path, frames):
    def make(episodes, **how):
        given = {"store": tmp_path / "store", "task": task, "generation": 0, "frames_of": frames, "recipe": recipe}
        given |= how
        return build(episodes, given.pop("frames_of"), given.pop("recipe"), **given)
    return make


def test_two_builds_in_two_folders_agree_in_id_and_every_byte(make, demos, tmp_path):
    one, two = make(demos, store=tmp_path / "1"), make(demos, store=tmp_path / "2")
    assert one == two
    assert contents(tmp_path / "1" / one.path) == contents(tmp_path / "2" / two.path)


def test_a_second_build_returns_the_version_without_reading_a_frame(make, demos):
    def never(episode):
        raise AssertionError("frames were read again")
    assert make(demos) == make(demos, frames_of=never)


def test_the_id_changes_with_whatever_decides_the_content(make, demos, episode, recipe, task):
    ids = {make(demos).id, make(demos[::-1]).id, make(demos[:-1]).id, make(demos, task="stack the cubes").id}
    ids.add(make([*demos[:-1], demos[-1].model_copy(update={"blob": "0" * 64})]).id)
    ids.add(make(demos, recipe=recipe.model_copy(update={"dataset": DatasetConfig(held_out=0.3)})).id)
    assert len(ids) == 6


def test_the_manifest_says_what_the_version_was_made_from(make, demos, recipe, tmp_path):
    version = make(demos)
    folder = tmp_path / "store" / version.path
    assert version.path == f"versions/{version.id}"
    assert load_version(folder) == version
    manifest = json.loads((folder / "meta/hardcase.json").read_text())
    assert manifest["recipe"] == recipe.model_dump(mode="json")
    assert version.episodes == tuple(d.id for d in demos)
    assert version.inputs == tuple(d.blob for d in demos)
    assert version.frames == sum(d.frames for d in demos)


def test_every_file_is_read_only(make, demos, tmp_path):
    version = make(demos)
    files = [p for p in (tmp_path / "store" / version.path).rglob("*") if p.is_file()]
    assert len(files) == 6
    assert {p.stat().st_mode & 0o222 for p in files} == {0}


def test_an_appended_version_shares_the_files_of_its_parent(make, demos, episode, frames, tmp_path):
    first = make(demos)
    fixed = episode("fix", "corrected", parent="attempt", generation=1, length=20, takeover=9)
    asked = []

    def counted(e):
        asked.append(e.id)
        return frames(e)

    second = make([fixed, *demos], parent=first, generation=1, frames_of=counted)
    store = tmp_path / "store"
    old, new = (store / v.path / "data/chunk-000/file-000.parquet" for v in (first, second))
    assert asked == [fixed.id]
    assert old.stat().st_ino == new.stat().st_ino
    assert second.episodes == (*first.episodes, fixed.id)
    assert sorted(p.name for p in new.parent.iterdir()) == ["file-000.parquet", "file-001.parquet"]
    assert load_version(store / first.path) == first


def test_where_files_cannot_be_linked_the_bytes_are_the_same(make, demos, episode, tmp_path, monkeypatch):
    def refused(*_):
        raise OSError(18, "Invalid cross-device link")
    extra = episode("more", length=5)
    linked = make([*demos, extra], parent=make(demos), store=tmp_path / "store")
    before = contents(tmp_path / "store" / linked.path)
    monkeypatch.setattr("os.link", refused)
    copied = make([*demos, extra], parent=make(demos, store=tmp_path / "2"), store=tmp_path / "2")
    assert (copied, contents(tmp_path / "2" / copied.path)) == (linked, before)


@pytest.mark.parametrize("change", ["drop", "relabel"])
def test_an_episode_that_left_or_changed_is_not_shared(make, demos, change, frames, tmp_path):
    first = make(demos[:4])
    first = make(demos, parent=first)
    rest = [d for k, d in enumerate(demos) if k != 5] if change == "drop" else [
        *demos[:5], demos[5].model_copy(update={"blob": "1" * 64})]
    second = make(rest, parent=first)
    folder = tmp_path / "store" / second.path
    inodes = [[(tmp_path / "store" / v.path / f"data/chunk-000/file-00{k}.parquet").stat().st_ino for k in (0, 1)]
              for v in (first, second)]
    assert inodes[0][0] == inodes[1][0] and inodes[0][1] != inodes[1][1]
    state = np.concatenate([np.stack(pq.read_table(p)["observation.state"].to_numpy())
                            for p in sorted(folder.glob("data/*/*"))])
    np.testing.assert_array_equal(state, np.concatenate([frames(d).state for d in rest]))


def test_failures_stay_out_unless_the_recipe_keeps_rejected_variants(make, demos, episode, recipe):
    failed = [episode("bad demo", label="failure"), episode("bad copy", "replayed", parent="demo 0", label="failure")]
    assert set(make([*demos, *failed]).episodes) == {d.id for d in demos}
    control = recipe.model_copy(update={"augment": recipe.augment.model_copy(update={"keep_rejected": True})})
    assert set(make([*demos, *failed], recipe=control).episodes) == {d.id for d in (*demos, failed[1])}


def test_the_weights_are_shares_of_what_exists(make, demos, episode, tmp_path):
    assert make(demos).weights == {"base": 1.0}
    fixes = [episode(f"fix {k}", "corrected", parent=f"attempt {k}", generation=1, takeover=4) for k in range(8)]
    copies = [episode(f"copy {k}", "replayed", parent=f"fix {k}", generation=1) for k in range(8)]
    version = make([*demos, *fixes, *copies], generation=1)
    assert version.weights == DatasetConfig().weights
    table = pq.read_table(tmp_path / "store" / version.path / "meta/episodes/chunk-000/file-000.parquet").to_pylist()
    share = {g: sum(row["weight"] for row in table if row["group"] == g) for g in ("base", "corrections")}
    assert share == pytest.approx(version.weights)
    assert {row["weight"] == 0 for row in table if row["split"] == "held_out"} == {True}
    assert {row["group"] for row in table if row["source"] == "replayed"} == {"base"}


def test_bad_frames_are_refused_by_episode_and_leave_nothing(make, demos, frames, tmp_path):
    broken = frames(demos[3])
    broken.joint_action[2, 1] = np.inf
    with pytest.raises(RecordingError, match=rf"action.joint\[1\] is inf at frame 2\n  at:   episode {demos[3].id}\n"
                                             r"  mend: drop the episode"):
        make(demos, frames_of={d.id: broken if d is demos[3] else frames(d) for d in demos})
    short = Frames(*(v[:-1] for v in frames(demos[1]).columns().values()))
    with pytest.raises(DatasetError, match=rf"8 frames were read, the episode has 9\n  at:   episode {demos[1].id}\n"
                                           r"  mend: recover the recording"):
        make(demos, frames_of={d.id: short if d is demos[1] else frames(d) for d in demos})
    with pytest.raises(DatasetError, match=rf"frames of episode {demos[5].id} are missing"):
        make(demos, frames_of={d.id: frames(d) for d in demos[:5]})
    assert [p.name for p in (tmp_path / "store").rglob("*")] in (["tmp", "versions"], ["versions", "tmp"])


@pytest.mark.parametrize(("fields", "message"), [
    ({"consent": "form 12"}, r"has no consent record; it cannot be used for training\n.*\n  mend: leave"),
    ({"origin": "teleop"}, r"has no consent record; it cannot be used for training\n.*\n  mend: leave"),
    ({"blob": None}, r"has no recording\n.*\n  mend: store its recording"),
    ({"control_hz": 30.0}, r"'arm' at 30 Hz beside 'arm' at 20 Hz\n.*\n  mend: build one version for each"),
], ids=["unknown consent", "a person without consent", "no recording", "another rate"])
def test_an_episode_that_may_not_enter_is_refused(make, demos, episode, recipe, fields, message):
    every = recipe.model_copy(update={"dataset": DatasetConfig(sources=("scripted", "teleop"))})
    with pytest.raises(HardcaseError, match=message):
        make([*demos, episode("odd", **fields)], recipe=every)


def test_a_person_who_consented_may_teach(make, demos, episode, recipe):
    every = recipe.model_copy(update={"dataset": DatasetConfig(sources=("scripted", "teleop"))})
    person = episode("person", "teleop", consent="form-12")
    form = Consent(id="form-12", operator="ada", site="lab", purposes=("training",), given=date(2026, 1, 1),
                   expires=date(2026, 12, 31))
    consents = Consents({form.id: form}, datetime(2026, 6, 1, tzinfo=UTC))
    assert person.id in make([*demos, person], recipe=every, consents=consents).episodes


@pytest.mark.parametrize("call", ["fsync", "link", "mkdir"])
def test_a_full_disk_leaves_nothing_and_says_so(make, demos, episode, tmp_path, monkeypatch, call):
    parent = make(demos)
    before = contents(tmp_path / "store")

    def full(*_, **__):
        raise OSError(errno.ENOSPC, "No space left on device")
    with monkeypatch.context() as patch:
        patch.setattr(f"os.{call}", full)
        if call == "link":
            patch.setattr("shutil.copyfile", full)
        with pytest.raises(DatasetError, match=r"No space left on device\n.*\n  mend: free space \(hardcase gc\)"):
            make([*demos, episode("more")], parent=parent)
    assert contents(tmp_path / "store") == before
    assert make([*demos, episode("more")], parent=parent).episodes[:-1] == parent.episodes


def test_an_empty_or_doubled_choice_is_refused(make, demos, episode):
    with pytest.raises(DatasetError, match=r"none of 1 episodes passes the filter\n.*\n  mend: .*hardcase collect"):
        make([episode("bad", label="failure")])
    with pytest.raises(DatasetError, match="an episode is there twice"):
        make([*demos, demos[0]])


def test_weights_and_sources_must_name_what_exists(make, demos, episode, recipe):
    fix = [episode(f"fix {k}", "corrected", parent=f"attempt {k}", generation=1) for k in range(9)]
    for config, message in [
        (DatasetConfig(weights={"base": 1.0}), r"no weight for the group 'corrections'\n.*\n  mend: add corrections"),
        (DatasetConfig(weights={"base": 1.0, "extra": 1.0}), r"unknown group 'extra'\n.*\n  mend: .*base, corrections"),
        (DatasetConfig(sources=("scriptd",)), r"unknown source 'scriptd'\n.*\n  mend: .*scripted"),
    ]:
        with pytest.raises(ConfigError, match=message):
            make([*demos, *fix], recipe=recipe.model_copy(update={"dataset": config}))


@pytest.mark.parametrize("damage", ["change", "remove", "add"])
def test_a_folder_that_was_touched_is_refused(make, demos, episode, tmp_path, damage):
    version = make(demos)
    folder = tmp_path / "store" / version.path
    path = folder / "meta/stats.json"
    if damage == "add":
        (folder / "notes.txt").write_text("hello")
    else:
        path.chmod(0o644)
        path.unlink() if damage == "remove" else path.write_text(path.read_text().replace("1", "2", 1))
    said = {"change": "stats.json was changed", "remove": "stats.json is missing", "add": "notes.txt was added"}[damage]
    with pytest.raises(DatasetError, match=rf"{said}[^\n]*\n.*\n  mend: remove the folder.*hardcase build"):
        load_version(folder)
    with pytest.raises(DatasetError, match=said):
        make([*demos, episode("more")], parent=version)


def test_a_folder_that_is_no_version_is_refused(tmp_path):
    with pytest.raises(DatasetError, match=r"not a dataset version.*\n.*\n  mend: .*hardcase build"):
        load_version(tmp_path)
