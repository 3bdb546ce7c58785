"""The plain loop over the torch model of a checkpoint."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from anchorflow_benchmarks.errors import BenchmarkError
from anchorflow_benchmarks.plain_loop import Arrays, sample_plainly
from anchorflow_client.contract import OdeSpec
from anchorflow_service.engine.samplers.ode import Beginning
from anchorflow_training.checkpoint import CheckpointError, load_checkpoint
from anchorflow_training.restore import restore_flow
from anchorflow_trajectory.ode.reference import PlainField


class TorchLoop:
    """A checkpoint's averaged weights, sampled the obvious way in eager float32.

    Raises:
        BenchmarkError: the file is no checkpoint of FlowMP.
    """

    def __init__(self, checkpoint: Path, *, threads: int) -> None:
        torch.set_num_threads(threads)
        try:
            self._model = restore_flow(load_checkpoint(checkpoint))
        except CheckpointError as error:
            raise BenchmarkError(str(error)) from error

    @torch.inference_mode()
    def sample(self, inputs: Arrays, begun: Beginning, sampler: OdeSpec) -> NDArray[np.float32]:
        """States at t = 1 [N,T,S] of anchors before the flow, given the inputs of encode, B = 1."""
        assert begun.mean is not None  # FlowMP's prior is a scene's routes
        tensors = {name: torch.from_numpy(array) for name, array in inputs.items()}
        field = self._field(tensors, torch.from_numpy(begun.mean)[:, None])
        return sample_plainly(field, torch.from_numpy(begun.x), sampler).numpy()

    def _field(self, inputs: dict[str, Tensor], mean: Tensor) -> PlainField:
        def field(x: Tensor, t: float) -> Tensor:
            encoded = self._model.encode(**inputs)
            context = {n: v.repeat_interleave(len(x), 0) for n, v in encoded.items()}
            modulation = self._model.modulate(torch.tensor([t]), context)[:, 0]
            return self._model.field(x[:, None], mean, modulation, context)[:, 0]

        return field
