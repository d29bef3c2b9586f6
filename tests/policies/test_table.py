import pytest

from pipeline.errors import ConfigError
from pipeline.policies.table import POLICIES, policy_kind


def test_an_unknown_policy_lists_every_valid_one():
    with pytest.raises(ConfigError, match="unknown policy 'chunkd'") as caught:
        policy_kind("chunkd")
    assert caught.value.mend == "use one of: " + ", ".join(sorted(POLICIES))
