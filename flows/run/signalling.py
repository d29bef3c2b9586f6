"""What the signals of shadow mode need from a store: the frames that a policy learnt from."""

import numpy as np

from flows.data.consents import consents_now
from pipeline.errors import ConsentError, DatasetError
from pipeline.lerobot_view.training_data import TrainingData
from pipeline.signals.neighbours import Neighbours
from pipeline.store import Store


def neighbours_of(policy: str, store: Store) -> Neighbours | None:
    """The training frames of a policy, ready to be asked for the nearest.

    None where its dataset version may not be opened any more, because somebody in it was forgotten or has withdrawn:
    the policy is then watched without distances and without the warning that rests on them.

    Raises:
        StoreError: there is no such policy.
    """
    version = store.version(store.policy(policy).dataset)
    try:
        data = TrainingData.load(store.path(version.path), consents_now(store))
    except (ConsentError, DatasetError):
        return None
    teaching = np.flatnonzero(data.last >= 0)
    return Neighbours.among(data.state[teaching], data.environment[teaching])
