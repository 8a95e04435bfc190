"""Files are written whole, keep their mode, and never take the place of something else."""

from __future__ import annotations

import os
import signal
import stat
import subprocess
import sys
from pathlib import Path

import pytest
from typer.testing import CliRunner

from planner_service import (
    InvalidFile,
    PlannerService,
    PlanRequest,
    Scene,
    load_scene,
    save_scene,
)
from planner_service.cli.commands import app
from planner_service.files.writing import write_whole
from tests.support.optional import present

HALF = """
import os, sys
from pathlib import Path
from planner_service.files import writing as written_file
os.replace = lambda *_: print("half", flush=True) or __import__("time").sleep(60)
written_file.write_whole(Path(sys.argv[1]), "content")
"""


def test_a_file_keeps_its_mode_and_a_new_one_has_what_the_umask_leaves(tmp_path: Path) -> None:
    there = tmp_path / "scene.toml"
    save_scene(Scene(name="old"), there)
    for mode in (0o600, 0o444, 0o755):
        there.chmod(mode)
        save_scene(Scene(name="new"), there)
        assert stat.S_IMODE(there.stat().st_mode) == mode
    assert load_scene(there).name == "new"
    before = os.umask(0o077)
    try:
        write_whole(tmp_path / "new", "content")
    finally:
        os.umask(before)
    assert stat.S_IMODE((tmp_path / "new").stat().st_mode) == 0o600


@pytest.mark.parametrize("kind", ["plan", "scene", "roadmap"])
def test_a_file_of_another_kind_is_not_replaced(tmp_path: Path, kind: str) -> None:
    service = PlannerService("planar2", Scene())
    result = service.plan(PlanRequest([0.0, 0.0], [0.1, 0.1]))
    there = tmp_path / ("mine.npz" if kind == "roadmap" else "something.py")

    def save() -> None:
        if kind == "plan":
            result.save(there)
        elif kind == "scene":
            save_scene(Scene(), there)
        else:
            service.path_memory().save(there)

    there.write_text("print('the work of a week')\n")
    with pytest.raises(InvalidFile, match="a file of another kind is there"):
        save()
    assert there.read_text() == "print('the work of a week')\n"
    there.write_text("")
    save()
    save()  # over one of its own kind


@pytest.mark.slow
def test_what_a_killed_process_left_is_removed_by_the_next_and_what_a_living_one_writes_is_not(tmp_path: Path) -> None:
    writers = [
        subprocess.Popen([sys.executable, "-c", HALF, str(tmp_path / name)], stdout=subprocess.PIPE)
        for name in ("killed", "alive")
    ]
    for writer in writers:
        assert writer.stdout is not None
        assert writer.stdout.readline() == b"half\n"
    writers[0].send_signal(signal.SIGKILL)
    writers[0].wait()
    assert len(list(tmp_path.glob(".*.tmp"))) == 2
    write_whole(tmp_path / "mine", "content")
    assert len(list(tmp_path.glob(".*.tmp"))) == 1
    writers[1].kill()
    writers[1].wait()
    write_whole(tmp_path / "mine", "content")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["mine"]
    for writer in writers:
        present(writer.stdout).close()


@pytest.mark.parametrize(
    ("command", "name"),
    [
        ("plan --start home --goal home --scene nowhere --out", "mine.py"),
        ("plan --start home --goal home --scene nowhere --plot", "mine.svg"),
        ("plan --start home --goal home --scene nowhere --png", "mine.png"),
        ("pick-place --object a --onto b --scene nowhere --out", "mine.py"),
        ("pick-place --object a --onto b --scene nowhere --png", "mine.png"),
        ("check --q home --scene nowhere --png", "mine.png"),
        ("export nowhere.json --out", "mine.py"),
        ("roadmap build --scene nowhere --out", "mine.npz"),
        ("roadmap query nowhere.npz --start home --goal home --plan", "mine.py"),
        ("roadmap query nowhere.npz --start home --goal home --learn --out", "mine.npz"),
        ("roadmap update nowhere.npz --out", "mine.npz"),
    ],
)
def test_a_command_refuses_to_replace_a_file_of_another_kind_before_it_begins(
    command: str, name: str, tmp_path: Path
) -> None:
    there = tmp_path / name
    there.write_text("print('the work of a week')\n")
    result = CliRunner().invoke(app, [*command.split(), str(there)], env={"COLUMNS": "500"})
    assert result.exit_code == 2
    assert "a file of another kind is there" in result.output
    assert there.read_text() == "print('the work of a week')\n"
