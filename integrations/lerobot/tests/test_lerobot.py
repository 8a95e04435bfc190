"""LeRobot's own commands, with simulated arms in real time."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.lerobot

RECORD = (
    *("--robot.simulated=true", "--robot.scene=table", "--teleop.type=scripted_leader", "--dataset.repo_id=me/try"),
    *("--dataset.single_task=try", "--dataset.num_episodes=1", "--dataset.episode_time_s=6"),
    *("--dataset.push_to_hub=false", "--play_sounds=false"),
)


def lerobot(folder: Path, command: str, *options: str) -> str:
    """What a command says, which is to succeed."""
    program = Path(sys.executable).with_name(f"lerobot-{command}")
    done = subprocess.run(
        [str(program), *options],
        cwd=folder,
        env={**os.environ, "HF_HOME": str(folder), "HF_HUB_OFFLINE": "1"},
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert done.returncode == 0, done.stderr[-3000:]
    return done.stderr + done.stdout


def test_an_episode_is_recorded_through_the_gate_and_nothing_is_touched(tmp_path: Path) -> None:
    log = tmp_path / "gate.jsonl"
    options = ("--robot.type=proven_widowxai_follower", f"--robot.log={log}", f"--dataset.root={tmp_path / 'data'}")
    said = lerobot(tmp_path, "record", *options, *RECORD)
    assert "the simulated arm touched nothing" in said
    assert "is left where it is" not in said
    info = json.loads((tmp_path / "data" / "meta" / "info.json").read_text("utf-8"))
    assert info["robot_type"] == "proven_widowxai_follower"
    assert info["total_episodes"] == 1
    assert info["features"]["action"]["names"][-1] == "left_carriage_joint.pos"
    pairs = [json.loads(line).get("pair") for line in log.read_text("utf-8").splitlines()]
    assert any(pair and "table" in pair for pair in pairs)


def test_two_arms_are_recorded_as_one(tmp_path: Path) -> None:
    options = ("--robot.type=proven_bi_widowxai_follower", "--teleop.arms=2", f"--dataset.root={tmp_path / 'data'}")
    said = lerobot(tmp_path, "record", *options, *RECORD)
    assert said.count("the simulated arm touched nothing") == 2
    assert "is left where it is" not in said


def test_an_arm_is_teleoperated(tmp_path: Path) -> None:
    options = ("--robot.type=proven_widowxai_follower", "--teleop_time_s=3", "--fps=30", *RECORD[:3])
    assert "the simulated arm touched nothing" in lerobot(tmp_path, "teleoperate", *options)
