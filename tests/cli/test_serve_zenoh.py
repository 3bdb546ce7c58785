"""`anchorflow serve --zenoh…`: both transports from one process, and one line where it cannot."""

from __future__ import annotations

import signal
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from command_line import Served, failure

from anchorflow_benchmarks.programs import free_endpoint
from anchorflow_cli.zenoh_options import OPTIONS
from anchorflow_client import AnchorClient, OipCodec
from anchorflow_client.zenoh_client import ZenohAnchorClient, ZenohSettings

FEW_STEPS = {"method": "euler", "schedule": {"uniform": 1}}


@pytest.fixture
def endpoint() -> str:
    return free_endpoint()


def test_one_process_answers_over_both(serve: Callable[..., Served], endpoint: str) -> None:
    served = serve("--zenoh", "peer", "--zenoh-listen", endpoint, "--zenoh-replica", "r1")
    assert served.read_line() == f"zenoh replica r1 (peer, listen {endpoint})"
    asked = {
        "cost_map": np.zeros((64, 64)),
        "resolution": 0.16,
        "x_curr": [-3, 0, 0, 0, 0, 0],
        "x_goal": [3, 0, 0, 0],
        "num_samples": 4,
        "seed": 1,
        "sampler": FEW_STEPS,
    }

    with AnchorClient(served.url, codec=OipCodec()) as http, ZenohAnchorClient(endpoint) as zenoh:
        assert http.models() == zenoh.models()
        one, other = http.plan(**asked), zenoh.plan(**asked)
    assert one.arrays.keys() == other.arrays.keys()
    for name, array in one.arrays.items():
        np.testing.assert_array_equal(array, other.arrays[name])

    assert served.ended(signal.SIGINT) == (0, [])


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ("-connect tcp/127.0.0.1:1", "--zenoh-connect: expected --zenoh or --zenoh-config"),
        (" x", "mode: expected peer, client, router, got 'x'"),
        ("-config FILE", "broken.json5: "),
        ("-config none.json5", "config_file: none.json5 is not a file"),
        (" client --zenoh-user a --zenoh-password-file none", "-file: none: No such file"),
        (" peer --zenoh-user a --zenoh-password-file FILE", "expected text, 'utf-8' codec can't"),
        ("=", "--zenoh: expected peer|client|router, got ''"),
        (" peer --zenoh-replica=", "--zenoh-replica: expected a name, got ''"),
    ],
)
def test_what_cannot_be_joined_is_one_line(options: str, said: str, tmp_path: Path) -> None:
    broken = tmp_path / "broken.json5"
    broken.write_bytes(b"{\xff\xfe")
    words = f"serve --port 0 --zenoh{options}".replace("FILE", str(broken)).split()
    assert said in failure(*words)


def test_a_router_that_is_not_there_is_one_line(
    endpoint: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("anchorflow_cli.serving.ZENOH_WAIT_S", 0.3)

    message = failure("serve", "--port", 0, "--zenoh", "client", "--zenoh-connect", endpoint)

    assert f"nobody listens at {endpoint}" in message


def test_every_setting_has_an_option() -> None:
    """The options have the order of the settings, so that a new setting is not forgotten."""
    settings = list(ZenohSettings.__dataclass_fields__)

    assert [name for name in OPTIONS if name != "replica"] == settings
