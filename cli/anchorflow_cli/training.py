"""`anchorflow train`, `distill` and `average`: checkpoints from datasets and checkpoints."""

from __future__ import annotations

import inspect
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

from anchorflow_cli.options import command_app, file_option, folder_option
from anchorflow_training.atomic_write import writing
from anchorflow_training.checkpoint import mean_checkpoint, model_before, save_checkpoint
from anchorflow_training.config import RunConfig
from anchorflow_training.dataset import open_dataset
from anchorflow_training.distillation.distiller import Distiller
from anchorflow_training.distillation.pairs import DistillConfig
from anchorflow_training.distillation.teacher import load_teacher
from anchorflow_training.planners import TRAININGS, training_of
from anchorflow_training.run import Report, TrainingRun
from anchorflow_training.settings import (
    ConfigError,
    Setting,
    config_text,
    layers,
    merged,
    settings,
    text_in,
)
from anchorflow_training.v2x.dataset import refuse_pairs

train_app, distill_app, average_app = command_app(), command_app(), command_app()

OutOption = Annotated[Path | None, folder_option("Folder of the run; an existing one is resumed.")]
ConfigOption = Annotated[
    Path | None, typer.Option(help="YAML file of settings; options override it.")
]
PrintConfigOption = Annotated[
    bool, typer.Option("--print-config", help="Print the whole configuration and stop.")
]
Bfloat16Option = Annotated[bool, typer.Option("--bfloat16", help="Short for --precision bfloat16.")]

SHORT = {
    "batch.scenes": "--scenes",
    "batch.samples": "--samples",
    "batch.seed": "--seed",
    "evaluation.held_out": "--held-out",
    "evaluation.patience": "--patience",
}
TRAIN_SHORT = {"model.variant": "--variant", **SHORT}
DISTILL_SHORT = {"model.layers": "--layers", "teacher.noise_scale": "--noise-scale", **SHORT}
METAVARS = {int: "INTEGER", float: "NUMBER"}
SHOWN = (
    "loss",
    "success",
    "any",
    "free",
    "feasible",
    "distance",
    "teacher_success",
    "samples_per_s",
    "seconds",
)


def with_settings(
    kinds: Sequence[type], short: Mapping[str, str]
) -> Callable[[Callable], Callable]:
    """Give a command, which takes `**given`, an option for each leaf of the dataclasses.

    `given` holds the options on the command line by dotted path, as text: the configuration
    converts them, and refuses those that it does not have.
    short: further names of options, by path
    """
    leaves: dict[str, Setting] = {}
    for leaf in (leaf for kind in kinds for leaf in settings(kind)):
        name = leaf.path.replace(".", "__")
        leaves[name] = _shared(leaves[name], leaf) if name in leaves else leaf

    def decorate(command: Callable) -> Callable:
        def run(**values: Any) -> None:
            named = {n: v for n, v in values.items() if n not in leaves}
            given = {leaves[n].path: v for n, v in values.items() if n in leaves and v is not None}
            command(**named, **given)

        own = inspect.signature(command, eval_str=True).parameters.values()
        own = [each for each in own if each.kind is not inspect.Parameter.VAR_KEYWORD]
        added = [_parameter(name, leaf, short) for name, leaf in leaves.items()]
        run.__signature__ = inspect.Signature([*own, *added])  # type: ignore[attr-defined]
        run.__annotations__ = {each.name: each.annotation for each in [*own, *added]}
        run.__name__, run.__doc__ = command.__name__, command.__doc__
        return run

    return decorate


def _shared(one: Setting, other: Setting) -> Setting:
    """Return the option of two settings with one path; if their types differ, it takes text."""
    return Setting(
        one.path,
        one.hint if one.hint == other.hint else str,
        one.default if one.default == other.default else "the planner's",
        one.about or other.about,
    )


def _parameter(name: str, leaf: Setting, short: Mapping[str, str]) -> inspect.Parameter:
    option = "--" + leaf.path.replace("_", "-")
    names = [option, *([short[leaf.path]] if leaf.path in short else [])]
    about = " ".join(filter(None, [leaf.about, f"[default: {leaf.default}]"]))
    if leaf.hint is bool:
        group, dot, last = option.removeprefix("--").rpartition(".")
        declared = f"{option}/--{group}{dot}no-{last}"
        annotation = Annotated[bool | None, typer.Option(declared, *names[1:], help=about)]
    else:
        metavar = "|".join(leaf.choices) or METAVARS.get(leaf.hint, "TEXT")
        annotation = Annotated[str | None, typer.Option(*names, metavar=metavar, help=about)]
    return inspect.Parameter(
        name, inspect.Parameter.KEYWORD_ONLY, default=None, annotation=annotation
    )


@train_app.command()
@with_settings([training.config for training in TRAININGS.values()], TRAIN_SHORT)
def train(
    dataset: Annotated[Path, typer.Argument(help="Folder that `anchorflow data` wrote.")],
    *,
    planner: Annotated[
        str | None,
        typer.Option(metavar="|".join(TRAININGS), help="Which.", show_default="the file's; flowmp"),
    ] = None,
    out: OutOption = None,
    config: ConfigOption = None,
    print_config: PrintConfigOption = False,
    bfloat16: Bfloat16Option = False,
    **given: Any,
) -> None:
    """Train a planner; stop it any time and start it again with the same words."""
    training = training_of(planner, config)
    if training.open_data is open_dataset:
        refuse_pairs(dataset)
    data = training.open_data(dataset)
    told = given_settings(given, bfloat16=bfloat16)
    fixed = {"model": training.run.model_settings(data), **training.run.other_settings(data)}
    base = _before(training.config, config, told, fixed)
    settings = layers(training.config, base, config, told)
    if print_config:
        typer.echo(config_text(settings), nl=False)
        return
    fit(training.run(settings, data, run_folder(out)))


@distill_app.command()
@with_settings([DistillConfig], DISTILL_SHORT)
def distill(
    checkpoint: Annotated[Path, typer.Argument(help="The teacher: checkpoint.pt of a run.")],
    dataset: Annotated[Path, typer.Argument(help="Folder that `anchorflow data` wrote.")],
    *,
    out: OutOption = None,
    pairs: Annotated[
        Path | None, folder_option("Folder of the teacher's pairs.", show_default="OUT/pairs")
    ] = None,
    config: ConfigOption = None,
    print_config: PrintConfigOption = False,
    bfloat16: Bfloat16Option = False,
    **given: Any,
) -> None:
    """Teach a student its teacher's anchors; stop it any time and start it again."""
    teacher, data = load_teacher(checkpoint), open_dataset(dataset)
    told = given_settings(given, bfloat16=bfloat16)
    base = merged({"model": asdict(teacher.model.config)}, _before(DistillConfig, config, told, {}))
    settings = layers(DistillConfig, base, config, told)
    if print_config:
        typer.echo(config_text(settings), nl=False)
        return
    folder = run_folder(out)
    teacher = teacher.widened(settings.teacher.noise_scale)
    student = Distiller(settings, data, folder, teacher=teacher, pairs=pairs or folder / "pairs")

    def tell(done: int, blocks: int) -> None:
        if student.leads:
            typer.echo(f"pairs {done}/{blocks}")

    student.prepare(tell)
    fit(student)


@average_app.command()
def average(
    checkpoints: Annotated[
        list[Path], typer.Argument(help="checkpoint.pt or best.pt of runs of one network.")
    ],
    *,
    out: Annotated[Path, file_option("File of the mean, a checkpoint itself.")],
) -> None:
    """Average the weights of checkpoints; all else in the mean is the last one's.

    The mean of runs that began with the same weights is often better than each.
    """
    if len(checkpoints) < 2:
        raise typer.BadParameter("expected two or more, got one", param_hint="CHECKPOINTS")
    save_checkpoint(out, mean_checkpoint(checkpoints))
    typer.echo(out)


def given_settings(given: dict[str, Any], *, bfloat16: bool) -> dict[str, Any]:
    """Return the settings of the command line by dotted path, with `--bfloat16` spelled out.

    Raises `ConfigError` if it contradicts `--precision`.
    """
    if bfloat16 and given.get("precision", "bfloat16") != "bfloat16":
        raise ConfigError(
            f"precision: expected --bfloat16 alone, got {given['precision']} beside it"
        )
    return {"precision": "bfloat16", **given} if bfloat16 else given


def _before(
    kind: type[RunConfig], file: Path | None, told: Mapping[str, Any], base: Mapping[str, Any]
) -> dict[str, Any]:
    """Return the base over the model's settings of the checkpoint that the run begins with."""
    path = told.get("before") or (text_in(file, "before") if file else None)
    return merged({"model": model_before(path, kind.planner)}, base)


def run_folder(out: Path | None) -> Path:
    """Return the folder of a run; raise `ConfigError` without `--out`."""
    if out is None:
        raise ConfigError("--out: expected the folder of the run, got nothing")
    return out


def fit(run: TrainingRun) -> None:
    """Train, with the configuration in the run's folder and reports on the way."""
    if run.leads:
        _write_config(run)
        if not run.evaluates:
            typer.echo("no scenes are held out (--held-out): nothing is evaluated", err=True)
    with _reported(run) as report:
        run.fit(report)
    if run.leads:
        why = ": no progress, stopped early" if run.stopped else ""
        typer.echo(f"{run.checkpoint_path}: step {run.step}{why}{_how_good(run)}")


def _how_good(run: TrainingRun) -> str:
    if not run.evaluations:
        return ""
    best = max(run.evaluations, key=lambda row: row["success"])
    return (
        f"; success on what is held out {run.evaluations[-1]['success']:.3g},"
        f" best {best['success']:.3g} at step {best['step']:g} ({run.best_path.name})"
    )


def _write_config(run: TrainingRun) -> None:
    file = run.out / "config.yaml"
    with writing(file, ConfigError):
        run.out.mkdir(parents=True, exist_ok=True)
        file.write_text(config_text(run.run_config))


@contextmanager
def _reported(run: TrainingRun) -> Iterator[Report]:
    """Yield a report that updates a progress bar on a terminal, and prints lines elsewhere."""
    if not (run.leads and sys.stdout.isatty()):
        yield _plain_line
        return
    columns = "step {task.completed}/{task.total}", "{task.fields[shown]}"
    with Progress(*map(TextColumn, columns), BarColumn(), TimeRemainingColumn()) as bar:
        task = bar.add_task("train", total=run.run_config.steps, completed=run.step, shown="")

        def report(step: int, row: dict[str, float]) -> None:
            if "loss" in row:
                bar.update(task, completed=step, shown=f"loss {row['loss']:.4f}")
            else:
                bar.console.print(_line(step, row))

        yield report


def _plain_line(step: int, row: dict[str, float]) -> None:
    typer.echo(_line(step, row))
    sys.stdout.flush()


def _line(step: int, row: dict[str, float]) -> str:
    """Return a line such as "step 500 loss 0.4213 samples_per_s 840 seconds 312"."""
    shown = (f"{name} {row[name]:.4g}" for name in SHOWN if name in row)
    return " ".join([f"step {step}", *shown])
