"""Small files and few numbers take little time and memory, whatever is in them."""

from __future__ import annotations

import io
import subprocess
import sys
import time
import tracemalloc
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from planner_service import HeightField, InvalidRequest, PointCloud, Roadmap, Robot, load_robot, load_scene

CHILD = """
import resource, sys
resource.setrlimit(resource.RLIMIT_AS, (3_000_000_000,) * 2)
resource.setrlimit(resource.RLIMIT_CPU, (60, 60))
import numpy as np
from planner_service import InvalidRequest, Mesh, load_scene
def ball(count):
    points = np.random.default_rng(0).normal(size=(count, 3))
    return 0.1 * points / np.linalg.norm(points, axis=1)[:, None]
try:
    print(load_scene(sys.argv[1]) if sys.argv[1].endswith(".toml") else Mesh(ball(int(sys.argv[1]))))
except InvalidRequest as error:
    print(str(error)[-400:])
"""

PARTS = 40_000


def said(given: str) -> str:
    done = subprocess.run([sys.executable, "-c", CHILD, given], capture_output=True, text=True, timeout=120, check=True)
    return done.stdout


@pytest.mark.slow
@pytest.mark.parametrize(
    "text",
    [
        ".".join("a" * PARTS) + " = 1",
        ".".join(["'='"] * PARTS) + " = 1",
        "x = {" + ".".join("a" * PARTS) + " = 1}",
    ],
)
def test_a_key_of_many_parts_is_refused_before_it_is_read(tmp_path: Path, text: str) -> None:
    (tmp_path / "scene.toml").write_text(text + "\n")
    assert "a key of more than 4 parts" in said(str(tmp_path / "scene.toml"))


@pytest.mark.slow
def test_long_texts_are_read_in_a_time_that_grows_with_their_length(tmp_path: Path) -> None:
    (tmp_path / "scene.toml").write_text("x = " + '"a\\' * 1_600_000 + "\n")
    assert "problem" in said(str(tmp_path / "scene.toml"))


@pytest.mark.slow
def test_a_hull_of_too_many_corners_is_refused_before_anything_is_worked_out_for_it() -> None:
    assert "a hull of 120,000 corners" in said("120000")


N = 20_000
HEAD = '<robot name="r"><link name="a"/><link name="b"/>'
HEAD += '<joint name="j" type="fixed"><parent link="a"/><child link="b"/></joint>'


def zipped(name: str, array: NDArray[np.uint8]) -> bytes:
    packed = io.BytesIO()
    np.savez_compressed(packed, **{name: array})  # type: ignore[arg-type]
    return packed.getvalue()


def lists() -> bytes:
    return zipped("head", np.frombuffer(b"[" + b"[]," * 30_000_000, dtype=np.uint8))


CASES: dict[str, str | Callable[[], bytes]] = {
    "a.urdf": f'<robot name="r"><link name="{"L" * 200_000}">{"<collision/>" * N}</link></robot>',
    "a.srdf": f'<robot name="r"><group_state name="{"L" * 200_000}" group="g">{"<joint/>" * N}</group_state></robot>',
    "poses/robot.toml": "[poses]\n" + "".join(f"p{k}=[1]\n" for k in range(N)) + '[[retreat]]\npose="x"\n' * 10_000,
    "parts.toml": '[[obstacle]]\nname="a"\nposition=[0,0,0]\ncompound=[' + "{a=1}," * 80_000 + "]\n",
    "head.npz": lists,
    "points.npz": lambda: zipped("points", np.zeros((15_000_000, 3), dtype=np.uint8)),
    "heights.npz": lambda: zipped("heights", np.zeros((6_500, 6_500), dtype=np.uint8)),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", CASES)
def test_what_a_small_file_holds_is_refused_in_little_time_and_memory(tmp_path: Path, name: str) -> None:
    path, content = tmp_path / name, CASES[name]
    path.parent.mkdir(exist_ok=True)
    data = content() if callable(content) else content.encode()
    path.write_bytes(data)
    (tmp_path / "base.urdf").write_text(HEAD + "</robot>")
    readers: dict[str, Callable[[Path], object]] = {
        ".urdf": Robot.from_urdf,
        ".srdf": lambda p: Robot.from_urdf(tmp_path / "base.urdf", srdf=p),
        ".toml": load_robot if path.name == "robot.toml" else load_scene,
        "points": lambda p: PointCloud.from_file(p, 0.05),
        "heights": lambda p: HeightField.from_file(p, 0.05),
    }
    read = readers.get(path.stem, readers.get(path.suffix, Roadmap.load))
    began = time.process_time()
    tracemalloc.start()
    try:
        with pytest.raises(InvalidRequest):
            read(path)
        assert tracemalloc.get_traced_memory()[1] < 250_000_000
    finally:
        tracemalloc.stop()
    assert time.process_time() - began < 20
