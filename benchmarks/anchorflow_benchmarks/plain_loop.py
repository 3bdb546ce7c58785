"""The same weights sampled the obvious way: what the engine is compared with.

Every evaluation of the field encodes the scene again, repeats what comes out for every sample, and
asks for one flow time. The loop itself is the textbook's, with its temporary arrays.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import onnxruntime as ort
from numpy.typing import NDArray

from anchorflow_client.contract import OdeSpec
from anchorflow_service.bundle import Bundle
from anchorflow_service.engine.samplers.flow_score import PRIOR_MEAN
from anchorflow_trajectory.ode.method import method_named
from anchorflow_trajectory.ode.reference import PlainField, integrate_plainly

Array = NDArray[np.float32]
Arrays = Mapping[str, Array]


def sample_plainly(field: PlainField, x: Any, sampler: OdeSpec) -> Any:
    """x at t = 1 from x at t = 0 [N,T,S]; numpy arrays or torch tensors."""
    method = method_named(sampler.method)
    return integrate_plainly(field, x, schedule=sampler.schedule, method=method)


class OnnxField:
    """The bundle's graphs with onnxruntime's defaults, called in turn at every evaluation.

    repeat_inputs: repeat the scene itself for every sample, as one graph of everything would have
        it, in place of what encode makes of it; N encodings in place of one
    """

    def __init__(self, bundle: Bundle, *, threads: int, repeat_inputs: bool = False) -> None:
        self._sessions = {
            role: _session(bundle, role, threads) for role in ("encode", "modulate", "field")
        }
        self._repeat_inputs = repeat_inputs

    def of(self, inputs: Arrays, mean: Array | None) -> PlainField:
        """The field of one scene, given the inputs of encode with a B axis of 1.

        mean: [N,T,S], the prior's of each sample; None where it has none of its own
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
    """[1,...] -> [N,...], copied: a caller who repeats does not broadcast."""
    return {name: np.repeat(array, count, axis=0) for name, array in arrays.items()}


def _session(bundle: Bundle, role: str, threads: int) -> ort.InferenceSession:
    options = ort.SessionOptions()
    options.intra_op_num_threads = threads
    path = bundle.graph_path(role)
    return ort.InferenceSession(path, options, providers=["CPUExecutionProvider"])
