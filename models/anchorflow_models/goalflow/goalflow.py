"""GoalFlow: trajectories drawn to goals by conditional flow matching (Xing et al., CVPR 2025).

    encode     a scene                     -> goals with scores, the ways that trajectories begin on
    modulate   flow times                  -> the field's modulation
    field      x_t on the way to a goal    -> dx/dt
    score      trajectories                -> scores

A state is a pose (x, y, heading) and three numbers that no flow moves: whether it has a goal (1, 0,
GIVEN or SETTLED), and the acceleration and curvature of the way that it began on.
"""

from __future__ import annotations

from dataclasses import astuple, fields
from typing import Any, cast

import numpy as np
import torch
from torch import Tensor, nn

from anchorflow_client.sensors import ROUTE_POINTS
from anchorflow_models.goalflow.config import (
    HALTINGS,
    SENSED_STRIDE,
    STRIDE,
    TURNS,
    GoalFlowConfig,
    ScoreWeights,
)
from anchorflow_models.goalflow.networks import (
    FIELDS,
    VELOCITY,
    SceneEncoder,
    WayScorer,
    WayScores,
    at_places,
    in_units,
    pick,
)
from anchorflow_models.goalflow.trajectory_score import (
    Judged,
    OutcomeScorer,
    Surroundings,
    judge,
    met,
    outcome_scores,
    trajectory_scores,
)
from anchorflow_models.goalflow.ways import (
    BRAKING,
    PULLING,
    SETTING_OFF,
    SHARPEST,
    SLOWING,
    arc_to,
    follows,
    is_told,
    led_to,
    roll_out,
    sharpest_at,
    ways_along,
    within,
)
from anchorflow_models.layers.geometry import in_float32, standing_still
from anchorflow_models.lqr_rollout import SLOWEST_TURN, curvature_of

Context = dict[str, Tensor]

POSE = 3
STATE = 6  # x, y, heading; has a goal, acceleration, curvature of the way it began on
UNITS = (10.0, 3.0, 1.0)  # m/s, m/s², rad/s, in which a motion is heard of
TIME_LEFT = 0.02  # least, that a slope is divided by
FULL = 255.0
LOOKED_UP = (2, 2)  # cells, the fewest that a look-up takes
BEND = 10.0  # m, scales curvatures for the networks
STRAYS = (0.4, 4.0)  # m, before training, at the first pose and at the last
SETTLED = -1.0  # in place of whether it has a goal: the way itself is the trajectory
GIVEN = 2.0  # the same: a goal of the request, which the trajectory reaches
LEANING = 2.5  # m/s² to the side, at most, of turns
LEAST_WEIGHT = 1e-6  # of a request's
CERTAIN = 20.0  # a logit, of what is known
GAINS = (3.0, 0.1)  # m/s², 1/m: how far controls may be from those of the way
SURROUNDINGS = tuple(each.name for each in fields(Surroundings))
"""Names of a score's inputs."""


class GoalFlow(nn.Module):
    """The network.

    vocabulary: [K, 2] m, the goals; stray: [T, 3] distance of poses from the way to their goal

    noise_scale: of sigma, when trajectories are drawn; 1: as in training
    takes_goals: whether requests may bring goals
    """

    vocabulary: Tensor
    stray: Tensor

    context_for_modulate = ("context",)
    context_for_field = ("features", "speed")
    context_for_score = ("features", "context", "course", *SURROUNDINGS)

    def __init__(self, config: GoalFlowConfig) -> None:
        super().__init__()
        self.config = config
        features, steps, context = config.feature_channels, config.num_steps, config.context
        self.scene = SceneEncoder(
            inputs=config.seen[0],
            stride=SENSED_STRIDE if config.sensors else STRIDE,
            channels=config.channels,
            features=features,
            context=context,
        )
        self.scorer = WayScorer(
            steps=steps, features=features, context=context, width=config.scorer_width
        )
        # A pose's numbers, those of the way, the features there; has a goal, controls of the way.
        token = POSE + 4 + features + 3
        self.flow = FIELDS[config.backbone](config, token=token)
        self.outcomes = (
            OutcomeScorer(
                steps=steps, features=features, context=context, width=config.outcome_width
            )
            if config.outcomes
            else None
        )
        self.noise_scale, self.takes_goals = 1.0, False
        self.register_buffer("vocabulary", _fan(config.goals))
        stray = np.linspace(*STRAYS, steps)[:, None] * [1.0, 1.0, 0.05]
        self.register_buffer("stray", torch.tensor(stray, dtype=torch.float32))

    def encode(
        self,
        bev: Tensor,
        ego_status: Tensor,
        vehicle_size: Tensor,
        route: Tensor | None = None,
        goal: Tensor | None = None,
        score_weights: Tensor | None = None,
    ) -> Context:
        """bev: [B, C, H, W] of the layout's dtype; ego_status: [B, 8]
        vehicle_size: [B, 2] length, width (m)
        route: [B, P, 2] m, as `anchorflow_client.sensors.route_ahead`; zeros, or None: not told;
        goal: [B, G, 2] m, to which alone trajectories are drawn, in turn; zeros, or None: not told;
        score_weights: [B, 8] in the order of `ScoreWeights`; zeros, or None: the configuration's.

        Returns by name: goals [B, K, 2] and goal_scores [B, K], those that are picked first, then
        by score; trajectory_goals [B, ways, 2], where each way leads; prior_mean [B, ways, T, S],
        after the goals' the shadow, the turns and the halts, and by turns with them those along the
        route; prior_basis [B, 3T, T·S]; and the inputs of the other graphs.
        """
        context = self.look(bev, ego_status, vehicle_size, route)
        return self.with_ways(context, ego_status, goal, score_weights)

    def with_ways(
        self,
        context: Context,
        ego_status: Tensor,
        goal: Tensor | None = None,
        score_weights: Tensor | None = None,
    ) -> Context:
        """Return what `look` gave with all that `encode` returns."""
        speed, bend = context["speed"], context["curvature"]
        ways = self.ways_to(self.vocabulary.expand(speed.shape[0], -1, -1), speed)
        rated = self.rate(ways[..., :POSE], context)
        scores = rated.drivable.sigmoid() * rated.distance.sigmoid()  # delta_dac · delta_dis
        order = self.order(scores)
        picked = order[:, : self.config.picked, None, None]
        # Plain gathers: the exporter takes the scenes of take_along_dim for a constant.
        taken = ways.gather(1, picked.expand(-1, -1, *ways.shape[2:]))
        shadow = self.shadow(ego_status, speed)
        ways = torch.cat([taken, shadow, self.turns(speed), self.halts(shadow, speed)], 1)
        ways = self.with_route(ways, context["course"], speed, bend)
        ways, aims = self.with_goals(ways, goal, speed)
        if score_weights is not None:
            context["weights"] = self.weights_or(score_weights)
        return context | {
            "prior_mean": ways,
            "trajectory_goals": aims,
            "prior_basis": self.basis().expand(scores.shape[0], -1, -1),
            "goals": self.vocabulary[order],
            "goal_scores": scores.gather(1, order),
        }

    def order(self, scores: Tensor) -> Tensor:
        """Return the order of goals [B, K] by scores [B, K]: the picked ones, then the others."""
        count = self.config.picked
        picked = pick(self.vocabulary, scores, count=count, spacing=self.config.spacing)
        first = 2.0 - torch.arange(count, device=scores.device) / count
        return scores.scatter(1, picked, first.expand_as(picked)).argsort(-1, descending=True)

    def look(
        self, bev: Tensor, ego_status: Tensor, vehicle_size: Tensor, route: Tensor | None = None
    ) -> Context:
        """Return the features of a scene, and the route."""
        cells = self.cells(bev)
        return self.seen(cells, self.surfaces(cells), ego_status, vehicle_size, route)

    def seen(
        self,
        cells: Tensor,
        surfaces: tuple[Tensor, Tensor],
        ego_status: Tensor,
        vehicle_size: Tensor,
        route: Tensor | None,
    ) -> Context:
        """Return the features of cells [B, C, H, W] with what `surfaces` says of them."""
        untold = torch.zeros(cells.shape[0], ROUTE_POINTS, 2, device=cells.device)
        features, context = self.scene(cells, ego_status, vehicle_size)
        drivable, occupied = surfaces
        return {
            "features": features,
            "context": context,
            "speed": ego_status[:, VELOCITY],
            "acceleration": ego_status[:, VELOCITY + 2],
            "curvature": curvature_of(ego_status[:, VELOCITY:]),
            "size": vehicle_size,
            "drivable": drivable,
            "occupied": occupied,
            "course": untold if route is None else route.clone(),  # a graph passes none on
        }

    def cells(self, bev: Tensor) -> Tensor:
        """Return the raster [B, C, H, W] as the network takes it, with its padding."""
        layout = self.config.bev
        cells = bev.float() / FULL if layout.dtype == "uint8" else bev
        below, right = layout.padding
        return nn.functional.pad(cells, (0, right, 0, below)) if below or right else cells

    def surfaces(self, cells: Tensor) -> tuple[Tensor, Tensor]:
        """Return drivable [B, H, W, 1] and occupied [B, 1 + K, H, W] of a raster; in features there
        is a road everywhere and nobody on it.
        """
        layout = self.config.bev
        if layout.dtype != "uint8":
            scenes, device = cells.shape[0], cells.device
            nobody = torch.zeros(scenes, 1 + layout.foretold, *LOOKED_UP, device=device)
            return torch.ones(scenes, *LOOKED_UP, 1, device=device), nobody
        now = cells[:, layout.boxes : layout.boxes + 3].amax(1, keepdim=True)
        foretold = cells[:, layout.occupied : layout.occupied + layout.foretold]
        return cells[:, layout.drivable, :, :, None], torch.cat([now, foretold], 1)

    def ways_to(self, goals: Tensor, speed: Tensor, *, aimed: float = 1.0) -> Tensor:
        """Arcs [B, P, T, S] that end at goals [B, P, 2] in time, of cars at speeds [B]; at those
        that are too near for a speed they do not arrive.
        """
        steps, dt = self.config.num_steps, self.config.dt
        speed = speed[:, None].expand(goals.shape[:2])
        controls = arc_to(goals, speed, duration=steps * dt)
        acceleration, curvature = (each[..., None].expand(-1, -1, steps) for each in controls)
        curvature = within(curvature, sharpest_at(speed, acceleration, dt=dt))
        return self._way(speed, acceleration, curvature, aimed=aimed)

    def shadow(self, ego_status: Tensor, speed: Tensor) -> Tensor:
        """Return the way [B, 1, T, S] that continues the ego's present motion, to no goal."""
        bend = curvature_of(ego_status[:, VELOCITY:])[:, None].clamp(-SHARPEST, SHARPEST)
        # What accelerates now does not for 4 s.
        acceleration = (0.5 * ego_status[:, None, VELOCITY + 2]).clamp(-BRAKING, PULLING)
        return self._way(speed[:, None], acceleration[..., None], bend[..., None], aimed=0.0)

    def turns(self, speed: Tensor) -> Tensor:
        """Return ways [B, 2 TURNS, T, S] that bend to the left and to the right, as far as LEANING
        allows, of cars that change from speeds [B] to a turn's speed.

        No flow moves them: trajectories drawn to goals never start from a slow car that is askew
        before a corner, because people take corners in one go.
        """
        steps, dt = self.config.num_steps, self.config.dt
        turns = [(side * bend, to) for bend, to in TURNS for side in (1.0, -1.0)]
        bend, to = torch.tensor(turns).to(speed).unbind(-1)
        acceleration = (to - speed[:, None]) / (steps * dt)
        acceleration = acceleration.clamp(-SLOWING, SETTING_OFF)[..., None]
        later = dt * torch.arange(1, steps + 1).to(speed)
        fast = (speed[:, None, None] + acceleration * later).clamp(min=SLOWEST_TURN)
        curvature = within(bend[None, :, None], LEANING / fast.square())
        speed = speed[:, None].expand(curvature.shape[:2])
        return self._way(speed, acceleration, curvature, aimed=SETTLED)

    def halts(self, shadow: Tensor, speed: Tensor) -> Tensor:
        """Ways [B, HALTINGS, T, S] that brake from speeds [B] until they stand, along the bend of a
        shadow [B, 1, T, S].

        No flow moves them either: what is drawn to goals comes of people who had no need to stop.
        """
        bend = shadow[:, :, :1, POSE + 2].expand(-1, len(HALTINGS), -1)
        braking = -torch.tensor(HALTINGS).to(bend)[:, None]
        return self._way(speed[:, None].expand(bend.shape[:2]), braking, bend, aimed=SETTLED)

    def with_route(self, ways: Tensor, route: Tensor, speed: Tensor, curvature: Tensor) -> Tensor:
        """Return ways [B, V, T, S] and those along routes [B, P, 2], alternating, so that a few
        anchors have some of both: [B, c V, T, S], c rounds of the former or, given a route, both
        once and the first again.
        """
        along = self.along(route, speed, curvature)
        both = min(ways.shape[1], along.shape[1])
        by_turns = torch.stack([ways[:, :both], along[:, :both]], 2).flatten(1, 2)
        told = torch.cat([by_turns, ways[:, both:], along[:, both:]], 1)
        rounds = -(-told.shape[1] // ways.shape[1])
        untold = ways.repeat(1, rounds, 1, 1)
        told = told[:, torch.arange(untold.shape[1]) % told.shape[1]]
        return torch.where(is_told(route)[:, None, None, None], told, untold)

    def with_goals(self, ways: Tensor, goal: Tensor | None, speed: Tensor) -> tuple[Tensor, Tensor]:
        """Return ways [B, V, T, S] and where they lead [B, V, 2]: those to goals [B, G, 2] in turn
        if there are any, the given ones if not.
        """
        ends = ways[..., -1, :2]
        if goal is None:
            return ways, ends
        count = ways.shape[1]
        dealt = goal.repeat(1, count, 1)[:, :count]
        told = (goal.abs().amax((1, 2)) > 0)[:, None, None]
        own = self.ways_to(dealt, speed, aimed=GIVEN)
        return torch.where(told[..., None], own, ways), torch.where(told, dealt, ends)

    def weights_or(self, score_weights: Tensor) -> Tensor:
        """Return score weights [B, 8], the configuration's for scenes in which they are zeros."""
        own = torch.tensor(astuple(self.config.score), device=score_weights.device)
        return torch.where(score_weights.amax(-1, keepdim=True) > 0, score_weights, own)

    def along(self, route: Tensor, speed: Tensor, curvature: Tensor) -> Tensor:
        """Ways [B, W, T, S] along routes [B, P, 2]; no flow moves them either."""
        steps, dt = self.config.num_steps, self.config.dt
        poses, controls = ways_along(route, speed, curvature, steps=steps, dt=dt)
        return torch.cat([poses, torch.full_like(poses[..., :1], SETTLED), controls], -1)

    def _way(
        self, speed: Tensor, acceleration: Tensor, curvature: Tensor, *, aimed: float
    ) -> Tensor:
        """Ways [..., T, S] from speeds [...] by controls [..., 1 or T]."""
        shape = *speed.shape, self.config.num_steps
        controls = torch.stack([acceleration.expand(shape), curvature.expand(shape)], -1)
        poses = roll_out(speed, *controls.unbind(-1), dt=self.config.dt)
        return torch.cat([poses, torch.full_like(poses[..., :1], aimed), controls], -1)

    def rate(self, poses: Tensor, context: Context) -> WayScores:
        """Return the logits of ways [B, P, T, 3]."""
        return self.scorer(
            poses, context["features"], context["context"], extent=self.config.bev.covered
        )

    def basis(self) -> Tensor:
        """[1, 3T, T·S]: each number of noise moves one number of a pose, sigma times its stray."""
        steps = self.config.num_steps
        spread = torch.zeros(steps * POSE, steps, STATE, device=self.stray.device)
        number = torch.arange(steps * POSE, device=self.stray.device)
        spread[number, number // POSE, number % POSE] = (
            self.noise_scale * self.config.sigma * self.stray.flatten()
        )
        return spread.flatten(1)[None]

    @in_float32
    def draw(self, noise: Tensor, prior_mean: Tensor) -> Tensor:
        """x_0 [B, N, T, S] from standard normal noise [B, N, 3T] around [B, N, T, S]."""
        return prior_mean + (noise @ self.basis()[0]).unflatten(-1, prior_mean.shape[2:])

    def modulate(self, times: Tensor, context: Context) -> Tensor:
        """Flow times [K], or [B, K] each scene's own -> modulation [B, K, 1 + M]."""
        scenes = context["context"]
        times = times.expand(scenes.shape[0], times.shape[-1])
        left = (1 - times).clamp(min=TIME_LEFT)
        return torch.cat([1 / left[..., None], self.flow.modulate(times, scenes)], -1)

    def field(
        self, x_t: Tensor, prior_mean: Tensor, modulation: Tensor, context: Context
    ) -> Tensor:
        """x_t, prior_mean [B, N, T, S], modulation [B, 1 + M] of one time -> dx/dt [B, N, T, S]."""
        hurry = modulation[:, None, None, :1]
        expected = self.expected(x_t, prior_mean, modulation[:, None, 1:], context)
        slope = (expected - x_t[..., :POSE]) * hurry
        return torch.cat([slope, torch.zeros_like(x_t[..., POSE:])], -1)

    def expected(
        self, x_t: Tensor, prior_mean: Tensor, modulation: Tensor, context: Context
    ) -> Tensor:
        """Return poses [B, N, T, 3] expected at t = 1 of x_t [B, N, T, S]; poses that hardly move
        are made to stand still, except in training.

        modulation: [B, 1 or N, M]
        """
        poses, way = x_t[..., :POSE], prior_mean[..., :POSE]
        seen = at_places(context["features"], poses[..., :2], self.config.bev.covered)
        aimed, acceleration, curvature = prior_mean[..., POSE:].unbind(-1)
        settled = (aimed < 0)[..., None]
        told = torch.stack([aimed.clamp(0, 1), acceleration / GAINS[0], curvature * BEND], -1)
        tokens = torch.cat([(poses - way) / self.stray, in_units(way), seen, told], -1)
        change = self.flow(tokens, modulation).tanh()
        acceleration = (acceleration + GAINS[0] * change[..., 0]).clamp(-BRAKING, PULLING)
        speed = context["speed"][:, None].expand(acceleration.shape[:2])
        curvature = curvature + GAINS[1] * change[..., 1]
        curvature = within(curvature, sharpest_at(speed, acceleration, dt=self.config.dt))
        expected = roll_out(speed, acceleration, curvature, dt=self.config.dt)
        if self.takes_goals:
            ends = way[..., -1, :2]
            led = led_to(ends, expected, speed, acceleration, curvature, dt=self.config.dt)
            expected = torch.where((aimed == GIVEN)[..., None], led, expected)
        return expected if self.training else standing_still(torch.where(settled, way, expected))

    def score(self, x_1: Tensor, prior_mean: Tensor, context: Context) -> Tensor:
        """Return scores [B, N] of trajectories that began on ways, both [B, N, T, S]."""
        poses, way = x_1[..., :POSE], prior_mean[..., :POSE]
        judged = self.judged(poses, context)
        missed = (poses[..., -1, :2] - way[..., -1, :2]).square().sum(-1).sqrt()
        missed = missed * prior_mean[..., 0, POSE].clamp(0, 1)
        route, ways = context["course"], self.rate(poses, context)
        ways = ways._replace(route=torch.where(is_told(route)[:, None], CERTAIN, ways.route))
        scores = trajectory_scores(judged.rules, missed, ways, self.weights(context))
        if self.outcomes is not None:
            logits = self.outcomes(self.told(judged, context), context["context"])
            scores = outcome_scores(logits, judged.rules, scores)
        return scores * follows(poses[..., -1, :2], route)

    def judged(self, poses: Tensor, context: Context) -> Judged:
        """Judge trajectories [B, N, T, 3] by the rules."""
        return judge(poses, _surroundings(context), self.config, self.weights(context))

    def weights(self, context: Context) -> ScoreWeights:
        """Return the weights of scores: those of a request, [B, 1] each, or the configuration's."""
        if "weights" not in context:
            return self.config.score
        told = context["weights"][..., None].clamp(min=LEAST_WEIGHT).unbind(1)
        return ScoreWeights(*cast(Any, told))  # tensors where a configuration has numbers

    def told(self, judged: Judged, context: Context) -> Tensor:
        """Return the features [B, N, F] that outcomes are learnt from."""
        poses = judged.driven.poses
        seen = at_places(context["features"], poses[..., :2], self.config.bev.covered)
        moves = [values / unit for values, unit in zip(judged.motion, UNITS, strict=True)]
        others = met(judged.driven, _surroundings(context), self.config)
        own = [seen.flatten(2), in_units(poses).flatten(2), *moves, others]
        return torch.cat([*own, torch.stack(judged.rules, -1)], -1)


def _surroundings(context: Context) -> Surroundings:
    return Surroundings(**{name: context[name] for name in SURROUNDINGS})


def _fan(count: int) -> Tensor:
    """Return goals [K, 2] over 50 m and 10 m to either side, before training replaces them."""
    rows = max(1, round((count / 2) ** 0.5))
    number = torch.arange(count)
    columns = -(-count // rows)
    ahead = 50.0 * (number // rows + 1) / columns
    left = 10.0 * (2 * (number % rows) - (rows - 1)) / max(1, rows - 1)
    return torch.stack([ahead, left], -1)
