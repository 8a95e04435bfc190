"""Peers: their input, their answers, and what is reported where they cannot run."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks.baselines.peers.child import Child

FAKE = """
import os, signal, sys, time
from benchmarks.baselines.peers.adapter_protocol import serve

class Fake:
    def __init__(self, job):
        print("noise while loading")
        if job["settings"].get("broken"):
            raise RuntimeError("no such robot")
        self.job = job

    def solve(self, problem, seed, answer):
        name, begun = problem["problem"], time.monotonic()
        if name == "noisy":
            print("noise on the answers' channel")
            os.write(1, b"and below Python\\n")
        if name == "raises":
            raise ValueError("cannot do cones")
        if name == "crashes":
            print("about to fall", flush=True)
            os.kill(os.getpid(), signal.SIGSEGV)
        if name == "hangs":
            with open("hanging.pid", "w") as file:
                file.write(str(os.getpid()))
            time.sleep(600)
        with answer.stage("search"):
            pass
        answer.checks["search"] = 7
        answer.seconds["setup"] = begun
        answer.waypoints = [problem["start"], problem["goals"][0]]

serve(("numpy",), Fake)
"""


def fake(tmp_path: Path, script: str = FAKE, seconds: float = 60.0) -> Child:
    (tmp_path / "fake.py").write_text(script, "utf-8")
    return Child((sys.executable, str(tmp_path / "fake.py")), dict(os.environ), tmp_path, problem_seconds=seconds)


def job(*names: str, **settings: Any) -> dict[str, Any]:
    problems = [{"problem": name, "seed": 0, "start": [0.0], "goals": [[1.0]], "obstacles": []} for name in names]
    return {"version": 1, "robot": {}, "settings": settings, "time_limit": 1.0, "problems": problems}


# --- whatever a peer does, each problem has a reply


def test_what_a_peer_prints_does_not_get_among_its_answers(tmp_path: Path) -> None:
    replies = list(fake(tmp_path).replies(job("good", "noisy")))
    assert [reply.failure for reply in replies] == [None, None]
    assert replies[1].answer is not None
    assert replies[1].answer["waypoints"] == [[0.0], [1.0]]
    assert replies[1].versions == {"numpy": np.__version__}
    assert "noise" in (tmp_path / "stderr.txt").read_text("utf-8")


def test_an_exception_is_the_answer_to_its_problem_alone(tmp_path: Path) -> None:
    first, second = fake(tmp_path).replies(job("raises", "good"))
    assert first.answer is not None
    assert second.answer is not None
    assert first.answer["error"] == "ValueError: cannot do cones"
    assert first.answer["waypoints"] is None
    assert second.answer["error"] == ""


def test_a_crash_is_told_with_what_was_printed_last_and_the_rest_goes_on(tmp_path: Path) -> None:
    replies = list(fake(tmp_path).replies(job("good", "crashes", "good")))
    assert [reply.failure for reply in replies] == [None, "crashed", None]
    assert replies[1].detail == "ended by SIGSEGV; last printed: about to fall"


def test_who_hangs_is_ended_and_the_rest_goes_on(tmp_path: Path) -> None:
    replies = list(fake(tmp_path, seconds=2.0).replies(job("hangs", "good")))
    assert [reply.failure for reply in replies] == ["hung", None]
    assert replies[0].detail.startswith("silent for 2 s, ended")
    assert replies[0].waited >= 2.0
    pid = int((tmp_path / "hanging.pid").read_text("utf-8"))
    with pytest.raises(ProcessLookupError):
        os.kill(pid, 0)


# --- rows


# --- jobs


# --- adapters


# --- environments
