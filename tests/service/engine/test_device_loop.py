"""A flow in a device's memory: the host's memory replaces it, bound as a GPU's would be.

Tests that need a GPU are skipped by the provider's name.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import onnxruntime as ort
import pytest
from asked_engine import AS_SAMPLED, Build, assert_same_at_once, assert_same_bytes, plan

from anchorflow_client.contract import SamplerChoice, resolve_for_card, uniform_schedule
from anchorflow_service.bundle import DEFAULT_BUNDLE, load_bundle
from anchorflow_service.bundle.providers import DEVICES, PROVIDERS, Device
from anchorflow_service.engine import Engine
from anchorflow_service.engine.conditioning import CONDITIONINGS
from anchorflow_service.engine.samplers.device_loop import ADD_SCALED, DeviceLoop
from anchorflow_trajectory.ode.methods import METHODS, method_named
from anchorflow_trajectory.ode.schedule import stage_times

THREE_STEPS = {"schedule": {"uniform": 3}}
STAND_IN = Device("cpu", provider="cpu")


@pytest.fixture
def host(tiny_bundle: Path) -> Engine:
    """On the CPU, as it serves."""
    return Engine(load_bundle(tiny_bundle), threads=2)


@pytest.fixture
def bound(tiny_bundle: Path, monkeypatch: pytest.MonkeyPatch) -> Engine:
    """On the CPU as if it were a device with a memory of its own."""
    with monkeypatch.context() as patch:
        patch.setitem(DEVICES, "cpu", STAND_IN)
        return Engine(load_bundle(tiny_bundle), threads=2)


class Crossings:
    """What goes between the host and a device from now on, by onnxruntime's own calls.

    up, down: shapes of values made from arrays, and of arrays made from values
    at_a_run: names of arrays that runs of bound graphs read and wrote
    """

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.up: list[tuple[int, ...]] = []
        self.down: list[tuple[int, ...]] = []
        self.at_a_run: list[str] = []
        self.runs = 0

        def watch(owner: type, method: str, note: Callable[..., object]) -> None:
            original = getattr(owner, method)

            def noted(self: Any, *given: Any) -> Any:
                note(self, *given)
                return original(self, *given)

            monkeypatch.setattr(owner, method, noted)

        def note_run(*_: Any) -> None:
            self.runs += 1

        def note_name(_: Any, name: str, *_where: Any) -> None:
            self.at_a_run.append(name)

        watch(Device, "upload", lambda _, array: self.up.append(array.shape))
        watch(ort.OrtValue, "numpy", lambda value: self.down.append(tuple(value.shape())))
        watch(ort.IOBinding, "bind_cpu_input", note_name)
        watch(ort.IOBinding, "bind_output", note_name)
        watch(ort.InferenceSession, "run_with_iobinding", note_run)


@pytest.mark.parametrize("method", METHODS)
def test_every_method_gives_the_hosts_bytes(
    host: Engine, bound: Engine, small_request: Build, method: str
) -> None:
    asked = partial(small_request, refine=AS_SAMPLED)
    for sampler in ({"method": method}, {"method": method, **THREE_STEPS}):
        assert_same_bytes(plan(bound, asked(sampler=sampler)), plan(host, asked(sampler=sampler)))


@pytest.mark.parametrize("name", ["student", "goalflow"])
def test_a_shipped_bundle_gives_the_hosts_bytes(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """One with a prior of the scene's routes, and one with a mixture of its encoder's."""
    bundle = load_bundle(DEFAULT_BUNDLE.with_name(name))
    probe = CONDITIONINGS[bundle.manifest.conditioning.kind](bundle).probe()
    request = replace(probe, sampler=SamplerChoice("heun", uniform_schedule(2)))
    on_host = plan(Engine(bundle, threads=1), request)
    monkeypatch.setitem(DEVICES, "cpu", STAND_IN)
    on_device = plan(Engine(bundle, threads=1), request)
    for name, array in on_host.arrays.items():
        assert on_device.arrays[name].tobytes() == array.tobytes(), name


@pytest.mark.parametrize("steps", [3, 12])
def test_states_and_context_cross_once_however_many_steps(
    bound: Engine, small_request: Build, monkeypatch: pytest.MonkeyPatch, steps: int
) -> None:
    """Up go x_0, the prior's means and a row for each stage time, down comes x_1; nothing else but
    weights."""
    schedule = uniform_schedule(steps)
    times = len(stage_times(method_named("rk4"), schedule).times)
    request = small_request(sampler={"method": "rk4", "schedule": schedule}, refine=AS_SAMPLED)
    seen = Crossings(monkeypatch)
    plan(bound, request)
    assert sorted(seen.up) == [*[(1, 3)] * times, *[(1, 20, 8, 7)] * 2]
    assert seen.down == [(1, 20, 8, 7)]
    # A step has four evaluations, three sums before them and four at its end.
    assert seen.runs == steps * (4 + 3 + 4)
    assert seen.at_a_run == ["weight"] * (steps * (3 + 4))


def test_a_call_is_asked_after_every_step_whether_it_goes_on(
    bound: Engine, small_request: Build, monkeypatch: pytest.MonkeyPatch
) -> None:
    class GivenUp(Exception):
        pass

    seen, runs = Crossings(monkeypatch), []

    def check() -> None:
        if seen.runs:
            runs.append(seen.runs)
        if len(runs) == 2:
            raise GivenUp

    with pytest.raises(GivenUp):
        plan(bound, small_request(sampler={"method": "euler", **THREE_STEPS}), check=check)
    assert runs == [2, 4]  # an evaluation and a sum to a step
    assert seen.down == []


def test_guidance_and_the_states_on_the_way_are_the_hosts(
    host: Engine, bound: Engine, small_request: Build, monkeypatch: pytest.MonkeyPatch
) -> None:
    def none_here(*_: Any, **__: Any) -> None:
        raise AssertionError("on the device")

    monkeypatch.setattr(DeviceLoop, "integrate", none_here)
    with pytest.raises(AssertionError, match="on the device"):
        plan(bound, small_request())

    guided = small_request(refine={**AS_SAMPLED, "guidance": 1.0})
    assert_same_bytes(plan(bound, guided), plan(host, guided))
    on_device, on_host = (
        engine.flow_states(resolve_for_card(small_request(), engine.card)).positions
        for engine in (bound, host)
    )
    np.testing.assert_array_equal(on_device, on_host)


def test_plans_at_once_do_not_touch_each_other(
    bound: Engine, small_request: Build, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Though others take their turn between what a plan binds and its run."""
    run = ort.InferenceSession.run_with_iobinding

    def run_late(session: ort.InferenceSession, binding: ort.IOBinding) -> None:
        time.sleep(1e-4)
        run(session, binding)

    monkeypatch.setattr(ort.InferenceSession, "run_with_iobinding", run_late)
    assert_same_at_once(bound, [small_request(seed=seed) for seed in range(4)])


def needing(provider: str, named: str) -> Any:
    """A case for a provider, skipped where this onnxruntime lacks it or cannot load it: a build
    for GPUs offers TensorRT wherever it runs."""
    wanted = PROVIDERS[provider]
    lacks = wanted not in ort.get_available_providers() or wanted not in obtained(wanted)
    skip = pytest.mark.skipif(lacks, reason=f"no {named} provider")
    return pytest.param(provider, marks=skip, id=provider)


def obtained(wanted: str) -> Sequence[str]:
    """Return the providers of a session that requested one."""
    options = ort.SessionOptions()
    options.log_severity_level = 4  # what cannot be loaded is no news here
    return ort.InferenceSession(ADD_SCALED, options, providers=[wanted]).get_providers()


@pytest.mark.parametrize(
    "provider", ["cpu", needing("cuda", "CUDA"), needing("tensorrt", "TensorRT")]
)
def test_each_device_gives_the_cpus_anchors(
    host: Engine,
    tiny_bundle: Path,
    small_request: Build,
    monkeypatch: pytest.MonkeyPatch,
    provider: str,
) -> None:
    """Up to rounding, in its own memory and with states that cross at every evaluation."""
    request, bundle = small_request(refine=AS_SAMPLED), load_bundle(tiny_bundle)
    if provider == "cpu":
        monkeypatch.setitem(DEVICES, "cpu", STAND_IN)
    staying = Engine(bundle, threads=1, provider=provider)
    monkeypatch.delitem(DEVICES, provider)
    crossing = Engine(bundle, threads=1, provider=provider)
    expected = plan(host, request)

    seen = Crossings(monkeypatch)
    anchors = [plan(staying, request).trajectories]
    assert set(seen.at_a_run) == {"weight"}
    anchors.append(plan(crossing, request).trajectories)
    assert {"x_t", "modulation", "dx_t"} < set(seen.at_a_run)
    for trajectories in anchors:
        np.testing.assert_allclose(trajectories, expected.trajectories, atol=1e-5)
