"""Sample a bundle or checkpoint with a textbook loop, the reference for the engine's latency.

Every evaluation of the field encodes the scene again, repeats the context for every sample, and
evaluates one flow time.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import onnxruntime as ort
from numpy.typing import NDArray

from anchorflow_benchmarks import BenchmarkError
from anchorflow_client.contract import OdeSpec
from anchorflow_service.bundle import Bundle
from anchorflow_service.engine.samplers.flow import PRIOR_MEAN, Beginning
from anchorflow_trajectory.ode.integrate import PlainField, integrate_plainly
from anchorflow_trajectory.ode.methods import method_named

Array = NDArray[np.float32]
Arrays = Mapping[str, Array]
Loop = Callable[[Arrays, Beginning, OdeSpec], Array]
"""Inputs of encode, N anchors before the flow, and a sampler -> x_1 [N,T,S]."""


def sample_plainly(field: PlainField, x: Any, sampler: OdeSpec) -> Any:
    """Integrate x [N,T,S], a numpy array or torch tensor, from t = 0 to t = 1."""
    method = method_named(sampler.method)
    return integrate_plainly(field, x, schedule=sampler.schedule, method=method)


class OnnxField:
    """The bundle's graphs with onnxruntime's defaults, run one by one at every evaluation.

    repeat_inputs: repeat the scene for every sample before encoding, as a single graph would
    """

    def __init__(self, bundle: Bundle, *, threads: int, repeat_inputs: bool = False) -> None:
        self._sessions = {
            role: _session(bundle, role, threads) for role in ("encode", "modulate", "field")
        }
        self._repeat_inputs = repeat_inputs

    def of(self, inputs: Arrays, mean: Array | None) -> PlainField:
        """Return the field of one scene, given the inputs of encode with B = 1.

        mean: [N,T,S] of the prior of each sample, or None
        """
        own = {} if mean is None else {PRIOR_MEAN: mean[:, None]}

        def field(x: Array, t: float) -> Array:
            context = {**self._context(inputs, len(x)), **own}
            times = np.array([t], np.float32)
            modulation = self._run("modulate", {**context, "times": times})["modulation"]
            arrays = {**context, "x_t": x[:, None], "modulation": modulation[:, 0]}
            return self._run("field", arrays)["dx_t"][:, 0]

        return field

    def _context(self, inputs: Arrays, count: int) -> Arrays:
        if self._repeat_inputs:
            return self._run("encode", repeated(inputs, count))
        return repeated(self._run("encode", inputs), count)

    def _run(self, role: str, arrays: Arrays) -> dict[str, Array]:
        session = self._sessions[role]
        feeds = {node.name: arrays[node.name] for node in session.get_inputs()}
        names = [node.name for node in session.get_outputs()]
        return dict(zip(names, map(np.asarray, session.run(names, feeds)), strict=True))


def repeated(arrays: Arrays, count: int) -> dict[str, Array]:
    """Copy arrays [1,...] -> [N,...]."""
    return {name: np.repeat(array, count, axis=0) for name, array in arrays.items()}


def _session(bundle: Bundle, role: str, threads: int) -> ort.InferenceSession:
    options = ort.SessionOptions()
    options.intra_op_num_threads = threads
    path = bundle.graph_path(role)
    return ort.InferenceSession(path, options, providers=["CPUExecutionProvider"])


def onnx_loop(bundle: Bundle, *, threads: int, repeat_inputs: bool = False) -> Loop:
    """Return the plain loop over a bundle's own graphs."""
    graphs = OnnxField(bundle, threads=threads, repeat_inputs=repeat_inputs)
    return lambda inputs, begun, sampler: sample_plainly(
        graphs.of(inputs, begun.mean), begun.x, sampler
    )


def torch_loop(checkpoint: Path, *, threads: int) -> Loop:
    """Return the plain loop over a checkpoint's averaged weights in eager float32 torch.

    Raises:
        BenchmarkError: the file is not a checkpoint of FlowMP.
    """
    import torch

    from anchorflow_training.checkpoint import CheckpointError, load_checkpoint, restore_flow

    torch.set_num_threads(threads)
    try:
        model = restore_flow(load_checkpoint(checkpoint))
    except CheckpointError as error:
        raise BenchmarkError(str(error)) from error

    @torch.inference_mode()
    def sample(inputs: Arrays, begun: Beginning, sampler: OdeSpec) -> Array:
        assert begun.mean is not None  # FlowMP's prior is the scene's routes
        tensors = {name: torch.from_numpy(array) for name, array in inputs.items()}
        mean = torch.from_numpy(begun.mean)[:, None]

        def field(x: torch.Tensor, t: float) -> torch.Tensor:
            encoded = model.encode(**tensors)
            context = {n: v.repeat_interleave(len(x), 0) for n, v in encoded.items()}
            modulation = model.modulate(torch.tensor([t]), context)[:, 0]
            return model.field(x[:, None], mean, modulation, context)[:, 0]

        return sample_plainly(field, torch.from_numpy(begun.x), sampler).numpy()

    return sample
