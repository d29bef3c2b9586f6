"""Cameras that show nothing, stand still, are mistaken for each other, or run beside the joints."""

import re

import numpy as np
import pytest

from pipeline.check.contract import completed
from pipeline.check.initial import from_log
from pipeline.check.load import read_recording
from schemas.contract import Contract

FRONT, TOP = "/camera/front/image/compressed", "/camera/top/image/compressed"


@pytest.fixture(scope="module")
def pictures(drawn):
    return drawn(0)


def test_a_clean_film_raises_no_finding(film, pictures, findings):
    verdict = findings(film(pictures))
    assert verdict.findings == ()
    assert {"black-camera", "frozen-camera", "swapped-cameras", "shifted-video", "frames"} <= set(verdict.checks)


def exchanged(p):
    return {"front": p["top"], "top": p["front"]}


def exchanged_on_the_way(p):
    half = len(p["front"]) // 2
    return {"front": np.concatenate([p["front"][:half], p["top"][half:]]),
            "top": np.concatenate([p["top"][:half], p["front"][half:]])}


def dark(p):
    return {**p, "front": np.where(np.arange(len(p["front"]))[:, None, None, None] // 10 == 1, 3, p["front"])
            .astype(np.uint8)}


def standing(p):
    front = p["front"].copy()
    front[10:30] = front[10]
    return {**p, "front": front}


def late(p):
    return {name: np.concatenate([frames[:1]] * 8 + [frames[:-8]]) for name, frames in p.items()}


def early(p):
    return {name: np.roll(frames, -8, axis=0) for name, frames in p.items()}


@pytest.mark.parametrize(("spoil", "check", "says"), [
    (exchanged, "swapped-cameras", f"{FRONT} shows what {TOP} should"),
    (exchanged_on_the_way, "swapped-cameras", f"{FRONT} shows what {TOP} should"),
    (dark, "black-camera", "10 of .* pictures show nothing"),
    (standing, "frozen-camera", "the same picture for 0.95 s while a joint moves"),
    (late, "shifted-video", r"pictures run 0\.[34]\d* s behind the joints \(8 frames\)"),
    (early, "shifted-video", r"pictures run 0\.[34]\d* s ahead of the joints \(8 frames\)"),
], ids=lambda value: value.__name__ if callable(value) else None)
def test_a_spoiled_film_is_found(spoil, check, says, film, pictures, findings):
    verdict = findings(film(spoil(pictures)))
    assert not verdict.passed
    found = next(f for f in verdict.findings if f.check == check)
    assert re.search(says, found.what), found.what


def test_a_contract_knows_its_cameras_by_their_picture(film, pictures, findings, drawn):
    good = read_recording(film(pictures, name="good"))
    contract = from_log(good).model_copy(update={"topics": {}, "motion": (), "limits": {}})
    assert set(contract.cameras) == {FRONT, TOP}
    assert findings(film(drawn(1), k=1, name="other"), contract).findings == ()
    swapped = findings(film(exchanged(drawn(1)), k=1, name="swapped"), contract)
    assert [f.check for f in swapped.findings] == ["swapped-cameras"]


def test_a_camera_that_the_contract_asks_for_and_is_not_there_is_found(film, pictures, findings):
    contract = from_log(read_recording(film(pictures, name="good")))
    alone = findings(film({"top": pictures["top"]}, name="alone"), contract)
    assert [f.what for f in alone.findings if f.check == "coverage" and FRONT in f.what]


def test_pictures_that_a_camera_left_out_are_counted(film, pictures, findings, spoil_film):
    lost = spoil_film(film(pictures), lambda topic, m: [] if topic == FRONT and 10 <= m.sequence < 15 else [m])
    found = {f.check: f.what for f in findings(lost).findings if f.where == FRONT}
    assert found["sequence"].startswith("5 of") and found["frames"].startswith("5 of")


def test_a_picture_that_is_no_picture_is_counted_not_fatal(film, pictures, findings, spoil_film):
    def torn(topic, m):
        if topic == FRONT and m.sequence == 7:
            m.data = m.data[:60] + bytes(len(m.data) - 60)
        return [m]

    found = [f.what for f in findings(spoil_film(film(pictures), torn)).findings if f.check == "black-camera"]
    assert any("1 of" in what for what in found)


def test_the_contract_of_a_film_needs_no_more_than_the_film(film, pictures):
    subject = read_recording(film(pictures))
    assert completed(Contract(), subject).motion == completed(from_log(subject), subject).motion
