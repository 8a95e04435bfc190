"""Small files and few numbers take little time and memory, whatever is in them."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

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


@pytest.mark.parametrize(
    "text",
    [
        ".".join("a" * PARTS) + " = 1",
        " . ".join(['"a,"'] * PARTS) + " = 1",
        ".".join(["'='"] * PARTS) + " = 1",
        "[" + ".".join("a" * PARTS) + "]",
        "x = {" + ".".join("a" * PARTS) + " = 1}",
    ],
)
def test_a_key_of_many_parts_is_refused_before_it_is_read(tmp_path: Path, text: str) -> None:
    (tmp_path / "scene.toml").write_text(text + "\n")
    assert "a key of more than 4 parts" in said(str(tmp_path / "scene.toml"))


@pytest.mark.parametrize("text", ['x = "' + "a" * 4_900_000 + '"', "x = " + '"a\\' * 1_600_000, "'a" * 2_400_000])
def test_long_texts_are_read_in_a_time_that_grows_with_their_length(tmp_path: Path, text: str) -> None:
    (tmp_path / "scene.toml").write_text(text + "\n")
    assert "problem" in said(str(tmp_path / "scene.toml"))


def test_dots_in_texts_and_numbers_are_no_key(tmp_path: Path) -> None:
    (tmp_path / "scene.toml").write_text('description = "a.b.c.d.e.f. 1.2.3.4.5"  # it\'s a.b c.d.\n')
    assert said(str(tmp_path / "scene.toml")).startswith("Scene(")


@pytest.mark.parametrize("count", [30_000, 480_000])
def test_a_hull_of_too_many_corners_is_refused_before_anything_is_worked_out_for_it(count: int) -> None:
    assert f"a hull of {count:,} corners" in said(str(count))
