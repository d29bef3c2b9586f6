import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.protocols import Observation
from pipeline.shadow import wire

ROWS = st.integers(0, wire.MAX_ROWS)


@given(rows=ROWS, seed=st.integers(0, 9), number=st.integers(0, 2**64 - 1))
def test_questions_and_answers_arrive_as_they_were_sent(rows, seed, number):
    rng = np.random.default_rng(seed)
    sent = Observation(*(rng.normal(size=(rows, k)).astype(np.float32).astype(np.float64) for k in (16, 7)))
    ids = rng.permutation(1000)[:rows]
    packet = wire.question(3, 1000, number, ids, sent)
    found = wire.asked(packet)
    assert len(packet) <= wire.MAX_PACKET
    assert (found.epoch, found.attempts, found.number) == (3, 1000, number)
    assert np.array_equal(found.ids, ids)
    assert np.array_equal(found.observation.state, sent.state)
    assert np.array_equal(found.observation.environment, sent.environment)
    actions = rng.normal(size=(rows, 5))
    said = wire.said(wire.answer(number, actions))
    assert (said.kind, said.number, said.rows) == (wire.ANSWER, number, rows)
    assert np.array_equal(said.actions, actions)


@given(packet=st.binary(max_size=400))
def test_whatever_a_process_says_is_numbers_a_short_text_or_refused(packet):
    try:
        said = wire.said(packet)
    except ValueError:
        return
    assert said.text.isprintable() and len(said.text) <= wire.MAX_TEXT
    assert said.actions is None or said.actions.shape == (said.rows, 5)


@pytest.mark.parametrize("packet", [b"", b"\x01", wire.answer(1, np.zeros((2, 5)))[:-1], b"\x09" + bytes(15),
                                    wire.word(wire.READY) + b"x" * 301],
                         ids=["empty", "cut", "half an action", "of no kind", "a long text"])
def test_what_keeps_to_no_layout_is_refused(packet):
    with pytest.raises(ValueError, match=r"\w"):
        wire.said(packet)


def test_a_reason_is_one_line_without_control_characters():
    said = wire.said(wire.word(wire.REFUSED, "a\nb\x1b[31m" + "ü" * 400))
    assert said.text.startswith("a b [31m??") and len(said.text) == wire.MAX_TEXT
