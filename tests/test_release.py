"""Releases as values: who becomes champion, who does not and what to do then, and the way back."""

import pytest

from pipeline.errors import GateError
from schemas.policy import PolicyRecord
from schemas.release import Release
from schemas.verdict import Verdict
from stages.release import release, return_to, rollback

OLD, NEW = "a" * 16, "b" * 16


def policy(id: str = NEW, files: tuple[str, ...] = ("model.safetensors", "policy.onnx")) -> PolicyRecord:
    return PolicyRecord(id=id, kind="chunked", dataset="d" * 16, seed=0, generation=1, steps=10, config="0" * 64,
                        code="1" * 64, checkpoint=f"policies/{id}", files=dict.fromkeys(files, "2" * 64),
                        train_loss=(), held_out_loss=(), onnx_error=1e-7)


def verdict(decision: str = "PASS", champion: str | None = OLD, **changes: object) -> Verdict:
    return Verdict(id="e" * 16, candidate=NEW, champion=champion, generation=1, decision=decision,
                   reason="no gain shown", strata=(), scenes=800, margin=0.05).model_copy(update=changes)


def first(number: int = 1, id: str = OLD) -> Release:
    return Release(number=number, policy=id, previous=None, verdict="f" * 16, kind="bootstrap",
                   onnx=f"policies/{id}/policy.onnx")


def promotion(number: int, id: str, previous: str) -> Release:
    return Release(number=number, policy=id, previous=previous, verdict=id, kind="promotion", onnx=f"{id}.onnx")


def test_a_pass_moves_the_champion():
    made = release(verdict(), first(), policy())
    assert made == Release(number=2, policy=NEW, previous=OLD, verdict="e" * 16, kind="promotion",
                           onnx=f"policies/{NEW}/policy.onnx")


def test_the_bootstrap_is_release_one():
    made = release(verdict("BOOTSTRAP", champion=None), None, policy())
    assert (made.number, made.previous, made.kind) == (1, None, "bootstrap")


@pytest.mark.parametrize(("judged", "advice"), [
    (verdict("FAIL"), "the champion stays; learn from its failures: hardcase harvest"),
    (verdict("INCONCLUSIVE", more_scenes=300), r"gate on more scenes \(a look at 1100 in gate.looks\)"),
    (verdict("INCONCLUSIVE"), "the champion stays; learn from its failures"),
    (verdict("FAIL", champion=None), "teach it better first: more collect.demonstrations"),
], ids=["worse", "open", "open for good", "too weak for a start"])
def test_what_did_not_pass_is_not_released_and_the_mend_fits(judged, advice):
    champion = first() if judged.champion else None
    with pytest.raises(GateError, match=f"{judged.decision}, no gain shown\n  at:   verdict e+\n  mend: .*{advice}"):
        release(judged, champion, policy())


def test_a_verdict_against_a_former_champion_is_refused():
    with pytest.raises(GateError, match="mend: gate it against the present champion"):
        release(verdict(), first(id="c" * 16), policy())
    with pytest.raises(GateError, match="the champion is nobody"):
        release(verdict(), None, policy())


def test_a_verdict_of_another_policy_is_refused():
    with pytest.raises(GateError, match="mend: gate this policy first"):
        release(verdict(), first(), policy("c" * 16))


def test_the_champion_is_not_released_again():
    with pytest.raises(GateError, match="champion already"):
        release(verdict(champion=NEW), first(id=NEW), policy())


@pytest.mark.parametrize("files", [("model.safetensors",), ("a.onnx", "b.onnx")], ids=["none", "two"])
def test_a_policy_without_its_one_onnx_file_is_refused(files):
    with pytest.raises(GateError, match="mend: train it again, training exports the ONNX file"):
        release(verdict(), first(), policy(files=files))


def test_rolling_back_goes_back_step_by_step_and_numbers_only_grow():
    history = [first(1, "a" * 16), promotion(2, "b" * 16, "a" * 16), promotion(3, "c" * 16, "b" * 16)]
    back = rollback(history)
    assert (back.number, back.policy, back.previous, back.kind) == (4, "b" * 16, "c" * 16, "rollback")
    assert (back.onnx, back.verdict) == (history[1].onnx, history[1].verdict)
    again = rollback([*history, back])
    assert (again.number, again.policy, again.previous) == (5, "a" * 16, "b" * 16)
    with pytest.raises(GateError, match="first champion"):
        rollback([*history, back, again])


def test_after_a_rollback_the_next_promotion_rolls_back_to_what_stood_before_it():
    history = [first(1, "a" * 16), promotion(2, "b" * 16, "a" * 16)]
    history.append(rollback(history))
    history.append(promotion(4, "c" * 16, "a" * 16))
    assert rollback(history).policy == "a" * 16


def test_there_is_no_way_back_before_the_first_release():
    with pytest.raises(GateError, match=r"nothing was released yet\n.*\n  mend: there is nothing to go back to"):
        rollback([])


def test_a_history_with_a_gap_is_refused():
    with pytest.raises(GateError, match=r"mend: .*hardcase doctor"):
        rollback([first(1), promotion(3, NEW, OLD)])


THIRD, FOURTH, LOST = "c" * 16, "d" * 16, "9" * 16


def test_returning_to_the_anchor_goes_past_every_promotion_since():
    history = [first(), promotion(2, NEW, OLD), promotion(3, THIRD, NEW)]
    back = return_to(history, OLD, LOST)
    assert (back.number, back.policy, back.previous, back.verdict, back.kind) == (4, OLD, THIRD, LOST, "rollback")
    assert back.onnx == first().onnx
    with pytest.raises(GateError, match="is the first champion"):
        rollback([*history, back])
    onward = [*history, back, promotion(5, FOURTH, OLD)]
    assert rollback(onward).policy == OLD, "what was passed over stays off"


def test_only_a_champion_that_stands_below_can_be_returned_to():
    history = [first(), promotion(2, NEW, OLD), promotion(3, THIRD, NEW)]
    for policy in (THIRD, FOURTH):
        with pytest.raises(GateError, match=f"mend: return to one of: {OLD}, {NEW}"):
            return_to(history, policy, LOST)
