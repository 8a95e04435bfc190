"""The doctor says what is in use, notices a kernel that errs, and compares on states drawn from a seed."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest
from typer.testing import CliRunner

from planner_service.certify import Certificate, Certifier
from planner_service.certify.certifier import Prover
from planner_service.cli.commands import app
from planner_service.collision.checker import CollisionChecker
from planner_service.collision.native_kernel import instruction_sets
from planner_service.path.trajectory import Trajectory
from planner_service.robot_setup import kernel_check as health
from planner_service.search.problem import SearchOracle
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
