"""Trainings that begin where robots stood before they fell, and with the weights of another training."""

import numpy as np
import pytest
from pydantic import ValidationError

from pipeline.errors import PolicyError
from pipeline.locomotion.biped import biped
from pipeline.locomotion.body import LeggedBody
from pipeline.locomotion.curriculum import Curriculum, HardStart, StartSource, spread_about
from pipeline.locomotion.starts import as_data, draw_start, from_data
from pipeline.ppo.config import Order
from pipeline.ppo.training import Training

CASES = ("00000000000000aa", "00000000000000bb")


@pytest.fixture(scope="module")
def body() -> LeggedBody:
    return biped()


@pytest.fixture(scope="module")
def hard(order, body):
    """Two hard starts of two families, the second three times as likely."""
    starts = [as_data(draw_start(order.task, body, "thrown", k)) for k in range(2)]
    return tuple(HardStart(case=c, episode=c, family=f, generation=0, weight=w, start=s)
                 for c, f, w, s in zip(CASES, ("forward", "sideways"), (1.0, 3.0), starts, strict=True))


@pytest.fixture(scope="module")
def lap(order, hard, straight, tmp_path_factory) -> tuple[Order, object]:
    """A lap that goes on from a finished training with hard starts, and the file of weights."""
    path = tmp_path_factory.mktemp("weights") / "weights.safetensors"
    curriculum = Curriculum(kinds={"leaning": 2.0, "thrown": 1.0}, hard_share=0.5, spread=1.0, starts=hard)
    update = {"curriculum": curriculum, "vary": 1.0, "goes_on": straight.leave_weights(path)}
    return order.model_copy(update=update), path


def test_starts_are_met_as_often_as_the_shares_say(order, body, hard):
    source = StartSource(Curriculum(kinds={"leaning": 1.0}, hard_share=0.5, starts=hard), order.task, body)
    drawn = [source.draw(seed) for seed in range(2000)]
    met = [sum(np.array_equal(s.bend, h.start.bend) for s in drawn) for h in hard]
    assert np.allclose(met, [250, 750], atol=75)
    blows = {s.blows.tobytes() for s in drawn if np.array_equal(s.bend, hard[1].start.bend)}
    assert len(blows) > 700  # the same state, pushed otherwise each time
    again = StartSource(Curriculum(kinds={"leaning": 1.0}, hard_share=0.5, starts=hard), order.task, body).draw(5)
    assert np.array_equal(again.velocity, drawn[5].velocity)


def test_a_spread_start_stays_near_the_hard_one(hard):
    middle, rng = from_data(hard[0].start), np.random.default_rng(0)
    near = [spread_about(middle, 1.0, rng) for _ in range(300)]
    assert np.allclose([np.linalg.norm(s.quaternion) for s in near], 1)
    assert np.std([s.bend - middle.bend for s in near]) == pytest.approx(0.05, rel=0.1)
    lean = [2 * (s.quaternion - middle.quaternion)[1:3] for s in near]
    assert np.std(lean) == pytest.approx(0.03, rel=0.2)
    assert spread_about(middle, 0.0, rng) is middle


@pytest.mark.parametrize(("wrong", "told"), [
    ({"hard_share": 0.5}, "give both or none"), ({"kinds": {"leaning": 0.0}}, "above 0")], ids=["no starts", "weight"])
def test_shares_without_what_they_share_are_refused(wrong, told):
    with pytest.raises(ValidationError, match=told):
        Curriculum(**{"kinds": {"leaning": 1.0}, **wrong})


def test_a_lap_begins_with_the_weights_it_goes_on_from_and_a_fresh_optimiser(lap, straight, tmp_path):
    order, path = lap
    begun = Training(order, tmp_path, weights=path)
    assert all(np.array_equal(v, straight.weights[k]) for k, v in begun.weights.items())
    assert np.array_equal(begun.env.normaliser.mean, straight.env.normaliser.mean)
    assert begun.model.policy.optimizer.state_dict()["state"] == {}
    assert begun.steps == 0


def test_a_lap_cut_off_ends_with_the_same_bits(lap, kept, tmp_path):
    order, path = lap
    Training(order, tmp_path / "straight", weights=path).run(save_every=10**6)

    class CutOffError(Exception):
        pass

    def cut(point, _):
        if point["step"] == 5 * order.ppo.iteration:
            raise CutOffError

    with pytest.raises(CutOffError):
        Training(order, tmp_path / "cut", weights=path).run(cut, save_every=2)
    resumed = Training(order, tmp_path / "cut")  # the weights are in the checkpoint by now
    assert resumed.steps == 4 * order.ppo.iteration
    resumed.run(save_every=2)
    (facts, arrays), (others, theirs) = kept(tmp_path / "cut"), kept(tmp_path / "straight")
    assert facts == others
    assert arrays.keys() == theirs.keys()
    assert all(np.array_equal(arrays[k], theirs[k]) for k in arrays)


def test_an_order_is_another_with_other_starts_or_weights(order, lap, hard):
    changed = lap[0].curriculum.model_copy(update={"starts": hard[:1]})
    orders = [order, lap[0], lap[0].model_copy(update={"curriculum": changed}),
              lap[0].model_copy(update={"goes_on": "0" * 64})]
    assert len({o.id for o in orders}) == 4
    assert "curriculum" not in order.model_dump_json()  # ids of orders without one are what they were
    assert Order.model_validate_json(lap[0].model_dump_json()) == lap[0]


@pytest.mark.parametrize("spoil", ["none", "other", "cut", "network"])
def test_weights_that_are_not_those_of_the_order_are_refused(lap, order, straight, tmp_path, spoil):
    ordered, path = lap
    if spoil == "network":
        ordered = ordered.model_copy(update={"ppo": order.ppo.model_copy(update={"hidden": (4, 4)})})
    if spoil in ("other", "cut"):
        path = tmp_path / "weights.safetensors"
        straight.leave_weights(path)
        path.write_bytes(path.read_bytes()[:-1 if spoil == "cut" else None] + b"x" * (spoil == "other"))
    with pytest.raises(PolicyError, match="mend: name the policy that the training was ordered to go on from"):
        Training(ordered, tmp_path, weights=None if spoil == "none" else path)
