"""What the README shows is what happens."""

from __future__ import annotations

import re
import shutil
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
from typer.core import TyperGroup
from typer.main import get_command
from typer.testing import CliRunner

from planner_service.cli.commands import app
from planner_service.files.package_data import data_folder

README = (Path(__file__).parents[2] / "README.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"^```(\w+)\n(.*?)^```$", README, flags=re.DOTALL | re.MULTILINE)


def test_its_python_examples_run_in_order_and_print_what_stands_below_them(capsys: pytest.CaptureFixture[str]) -> None:
    names: dict[str, Any] = {}
    shown = 0
    for (language, code), (below, expected) in pairwise(BLOCKS):
        if language == "python":
            exec(compile(code, "README.md", "exec"), names)
            printed = [line.rstrip() for line in capsys.readouterr().out.splitlines()]
            assert (below, printed) == ("text", expected.splitlines())
            shown += 1
    assert shown == sum(language == "python" for language, _ in BLOCKS)
    assert shown >= 3


def test_its_demo_is_what_the_demo_prints_but_for_milliseconds() -> None:
    shown = next(text for language, text in BLOCKS if language == "console").splitlines()
    printed = CliRunner(env={"COLUMNS": "100"}).invoke(app, ["pick-place"]).stdout.splitlines()
    assert shown[0] == "$ make demo"
    assert [line[:92].rstrip() for line in shown[1:]] == [line[:92].rstrip() for line in printed]


def test_its_commands_are_understood(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    shutil.copy(data_folder("robots") / "planar2" / "planar2.urdf", "my.urdf")
    commands = re.findall(r"^\$ planner-service (.*?)(?: +#.*)?$", README, flags=re.MULTILINE)
    long = [command.split() for command in commands if command.startswith(("view", "run", "episodes"))]
    short = [command for command in commands if command.split() not in long]
    assert [CliRunner().invoke(app, command).exit_code for command in short] == [0] * 11
    group = get_command(app)
    assert isinstance(group, TyperGroup)
    for name, *arguments in long:  # what they do is tested with them
        assert group.commands[name].make_context(name, arguments).args == []
    assert len(long) == 3
