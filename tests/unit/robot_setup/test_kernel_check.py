"""The doctor says what is in use, notices a kernel that errs, and compares on states drawn from a seed."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import Any

import pytest
from typer.testing import CliRunner

from planner_service.certify import Certificate, Certifier
from planner_service.certify.prover import Prover
from planner_service.cli.commands import app
from planner_service.collision.checker import CollisionChecker
from planner_service.collision.native_kernel import instruction_sets
from planner_service.errors import InvalidRequest
from planner_service.path.trajectory import Trajectory
from planner_service.robot_setup import kernel_check as health
from planner_service.robot_setup.kernel_check import examine
from planner_service.robot_setup.loading import load_robot
from planner_service.scene.loading import load_scene
from planner_service.search.edge_cache import SearchOracle
from planner_service.timing.laws import ToppRa

WORDS = ["doctor", "--states", "200"]


@pytest.mark.slow
def test_the_doctor_names_the_instruction_set_and_finds_no_difference() -> None:
    done = CliRunner().invoke(app, WORDS)
    fastest = instruction_sets()[-1]
    assert done.exit_code == 0
    assert done.output.startswith(f"checks: {fastest}")
    assert "200 random states of wxai in bin" in done.output
    assert "proofs: " in done.output
    assert "10 short edges" in done.output
    assert done.output.count(" 0 differences") == 4


def test_the_doctor_speaks_json() -> None:
    done = CliRunner().invoke(app, [*WORDS, "--robot", "planar2", "--scene", "table", "--json"])
    told = json.loads(done.output)
    assert [(told[part]["asked"], told[part]["differences"]) for part in ("checks", "proofs")] == [(200, 0), (10, 0)]
    assert told["agrees"] is True
    assert told["checks"]["available"] == list(instruction_sets())


@pytest.mark.slow
def test_equal_seeds_compare_on_equal_states() -> None:
    robot, scene = load_robot("wxai"), load_scene("bin")
    found = {examine(robot, scene, states=300, seed=seed).checks.refused for seed in (1, 1, 2)}
    assert len(found) == 2


@pytest.mark.slow
def test_a_kernel_that_errs_is_our_bug(monkeypatch: pytest.MonkeyPatch) -> None:
    whole = CollisionChecker.edge_hit

    def blind(checker: CollisionChecker, *ends: Any, **known: Any) -> Any:
        return None if checker.backend == "native" else whole(checker, *ends, **known)

    monkeypatch.setattr(CollisionChecker, "edge_hit", blind)
    done = CliRunner().invoke(app, WORDS)
    assert done.exit_code == 70
    assert done.output.count(" 0 differences") == 3


class Plain(Prover):
    """That of the judge."""


@pytest.mark.slow
def test_a_proof_that_errs_is_our_bug(monkeypatch: pytest.MonkeyPatch) -> None:
    whole = Certifier.certify

    def hopeful(certifier: Certifier, path: Any) -> Certificate:
        found = whole(certifier, path)
        return found if isinstance(certifier.prover, Plain) else replace(found, refusal=None)

    monkeypatch.setattr(health, "Prover", Plain)
    monkeypatch.setattr(Certifier, "certify", hopeful)
    done = CliRunner().invoke(app, WORDS)
    assert done.exit_code == 70
    assert done.output.count(" 0 differences") == 3


@pytest.mark.slow
def test_a_search_that_errs_is_our_bug(monkeypatch: pytest.MonkeyPatch) -> None:
    class Known(SearchOracle):
        def __init__(self, checker: CollisionChecker, *ends: Any) -> None:
            super().__init__(checker, *ends)
            self.judge = checker.backend

    monkeypatch.setattr(health, "SearchOracle", Known)
    monkeypatch.setattr(health, "pulled_in", lambda path, oracle: path if oracle.judge == "fcl" else path[::-1])
    done = CliRunner().invoke(app, WORDS)
    assert done.exit_code == 70
    assert done.output.count(" 0 differences") == 3


@pytest.mark.slow
def test_a_time_law_that_errs_is_our_bug(monkeypatch: pytest.MonkeyPatch) -> None:
    whole = ToppRa.time_path

    def hasty(law: ToppRa, *asked: Any, **settings: Any) -> Trajectory:
        found = whole(law, *asked, **settings)
        return found.dilated(1.1) if law.backend == "own" else found

    monkeypatch.setattr(ToppRa, "time_path", hasty)
    done = CliRunner().invoke(app, WORDS)
    assert done.exit_code == 70
    assert done.output.count(" 0 differences") == 3


@pytest.mark.parametrize("states", [1, 2])
def test_a_state_or_two_are_enough(states: int) -> None:
    assert examine(load_robot("planar2"), load_scene("discs"), states=states).agrees


def test_a_number_of_states_that_makes_no_sense_is_refused() -> None:
    states: Any
    for states in [0, -1, 1_000_001, True, 2.0]:
        with pytest.raises(InvalidRequest, match="states"):
            examine(load_robot("planar2"), load_scene("table"), states=states)


def test_bad_input_exits_with_two() -> None:
    assert CliRunner().invoke(app, ["doctor", "--states", "0"]).exit_code == 2
