"""Predict the poses of every other road user in several modes.

Each is predicted in its own frame, from its past, the lanes around it and the road users near it.
Predictions depend neither on the ego's place nor on the order of the others.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from anchorflow_client.sensors import HEADING, KIND, KINDS, LENGTH, VX, VY, WIDTH, X, Y
from anchorflow_models.futures.config import FuturesConfig
from anchorflow_models.goalflow.networks import at_places

STATE = 6
"""Numbers of a state in a frame: place, cosine and sine of the heading, velocity."""
DRIVABLE, LANES, CROSSWALKS = 0, slice(1, 5), 5
"""Channels of the raster; lanes point ahead, left, back and right."""
AHEAD, ASIDE = (-6.0, 42.0, 17), (-10.5, 10.5, 8)
"""Least, greatest (m) and number of the places around a road user at which it reads the raster."""
MAP_FEATURES = 5
PLACE_UNIT, SPEED_UNIT = 10.0, 10.0  # m, m/s


class FuturesNetwork(nn.Module):
    """The network.

    around: [P, 2] m, the places at which it reads the raster, in the frame of a road user
    """

    around: Tensor

    def __init__(self, config: FuturesConfig) -> None:
        super().__init__()
        self.config = config
        width, channels = config.width, config.map_channels
        self.register_buffer("around", _grid(), persistent=False)
        self.history = _mlp(config.times * (STATE + 1) + 2 + len(KINDS), width, width)
        self.lanes = nn.Sequential(
            nn.Conv2d(MAP_FEATURES, channels, 3, padding=1),
            nn.SiLU(),
            nn.Conv2d(channels, 2 * channels, 3, stride=2, padding=1),
            nn.SiLU(),
            nn.Flatten(),
            nn.Linear(2 * channels * (AHEAD[2] // 2 + 1) * (ASIDE[2] // 2), width),
        )
        self.near = _mlp(STATE + 2 + 2 + len(KINDS) + 1, width // 2, width // 2)
        self.mix = nn.Sequential(
            nn.Linear(2 * width + width // 2, width), nn.SiLU(), nn.Linear(width, width)
        )
        self.modes = nn.Parameter(torch.randn(config.modes, width))
        self.ways = nn.Sequential(
            nn.SiLU(),
            nn.Linear(width, width),
            nn.SiLU(),
            nn.Linear(width, config.num_steps * 3 + 1),
        )

    def forward(self, others: Tensor, bev: Tensor, ego_status: Tensor) -> tuple[Tensor, Tensor]:
        """Return poses [B, A, M, T, 3] in the ego's frame and logits [B, A, M].

        others: [B, A, H, 8] as `anchorflow_client.sensors.others_before`; bev: uint8 [B, C, H, W];
        ego_status: [B, 8]
        """
        now = others[:, :, -1]
        there = now[..., KIND] > 0
        frame = now[..., : HEADING + 1]
        kind = F.one_hot((now[..., KIND].long() - 1).clamp(0, len(KINDS) - 1), len(KINDS)).to(
            others.dtype
        )
        size = now[..., LENGTH : WIDTH + 1] / PLACE_UNIT
        history = self._history(others, frame)
        seen = torch.cat(
            [
                self.history(torch.cat([history, size, kind], -1)),
                self._lanes(bev, frame),
                self._near(now, there, kind, ego_status),
            ],
            -1,
        )
        hidden = self.mix(seen)[..., None, :] + self.modes
        ways = self.ways(hidden)
        steps = ways[..., :-1].unflatten(-1, (self.config.num_steps, 3))
        return self._poses(steps, now), ways[..., -1]

    def futures(self, others: Tensor, bev: Tensor, ego_status: Tensor) -> dict[str, Tensor]:
        """Return futures [B, A, M, T, 3] and future_probabilities [B, A, M], the likeliest mode
        first; zeros in unused rows.
        """
        poses, logits = self(others, bev, ego_status)
        order = logits.argsort(-1, descending=True)
        there = (others[:, :, -1, KIND] > 0).to(poses.dtype)[..., None]
        index = order[..., None, None].expand(-1, -1, -1, *poses.shape[-2:])
        return {
            "futures": poses.gather(2, index) * there[..., None, None],
            "future_probabilities": logits.softmax(-1).gather(2, order) * there,
        }

    def _history(self, others: Tensor, frame: Tensor) -> Tensor:
        """Return the past [B, A, H (STATE + 1)] of each in its own frame; zeros while absent."""
        there = (others[..., KIND:] > 0).to(others.dtype)
        states = _seen_from(frame[:, :, None], others[..., : VY + 1])
        return (torch.cat([states, there], -1) * there).flatten(2)

    def _lanes(self, bev: Tensor, frame: Tensor) -> Tensor:
        """Return features [B, A, W] of the lanes around each, turned into its frame."""
        drawn = bev[:, : CROSSWALKS + 1].to(frame.dtype) / 255.0
        # A centreline is one cell wide; the mean of sixteen can be read a step beside it.
        # (As a convolution, which onnxruntime runs ten times as fast as the pooling.)
        channels, side = drawn.shape[1], 4
        mean = torch.full((channels, 1, side, side), 1 / side**2, device=drawn.device)
        soft = F.conv2d(drawn, mean, stride=2, padding=1, groups=channels).permute(0, 2, 3, 1)
        cos, sin = frame[..., HEADING, None].cos(), frame[..., HEADING, None].sin()
        x, y = self.around.unbind(-1)
        places = frame[..., None, :2] + torch.stack([cos * x - sin * y, sin * x + cos * y], -1)
        read = at_places(soft, places, self.config.bev.extent)
        ahead, left, back, right = read[..., LANES].unbind(-1)
        along, aside = ahead - back, left - right
        turned = [cos * along + sin * aside, cos * aside - sin * along, ahead + left + back + right]
        features = torch.stack([read[..., DRIVABLE], read[..., CROSSWALKS], *turned], -2)
        grid = features.unflatten(-1, (AHEAD[2], ASIDE[2])).flatten(0, 1)
        return self.lanes(grid).unflatten(0, frame.shape[:2])

    def _near(self, now: Tensor, there: Tensor, kind: Tensor, ego_status: Tensor) -> Tensor:
        """Return features [B, A, W / 2] of the road users near each, the ego among them."""
        ego = torch.zeros_like(now[:, :1])
        ego = torch.cat([ego[..., :VX], ego_status[:, None, 4:6], ego[..., LENGTH:]], -1)
        all_ = torch.cat([now, ego], 1)
        is_ego = F.pad(torch.zeros_like(there, dtype=now.dtype), (0, 1), value=1.0)[..., None]
        size = all_[..., LENGTH : WIDTH + 1] / PLACE_UNIT
        boxes = torch.cat([size, F.pad(kind, (0, 0, 0, 1)), is_ego], -1)
        states = _seen_from(now[:, :, None, : HEADING + 1], all_[:, None, :, : VY + 1])
        away = states[..., :2].square().sum(-1, keepdim=True)
        own = _turned(now[..., VX : VY + 1], now[..., HEADING])[:, :, None] / SPEED_UNIT
        pairs = [states, own.expand(-1, -1, states.shape[2], -1)]
        boxes = boxes[:, None].expand(-1, states.shape[1], -1, -1)
        hidden = self.near(torch.cat([*pairs, boxes], -1)) / (1 + away)
        count = now.shape[1]
        others = torch.cat([there, torch.ones_like(there[:, :1])], 1)[:, None]
        itself = torch.eye(count, count + 1, dtype=torch.bool, device=now.device)
        return torch.where((others & ~itself)[..., None], hidden, 0.0).amax(2)

    def _poses(self, steps: Tensor, now: Tensor) -> Tensor:
        """Return poses [B, A, M, T, 3] in the ego's frame.

        steps: [B, A, M, T, 3] what velocities (in m/s, in the frame of each) and headings differ by
        from those of now
        """
        own = _turned(now[..., VX : VY + 1], now[..., HEADING])[:, :, None, None]
        moved = ((own + steps[..., :2]) * self.config.dt).cumsum(-2)
        heading = now[..., HEADING, None, None]
        cos, sin = heading.cos(), heading.sin()
        x, y = moved.unbind(-1)
        return torch.stack(
            [
                now[..., X, None, None] + cos * x - sin * y,
                now[..., Y, None, None] + sin * x + cos * y,
                heading + steps[..., 2],
            ],
            -1,
        )


def _grid() -> Tensor:
    x, y = torch.linspace(*AHEAD), torch.linspace(*ASIDE)
    return torch.stack(torch.meshgrid(x, y, indexing="ij"), -1).flatten(0, 1)


def _mlp(inputs: int, hidden: int, outputs: int) -> nn.Sequential:
    return nn.Sequential(nn.Linear(inputs, hidden), nn.SiLU(), nn.Linear(hidden, outputs))


def _turned(vectors: Tensor, heading: Tensor) -> Tensor:
    """Return vectors [..., 2] in frames of such headings [...]."""
    cos, sin = heading.cos(), heading.sin()
    x, y = vectors.unbind(-1)
    return torch.stack([cos * x + sin * y, cos * y - sin * x], -1)


def _seen_from(frame: Tensor, states: Tensor) -> Tensor:
    """Return states [..., 5] in frames [..., 3], in the network's units: [..., STATE]."""
    heading = frame[..., HEADING]
    place = _turned(states[..., :2] - frame[..., :2], heading) / PLACE_UNIT
    turn = states[..., HEADING] - heading
    velocity = _turned(states[..., VX : VY + 1], heading) / SPEED_UNIT
    return torch.cat([place, torch.stack([turn.cos(), turn.sin()], -1), velocity], -1)
