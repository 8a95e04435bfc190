"""What a gate writes into its log is read again; anything else is refused with its line."""

from __future__ import annotations

import contextlib
import json
import random
from pathlib import Path

import numpy as np
import pytest

from planner_service.errors import InvalidFile
from planner_service.gate import Kind
from planner_service.gate.log_reader import read_log
from planner_service.scene.scene import Scene
from tests.support.optional import present
from tests.unit.certify.test_certifier import ball_beyond
from tests.unit.gate.test_action_gate import START, gate_of, ramp


def written(log: Path) -> list[bytes]:
    """A log of a chunk that is cut, one that is slowed down, and an arm that is lost."""
    gate = gate_of(ball_beyond(-0.05), slow=True, log=log)
    gate.check(START, ramp(90))
    gate.check(START, ramp(90)[40:45], sent=0)
    gate.check(START + 1.0, ramp(3), sent=0)
    return log.read_bytes().splitlines()


def test_a_log_is_read_as_it_was_decided_with_where_the_arm_was_and_comes_to_rest(tmp_path: Path) -> None:
    log = tmp_path / "gate.jsonl"
    gate = gate_of(ball_beyond(-0.05), log=log)
    verdict = gate.check(START, ramp(90))
    (logged,) = read_log(log, 2)
    assert logged.refused == verdict.refused
    assert (logged.chunk, logged.accepted, logged.proven) == (1, verdict.accepted, True)
    assert (logged.q, logged.rest) == (tuple(START.tolist()), tuple(verdict.rows[-1].tolist()))


def test_a_measurement_that_is_no_number_is_left_out_of_the_log(tmp_path: Path) -> None:
    log = tmp_path / "gate.jsonl"
    gate = gate_of(Scene(), log=log)
    gate.check(START, START)
    gate.check(np.array([np.nan, 0.0]), START)
    (logged,) = read_log(log, 2)
    assert (logged.q, present(logged.refused).kind) == ((), Kind.TRACKING)


def test_a_line_without_where_the_arm_was_is_read_too(tmp_path: Path) -> None:
    line = json.loads(written(tmp_path / "gate.jsonl")[0])
    del line["q"], line["rest"]
    (tmp_path / "older.jsonl").write_text(json.dumps(line))
    (logged,) = read_log(tmp_path / "older.jsonl", 2)
    assert (logged.q, logged.rest) == ((), ())


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"chunk": -1}, "line 2.chunk: got -1"),
        ({"kind": "whim"}, "line 2.*whim.*one of number, limit"),
        ({"pair": ["a"]}, "line 2.pair"),
        ({"q": [0.0]}, "line 2.q: 1 numbers; the robot has 2 joints"),
        ({"rest": ["x", 1.0]}, "line 2.rest"),
        ({"colour": "red"}, "line 2: unknown key 'colour'"),
        ({"depth": "deep"}, "line 2.depth"),
    ],
)
def test_what_no_gate_writes_is_refused_with_its_line(tmp_path: Path, change: dict[str, object], said: str) -> None:
    log = tmp_path / "gate.jsonl"
    lines = written(log)
    log.write_bytes(lines[0] + b"\n" + json.dumps(json.loads(lines[0]) | change).encode())
    with pytest.raises(InvalidFile, match=said):
        read_log(log, 2)


def test_a_damaged_log_is_refused_or_read_and_nothing_else_happens(tmp_path: Path) -> None:
    log, rng = tmp_path / "gate.jsonl", random.Random(5)
    good = b"\n".join(written(log))
    for _ in range(300):
        data = bytearray(good)
        for _ in range(rng.randint(1, 8)):
            at = rng.randrange(len(data))
            data[at : at + rng.randint(0, 3)] = rng.choice([b"", b"}", b"[", b"1e999", b'"', b"\xff", b"NaN", b"\n"])
        log.write_bytes(data)
        with contextlib.suppress(InvalidFile):
            read_log(log, 2)
