"""`anchorflow data make`, `import`, `synthetic`, `inspect` and `from-poses`: datasets of scenes."""

from __future__ import annotations

import math
from functools import partial
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from rich.console import Console
from rich.progress import Progress
from rich.table import Table

from anchorflow_cli.extras import needs_extra
from anchorflow_cli.options import new_file, new_folder, picture_option
from anchorflow_training.data import SyntheticTrajectoryDataset, TrajectoryDataset
from anchorflow_training.data.array_layout import TimeStepUnknown
from anchorflow_training.data.inspection import (
    Summary,
    inspect_scenes,
    inspect_trajectories,
    limits_in_words,
)
from anchorflow_training.data.poses import CutConfig, cut_trajectories, read_poses
from anchorflow_training.data.scene_import import ImportConfig, SceneOptions, import_scenes
from anchorflow_training.data.synthetic import KINDS
from anchorflow_training.dataset import open_dataset
from anchorflow_training.make_data import DataConfig, make_dataset
from anchorflow_training.v2x.dataset import refuse_pairs
from anchorflow_trajectory.motion import MotionLimits
from anchorflow_trajectory.threads import usable_cores

CORES = usable_cores()

TrajectoryFile = Annotated[
    Path, typer.Argument(metavar="FILE", help="Trajectories: .npz, .npy, .h5, .pt or .pkl.")
]
DtOption = Annotated[
    float | None, typer.Option(help="Time step [s]; by default what the file says.")
]
HorizonOption = Annotated[
    float | None, typer.Option("--horizon-s", help="Instead of --dt: dt (T - 1) [s].")
]
ResolutionOption = Annotated[
    float | None, typer.Option(help="Of the cost maps [m/cell], where the file does not say it.")
]
PickleOption = Annotated[
    bool, typer.Option("--allow-pickle", help="Open a .pkl: it runs its author's code.")
]


def make(
    out: Annotated[Path, typer.Argument(parser=new_folder, help="Folder to write.")],
    *,
    scenes: Annotated[int, typer.Option(min=1, help="How many scenes.")] = 20_000,
    trajectories: Annotated[
        int, typer.Option(min=1, help="Trajectories kept a scene.")
    ] = DataConfig.trajectories,
    seed: Annotated[int, typer.Option(min=0, help="Same seed, same bytes.")] = 0,
    workers: Annotated[int, typer.Option(min=1, help="Processes.")] = CORES,
) -> None:
    """Draw random scenes and let the expert solve them."""
    config = DataConfig(scenes=scenes, trajectories=trajectories, seed=seed)
    with Progress() as bar:
        task = bar.add_task("scenes", total=scenes)
        meta = make_dataset(out, config, workers=workers, progress=lambda n: bar.advance(task, n))
    typer.echo(
        f"{out}: {scenes} scenes; {meta['good_share']:.0%} of the expert's tries were good; "
        f"redrawn as unsolved: {sum(meta['unsolved'].values())}"
    )
    for line in limits_in_words(config.limits, meta["ranges"]):
        typer.echo(line)


def import_file(
    file: TrajectoryFile,
    out: Annotated[
        Path, typer.Argument(parser=new_folder, help="Folder to write, for `anchorflow train`.")
    ],
    *,
    dt: DtOption = None,
    horizon_s: HorizonOption = None,
    resolution: ResolutionOption = None,
    v_max: Annotated[
        float | None, typer.Option(help="[m/s]; by default what nearly all samples keep.")
    ] = None,
    a_max: Annotated[float | None, typer.Option(help="[m/s^2]; likewise.")] = None,
    robot_radius: Annotated[float, typer.Option(min=0.0, help="[m]")] = SceneOptions.robot_radius,
    cells: Annotated[
        int, typer.Option(min=16, max=512, help="A side of the empty map of samples without one.")
    ] = SceneOptions.cells,
    least_quality: Annotated[
        float, typer.Option(help="Leave out samples of less quality, 0 to 1.")
    ] = 0.0,
    keep_collisions: Annotated[
        bool, typer.Option("--keep-collisions", help="Keep samples that touch an obstacle.")
    ] = False,
    allow_pickle: PickleOption = False,
    workers: Annotated[int, typer.Option(min=1, help="Processes.")] = 1,
) -> None:
    """Turn your own trajectories into a dataset to train on."""
    config = ImportConfig(
        v_max=v_max,
        a_max=a_max,
        least_quality=least_quality,
        scene=SceneOptions(robot_radius, cells, keep_collisions),
    )
    dataset = TrajectoryDataset(
        file, dt=dt, horizon_s=horizon_s, resolution=resolution, allow_pickle=allow_pickle
    )
    with Progress() as bar:
        task = bar.add_task("samples", total=len(dataset))
        meta = import_scenes(
            dataset, out, config, workers=workers, progress=lambda n: bar.advance(task, n)
        )
    if dataset.ignored:
        typer.echo(f"arrays that nothing reads: {', '.join(dataset.ignored)}", err=True)
    left_out = meta["left_out"]
    reasons = ", ".join(f"{reason.replace('_', ' ')} {n}" for reason, n in left_out.items() if n)
    typer.echo(f"{out}: {meta['scenes']} scenes, T {meta['num_steps']}, D {meta['dim']}")
    for line in limits_in_words(MotionLimits(**meta["limits"]), meta["ranges"]):
        typer.echo(line)
    typer.echo(f"samples that exceed them: {meta['over_limits']}")
    typer.echo(f"left out: {reasons or 'none'}")
    if "quality" in dataset.arrays:
        typer.echo("quality: what each sample counts in the loss")
    if meta["not_finite_rows"]:
        typer.echo(f"rows that are not finite: {', '.join(map(str, meta['not_finite_rows']))}")


def synthetic(
    out: Annotated[Path, typer.Argument(parser=new_file, help="File to write, .npz.")],
    *,
    kind: Annotated[str, typer.Option(help=f"One of {', '.join(KINDS)}.")] = "bezier",
    count: Annotated[int, typer.Option(min=1, help="How many.")] = 1000,
    num_steps: Annotated[int, typer.Option(min=3, help="T.")] = 64,
    dim: Annotated[int, typer.Option(min=2, max=3, help="3: with heading.")] = 2,
    horizon_s: Annotated[float, typer.Option(help="That each lasts [s].")] = 8.0,
    seed: Annotated[int, typer.Option(min=0, help="Same seed, same numbers.")] = 0,
) -> None:
    """Draw smooth random trajectories without obstacles into a file that `import` reads."""
    drawn = SyntheticTrajectoryDataset(
        kind, count, num_steps=num_steps, dim=dim, horizon_s=horizon_s, seed=seed
    )
    arrays = {"horizon_s": np.float64(horizon_s), **drawn.read(slice(None))}
    np.savez(out, **arrays)  # type: ignore[arg-type]
    typer.echo(f"{out}: {count} trajectories, T {num_steps}, D {dim}")


def inspect(
    path: Annotated[
        Path, typer.Argument(metavar="FILE_OR_DIR", help="Trajectory file or dataset folder.")
    ],
    *,
    out: Annotated[Path | None, picture_option("Picture of some scenes")] = None,
    scenes: Annotated[
        int, typer.Option(min=1, help="Scenes whose homology classes are counted.")
    ] = 200,
    dt: DtOption = None,
    horizon_s: HorizonOption = None,
    resolution: ResolutionOption = None,
    allow_pickle: PickleOption = False,
) -> None:
    """Print shapes, ranges and class counts; draw a sheet of scenes with --out."""
    if path.is_dir():
        refuse_pairs(path)
        dataset = open_dataset(path)
        summary = inspect_scenes(dataset, scenes=scenes)
    else:
        opened = partial(TrajectoryDataset, path, resolution=resolution, allow_pickle=allow_pickle)
        try:
            dataset = opened(dt=dt, horizon_s=horizon_s)
        except TimeStepUnknown:
            typer.echo("neither dt nor horizon_s is known: derivatives are per step")
            dataset = opened(dt=1.0)
        summary = inspect_trajectories(dataset)
    print_summary(summary)
    if out is not None:
        with needs_extra("plot", who="anchorflow data inspect --out"):
            from anchorflow_cli.scene_sheet import draw_sheet
        draw_sheet(dataset, out)
        typer.echo(str(out))


def npz_path(text: str | Path) -> Path:
    """A file of arrays to write. Raises `typer.BadParameter` before any work."""
    if Path(text).suffix != ".npz":
        raise typer.BadParameter(f"expected a file .npz, got {str(text)!r}")
    return new_file(text)


def from_poses(
    poses: Annotated[
        Path, typer.Argument(metavar="DIR", help="KITTI *.txt or DAIR-V2X novatel_to_world JSON.")
    ],
    out: Annotated[Path, typer.Argument(parser=npz_path, help="File to write, .npz.")],
    *,
    steps: Annotated[int, typer.Option(min=3, help="T.")] = CutConfig.steps,
    rate_hz: Annotated[
        float, typer.Option("--rate-hz", help="Steps a second.")
    ] = CutConfig.rate_hz,
    stride: Annotated[
        int, typer.Option(min=1, help="Steps from one trajectory's start to the next.")
    ] = CutConfig.stride,
    heading: Annotated[
        bool, typer.Option("--heading", help="Heading [rad] as third dimension.")
    ] = False,
    pose_rate_hz: Annotated[
        float, typer.Option("--pose-rate-hz", help="Of recordings that carry no times.")
    ] = 10.0,
) -> None:
    """Cut ego-centred trajectories (x forward, y left) from recorded poses."""
    if not (0 < rate_hz < math.inf and 0 < pose_rate_hz < math.inf):
        raise typer.BadParameter("expected finite rates above 0 Hz")
    tracks = read_poses(poses, pose_rate_hz=pose_rate_hz)
    cut = cut_trajectories(tracks, CutConfig(steps, rate_hz, stride, heading))
    out.parent.mkdir(parents=True, exist_ok=True)
    cut.save(out)
    count, steps, dim = cut.positions.shape
    typer.echo(
        f"{out}: {count} trajectories, T {steps}, D {dim}, dt {cut.dt:g} s, of {len(tracks)} drives"
        f" with {sum(len(track.times) for track in tracks)} poses"
        + (f"; {cut.bad_poses} poses are not finite" if cut.bad_poses else "")
    )


def print_summary(summary: Summary) -> None:
    table = Table("array", "shape", "dtype", "from", "to", "note", box=None)
    for array in summary.arrays:
        table.add_row(
            array.name,
            " x ".join(map(str, array.shape)),
            array.dtype,
            *(("" if value is None else f"{value:.4g}") for value in (array.least, array.most)),
            array.note,
        )
    Console(markup=False).print(table)
    for fact in summary.facts:
        typer.echo(fact)
    for family, count in summary.families.items():
        typer.echo(f"family {family}: {count}")
    for classes, count in summary.classes.items():
        typer.echo(f"homology classes {classes}: {count} scenes")
