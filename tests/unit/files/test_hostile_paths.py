"""Paths that are no usable files: every reader and every writer says so, soon, and leaves everything as it was."""

from __future__ import annotations

import os
import signal
import socket
import stat
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from types import FrameType

import numpy as np
import pytest

from planner_service import (
    CollisionChecker,
    Compound,
    HeightField,
    Mesh,
    PlannerService,
    PlanRequest,
    PlanResult,
    PointCloud,
    Roadmap,
    Robot,
    TaskResult,
    load_robot,
    load_scene,
    save_scene,
)
from planner_service.certify import Certifier
from planner_service.datasets import EpisodeWork, episode_task, write_episodes
from planner_service.errors import InvalidFile, InvalidRequest
from planner_service.gate import Kind, Refused
from planner_service.gate.log import Logged
from planner_service.gate.log_reader import read_log
from planner_service.records.evidence import save_plan
from planner_service.records.exports.trajectory_export import write_csv
from planner_service.records.plan_file import SavedTask, load_plan, load_plan_or_task, load_task
from planner_service.records.problems import read_problems
from planner_service.robot_setup.import_robot import Source, import_robot
from planner_service.scene.moveit_scene import read_moveit_scene
from planner_service.scene.urdf_scene import read_urdf_scene
from planner_service.tasks import MoveTo, Task
from planner_service.view.still import pictures
from planner_service.view.still.motion_plot import write_plot
from planner_service.view.still.moving import draw_motions, draw_refusals
from planner_service.view.still.pictures import draw_check, draw_plan, draw_refusal, draw_task, write_png

SECONDS = 5
"""A call that takes longer hangs."""

ARM = Path(__file__).parents[3] / "examples" / "desk_arm.urdf"


class Late(BaseException):
    """Raised in a call that hangs; as an Exception it could be taken for an error of the file."""


@dataclass(frozen=True)
class World:
    """A plan and a task to be written."""

    service: PlannerService
    request: PlanRequest
    result: PlanResult
    task: TaskResult
    saved: SavedTask


@pytest.fixture(scope="module")
def world() -> World:
    service = PlannerService("planar2", "discs")
    home = service.robot.home
    request = PlanRequest(home, home + 0.01)
    result = service.plan(request)
    task = TaskResult((), service.world, home, result.failure)
    saved = SavedTask(service.world, "nothing", (), result.counts, 0.0)
    return World(service, request, result, task, saved)


@pytest.fixture(autouse=True)
def small_pictures(monkeypatch: pytest.MonkeyPatch) -> None:
    """It is their file that matters here, and drawing takes seconds."""
    monkeypatch.setattr(pictures, "SIZE", (160, 100))


def _folder(path: Path) -> None:
    path.mkdir()
    (path / "kept").write_bytes(b"kept")


def _socket(path: Path) -> None:
    with socket.socket(socket.AF_UNIX) as server:
        server.bind(path.name)  # in the working folder: the whole path may be too long for it


PLACES: dict[str, tuple[str, Callable[[Path], None], str]] = {
    "folder": ("a", _folder, "not a file"),
    "FIFO": ("a", os.mkfifo, "not a file"),
    "endless device": ("a", lambda path: path.symlink_to("/dev/zero"), "not a file"),
    "socket": ("a", _socket, "not a file"),
    "symlink loop": ("a", lambda path: path.symlink_to(path.name), "cannot be read"),
    "NUL": ("a\0b", lambda path: None, "cannot be read"),
    "5,000 characters": ("a" * 5_000, lambda path: None, "cannot be read"),
    "lone surrogate": ("a\ud800b", lambda path: None, "cannot be read"),
    "missing": ("missing/a", lambda path: None, "no such file"),
}
"""What is there, and what a reader says of it."""

READERS: dict[str, tuple[str, Callable[[Path], object]]] = {
    "load_robot": (".toml", load_robot),
    "PlannerService, robot": (".toml", lambda path: PlannerService(path, "discs")),
    "PlannerService, scene": (".toml", lambda path: PlannerService("planar2", path)),
    "Robot.from_urdf": (".urdf", Robot.from_urdf),
    "Robot.from_urdf, srdf": (".srdf", lambda path: Robot.from_urdf(ARM, srdf=path)),
    "import_robot": (".urdf", lambda path: import_robot(Source(path), path.parent / "imported")),
    "load_scene": (".toml", load_scene),
    "load_scene, MoveIt": (".scene", load_scene),
    "load_scene, URDF": (".urdf", load_scene),
    "read_moveit_scene": (".scene", read_moveit_scene),
    "read_urdf_scene": (".urdf", read_urdf_scene),
    "read_problems": (".json", read_problems),
    "Mesh.from_file, STL": (".stl", Mesh.from_file),
    "Mesh.from_file, OBJ": (".obj", Mesh.from_file),
    "Mesh.from_file, PLY": (".ply", Mesh.from_file),
    "Mesh.from_file, COLLADA": (".dae", Mesh.from_file),
    "Compound.of_mesh": (".stl", Compound.of_mesh),
    "PointCloud.from_file, npy": (".npy", lambda path: PointCloud.from_file(path, 0.05)),
    "PointCloud.from_file, npz": (".npz", lambda path: PointCloud.from_file(path, 0.05)),
    "PointCloud.from_file, ply": (".ply", lambda path: PointCloud.from_file(path, 0.05)),
    "HeightField.from_file": (".npy", lambda path: HeightField.from_file(path, 0.05)),
    "Roadmap.load": (".npz", Roadmap.load),
    "load_plan": (".json", load_plan),
    "load_task": (".json", load_task),
    "load_plan_or_task": (".json", load_plan_or_task),
    "Task.load": (".json", Task.load),
    "read_log": (".jsonl", lambda path: read_log(path, 6)),
}
"""Each with the suffix it takes: what is refused must be what is there, not its name."""


def refusal(world: World) -> Logged:
    """A line of a gate's log."""
    home = tuple(world.service.robot.home.tolist())
    return Logged(0.0, 1, 0, 1.0, False, True, Refused(Kind.CONTACT, 0, "too close", at=home), home, home)


WRITERS: dict[str, tuple[str, Callable[[World, Path], object]]] = {
    "save_scene": (".toml", lambda world, path: save_scene(world.service.scene, path)),
    "save_plan": (".json", lambda world, path: save_plan(world.result, path)),
    "PlanResult.save": (".json", lambda world, path: world.result.save(path)),
    "TaskResult.save": (".json", lambda world, path: world.task.save(path)),
    "SavedTask.save": (".json", lambda world, path: world.saved.save(path)),
    "Roadmap.save": (".npz", lambda world, path: world.service.path_memory().save(path)),
    "write_csv": (".csv", lambda world, path: write_csv(world.result, path, world.service.robot.joint_names, 0.1)),
    "write_png": (".png", lambda world, path: write_png(path, np.zeros((2, 2, 3), np.uint8))),
    "draw_plan": (".png", lambda world, path: draw_plan(world.service, world.request, world.result, path)),
    "draw_task": (".png", lambda world, path: draw_task(world.service, world.saved, path)),
    "draw_motions": (".webp", lambda world, path: draw_motions([world.result], path, speed=10.0)),
    "Task.save": (".json", lambda world, path: Task((MoveTo(),)).save(path)),
    "draw_refusal": (".png", lambda world, path: draw_refusal(world.service, refusal(world), path)),
    "draw_refusals": (".webp", lambda world, path: draw_refusals(world.service, [refusal(world)], path)),
    "draw_check": (
        ".png",
        lambda world, path: draw_check(
            CollisionChecker(world.service.robot, world.service.scene), world.service.robot.home, path
        ),
    ),
    "write_plot": (
        ".svg",
        lambda world, path: write_plot(
            str(path), Certifier(world.service.robot, world.service.scene), {"a": world.result.unwrap()[0]}
        ),
    ),
}

FOLDER_WRITERS: dict[str, Callable[[Path], object]] = {
    "import_robot": lambda path: import_robot(Source(ARM), path),
    "write_episodes": lambda path: write_episodes(path, EpisodeWork(load_robot("wxai"), episode_task("pick-place")), 1),
}


@pytest.fixture(autouse=True)
def soon() -> Iterator[None]:
    def late(number: int, frame: FrameType | None) -> None:
        raise Late(f"more than {SECONDS} s")

    before = signal.signal(signal.SIGALRM, late)
    yield
    signal.alarm(0)
    signal.signal(signal.SIGALRM, before)


def there(folder: Path) -> dict[str, tuple[int, int, int]]:
    """What is below a folder: by name, which file, of which kind and when it last changed."""
    states = {str(path): path.lstat() for path in sorted(folder.rglob("*"))}
    return {name: (state.st_ino, stat.S_IFMT(state.st_mode), state.st_mtime_ns) for name, state in states.items()}


def refuses(call: Callable[[Path], object], place: str, suffix: str, below: Path, patch: pytest.MonkeyPatch) -> str:
    """What is said of a place where nothing is read or written, in a folder of its own."""
    name, make, _ = PLACES[place]
    folder = below / place
    folder.mkdir()
    patch.chdir(folder)
    path = folder / f"{name}{suffix}"
    make(path)
    before = there(folder)
    signal.alarm(SECONDS)
    with pytest.raises((InvalidFile, InvalidRequest)) as caught:
        call(path)
    signal.alarm(0)
    str(caught.value).encode("utf-8")  # an error that cannot be printed is another error
    assert there(folder) == before
    return str(caught.value)


@pytest.mark.parametrize("reader", READERS)
def test_a_reader_says_that_there_is_no_file(reader: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    suffix, read = READERS[reader]
    for place, (_, _, said) in PLACES.items():
        told = "no requests" if (reader, place) == ("read_problems", "folder") else said  # a set may be a folder
        assert told in refuses(read, place, suffix, tmp_path, monkeypatch), place


@pytest.mark.slow
@pytest.mark.parametrize("writer", WRITERS)
def test_a_writer_puts_nothing_in_the_place_of_what_is_no_file(
    writer: str, world: World, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    suffix, write = WRITERS[writer]
    for place in PLACES:
        refuses(lambda path: write(world, path), place, suffix, tmp_path, monkeypatch)


@pytest.mark.parametrize("writer", FOLDER_WRITERS)
def test_a_writer_of_a_folder_needs_one(writer: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for place in PLACES.keys() - {"folder"}:
        refuses(FOLDER_WRITERS[writer], place, "", tmp_path, monkeypatch)


@pytest.mark.slow
@pytest.mark.parametrize("writer", WRITERS)
def test_a_writer_that_cannot_finish_leaves_what_was_there(
    writer: str, world: World, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    suffix, write = WRITERS[writer]
    path = tmp_path / f"a{suffix}"
    write(world, path)
    before = there(tmp_path)
    assert list(before) == [str(path)]
    for step, error in (("replace", OSError), ("fsync", OSError), ("replace", KeyboardInterrupt)):

        def fail(*_: object, error: type[BaseException] = error) -> None:
            raise error(28, "No space left on device")

        with monkeypatch.context() as patch:
            patch.setattr(os, step, fail)
            with pytest.raises((InvalidFile, KeyboardInterrupt), match="No space left on device"):
                write(world, path)
        assert there(tmp_path) == before
