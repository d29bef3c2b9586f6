"""From how the scenes ended to HELPS, HURTS or INCONCLUSIVE."""

import numpy as np
import pytest
from pydantic import ValidationError

from pipeline.worth.judging import families, kinds, ruled
from pipeline.worth.trial import Played
from schemas.worth import BatchWorth, WorthPart

SCENES = ["common"] * 100 + ["beside"] * 100


def runs(seed, common, beside, seeds=8):
    rng = np.random.default_rng(seed)
    rates = np.repeat([common, beside], 100) + 0.02 * rng.normal(size=(seeds, 1))
    return rng.random((seeds, 200)) < rates


def judged(with_batch, without, seeds=8):
    parts, overall = kinds(SCENES, (runs(1, *with_batch, seeds), runs(2, *without, seeds)))
    return ruled(parts, overall, seeds)


def test_a_batch_that_fixes_a_kind_of_start_helps_and_the_reason_names_it():
    decision, reason, more = judged((0.95, 0.8), (0.95, 0.2))
    assert decision == "HELPS" and more is None
    assert "points [" in reason and "fixed: beside +" in reason and "broken: none" in reason


def test_a_batch_that_costs_success_hurts():
    decision, reason, _ = judged((0.7, 0.5), (0.95, 0.8))
    assert decision == "HURTS" and "broken: common -" in reason


def test_a_loss_on_one_kind_of_start_that_nothing_outweighs_hurts():
    decision, reason, _ = judged((0.8, 0.6), (0.95, 0.6))
    assert decision == "HURTS" and "common -" in reason and "beside" not in reason


def test_a_loss_on_one_kind_of_start_is_named_where_the_gain_outweighs_it():
    decision, reason, _ = judged((0.8, 0.9), (0.95, 0.2))
    assert decision == "HELPS" and "fixed: beside +" in reason and "broken: common -" in reason


def test_no_difference_is_inconclusive_and_says_how_many_seeds_would_decide():
    decision, reason, more = judged((0.9, 0.62), (0.9, 0.60))
    assert decision == "INCONCLUSIVE" and "no difference shown" in reason
    assert "more seeds a side" in reason if more is not None else "no number of seeds" in reason


@pytest.mark.parametrize("seeds", [1, 2, 7])
def test_fewer_than_8_seeds_decide_nothing_however_large_the_difference(seeds):
    decision, reason, more = judged((1.0, 1.0), (0.2, 0.0), seeds)
    assert decision == "INCONCLUSIVE" and more == 8 - seeds
    assert f"{seeds} seed{'s' if seeds > 1 else ''}, indicative" in reason


def test_a_verdict_by_few_seeds_cannot_even_be_written_down():
    part = WorthPart(name="all", scenes=20, with_batch=(20,), without=(0,), difference=1.0)
    with pytest.raises(ValidationError, match="fewer than 8 on a side decide nothing"):
        BatchWorth(id="0" * 16, version="1" * 16, batch="2" * 16, says="a batch", episodes=("3" * 16,),
                   decision="HELPS", reason="", seeds_with=(1,), seeds_without=(2,), parts=(part,))


def test_failures_are_counted_by_family_and_a_rarer_family_is_shown():
    before = [Played(np.arange(50) >= 20, ("stall-reach",) * 20 + ("",) * 30)] * 8
    after = [Played(np.arange(50) >= 2, ("dropped-carry",) * 2 + ("",) * 48)] * 8
    by_name = {p.name: p for p in families(after, before)}
    assert by_name["stall-reach"].difference == pytest.approx(-0.4) and by_name["stall-reach"].p_holm < 0.05
    assert by_name["dropped-carry"].with_batch == (2,) * 8


def test_equal_batches_are_rarely_judged_at_all():
    """Several kinds of start are asked about at once: Holm keeps the whole verdict at 5 in 100."""
    decided = 0
    for k in range(60):
        parts, overall = kinds(SCENES, (runs(3 * k, 0.9, 0.5), runs(3 * k + 1, 0.9, 0.5)))
        decided += ruled(parts, overall, 8)[0] != "INCONCLUSIVE"
    assert decided <= 7
