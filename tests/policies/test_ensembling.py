import numpy as np
import pytest

from pipeline.policies.ensembling import Ensembler

CHUNK, SIZE = 5, 3


def by_definition(chunks: np.ndarray, tick: int, decay: float) -> np.ndarray:
    """Weighted mean over every chunk seen so far that predicted this tick; chunks (ticks, CHUNK, SIZE)."""
    ages = np.arange(min(tick + 1, CHUNK))
    weights = np.exp(-decay * ages)
    return weights / weights.sum() @ np.array([chunks[tick - age, age] for age in ages])


@pytest.mark.parametrize("decay", [0.0, 0.3, -0.01], ids=["flat", "newest first", "oldest first, as ACT"])
def test_an_action_is_the_weighted_mean_of_all_chunks_that_predicted_it(decay: float):
    chunks = np.random.default_rng(0).normal(size=(12, 4, CHUNK, SIZE))
    ensembler = Ensembler(CHUNK, SIZE, decay)
    ensembler.reset(4)
    for tick in range(12):
        actions = ensembler.step(chunks[tick], np.arange(4))
        for k in range(4):
            assert np.allclose(actions[k], by_definition(chunks[:, k], tick, decay), atol=1e-12)


def test_attempts_that_step_at_different_times_do_not_mix():
    rng = np.random.default_rng(1)
    together, alone = Ensembler(CHUNK, SIZE, 0.1), Ensembler(CHUNK, SIZE, 0.1)
    together.reset(3)
    alone.reset(1)
    for tick in range(15):
        ids = np.array([2, 0]) if tick % 3 else np.array([1, 2])
        chunks = rng.normal(size=(2, CHUNK, SIZE))
        row = int(np.flatnonzero(ids == 2)[0])
        got = together.step(chunks, ids)[row]
        assert (got == alone.step(chunks[[row]], np.array([0]))[0]).all()


def test_a_restored_memory_goes_on_bit_for_bit():
    rng = np.random.default_rng(2)
    first, second = Ensembler(CHUNK, SIZE, 0.2), Ensembler(CHUNK, SIZE, 0.2)
    first.reset(3)
    second.reset(5)
    for _ in range(3):
        first.step(rng.normal(size=(3, CHUNK, SIZE)), np.arange(3))
    rows = first.memory(np.array([2, 0]))
    assert rows.shape == (2, first.width)
    second.restore(np.array([4, 1]), rows)
    for _ in range(7):
        chunks = rng.normal(size=(2, CHUNK, SIZE))
        assert (first.step(chunks, np.array([2, 0])) == second.step(chunks, np.array([4, 1]))).all()
    assert (first.memory(np.array([2])) == second.memory(np.array([4]))).all()
