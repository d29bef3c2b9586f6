"""Leftovers of live recordings, cut and damaged in every way: a prefix that is right, or the quarantine."""

import time

import numpy as np
import pytest
from mcap.reader import make_reader

from pipeline.recording import read_attachments, read_episode, recover
from pipeline.recording.live import LiveRecorder
from schemas.episode import Outcome

TICKS = 120
PICTURE = np.full((24, 32, 3), 90, np.uint8)


@pytest.fixture(scope="module")
def lived(tmp_path_factory, trace, start, row, attachments):
    """A finished live recording of many chunks, as bytes."""
    path, whole = tmp_path_factory.mktemp("whole") / "a.mcap", trace(TICKS)
    with LiveRecorder(path, start(), attachments=attachments) as recorder:
        for tick in range(TICKS):
            if tick == 50:
                recorder.segment("intervention", "operator-1", tick=tick)
            recorder.image("front", PICTURE, tick=tick)
            recorder.tick(tick, row(whole, tick))
            time.sleep(0.01)
        recorder.close(Outcome(label="success", judged_by="operator"))
    return path.read_bytes()


@pytest.fixture
def left(tmp_path, lived):
    """Leave some bytes as a .part, recover them, and check what was kept; gives what recover says."""
    def leave(data: bytes, trace) -> object:
        (tmp_path / "a.mcap.part").write_bytes(data)
        (done,) = recover(tmp_path)
        if done.kept is None:
            assert done.reason and (tmp_path / "quarantine").is_dir()
            return done
        episode, back = read_episode(done.kept)
        assert back.state.tobytes() == trace.state[: done.frames].tobytes()
        assert back.sim_state.tobytes() == trace.sim_state[: done.frames].tobytes()
        assert episode.frames == done.frames
        if done.reason:
            assert episode.outcome.label == "unknown" and episode.outcome.reason.startswith("truncated: ")
        else:
            assert (episode.outcome.label, done.frames) == ("success", TICKS)
        kinds = [(s.kind, s.start, s.stop) for s in episode.segments]
        assert kinds == [("demonstration", 0, min(50, done.frames)), ("intervention", 50, done.frames)][: len(kinds)]
        assert len(kinds) == 1 + (done.frames > 50)
        with done.kept.open("rb") as stream:
            reader = make_reader(stream, validate_crcs=True)
            pictures = sum(c.topic == "/camera/front/image/compressed" for _, c, _ in reader.iter_messages())
        assert done.frames - 1 <= pictures <= done.frames + 1
        done.kept.unlink()
        return done

    return leave


def test_cut_anywhere_it_keeps_all_whole_chunks(lived, left, trace):
    rng, whole = np.random.default_rng(4), trace(TICKS)
    cuts = sorted(int(cut) for cut in rng.integers(0, len(lived), 25))
    frames = [left(lived[:cut], whole).frames for cut in cuts]
    assert frames == sorted(frames), "a longer file keeps no less"
    assert frames[0] < 60 and frames[-1] > 90


@pytest.mark.parametrize("missing", [0, 1, 100, 2000], ids=["only its name", "a byte", "the footer", "the summary"])
def test_what_was_finished_but_not_named_is_whole(lived, left, trace, missing):
    done = left(lived[: len(lived) - missing], trace(TICKS))
    assert (done.frames, done.reason) == (TICKS, "")


def test_damage_is_never_kept_silently(lived, left, trace):
    rng, whole = np.random.default_rng(5), trace(TICKS)
    kept = [done for _ in range(60) if (done := left(flipped(lived, rng), whole)).kept]
    assert sum(done.frames < TICKS for done in kept) > 20


def flipped(data: bytes, rng: np.random.Generator) -> bytes:
    """One bit, some bytes of zeros, or some bytes gone."""
    out, at, size = bytearray(data), int(rng.integers(0, len(data))), int(rng.integers(1, 500))
    match int(rng.integers(0, 3)):
        case 0:
            out[at] ^= 1 << int(rng.integers(0, 8))
        case 1:
            out[at : at + size] = bytes(len(out[at : at + size]))
        case _:
            del out[at : at + size]
    return bytes(out)


def test_a_changed_head_is_not_believed(lived, left, trace):
    changed = lived.replace(b'"actor":"expert"', b'"actor":"expurt"', 1)
    done = left(changed[: len(changed) * 3 // 4], trace(TICKS))
    assert done.kept is None and "sha256 mismatch" in done.reason


def test_what_is_recovered_carries_its_attachments(tmp_path, lived, attachments):
    (tmp_path / "a.mcap.part").write_bytes(lived[: len(lived) // 2])
    (done,) = recover(tmp_path)
    assert read_attachments(done.kept) == attachments
