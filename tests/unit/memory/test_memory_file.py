"""Memories in files: what was saved comes back bit for bit, and nothing else is taken for a memory."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from planner_service.errors import InvalidFile
from planner_service.memory import Memory


def sample() -> Memory:
    rng = np.random.default_rng(0)
    motions = tuple(rng.normal(size=(count, 3)) for count in (2, 5, 3))
    motions[0][0] = [-0.0, 1e-300, 0.1]
    return Memory(("a", "köln", "塔"), motions, (rng.random(5), np.array([-1e-300, -0.0, 2.0, 0.05, 0.03])))


def saved(tmp_path: Path) -> Path:
    path = tmp_path / "cell.memory.json"
    sample().save(path)
    return path


@pytest.mark.parametrize("memory", [Memory(), sample()])
def test_what_was_saved_comes_back_bit_for_bit(memory: Memory, tmp_path: Path) -> None:
    path = tmp_path / "a.json"
    memory.save(path)
    back = Memory.load(path)
    assert back.hash == memory.hash
    assert back.joint_names == memory.joint_names
    assert [motion.tobytes() for motion in back.motions] == [motion.tobytes() for motion in memory.motions]
    assert [grip.tobytes() for grip in back.grips] == [grip.tobytes() for grip in memory.grips]
    before = path.read_bytes()
    back.save(path)
    assert path.read_bytes() == before


def test_a_truncated_file_is_refused(tmp_path: Path) -> None:
    path = saved(tmp_path)
    data = path.read_bytes().rstrip()
    for length in range(0, len(data), 16):
        path.write_bytes(data[:length])
        with pytest.raises(InvalidFile):
            Memory.load(path)


def test_a_file_with_a_flipped_bit_is_refused_or_the_same(tmp_path: Path) -> None:
    path = saved(tmp_path)
    data, rng, refused = path.read_bytes(), np.random.default_rng(0), 0
    for at in rng.integers(0, len(data), 250).tolist():
        path.write_bytes(data[:at] + bytes([data[at] ^ (1 << int(rng.integers(8)))]) + data[at + 1 :])
        try:
            assert Memory.load(path).hash == sample().hash
        except InvalidFile:
            refused += 1
    assert refused > 200


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"format": "other"}, "no memory: expected the format 'planner-service/memory'"),
        ({"version": 2}, "version 2; this package reads version 1"),
        ({"version": True}, "version True"),
        ({"hash": "0" * 64}, "hash: got '0000"),
        ({"more": 1}, "more"),
        ({"memory": {}}, "joint_names: missing"),
        ({"memory": {"joint_names": ["a"], "motions": [[[1.0], [2.0, 3.0]]], "grips": []}}, "motions"),
        ({"memory": {"joint_names": ["a"], "motions": [[[1.0], ["2"]]], "grips": []}}, "motions"),
        ({"memory": {"joint_names": ["a"], "motions": [[[1.0], [1e999]]], "grips": []}}, "malformed JSON|motions"),
        ({"memory": {"joint_names": ["a"], "motions": [[[1.0], [2.0]]] * 1001, "grips": []}}, "at most 1,000"),
        ({"memory": {"joint_names": ["\x1b[2J"], "motions": [], "grips": []}}, "joint_names"),
        ({"memory": {"joint_names": ["a"], "motions": [], "grips": [[1.0, 0.1]]}}, "grips"),
        ({"memory": {"joint_names": ["a"], "motions": [], "grips": [[1.0, 0.1, -0.1]]}}, "grips"),
        ({"memory": {"joint_names": ["a"], "motions": [], "grips": [[1.0, 0.1, 0.1]] * 1001}}, "at most 1,000"),
    ],
)
def test_a_file_that_says_something_else_is_refused_by_name(change: dict[str, Any], said: str, tmp_path: Path) -> None:
    path = saved(tmp_path)
    path.write_text(json.dumps(json.loads(path.read_text()) | change))
    with pytest.raises(InvalidFile, match=said):
        Memory.load(path)


def test_a_memory_is_not_written_over_a_file_of_another_kind(tmp_path: Path) -> None:
    path = tmp_path / "notes.txt"
    path.write_text("mine")
    with pytest.raises(InvalidFile, match="a file of another kind is there"):
        sample().save(path)
    assert path.read_text() == "mine"
