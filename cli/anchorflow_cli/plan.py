"""`anchorflow plan`: plan between two points of a ROS map; print a table, draw a picture."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table

from anchorflow_cli.body_options import (
    BodyChoice,
    FootprintOption,
    GoalToleranceOption,
    KinematicsOption,
    OmegaMaxOption,
    ReverseOption,
    TurningRadiusOption,
)
from anchorflow_cli.extras import needs_extra
from anchorflow_cli.options import (
    LAYERS,
    AMaxOption,
    BundleOption,
    GoalOption,
    GoalVelocityOption,
    HorizonOption,
    LayerOption,
    NumSamplesOption,
    ObstaclesOption,
    PenaltyOption,
    RadiusOption,
    SeedOption,
    StartOption,
    StartVelocityOption,
    StyleOption,
    UnknownIsFreeOption,
    VMaxOption,
    command_app,
    end_states,
    picture_option,
    url_option,
)
from anchorflow_client.contract import DEFAULT_NUM_SAMPLES, AnchorBatch, AnchorRequest, CostMap
from anchorflow_client.http import AnchorClient
from anchorflow_client.ros_map import RosMap, load_ros_map, map_window, read_layer
from anchorflow_service.bundle import DEFAULT_BUNDLE
from anchorflow_service.engine import later_loops
from anchorflow_service.local import LocalClient

app = command_app()


@app.command()
def plan(
    *,
    map_file: Annotated[Path, typer.Option("--map", help="The .yaml file of a ROS map.")],
    start: StartOption,
    goal: GoalOption,
    start_velocity: StartVelocityOption = None,
    goal_velocity: GoalVelocityOption = None,
    style: StyleOption = None,
    layer: LayerOption = None,
    obstacles: ObstaclesOption = None,
    cost_penalty: PenaltyOption = None,
    num_samples: NumSamplesOption = DEFAULT_NUM_SAMPLES,
    seed: SeedOption = None,
    v_max: VMaxOption = None,
    a_max: AMaxOption = None,
    radius: RadiusOption = None,
    footprint: FootprintOption = None,
    kinematics: KinematicsOption = None,
    min_turning_radius: TurningRadiusOption = None,
    omega_max: OmegaMaxOption = None,
    reverse: ReverseOption = False,
    horizon: HorizonOption = None,
    window: Annotated[
        float | None, typer.Option(help="Side of the map's window [m]; by the way's length.")
    ] = None,
    unknown_is_free: UnknownIsFreeOption = False,
    clear_start: Annotated[
        bool, typer.Option("--clear-start", help="Free the cells under the robot at the start.")
    ] = False,
    goal_tolerance: GoalToleranceOption = None,
    out: Annotated[Path | None, picture_option("Picture to draw")] = None,
    url: Annotated[
        str | None, url_option("Ask this server instead of the engine in-process.")
    ] = None,
    bundle: BundleOption = None,
) -> None:
    """Plan on a ROS map; print a table of the anchors and, with --out, draw them."""
    wheels = {"min_turning_radius": min_turning_radius, "omega_max": omega_max, "reverse": reverse}
    body = BodyChoice.of(footprint, kinematics, **wheels)
    start, goal, heading_counts = body.ends(start, goal)
    if len(start) != len(goal):
        raise typer.BadParameter(
            "--start and --goal: expected a heading in both, for a model that plans it, or in none"
        )
    if url is not None and bundle is not None:
        raise typer.BadParameter("expected --url or --bundle, got both")
    ros_map = load_ros_map(map_file, unknown_is_free=unknown_is_free)
    seen = map_window(ros_map, start[:2], goal[:2], size_m=window, option="--window")
    if seen.resolution > ros_map.resolution:
        typer.echo(
            f"{seen.values.shape[0]} cells of {seen.resolution:g} m a side are planned on: the map "
            f"has cells of {ros_map.resolution:g} m, too many for one request (a smaller --window "
            "keeps them)",
            err=True,
        )
    x_curr, x_goal = end_states(start, goal, start_velocity, goal_velocity)
    request = AnchorRequest.build(
        cost_map=CostMap.build(layers_of(ros_map, seen, layer), seen.resolution, seen.origin),
        x_curr=x_curr,
        x_goal=x_goal,
        w_style=style,
        obstacles=obstacles,
        cost_penalty=cost_penalty,
        num_samples=num_samples,
        seed=seed,
        v_max=v_max,
        a_max=a_max,
        robot_radius=radius,
        footprint=body.footprint,
        kinematics=body.kinematics,
        horizon_s=horizon,
        clear_start=clear_start,
        goal_tolerance=body.tolerance(goal_tolerance, heading_counts=heading_counts),
    )
    later_loops.on_demand()
    opened = AnchorClient(url) if url else LocalClient.of(bundle or DEFAULT_BUNDLE)
    with opened as client:
        anchors = client.plan_request(request)
        outline = body.outline(client, anchors, radius) if out else None
    Console(markup=False).print(table(anchors))
    if anchors.reason is not None:
        typer.echo(anchors.reason)
    if out is not None:
        with needs_extra("plot", who="anchorflow plan --out"):
            from anchorflow_cli.plots import draw_anchors
        ends = {"start": start[:2], "goal": goal[:2]}
        draw_anchors(anchors, seen, path=out, obstacles=obstacles, outline=outline, **ends)


def layers_of(
    ros_map: RosMap, window: RosMap, layers: Sequence[tuple[int, Path]] | None
) -> NDArray[np.float32]:
    """Return the cost map [C, H, W] of a window and the pictures of its further channels."""
    named = dict(layers or ())
    cost_map = np.zeros((1 + max(named, default=0), *window.occupancy.shape), np.float32)
    cost_map[0], cost_map[1:2] = window.occupancy, 1.0
    for channel, path in named.items():
        neutral = float(channel == LAYERS["traversability"])
        cost_map[channel] = read_layer(path, ros_map, window, neutral=neutral)
    return cost_map


def table(anchors: AnchorBatch) -> Table:
    """Return a table with the figures of the best anchor and of all."""
    best = anchors.best
    lengths = np.linalg.norm(np.diff(anchors.trajectories[..., :2], axis=1), axis=-1).sum(axis=-1)
    rows = {
        "score": anchors.scores,
        "clearance (m)": anchors.clearance,
        "length (m)": lengths,
        "duration (s)": anchors.durations,
    }
    model, timing = anchors.model, anchors.timing_ms
    spent = ", ".join(f"{stage} {ms:.0f} ms" for stage, ms in timing.items())
    grid = Table(
        title=f"{anchors.safe.sum()} of {anchors.safe.size} anchors are safe",
        caption=f"{model.name} {model.version}, seed {anchors.seed}\n{spent}",
        title_justify="left",
        caption_justify="left",
    )
    for column in ("", "best", "least", "median", "most"):
        grid.add_column(column, justify="right" if column else "left")
    for name, values in rows.items():
        figures = (values[best], values.min(), np.median(values), values.max())
        grid.add_row(name, *(f"{figure:.2f}" for figure in figures))
    return grid
