"""Key expressions, and the names that they can hold."""

from __future__ import annotations

import pytest

from anchorflow_client import InvalidRequest
from anchorflow_client import zenoh_messages as keys


def test_the_keys_are_the_contracts() -> None:
    assert keys.anchors_key("flowmp-small") == "anchorflow/v1/anchors/flowmp-small"
    assert keys.replica_key("a") == "anchorflow/v1/replica/a"
    assert keys.replica_anchors_key("a", "m") == "anchorflow/v1/replica/a/anchors/m"
    assert keys.info_key("a") == "anchorflow/v1/replica/a/info"


def test_a_token_names_its_replica() -> None:
    assert keys.replica_of(keys.replica_key("a1")) == "a1"


@pytest.mark.parametrize("name", ["", "a/b", "*", "a*", "$x", "a?b", "a#b", "a b", "é", "\n"])
def test_a_name_that_no_key_holds_is_refused(name: str) -> None:
    with pytest.raises(InvalidRequest, match="model: expected a name without spaces") as caught:
        keys.anchors_key(name)
    assert caught.value.field == "model"
    with pytest.raises(InvalidRequest, match="replica: "):
        keys.info_key(name)
