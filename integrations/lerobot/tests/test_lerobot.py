"""LeRobot's own commands, with simulated arms in real time."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from lerobot_robot_proven import ProvenActionStep
from lerobot_robot_proven.config import STAGED

pytestmark = pytest.mark.lerobot

README = Path(__file__).parents[1] / "README.md"

SIMULATED = "--robot.simulated=true --robot.scene=table --teleop.type=scripted_leader"


def said_by(command: str, folder: Path) -> str:
    """What one of LeRobot's commands says, which is to succeed."""
    code, said = ended(command, folder)
    assert code == 0, said[-3000:]
    assert "is left where it is" not in said
    return said


def ended(command: str, folder: Path) -> tuple[int, str]:
    """How a command ends, and what it says."""
    programs = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    done = subprocess.run(
        ["bash", "-c", command],
        cwd=folder,
        env={**os.environ, "PATH": programs, "HF_HOME": str(folder), "HF_HUB_OFFLINE": "1"},
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    return done.returncode, done.stderr + done.stdout


def test_episodes_are_recorded_as_the_readme_says_and_replayed_and_nothing_is_touched(tmp_path: Path) -> None:
    found = re.search(r"^\$ (lerobot-record .*?)\n(?=```)", README.read_text("utf-8"), flags=re.DOTALL | re.MULTILINE)
    assert found is not None
    assert "the simulated arm touched nothing" in said_by(found[1], tmp_path)
    info = json.loads((tmp_path / "swings" / "meta" / "info.json").read_text("utf-8"))
    assert info["robot_type"] == "proven_widowxai_follower"
    assert info["total_episodes"] == 2
    assert info["features"]["action"]["names"][-1] == "left_carriage_joint.pos"
    lines = (tmp_path / "gate.jsonl").read_text("utf-8").splitlines()
    assert any("table" in (json.loads(line).get("pair") or ()) for line in lines)
    robot = "--robot.type=proven_widowxai_follower --robot.simulated=true --robot.scene=table --play_sounds=false"
    data = "--dataset.repo_id=me/swings --dataset.root=swings --dataset.episode=0"
    assert "the simulated arm touched nothing" in said_by(f"lerobot-replay {robot} {data}", tmp_path)


def test_two_arms_are_recorded_as_one(tmp_path: Path) -> None:
    data = "--dataset.repo_id=me/try --dataset.root=data --dataset.single_task=try --dataset.num_episodes=1"
    more = "--dataset.episode_time_s=6 --dataset.push_to_hub=false --play_sounds=false"
    robot = "--robot.type=proven_bi_widowxai_follower --teleop.arms=2"
    said = said_by(f"lerobot-record {robot} {SIMULATED} {data} {more}", tmp_path)
    assert said.count("the simulated arm touched nothing") == 2


def test_an_arm_is_teleoperated(tmp_path: Path) -> None:
    robot = "--robot.type=proven_widowxai_follower --teleop_time_s=3 --fps=30"
    assert "the simulated arm touched nothing" in said_by(f"lerobot-teleoperate {robot} {SIMULATED}", tmp_path)


def test_the_step_takes_its_place_in_a_pipeline(tmp_path: Path) -> None:
    from lerobot.processor import RobotProcessorPipeline
    from lerobot.processor.converters import robot_action_observation_to_transition, transition_to_robot_action

    joints = {f"joint_{k}.pos": f"joint_{k}" for k in range(6)}
    step = ProvenActionStep(robot="wxai", scene="table", joints=joints)
    gated = RobotProcessorPipeline(
        steps=[step], to_transition=robot_action_observation_to_transition, to_output=transition_to_robot_action
    )
    stands = dict(zip(joints, STAGED[:-1], strict=True))
    assert gated((stands | {"gripper.pos": 1.0}, stands)) == pytest.approx(stands | {"gripper.pos": 1.0})
    wanted = stands | {"joint_1.pos": 3.0}  # into the table
    assert gated((wanted, stands))["joint_1.pos"] < 1.2
    gated.save_pretrained(tmp_path)
    again = RobotProcessorPipeline.from_pretrained(tmp_path, config_filename=next(tmp_path.glob("*.json")).name)
    assert again.steps[0].get_config() == step.get_config()
