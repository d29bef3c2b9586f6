"""The loader of versions with cameras: what is drawn, how often, and that pictures are decoded once."""

import os
import time
from datetime import UTC, date, datetime

import numpy as np
import pytest

from pipeline.consent import Consents
from pipeline.errors import ConfigError, ConsentError, DatasetError
from pipeline.lerobot_view.augmenting import Augment
from pipeline.lerobot_view.frame_cache import FrameCache
from pipeline.lerobot_view.frame_weights import Factors
from pipeline.lerobot_view.mixing import Mixture
from pipeline.lerobot_view.samples import Samples
from pipeline.lerobot_view.video import decoded
from schemas.consent import Consent
from schemas.recipe import CameraConfig, DatasetConfig
from stages.build import build

FRONT, TOP = "observation.images.front", "observation.images.top"
CHUNK = {"action": range(4)}


@pytest.fixture
def made(recipe, task, tmp_path, frames, footage):
    def made(episodes, cameras=("front", "top"), held_out=0.1, **how):
        config = DatasetConfig(cameras=dict.fromkeys(cameras, CameraConfig()), held_out=held_out, only_success=False)
        built = build(episodes, frames, recipe.model_copy(update={"dataset": config}),
                      **{"store": tmp_path, "task": task, "generation": 0, "footage": footage, **how})
        return tmp_path / built.path
    return made


@pytest.fixture
def episodes(episode):
    return [*(episode(f"demo {k}", length=6 + k) for k in range(4)),
            episode("fix", "corrected", parent="attempt", generation=1, length=9, takeover=4),
            episode("lost", label="failure", length=7)]


def test_pictures_are_those_of_the_videos_beside_their_own_frames(made, episodes):
    folder = made(episodes)
    data = Samples.load(folder)
    rows = np.arange(len(data.columns["index"]))[::-3]
    found = data.gather(rows, CHUNK)
    for camera in (FRONT, TOP):
        files = sorted((folder / "videos" / camera).rglob("*.mp4"))
        meant = np.concatenate([np.stack(list(decoded(f))) for f in files])[rows].transpose(0, 3, 1, 2)
        np.testing.assert_array_equal(found[camera], meant.astype(np.float32) / np.float32(255))
        np.testing.assert_array_equal(data.gather(rows, {}, pictures="bytes")[camera], meant)
    assert found[FRONT].shape == (len(rows), 3, 48, 64) and found["skew.camera.front"].shape == (len(rows),)
    np.testing.assert_array_equal(found["index"], rows)
    assert data.task_of(found) == ["pick up the cube and place it on the target"] * len(rows)


def test_a_version_with_somebody_who_does_not_agree_any_more_is_not_loaded(made, episodes, episode):
    form = Consent(id="form-12", operator="operator-7", site="lab", purposes=("training",), given=date(2026, 1, 1),
                   expires=date(2027, 1, 1))
    person = episode("person", "corrected", parent="attempt", length=9, consent="form-12")
    person = person.model_copy(update={"segments": tuple(
        s.model_copy(update={"actor": "operator-7"}) for s in person.segments)})
    agreed = Consents({form.id: form}, datetime(2026, 6, 1, tzinfo=UTC))
    folder = made([*episodes, person], consents=agreed)
    assert Samples.load(folder, agreed).starts.size > 0
    with pytest.raises(ConsentError, match="cannot be used for training"):
        Samples.load(folder, Consents({form.id: form}, datetime(2028, 6, 1, tzinfo=UTC)))


def test_history_and_chunks_are_padded_at_the_ends_and_say_so(made, episodes):
    data = Samples.load(made(episodes))
    start, stop = int(data.starts[1]), int(data.stops[1])
    found = data.gather(np.array([start, stop - 1]), {FRONT: (-1, 0), "action": range(3)})
    assert found[f"{FRONT}_is_pad"].tolist() == [[True, False], [False, False]]
    assert found["action_is_pad"].tolist() == [[False] * 3, [False, True, True]]
    np.testing.assert_array_equal(found[FRONT][0, 0], found[FRONT][0, 1])
    np.testing.assert_array_equal(found["action"][1], data.columns["action"][[stop - 1] * 3])


def test_videos_are_decoded_once_for_all_versions_and_never_by_halves(made, episodes, episode, tmp_path):
    Samples.load(made(episodes))
    cache = tmp_path / "caches/frames"
    before = {p.name: p.stat().st_ino for p in cache.iterdir()}
    Samples.load(made([*episodes, episode("more")], generation=1))
    after = {p.name: p.stat().st_ino for p in cache.iterdir()}
    assert len(before) == 12 and len(after) == 14 and before.items() <= after.items()
    cut = cache / next(iter(before))
    whole = cut.read_bytes()
    cut.write_bytes(whole[:-5])  # what no writer of ours leaves
    Samples.load(made(episodes))
    assert cut.read_bytes() == whole


def test_a_decoding_that_fails_leaves_nothing(tmp_path):
    (tmp_path / "bad.mp4").write_bytes(b"no video at all")
    with pytest.raises(DatasetError, match=r"the video cannot be read.*\n.*\n  mend: remove the file and build"):
        FrameCache(tmp_path / "cache").frames(tmp_path / "bad.mp4", "0" * 64)
    assert list((tmp_path / "cache").iterdir()) == []


def share(data, rows, kind, wanted):
    return np.mean([kind[r] == wanted for r in rows])


def test_factors_weigh_source_family_outcome_and_segment(made, episodes):
    folder = made(episodes, cameras=(), held_out=0.0, footage=None)
    data = Samples.load(folder)
    kinds = np.repeat([e.outcome.family or "" for e in episodes], [e.frames for e in episodes])
    rng = np.random.default_rng(0)
    plain = share(data, data.draw(rng, 20_000), kinds, "dropped")
    doubled = Samples.load(folder, factors=Factors(family={"dropped": 2.0}))
    more = share(doubled, doubled.draw(rng, 20_000), kinds, "dropped")
    assert more == pytest.approx(2 * plain / (1 + plain), abs=0.01)
    for factors in (Factors(outcome={"failure": 0.0}), Factors(family={"dropped": 0.0})):
        without = Samples.load(folder, factors=factors)
        assert not (kinds[without.rows] == "dropped").any()
    only = Samples.load(folder, factors=Factors(segment={"demonstration": 0.0}))
    assert only.columns["intervention"][only.rows].all() and len(only.rows) == 5
    assert not set(Samples.load(folder, factors=Factors(source={"corrected": 0})).rows) & set(only.rows)


@pytest.mark.parametrize(("factors", "line", "mend"), [
    (Factors(family={"slp": 2}), "no frame has the family 'slp'", "'', 'dropped'"),
    (Factors(source={"scripted": -1}), "factor -1 of source 'scripted'", "0 or more"),
    (Factors(segment={"demonstration": 0, "intervention": 0}), "leave no frame", "above 0"),
], ids=["unknown name", "negative", "nothing left"])
def test_factors_that_cannot_be_are_refused(made, episodes, factors, line, mend):
    folder = made(episodes, cameras=(), footage=None)
    with pytest.raises(ConfigError, match=line) as error:
        Samples.load(folder, factors=factors)
    assert mend in error.value.mend


def test_a_camera_or_feature_that_is_not_there_is_refused_with_those_that_are(made, episodes):
    folder = made(episodes)
    with pytest.raises(ConfigError, match=r"no camera 'wrist'\n.*\n  mend: use one of: front, top"):
        Samples.load(folder, cameras=["wrist"])
    with pytest.raises(ConfigError, match=r"no feature 'actions'\n.*\n  mend: use one of: .*action"):
        Samples.load(folder, cameras=["top"]).gather(np.zeros(1, int), {"actions": [0]})
    assert list(Samples.load(folder, cameras=["top"]).films) == [TOP]


def test_equal_generators_give_equal_batches_whatever_is_augmented(made, episodes):
    data = Samples.load(made(episodes))
    augment = Augment(shift_px=4, brightness=0.3, contrast=0.3, saturation=0.5)
    one, two, other = (data.sample(np.random.default_rng(seed), 8, CHUNK, augment) for seed in (1, 1, 2))
    for name in one:
        np.testing.assert_array_equal(one[name], two[name])
    assert not np.array_equal(one[FRONT], other[FRONT])


def test_augmenting_shifts_and_lights_pictures_within_its_bounds(footage, episode):
    picture = next(footage(episode("a"), "front").pictures())
    rng = np.random.default_rng(0)
    pair = np.stack([picture, picture])
    np.testing.assert_array_equal(Augment()(pair, rng), pair)
    moved = [Augment(shift_px=3)(pair[:1], rng)[0] for _ in range(40)]
    for one in moved:
        assert any(np.array_equal(one[3:-3, 3:-3], picture[3 - down:45 - down, 3 - right:61 - right])
                   for down in range(-3, 4) for right in range(-3, 4))
    assert len({one.tobytes() for one in moved}) > 20
    lit = np.concatenate([Augment(brightness=0.2)(pair[:1], rng) for _ in range(40)]).astype(float)
    ratio = lit.mean(axis=(1, 2, 3)) / picture.mean()
    assert 0.79 < ratio.min() < 0.9 and 1.1 < ratio.max() < 1.21
    both = Augment(shift_px=3, brightness=0.5)(pair, rng, together=2)
    np.testing.assert_array_equal(both[0], both[1])
    grey = Augment(saturation=1.0)(np.repeat(pair[:1], 60, axis=0), rng).astype(float)
    assert grey.std(axis=3).mean(axis=(1, 2)).min() < 0.25 * picture.std(axis=2).mean()


def test_versions_are_mixed_by_their_weights_and_teach_nothing_that_one_holds_out(made, episode, episodes, tmp_path):
    a = Samples.load(made(episodes, held_out=0.3))
    b = Samples.load(made([*episodes[:4], *(episode(f"new {k}") for k in range(3))], task="stack the cubes",
                          held_out=0.0))
    mixed = Mixture([(a, 3.0), (b, 1.0)])
    drawn = mixed.sample(np.random.default_rng(0), 4000, {})
    told = np.array(mixed.task_of(drawn))
    assert (told == "stack the cubes").mean() == pytest.approx(0.25, abs=0.03)
    held = a.held_out_lineages
    assert held and not b.held_out_lineages
    for part in mixed.parts:
        at = np.searchsorted(part.stops, part.rows, "right")
        assert not {part.lineages[k] for k in at} & held
    with pytest.raises(DatasetError, match=r"skew.camera.top has no values, version 0 has \(1,\)"):
        Mixture([(a, 1), (Samples.load(made(episodes, cameras=("front",))), 1)])
    with pytest.raises(ConfigError, match=r"weights \[0\]"):
        Mixture([(a, 0)])


def test_decoded_frames_grow_young_when_they_are_used(made, episodes, tmp_path):
    folder = made(episodes[:2])
    Samples.load(folder)
    for file in (tmp_path / "caches/frames").iterdir():
        os.utime(file, (1, 1))
    Samples.load(folder)
    assert all(time.time() - f.stat().st_mtime < 600 for f in (tmp_path / "caches/frames").iterdir())
