"""The noise that the flow starts from: smooth trajectories around the scene's routes.

x_0 is the spline along a route plus a Gaussian in its free control points and its log duration, so
it is a trajectory whose velocity and acceleration belong to its position, as in the data. Over the
routes it is a mixture: anchor i begins on route i modulo their number. The covariance is that of
what the expert's tries began with, in the scene's axes and in shares of `Frame.spread`; for data
without it, that of the trajectories' residuals from their route's spline: a flow
between distributions of equal first and second moments has the least way to go.

A state is p, p', p'' in the trajectory's own time, in m, and its log duration at every step.
"""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor, nn

from anchorflow_models.flowmp.config import L2Config
from anchorflow_models.flowmp.frame import Frame
from anchorflow_models.layers.geometry import in_float32
from anchorflow_trajectory.spline.basis import SplineBasis

FIELDS = 3  # position and its derivatives by the trajectory's own time
LEAST_SPREAD = 0.05  # of log duration, which data of one horizon do not spread at all


class TrajectoryPrior(nn.Module):
    """The noise of each scene, and the units in which the network works."""

    free: Tensor  # [F, T, 3] states of each free control point
    factor: Tensor  # [R, D F + 1] control points' and log duration's noise of each unit of noise
    spread: Tensor  # [S] standard deviation of the states' residuals

    def __init__(self, config: L2Config) -> None:
        super().__init__()
        self.dim = config.dim
        self.register_buffer("free", _free_states(config.basis))
        self.register_buffer("factor", torch.zeros(self.rank, self.rank))
        self.register_buffer("spread", torch.ones(config.state_dim))
        self.set_covariance(np.eye(self.rank))

    @property
    def rank(self) -> int:
        """R: numbers of noise a trajectory."""
        return self.dim * self.free.shape[0] + 1

    def set_covariance(self, covariance: np.ndarray) -> None:
        """Take the residuals' covariance [R, R]: control points in (D, F) order, log duration.

        Control points in shares of `Frame.spread`, in the scene's axes.
        """
        ridge = 1e-6 * np.trace(covariance) / self.rank * np.eye(self.rank)
        root = np.linalg.cholesky(np.asarray(covariance, np.float64) + ridge).T
        self.factor.copy_(torch.from_numpy(root))
        states = self._noise_states(torch.ones(1))[0]
        self.spread.copy_(states.square().sum(0).mean(0).sqrt())
        self.spread[-1].clamp_(min=LEAST_SPREAD)

    def widen(self, scale: float) -> None:
        """Draw noise `scale` times as wide; above 1 more alternatives, each less typical."""
        self.factor.mul_(scale)

    def basis(self, frame: Frame, horizon_s: Tensor) -> Tensor:
        """States of each unit of noise, [B, R, T * S] in SI and the map's frame.

        horizon_s: [B], above 0 where a duration is given and not drawn
        """
        states = self._noise_states(frame.spread)
        fields = states[..., :-1].unflatten(-1, (FIELDS, self.dim))
        turned = frame.turn_out(fields).flatten(-2)
        lasting = states[..., -1:] * (horizon_s <= 0).to(states)[:, None, None, None]
        return torch.cat([turned, lasting], -1).flatten(2)

    def units(self, frame: Frame) -> Tensor:
        """[B, S, S]: what turns SI residuals (rows) into the scene's axes, at unit spread."""
        turn = frame.rotation / frame.spread[:, None, None]
        return self._diagonal(turn) / self.spread

    def si_units(self, frame: Frame) -> Tensor:
        """[B, S, S]: the inverse of `units`."""
        turn = frame.rotation.transpose(1, 2) * frame.spread[:, None, None]
        return self._diagonal(turn) * self.spread[:, None]

    @in_float32
    def normalise(self, residual: Tensor, units: Tensor) -> Tensor:
        """What states [B, N, T, S] in SI differ by, at unit spread in the scene's axes."""
        return (residual.flatten(1, 2) @ units).reshape(residual.shape)

    @in_float32
    def to_si(self, field: Tensor, si_units: Tensor) -> Tensor:
        """A field [B, N, T, S] of the normalised states as one of the SI states."""
        return (field.flatten(1, 2) @ si_units).reshape(field.shape)

    @in_float32
    def disturbed(self, disturbance: Tensor) -> Tensor:
        """States [..., T, S] of control points in (D, F) order [m] and log duration [..., R]."""
        points = disturbance[..., :-1].unflatten(-1, (self.dim, -1))
        fields = torch.einsum("...df,ftk->...tkd", points, self.free).flatten(-2)
        lasting = disturbance[..., None, -1:].expand(*fields.shape[:-1], 1)
        return torch.cat([fields, lasting], -1)

    def _noise_states(self, size: Tensor) -> Tensor:
        """[B, R, T, S] in the scene's axes; size: [B] m"""
        states = self.disturbed(self.factor)
        lengths = size[:, None].expand(-1, states.shape[-1] - 1)
        scale = torch.cat([lengths, torch.ones_like(size)[:, None]], -1)
        return states * scale[:, None, None]

    def _diagonal(self, turn: Tensor) -> Tensor:
        """[B, D, D] -> [B, S, S]: the same for p, p' and p''; log duration stays."""
        blocks = torch.eye(FIELDS, device=turn.device)[:, None, :, None] * turn[:, None, :, None, :]
        size = FIELDS * self.dim
        whole = nn.functional.pad(blocks.reshape(-1, size, size), (0, 1, 0, 1))
        last = torch.zeros(size + 1, device=turn.device)
        last[-1] = 1.0
        return whole + torch.diag(last)


def _free_states(basis: SplineBasis) -> Tensor:
    orders = (basis.position, basis.velocity, basis.acceleration)
    return torch.from_numpy(np.stack([order[:, basis.free].T for order in orders], -1))
