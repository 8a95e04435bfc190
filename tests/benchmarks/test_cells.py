"""The cells that are measured: nothing stands in anything else, and simulated arms are those that are planned for."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest

import planner_service as ps
from benchmarks.harness.kept import Kept
from benchmarks.harness.markdown import write_part
from benchmarks.harness.report import Row
from benchmarks.studies.cells import PARTS, executed, failures, run, solved
from benchmarks.studies.cells.physics import Physics
from benchmarks.studies.cells.work import kept_rows
from benchmarks.worlds.cells import KINDS, ROBOTS, Cell, cell
from planner_service.execute.mjcf import link_of

COUNTS = {"palletise": 24, "bin": 12, "shelf": 10, "kitting": 8, "screws": 30}


def overlaps(scene: ps.Scene, loose: list[str], robot: ps.Robot) -> set[str]:
    """Pairs of loose things, and of these and what is fixed, that overlap to MuJoCo."""
    physics = Physics(robot, scene, robot.home, loose, still=True)
    model, data = physics.model, physics.data
    found = set()
    for a, b in data.contact.geom[: data.ncon].tolist():
        found.add(" x ".join(sorted(link_of(model.geom(k).name) for k in (a, b))))
    return found


def placed(each: Cell) -> ps.Scene:
    """Every object where it is to go, each at a place of its own."""
    scene, taken = each.scene, set[tuple[float, ...]]()
    for job in each.jobs:
        place = next(pose for pose in job.places if pose.position not in taken)
        taken.add(place.position)
        scene = scene.without(job.name) if job.name in scene.names else scene
        scene = scene.with_obstacle(ps.Obstacle(job.name, job.shape, place))
    return scene


@pytest.mark.parametrize("robot", ROBOTS)
@pytest.mark.parametrize("kind", KINDS)
def test_nothing_in_a_cell_stands_in_anything_else_before_or_after(kind: str, robot: str) -> None:
    arm = ps.load_robot(robot)
    for draw in range(3):
        each = cell(kind, robot, draw)
        assert len(each.jobs) == COUNTS[kind]
        there = [job.name for job in each.jobs if job.name in each.scene.names]
        assert overlaps(each.scene, there, arm) == set()
        assert overlaps(placed(each), [job.name for job in each.jobs], arm) == set()


@pytest.mark.parametrize("kind", KINDS)
def test_a_draw_is_the_same_every_time_and_unlike_the_others(kind: str) -> None:
    assert cell(kind, "wxai", 1).scene == cell(kind, "wxai", 1).scene
    assert cell(kind, "wxai", 1).scene != cell(kind, "wxai", 2).scene


@pytest.mark.parametrize("name", ROBOTS)
def test_a_simulated_arm_has_its_tool_where_the_planner_says(name: str) -> None:
    robot = ps.load_robot(name)
    chance = np.random.default_rng(0)
    for _ in range(5):
        q = chance.uniform(*robot.bounds)
        physics = Physics(robot, ps.Scene(), q, (), still=True)
        body = "link_6" if name == "wxai" else f"at {robot.bodies[robot.tool_body].name}"
        at = physics.data.body(body)
        tool = at.xmat.reshape(3, 3) @ robot.tool_placement[:3, 3] + at.xpos
        assert np.allclose(tool, robot.tool_pose(q)[:3, 3], atol=1e-6)


@pytest.mark.parametrize("name", ROBOTS)
def test_a_simulated_arm_stands_still_where_it_is_told_to(name: str) -> None:
    robot = ps.load_robot(name)
    physics = Physics(robot, ps.Scene(), robot.home, ())
    for _ in range(500):
        mujoco.mj_step(physics.model, physics.data)
    assert np.abs(physics.positions() - robot.home).max() < 2e-3


def test_jobs_are_solved_and_the_auditor_finds_nothing_touching() -> None:
    report = solved.run(1, 0, "ur5_vacuum")
    assert [row["ok"] for row in report.rows] == [True] * len(KINDS)
    assert all(promise.kept for promise in report.promises)


def test_jobs_are_carried_out_without_an_unexpected_contact() -> None:
    report = executed.run(1, 0, "ur5_vacuum")
    assert [row["contacts"] for row in report.rows] == [[]] * len(KINDS)
    assert all(promise.kept for promise in report.promises)


def test_a_motion_through_a_thing_is_an_unexpected_contact() -> None:
    robot = ps.load_robot("ur5_vacuum")
    goal = robot.home + np.array([1.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    plan = ps.PlannerService(robot, ps.Scene()).plan(ps.PlanRequest(robot.home, goal))
    middle = robot.tool_pose(robot.home + np.array([0.5, 0.0, 0.0, 0.0, 0.0, 0.0]))[:3, 3]
    post = ps.Obstacle("post", ps.Cylinder(0.02, 1.0), ps.Pose(tuple(middle.tolist())))
    physics = Physics(robot, ps.Scene((post,)), robot.home, ())
    outcome = physics.run([ps.planning.task_result.Segment("swing", plan, 0.0)])
    assert any("post" in pair for pair in outcome.unexpected)


def test_parts_are_written_each_in_its_place_with_what_was_kept_of_other_robots(tmp_path: Path) -> None:
    text, keep = tmp_path / "cells.md", tmp_path / "done.jsonl"
    marks = [f"<!-- generated: cells {part} -->\nold\n<!-- end of cells {part} -->\n" for part in PARTS]
    text.write_text("".join(marks))
    rows: list[Row] = [{"x": 0.0}]
    Kept(keep).put("solved screws panda 0 1", {"rows": rows})

    def jobs(each: Cell, queries: int | None) -> list[Row]:
        return [{"cell": each.name, "queries": queries}]

    found = kept_rows("solved", jobs, 1, 0, "wxai", Kept(keep))
    assert [row for row in found if "cell" not in row] == rows
    assert len(found) == len(KINDS) + 1
    assert kept_rows("solved", jobs, 1, 0, "ur5_vacuum", Kept(keep))[1] == {
        "cell": "palletise, ur5_vacuum",
        "queries": 1,
    }
    write_part(run("failures", 1, robot="ur5_vacuum"), text)
    written = text.read_text()
    assert "| the cup has no flat face |" in written
    assert written.count("old") == len(PARTS) - 1


def test_a_failure_of_a_cup_names_step_and_cause() -> None:
    report = failures.run(None, 0, "ur5_vacuum")
    assert all(promise.kept for promise in report.promises)
