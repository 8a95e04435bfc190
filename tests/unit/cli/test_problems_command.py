"""``planner-service problems``: lists a published problem set, and plans its problems."""

from __future__ import annotations

import json
from pathlib import Path

from typer.testing import CliRunner

from planner_service.cli.commands import app

SAMPLES = Path(__file__).parents[3] / "benchmarks" / "problems" / "samples"


def test_a_set_is_listed_and_one_of_its_problems_is_planned() -> None:
    file = str(SAMPLES / "vamp_panda.json")
    listed = CliRunner().invoke(app, ["problems", file])
    assert (listed.exit_code, "cage/0007" in listed.output) == (0, True)
    planned = CliRunner().invoke(app, ["problems", file, "--robot", "panda_mbm", "--id", "cage/0007", "--json"])
    (problem,) = json.loads(planned.output)["problems"]
    assert (planned.exit_code, problem["id"], problem["planned"]) == (0, "cage/0007", True)
    assert problem["states"] > 0


def test_a_problem_that_is_not_planned_and_a_robot_that_does_not_fit_have_exit_codes() -> None:
    file = str(SAMPLES / "robometrics_panda.yaml")
    late = CliRunner().invoke(app, ["problems", file, "--robot", "panda_mbm", "--time-limit", "1e-9"])
    assert (late.exit_code, "0 of 2 planned" in late.output) == (1, True)
    other = CliRunner().invoke(app, ["problems", file, "--robot", "wxai"])
    assert other.exit_code == 2
