"""Errors: what a person reads, and that they survive the way out of a worker process."""

from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context

import pytest

from pipeline.errors import ConfigError, StoreError, unknown
from pipeline.recipes import load_recipe


def test_an_error_says_what_where_and_the_mend():
    said = r"^the store is locked\n  at:   datasets/store\n  mend: wait for the other loop$"
    with pytest.raises(StoreError, match=said):
        raise StoreError("the store is locked", where="datasets/store", mend="wait for the other loop")


def test_an_unknown_name_is_answered_with_every_known_one():
    assert unknown("robot", "amr", ["arm", "biped"]).mend == "use one of: arm, biped"


def test_an_error_of_a_worker_process_arrives_whole():
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as workers, pytest.raises(ConfigError) as caught:
        workers.submit(load_recipe, "nope").result()
    assert "nope" in caught.value.what
    assert "default" in caught.value.mend
