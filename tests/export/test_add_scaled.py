"""The graph that ships with the service for loops on a device."""

from __future__ import annotations

import numpy as np
import onnx
import onnxruntime as ort
import pytest

from anchorflow_export.add_scaled import add_scaled
from anchorflow_service.bundle.providers import Device
from anchorflow_service.engine.samplers.device_loop import ADD_SCALED

SHAPE = (1, 5, 8, 7)
HOST = Device("cpu", provider="cpu")


def test_what_ships_is_what_the_exporter_writes() -> None:
    assert onnx.load(ADD_SCALED) == add_scaled()


@pytest.mark.parametrize("in_place", [False, True])
def test_it_is_numpys_sum_to_the_last_bit(in_place: bool) -> None:
    """Also where the sum takes the place of x, as it does from the second slope on."""
    x, slope = np.random.default_rng(0).standard_normal((2, *SHAPE), dtype=np.float32)
    weight = np.float32(0.05 / 6)
    expected = x + slope * weight
    session = ort.InferenceSession(ADD_SCALED, providers=["CPUExecutionProvider"])
    binding, start = session.io_binding(), HOST.upload(x)
    out = start if in_place else HOST.empty(SHAPE)
    binding.bind_ortvalue_input("x", start)
    binding.bind_ortvalue_input("slope", HOST.upload(slope))
    binding.bind_cpu_input("weight", np.array(weight))
    binding.bind_ortvalue_output("advanced", out)
    session.run_with_iobinding(binding)
    np.testing.assert_array_equal(out.numpy(), expected)
