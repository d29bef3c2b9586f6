"""Without a batch at the loader, and without it in a version of its own: the same bits."""

import numpy as np
import pytest

from flows.data.consents import consents_now
from flows.data.deriving import Order, derive_version
from pipeline.errors import DatasetError
from pipeline.lerobot_view.training_data import TrainingData
from pipeline.policies.training import fit
from pipeline.worth.trials import digest
from pipeline.worth.without import without


@pytest.fixture
def lap(steps):
    """Version of lap 1, the one before it, and what is new."""
    version = steps.material.version(1)
    before = steps.store.version(version.parent)
    return version, before, [e for e in version.episodes if e not in set(before.episodes)]


def read(steps, version):
    return TrainingData.load(steps.store.path(version.path), consents_now(steps.store))


def test_without_what_a_lap_added_it_is_the_version_before_to_the_bit(steps, lap):
    version, before, new = lap
    left, old = without(read(steps, version), version.episodes, new), read(steps, before)
    assert digest(left, 8) == digest(old, 8)
    one, other = (fit(data, steps.recipe.train, 5).weights for data in (left, old))
    assert all(np.array_equal(one[name], other[name]) for name in one)


def test_without_some_episodes_it_is_the_version_that_derive_drop_makes(steps, lap):
    version, _, new = lap
    corrected = [e.id for e in steps.store.episodes(new) if e.origin == "corrected"]
    derived = derive_version(Order(version.id, drop=corrected))
    left = without(read(steps, version), version.episodes, corrected)
    assert digest(left, 8) == digest(read(steps, derived), 8)
    assert set(left.rows) == {"base"} and left.weights == {"base": 1.0}


def test_a_stranger_or_the_whole_version_is_refused(steps, lap):
    version, _, _ = lap
    data = read(steps, version)
    with pytest.raises(DatasetError, match=r"not in the version(.|\n)*mend: name episodes of the version"):
        without(data, version.episodes, ["0" * 16])
    with pytest.raises(DatasetError, match=r"nothing is left(.|\n)*mend: name a batch that is a part"):
        without(data, version.episodes, version.episodes)
