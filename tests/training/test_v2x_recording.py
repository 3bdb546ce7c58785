"""Cooperative recordings in the layout of DAIR-V2X; errors name the file."""

from __future__ import annotations

import errno
import json
import os
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from anchorflow_cli.main import main
from anchorflow_driving.cooperative.crossings import CAR, FRAMES, draw_crossing
from anchorflow_driving.cooperative.layout import GROUP, CooperativeFrame, write_recording
from anchorflow_driving.errors import LogError
from anchorflow_driving.geometry import boxes_overlap
from anchorflow_driving.window import Vehicle
from anchorflow_training.dataset import DatasetError
from anchorflow_training.v2x.dataset import make_pairs, open_pairs
from anchorflow_training.v2x.evaluation import baselines, constant_velocity, judge
from anchorflow_training.v2x.recording import (
    read_boxes,
    read_recording,
    verify_recording,
    without_own,
)

SIZE = (48, 32)
SCENES = 5


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("recording") / "cooperative-vehicle-infrastructure"
    write_recording(folder, ((str(n), draw_crossing(n, size=SIZE).frames) for n in range(SCENES)))
    return folder


@pytest.fixture
def copy(recording: Path, tmp_path: Path) -> Path:
    return shutil.copytree(recording, tmp_path / "copy")


def circle(frames: int, pictures: slice) -> list[CooperativeFrame]:
    """A left-hand circle at 5 m/s, 10 m around."""
    picture = np.zeros((3, 8, 8), np.uint8)
    drive = []
    for number in range(frames):
        angle = 0.05 * number + 0.7
        pose = np.array([10 * np.sin(angle) + 50, -10 * np.cos(angle) - 20, angle])
        seen = (picture, picture) if number in range(frames)[pictures] else (None, None)
        drive.append(CooperativeFrame(0.1 * number, pose, *seen, np.zeros((0, 5))))
    return drive


def test_a_recording_that_is_cut_off_is_none(copy: Path) -> None:
    def cut_off() -> Iterator[CooperativeFrame]:
        yield from circle(3, slice(None))
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write_recording(copy, [("0", cut_off())])

    with pytest.raises(DatasetError, match=r"data_info\.json"):
        read_recording(copy)


def test_a_full_disk_is_named(tmp_path: Path) -> None:
    picture = tmp_path / "vehicle-side/image/000000.jpg"
    picture.parent.mkdir(parents=True)
    picture.symlink_to("/dev/full")
    with pytest.raises(LogError, match=r"000000\.jpg: file: expected a place to write, .*No space"):
        write_recording(tmp_path, [("0", circle(1, slice(None)))])


def test_waypoints_are_the_45_frames_after(tmp_path: Path) -> None:
    write_recording(tmp_path, [("7", circle(48, slice(None)))])
    (sequence,) = read_recording(tmp_path)
    assert [*sequence.askable()] == [1, 2]  # one before, 45 after: no frame is taken twice

    waypoints = sequence.waypoints(1)

    turned = 0.05 * np.arange(1, 46)
    wanted = np.stack([10 * np.sin(turned), 10 * (1 - np.cos(turned))], -1)
    np.testing.assert_allclose(waypoints, wanted, atol=1e-6)
    assert sequence.speed(1) == pytest.approx(5.0, rel=0.01)
    assert sequence.turn_rate(1) == pytest.approx(0.5, rel=1e-6)


def test_a_gap_in_time_leaves_no_waypoints_across(tmp_path: Path) -> None:
    write_recording(tmp_path, [("0", circle(60, slice(None)))])
    file = tmp_path / "vehicle-side" / "data_info.json"
    entries = json.loads(file.read_text())
    del entries[50]
    file.write_text(json.dumps(entries))
    pairs = tmp_path / "cooperative" / "data_info.json"
    listed = json.loads(pairs.read_text())
    pairs.write_text(json.dumps(listed[:50] + listed[51:]))

    (sequence,) = read_recording(tmp_path)
    assert [*sequence.askable()] == [1, 2, 3, 4]


def test_sequences_are_the_batches_whatever_their_order(tmp_path: Path) -> None:
    write_recording(tmp_path, [("b", circle(47, slice(None))), ("a", circle(50, slice(None)))])
    for side in ("vehicle-side", "cooperative"):
        file = tmp_path / side / "data_info.json"
        file.write_text(json.dumps(json.loads(file.read_text())[::-1]))
    sequences = read_recording(tmp_path)
    assert [(each.name, len(each.times)) for each in sequences] == [("a", 50), ("b", 47)]
    assert all((np.diff(each.times) > 0).all() for each in sequences)


def test_boxes_come_of_their_eight_points_in_any_order(tmp_path: Path) -> None:
    box = np.array([3.0, -4.0, 0.6, 4.5, 1.8])
    pose = np.zeros(3)
    write_recording(tmp_path, [("0", [CooperativeFrame(0.0, pose, None, None, box[None])])])
    (file,) = (tmp_path / "cooperative" / "label_world").glob("*.json")
    entries = json.loads(file.read_text())
    np.random.default_rng(0).shuffle(entries[0]["world_8_points"])
    file.write_text(json.dumps(entries))
    (got,) = read_boxes(file)
    np.testing.assert_allclose(got[[0, 1, 3, 4]], box[[0, 1, 3, 4]], atol=1e-9)
    assert np.sin(got[2] - 0.6) == pytest.approx(0.0, abs=1e-9)  # a box has no front


def test_the_vehicle_s_own_box_lies_ahead_of_its_rear_axle() -> None:
    pose = np.array([10.0, 20.0, np.pi / 2])
    own, other = np.array([10.0, 21.7, 1.6, 4.6, 1.9]), np.array([10.0, 26.0, 1.6, 4.0, 1.8])
    np.testing.assert_array_equal(without_own(np.stack([own, other]), pose), [other])


def test_a_whole_recording_has_no_fault(recording: Path) -> None:
    verdict = verify_recording(recording)
    assert verdict.faults == ()
    assert (verdict.sequences, verdict.frames) == (SCENES, SCENES * FRAMES)
    assert verdict.pairs == verdict.askable == 5 * SCENES


def edited(file: str, change: Callable[[Any], Any]) -> Callable[[Path], None]:
    def edit(folder: Path) -> None:
        value = json.loads((folder / file).read_text())
        changed = change(value)
        (folder / file).write_text(json.dumps(value if changed is None else changed))

    return edit


def cut(file: str) -> Callable[[Path], None]:
    def shorten(folder: Path) -> None:
        data = (folder / file).read_bytes()
        (folder / file).write_bytes(data[: len(data) // 2])

    return shorten


POSE = "vehicle-side/calib/novatel_to_world/000003.json"
VEHICLE, PAIRS = "vehicle-side/data_info.json", "cooperative/data_info.json"
LABEL = "cooperative/label_world/000005.json"
BROKEN: dict[str, tuple[Callable[[Path], None], str, str]] = {
    "no list of pairs": (lambda folder: (folder / PAIRS).unlink(), PAIRS, "No such file"),
    "a list that breaks off": (cut(VEHICLE), VEHICLE, "line 1"),
    "a frame without its batch": (
        edited(VEHICLE, lambda entries: entries[3].pop("batch_id") and None),
        VEHICLE,
        "entry 3: expected batch_id",
    ),
    "a time that is none": (
        edited(VEHICLE, lambda entries: entries[2].update(image_timestamp="noon")),
        VEHICLE,
        "expected a time in microseconds",
    ),
    "a pair of nobody's": (
        edited(PAIRS, lambda entries: entries[0].update(vehicle_image_path="vehicle-side/x.jpg")),
        PAIRS,
        "entry 0: expected a picture that",
    ),
    "no picture of the car": (
        lambda folder: (folder / "vehicle-side/image/000005.jpg").unlink(),
        "vehicle-side/image/000005.jpg",
        "expected a picture",
    ),
    "half a roadside picture": (
        cut("infrastructure-side/image/000009.jpg"),
        "infrastructure-side/image/000009.jpg",
        "expected a picture",
    ),
    "no pose": (lambda folder: (folder / POSE).unlink(), POSE, "No such file"),
    "a rotation that is none": (
        edited(POSE, lambda pose: pose["rotation"][0].__setitem__(0, 3.0)),
        POSE,
        "rotation: expected a rotation",
    ),
    "a pose with two coordinates": (
        edited(POSE, lambda pose: pose.update(translation=[[1.0], [2.0]])),
        POSE,
        "translation: expected [3, 1]",
    ),
    "no label": (lambda folder: (folder / LABEL).unlink(), LABEL, "No such file"),
    "a box of seven points": (
        edited(LABEL, lambda _: [{"type": "car", "world_8_points": [[0, 0, 0]] * 7}]),
        LABEL,
        "box 0: world_8_points: expected 8 points [8,3], found [7, 3]",
    ),
}


@pytest.mark.parametrize("case", BROKEN)
def test_a_broken_recording_is_told_by_its_file(
    copy: Path, capsys: pytest.CaptureFixture[str], case: str
) -> None:
    damage, file, words = BROKEN[case]
    damage(copy)

    verdict = verify_recording(copy)

    found = [fault for fault in verdict.faults if str(copy / file) in fault and words in fault]
    assert found, verdict.faults
    with pytest.raises(SystemExit) as ended:
        main(["data", "verify", str(copy)])
    assert ended.value.code == 1
    assert file.rpartition("/")[2] in capsys.readouterr().out.replace("\n", "")


def test_pictures_may_be_where_the_published_archives_unpack_them(copy: Path) -> None:
    """Beside the folder, a folder for each side."""
    pairs = [pair for each in read_recording(copy) for pair in each.pairs.values()]
    for side in ("vehicle-side", "infrastructure-side"):
        (copy / side / "image").rename(copy.with_name(f"{copy.name}-{side}-image"))
    found = [pair for each in read_recording(copy) for pair in each.pairs.values()]
    assert verify_recording(copy).faults == ()
    assert [each.name for each in found] == [each.name for each in pairs]
    for one, other in zip(found, pairs, strict=True):
        assert one.vehicle_image.name == other.vehicle_image.name
        assert one.vehicle_image.parent == copy.with_name("copy-vehicle-side-image")
    found[3].infrastructure_image.unlink()
    (fault,) = verify_recording(copy).faults
    assert f"{copy}/infrastructure-side/image/{found[3].infrastructure_image.name}: " in fault


def test_too_short_sequences_are_a_fault(tmp_path: Path) -> None:
    write_recording(tmp_path, [("5", circle(46, slice(None)))])
    (fault,) = verify_recording(tmp_path).faults
    assert "the longest batch_id, 5, has 46 frames" in fault


def test_pairs_are_split_by_sequence(recording: Path, tmp_path: Path) -> None:
    dataset = make_pairs(recording, tmp_path / "pairs", image_size=32)
    assert len(dataset) == 5 * SCENES
    held, trained = dataset.indices(held_out=True), dataset.indices(held_out=False)
    assert (len(held), len(trained)) == (5, 20)
    sequence = dataset.arrays["sequence"]
    assert not {*sequence[held]} & {*sequence[trained]}
    assert dataset.arrays["vehicle_image"].shape == (25, 3, 32, 32)
    assert dataset.arrays["vehicle_image"][0].std() > 10
    assert "m/s" in dataset.prompts[0]

    with pytest.raises(DatasetError, match="expected a new or an empty folder"):
        make_pairs(recording, tmp_path / "pairs", image_size=32)
    speed = tmp_path / "pairs" / "speed.npy"
    whole = speed.read_bytes()
    for damaged in (b"", whole[:-1], whole.replace(b")", b" ", 1)):
        speed.write_bytes(damaged)
        with pytest.raises(DatasetError, match=r"speed\.npy: "):
            open_pairs(tmp_path / "pairs")
    speed.unlink()
    with pytest.raises(DatasetError, match=r"speed\.npy"):
        open_pairs(tmp_path / "pairs")
    meta = dict(dataset.meta)
    for name in ("image_size", "names", "held_out", "prompts"):
        (tmp_path / "pairs" / "dataset.json").write_text(json.dumps(meta | {name: None}))
        with pytest.raises(DatasetError, match=rf"dataset\.json: {name}: expected .*, found None"):
            open_pairs(tmp_path / "pairs")


@pytest.mark.parametrize("name", ["vehicle_image", "speed.npy", "tokenizer.json", "dataset.json"])
def test_a_full_disk_for_pairs_is_named(
    name: str, recording: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "pairs"

    def full(*_: int) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    if name == "vehicle_image":
        monkeypatch.setattr(os, "posix_fallocate", full)

    def fill(done: int, _: int) -> None:
        if done == 1:
            draft = f"{name}.{os.getpid()}" if name == "dataset.json" else name
            (out / draft).symlink_to("/dev/full")

    with pytest.raises(DatasetError, match=rf"{out}.*: expected a .* to write"):
        make_pairs(recording, out, image_size=32, progress=fill)
    with pytest.raises(DatasetError, match=r"dataset\.json: expected a folder of"):
        open_pairs(out)


def test_sequences_of_one_log_alone_cannot_be_split(tmp_path: Path) -> None:
    drives = [(f"log{GROUP}{ego}", circle(47, slice(1, 2))) for ego in range(3)]
    write_recording(tmp_path / "one", drives)
    with pytest.raises(DatasetError, match="two sequences or more, of different logs, found 3 in"):
        make_pairs(tmp_path / "one", tmp_path / "pairs", image_size=32)

    write_recording(tmp_path / "two", [*drives, (f"other{GROUP}0", circle(47, slice(1, 2)))])
    dataset = make_pairs(tmp_path / "two", tmp_path / "pairs", image_size=32)
    assert {len(dataset.indices(held_out=held)) for held in (True, False)} == {1, 3}


def test_plans_are_judged_by_who_was_there(tmp_path: Path) -> None:
    """Straight on at 5 m/s; a box stands 16.5 m ahead of the rear axle, or goes away in time."""
    for name, gone_after in (("stays", 99), ("goes too late", 24), ("goes", 23)):
        frames = []
        for number in range(60):
            pose = np.array([0.5 * number, 0.0, 0.0])
            box = np.array([[17.0, 0.0, 0.0, 4.0, 2.0]])
            picture = np.zeros((3, 8, 8), np.uint8)
            seen = (picture, picture) if number == 1 else (None, None)
            boxes = box if number < gone_after else box[:0]
            frames.append(CooperativeFrame(0.1 * number, pose, *seen, boxes))
        write_recording(tmp_path / name, [(batch, frames) for batch in "ab"])
        dataset = make_pairs(tmp_path / name, tmp_path / f"{name}-pairs", image_size=32)
        indices = np.arange(2)
        plans = constant_velocity(dataset, indices)

        row = judge(dataset, indices, plans)

        # 15.2 m between the middles at first, 4.3 m of which the two boxes fill: after 21.8 frames.
        touched = [gone_after > 23] * 3
        assert [row[f"collision_{each}s"] for each in (2.5, 3.5, 4.5)] == touched
        assert row["l2_mean"] == pytest.approx(0.0, abs=1e-5)
        away = plans + np.array([0.0, 3.0])
        beside = judge(dataset, indices, away)
        assert (beside["collision_mean"], beside["success"]) == (0.0, 0.0)
        assert beside["l2_2.5s"] == pytest.approx(3.0, abs=1e-5)
        assert judge(dataset, indices, baselines(dataset, indices)["driven"])["success"] == 1.0


def test_nobody_who_lets_others_pass_is_hit() -> None:
    conflicts = 0
    for seed in range(40):
        crossing = draw_crossing(seed, size=SIZE, every=1000)
        conflicts += crossing.conflict
        for frame in crossing.frames:
            if len(frame.boxes):
                own, others = Vehicle(*CAR), frame.boxes
                middle = own.middles(frame.pose)
                touching = boxes_overlap(middle, own.size, others[:, :3], others[:, 3:])
                assert not touching.any(), (seed, frame.time_s)
    assert 5 < conflicts < 35


def test_the_pole_shows_who_the_car_has_to_let_pass() -> None:
    asked = slice(1, FRAMES - 45, 4)
    drawn = [draw_crossing(seed, size=SIZE, every=1000) for seed in range(200)]
    conflicts = [crossing for crossing in drawn if crossing.conflict]
    shown = np.mean([crossing.shown[asked] for crossing in conflicts])
    hidden = np.mean([crossing.occluded[asked] for crossing in conflicts])
    assert (shown > 0.85, hidden > 0.5) == (True, True), (shown, hidden)
