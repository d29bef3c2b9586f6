"""Distance to the training data: small where a policy was shown something like it, large where it was not."""

import numpy as np
import pytest
from scipy.spatial import cKDTree

from pipeline.protocols import Observation
from pipeline.signals.neighbours import NEAREST, Neighbours, in_feature_space


@pytest.fixture(scope="module")
def shown(observations):
    seen = observations(600)
    return seen.state.astype(np.float32), seen.environment.astype(np.float32)


def test_it_is_the_mean_distance_to_the_nearest_frames_in_the_policys_features(shown, observations):
    found = Neighbours.among(*shown)
    asked = observations(70, seed=1)
    features = in_feature_space(*shown)
    mean, scale = features.mean(axis=0), features.std(axis=0)
    scale[scale < 1e-6] = 1
    tree = cKDTree((features - mean) / scale)
    expected = tree.query((in_feature_space(asked.state, asked.environment) - mean) / scale, NEAREST)[0].mean(axis=1)
    assert found.distance(asked) == pytest.approx(expected, rel=1e-4)


def test_what_was_never_shown_is_farther_than_what_was(shown, observations):
    found = Neighbours.among(*shown)
    assert found.distance(observations(50, seed=2)).max() < found.distance(observations(50, shift=0.5)).min()


def test_an_attempts_distance_does_not_depend_on_its_company(shown, observations):
    found, asked = Neighbours.among(*shown), observations(300, seed=3)
    alone = [found.distance(Observation(asked.state[[k]], asked.environment[[k]]))[0] for k in (0, 150, 299)]
    assert found.distance(asked)[[0, 150, 299]].tolist() == alone


def test_the_same_version_gives_the_same_index_and_no_more_frames_than_asked_for(shown, observations):
    one, other = Neighbours.among(*shown, kept=100), Neighbours.among(*shown, kept=100)
    assert len(one.frames) == 100
    assert np.array_equal(one.distance(observations(9)), other.distance(observations(9)))
    few = Neighbours.among(shown[0][:2], shown[1][:2])
    assert np.isfinite(few.distance(observations(3))).all()
