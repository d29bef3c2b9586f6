"""Which sample a frame uses: the laws of the three rules, and that a spool on the disk is as good as an array."""

from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pipeline.logs import spool
from pipeline.logs.resample import frames_until, only, pick, ticks, values
from pipeline.logs.spool import Samples, Spool

MS = 1_000_000


def spooled(folder: Path, stamps_ms: list[int], rows: np.ndarray | None = None, piece: int = 3) -> Samples:
    """Samples that came in batches of `piece`; by default each says its own stamp."""
    stamps = np.array(stamps_ms, np.int64) * MS
    rows = stamps[:, None] / MS if rows is None else rows
    taken = Spool(folder / "topic", rows.shape[1])
    for k in range(0, stamps.size, piece):
        taken.append(stamps[k:k + piece], rows[k:k + piece])
    return taken.finish()


def used(samples: Samples, at_ms: list[float], rule: str, limit_s: float = 10.0) -> list[float | None]:
    picks = pick(samples, np.array(at_ms, np.float64).astype(np.int64) * MS, rule, limit_s)
    told = iter(values(samples, only(picks, picks.admissible))[:, 0].tolist())
    return [next(told) if ok else None for ok in picks.admissible]


STAMPS = [100, 110, 130, 200]


@pytest.mark.parametrize(("rule", "expected"), [
    ("hold", [None, 100, 110, 110, 130, 200, 200]),
    ("nearest", [100, 100, 110, 110, 130, 200, 200]),
    ("linear", [None, 100, 112, 120, 150, 200, None]),
])
def test_each_rule_uses_the_sample_it_names(tmp_path, rule, expected):
    assert used(spooled(tmp_path, STAMPS), [90, 100, 112, 120, 150, 200, 260], rule) == expected


def test_skew_tells_how_old_a_sample_is_and_whether_it_lies_ahead(tmp_path):
    samples, at = spooled(tmp_path, STAMPS), np.array([112, 125, 200]) * MS
    assert (pick(samples, at, "hold", 1).skew_ns // MS).tolist() == [2, 15, 0]
    assert (pick(samples, at, "nearest", 1).skew_ns // MS).tolist() == [2, -5, 0]
    assert (pick(samples, at, "linear", 1).skew_ns // MS).tolist() == [18, 15, 0]


@pytest.mark.parametrize("rule", ["hold", "nearest", "linear"])
def test_a_sample_farther_than_the_limit_is_not_used(tmp_path, rule):
    assert used(spooled(tmp_path, [100, 200]), [120, 150], rule, limit_s=0.03)[1] is None
    assert used(spooled(tmp_path, [100, 200]), [120], "hold", limit_s=0.02) == [100]  # the limit itself is near enough


def test_angles_go_the_shorter_way_only_when_asked(tmp_path):
    samples = spooled(tmp_path, [0, 100], np.array([[3.0], [-3.0]]))
    picks = pick(samples, np.array([50]) * MS, "linear", 1)
    assert values(samples, picks)[0, 0] == 0
    assert values(samples, picks, wrap=True)[0, 0] == pytest.approx(np.pi)


def test_of_samples_with_one_stamp_the_last_counts(tmp_path):
    samples = spooled(tmp_path, [10, 20, 20, 20, 30], np.arange(5.0)[:, None], piece=2)
    assert len(samples) == 3
    assert used(samples, [10, 20, 30], "hold") == [0, 3, 4]


def test_samples_that_come_out_of_order_are_put_in_order(tmp_path):
    taken = Spool(tmp_path / "topic", 1)
    for stamp in (10, 40, 20, 30, 20):
        taken.append(np.array([stamp]) * MS, np.array([[float(taken.count)]]))
    samples = taken.finish()
    assert samples.stamps(np.arange(samples.first, samples.end)).tolist() == [s * MS for s in (10, 20, 30, 40)]
    assert taken.back.message == 2
    assert taken.back.by_ns == 20 * MS


def test_a_latched_sample_at_0_is_no_sample_of_a_log_of_today_but_one_of_a_clock_that_starts_at_0(tmp_path):
    today = 1_700_000_000_000
    late = spooled(tmp_path, [0, today, today + 10])
    assert (len(late), late.dropped, late.span[0]) == (2, 1, today * MS)
    early = spooled(tmp_path, [0, 10, 20])
    assert (len(early), early.dropped, early.span[0]) == (3, 0, 0)
    assert used(early, [0, 5, 10], "hold") == [0, 0, 10]


def test_frames_stand_on_an_even_clock_that_does_not_drift():
    at = ticks(7, 0, 3_000_001, 30)
    assert at[-1] - 7 == 100_000 * 10**9
    assert set(np.diff(at).tolist()) == {33_333_333, 33_333_334}
    assert frames_until(7, int(at[-1]), 30) == 3_000_001
    assert frames_until(7, int(at[-1]) - 1, 30) == 3_000_000
    assert (frames_until(5, 5, 30), frames_until(5, 4, 30)) == (1, 0)


gaps = st.lists(st.integers(0, 50), min_size=1, max_size=60)


@settings(max_examples=80, deadline=None)
@given(gaps=gaps, at=st.lists(st.integers(-20, 1500), min_size=1, max_size=40), piece=st.integers(1, 7),
       rule=st.sampled_from(["hold", "nearest"]), shuffled=st.randoms())
def test_no_rule_invents_a_value_and_the_disk_changes_nothing(gaps, at, piece, rule, shuffled):
    """Against the plainest search over a list, with blocks of 4 samples, whatever the order in which they come."""
    stamps = (np.cumsum(gaps) + 1).tolist()
    shuffled.shuffle(stamps)
    spool.BLOCK, block = 4, spool.BLOCK
    try:
        with TemporaryDirectory() as folder:
            samples = spooled(Path(folder), stamps, piece=piece)
            got = used(samples, sorted(at), rule, limit_s=1000)
    finally:
        spool.BLOCK = block
    earlier = [[s for s in stamps if s <= t] for t in sorted(at)]
    held = [max(e) if e else None for e in earlier]
    near = [min(sorted(set(stamps)), key=lambda s: (abs(t - s), s)) for t in sorted(at)]
    assert got == (held if rule == "hold" else near)
