"""Cameras of other robots' logs as videos of a dataset version."""

import json
from datetime import date

import numpy as np
import pyarrow.parquet as pq
import pytest
import yaml

from pipeline.lerobot_view.filmed import clips_in
from pipeline.lerobot_view.video import decoded
from pipeline.recording.pictures import jpeg
from pipeline.store import Store
from schemas.consent import Consent

MAP = {
    "name": "theirs", "robot": "g1", "task": "walk to the door", "fps": 20,
    "features": {"observation.state": {"topic": "/joints", "fields": ["q"]},
                 "action": {"topic": "/cmd", "fields": ["q"]}},
    "cameras": {"head": {"topic": "/cam", "max_skew_s": 0.2}},
    "consent": "form-1", "operator": "op-7", "site": "lab-2",
}


@pytest.fixture
def ingest(tmp_path, monkeypatch, hardcase):
    monkeypatch.setenv("HARDCASE_STORE", str(tmp_path / "store"))
    with Store.open(tmp_path / "store", create=True) as store:
        store.add_consent(Consent(id="form-1", operator="op-7", site="lab-2", purposes=("training",),
                                  given=date(2020, 1, 1), expires=date(2099, 1, 1)))
    (tmp_path / "map.yaml").write_text(yaml.safe_dump(MAP, sort_keys=False))

    def call(*arguments):
        words = ("ingest", *map(str, arguments), "--map", str(tmp_path / "map.yaml"), "--dataset", "d", "--json")
        return hardcase(*words)

    return call


def picture(k):
    return np.full((48, 64, 3), 5 * k + 20, np.uint8)


@pytest.fixture
def walk(foreign_log):
    """Two seconds at 20 Hz; every fifth picture is missing, and one is damaged where that is asked for."""
    def make(damaged=-1):
        with foreign_log() as log:
            for k in range(40):
                t, header = k / 20, {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": ""}
                log.json("/joints", t, {"q": [t]})
                log.json("/cmd", t, {"q": [t, -t]})
                if k % 5 != 3:
                    data = jpeg(picture(k))
                    log.ros("/cam", "sensor_msgs/msg/CompressedImage", t, {
                        "header": header, "format": "jpeg", "data": data[:200] if k == damaged else data})
        return log.path
    return make


def test_each_frame_has_the_picture_that_the_conversion_chose(ingest, walk, tmp_path):
    code, out, _ = ingest(walk())
    told = json.loads(out)["dataset"]
    assert (code, told["cameras"], told["cameras_waiting"]) == (0, ["head"], [])
    folder = tmp_path / "store/versions" / told["version"]
    ((_, clip),) = clips_in(folder).items()
    assert (clip.frames, clip.repeated) == (40, 8)
    shown = np.array([frame.mean() for frame in decoded(clip.file)])
    meant = [5 * (k - (k % 5 == 3)) + 20 for k in range(40)]
    np.testing.assert_allclose(shown, meant, atol=2.5)
    skew = pq.read_table(folder / "data/chunk-000/file-000.parquet")["skew.camera.head"].to_numpy()
    np.testing.assert_allclose(skew, [0.05 * (k % 5 == 3) for k in range(40)], atol=1e-6)
    stats = json.loads((folder / "meta/stats.json").read_text())["observation.images.head"]
    assert stats["max"][0][0][0] == pytest.approx((5 * 39 + 20) / 255, abs=0.005)


def test_a_size_may_be_given_and_another_version_encodes_the_rest_no_more(ingest, walk, tmp_path):
    log = walk()
    small = json.loads(ingest(log, "--camera", "head=32x16")[1])["dataset"]
    info = json.loads((tmp_path / "store/versions" / small["version"] / "meta/info.json").read_text())
    assert info["features"]["observation.images.head"]["shape"] == [16, 32, 3]
    assert len(list((tmp_path / "store/videos").glob("*.mp4"))) == 1
    ingest(log)
    assert len(list((tmp_path / "store/videos").glob("*.mp4"))) == 2


@pytest.mark.parametrize(("option", "line", "mend"), [
    ("head=33x16", "'head=33x16' is no camera with a size", "even width and height: --camera head=320x240"),
    ("wrist=32x16", "the map has no camera 'wrist'", "use one of: head"),
])
def test_a_size_that_cannot_be_is_refused(ingest, walk, option, line, mend):
    code, _, err = ingest(walk(), "--camera", option)
    assert code == 2 and line in err and mend in err and "Traceback" not in err


def test_a_damaged_picture_is_named(ingest, walk):
    code, _, err = ingest(walk(damaged=21))
    assert code == 2 and "a picture cannot be decoded" in err and "camera head, image 17" in err
