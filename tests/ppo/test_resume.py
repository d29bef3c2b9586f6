"""A training that was cut off, by us or by kill -9, ends with the very bits of one that was not."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from pipeline.errors import PolicyError
from pipeline.policies.resuming import newest
from pipeline.ppo.training import Training

ROOT = Path(__file__).parents[2]


class CutOffError(Exception):
    pass


def equal(one: tuple[dict, dict], other: tuple[dict, dict]) -> bool:
    assert one[0] == other[0]
    assert one[1].keys() == other[1].keys()
    return all(np.array_equal(one[1][k], other[1][k]) for k in one[1])


def test_a_training_cut_off_between_checkpoints_ends_with_the_same_bits(order, straight, kept, tmp_path):
    def cut(point, _):
        if point["step"] == 5 * order.ppo.iteration:
            raise CutOffError

    with pytest.raises(CutOffError):
        Training(order, tmp_path).run(cut, save_every=2)
    np.random.seed(99)  # noqa: NPY002 a new process would have another state, too
    resumed = Training(order, tmp_path)
    assert resumed.steps == 4 * order.ppo.iteration
    assert len(resumed.curve) == 4
    resumed.run(save_every=2)
    assert equal(kept(tmp_path), kept(straight.folder))
    assert len(list(tmp_path.glob("step-*"))) == 1


def test_a_training_killed_goes_on_to_the_same_bits(order, straight, kept, tmp_path):
    code = (f"import pathlib; from pipeline.ppo.config import Order; from pipeline.ppo.training import Training; "
            f"Training(Order.model_validate_json({order.model_dump_json()!r}), pathlib.Path({str(tmp_path)!r}))"
            ".run(lambda p, _: print(p['step'], flush=True) or (p['step'] > 200 and input()), save_every=1)")
    child = subprocess.Popen([sys.executable, "-c", code], cwd=ROOT, stdin=subprocess.PIPE, stdout=subprocess.PIPE,
                             env=os.environ | {"PYTHONPATH": str(ROOT)})
    assert child.stdout is not None
    said = [int(child.stdout.readline()) for _ in range(4)]  # the fourth iteration hangs before its update
    child.send_signal(signal.SIGKILL)
    assert child.wait() == -signal.SIGKILL
    assert said[-1] == 4 * order.ppo.iteration
    resumed = Training(order, tmp_path)
    assert resumed.steps == 3 * order.ppo.iteration
    resumed.run(save_every=1)
    assert equal(kept(tmp_path), kept(straight.folder))


def test_a_finished_training_is_not_trained_again(order, straight):
    before = newest(straight.folder).read_bytes()
    again = Training(order, straight.folder)
    assert again.over
    assert again.run().curve == straight.curve
    assert newest(straight.folder).read_bytes() == before


def test_threads_of_the_engine_change_no_bit(order, straight, kept, tmp_path):
    Training(order, tmp_path, threads=2).run()
    assert equal(kept(tmp_path), kept(straight.folder))


def test_another_seed_gives_other_weights(order, straight, kept, tmp_path):
    Training(order.model_copy(update={"seed": 4}), tmp_path).run()
    ours, theirs = kept(tmp_path)[1], kept(straight.folder)[1]
    assert not np.array_equal(ours["weights/action_net.weight"], theirs["weights/action_net.weight"])


def test_a_checkpoint_of_another_training_is_refused(order, straight):
    other = order.model_copy(update={"seed": 5})
    with pytest.raises(PolicyError, match=r"another training.*\n.*\n  mend: give another folder"):
        Training(other, straight.folder)


@pytest.mark.parametrize("keep", [0, 100, 5000], ids=["empty", "cut in its header", "cut in its arrays"])
def test_a_damaged_checkpoint_is_refused_in_one_line(order, straight, tmp_path, keep):
    whole = newest(straight.folder)
    (tmp_path / whole.name).write_bytes(whole.read_bytes()[:keep])
    with pytest.raises(PolicyError, match=r"not a training checkpoint.*\n.*\n  mend: remove it and train again"):
        Training(order, tmp_path)


def test_a_training_that_diverges_says_so(order, tmp_path):
    wild = order.model_copy(update={"ppo": order.ppo.model_copy(update={"learning_rate": 1e30, "steps": 10_000})})
    with pytest.raises(PolicyError, match=r"training diverged\n.*\n  mend: train with a lower learning rate"):
        Training(wild, tmp_path).run()
    assert not list(tmp_path.iterdir())  # what it would go on from is not spoilt
