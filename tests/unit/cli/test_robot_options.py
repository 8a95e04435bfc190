"""The options that say more of a robot are on every command that takes one, and none is ignored."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from tests.support.command import document, run
from tests.support.small_robots import urdf
from tests.unit.robot_setup.test_as_published import ASKS, BASE, MACRO, arm, fingers, used

GRIPPING = urdf("r", BASE, arm(), fingers())
COMMANDS = (
    *("plan", "explain", "pick-place", "check", "view", "certify", "run", "episodes", "serve", "doctor", "robots"),
    *("import-robot", "problems", "robot check", "roadmap build", "roadmap query", "roadmap update"),
)
OPTIONS = ("--package-dir", "--xacro-arg", "--lock", "--tool-frame", "--gripper")


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_that_takes_a_robot_has_them(command: str) -> None:
    text = run(*command.split(), "-h").stdout
    assert [option for option in OPTIONS if option not in text] == []


def test_a_robot_is_shown_as_they_say(tmp_path: Path) -> None:
    path = tmp_path / "r.urdf"
    path.write_text(GRIPPING)
    shown = document("robots", path, "--lock", "joint1=0.5", "--gripper", "none", "--tool-frame", "part1")
    assert [joint["name"] for joint in shown["joints"]] == [
        "joint2",
        "joint3",
        "left_finger_joint",
        "right_finger_joint",
    ]
    assert shown["tool_frame"] == "part1"


def test_the_step_of_a_message_can_be_taken_on_the_command_line(tmp_path: Path) -> None:
    (tmp_path / "lib").mkdir()
    (tmp_path / "lib" / "bar.xacro").write_text(MACRO)
    path = tmp_path / "arm.xacro"
    path.write_text(used("lib/bar.xacro", start=ASKS))
    done = run("robots", path)
    assert (done.exit_code, "--xacro-arg kind:=VALUE" in done.stderr) == (2, True)
    (joint,) = document("robots", path, "--xacro-arg", "kind:=big")["joints"]
    assert joint["name"] == "j"


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("certify", "x.json", "--lock", "a=1"), "--lock: got .* together with the robot that it is about"),
        (("robots", "wxai", "--package-dir", "/tmp"), "package_dirs: got .* a robot.toml says it itself"),
        (("robots", "wxai", "--xacro-arg", "a=1"), "--xacro-arg: got 'a=1'; expected name:=value"),
        (("robots", "wxai", "--lock", "joint_1=x"), "--lock: got 'joint_1=x'; expected joint=value"),
        (("robots", "wxai", "--lock", "joint_9=0"), "unknown joint 'joint_9'; did you mean"),
    ],
)
def test_what_does_not_fit_is_bad_input(arguments: tuple[str, ...], message: str) -> None:
    done = run(*arguments)
    assert done.exit_code == 2
    assert re.search(message, done.stderr), done.stderr
