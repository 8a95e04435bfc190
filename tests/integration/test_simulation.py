"""The simulated arm: our shapes where we have them, contacts reported, and pick-and-place through the vendor's driver.

The simulation runs in real time, and so do these tests. A machine that does other things makes the stream late; what is
asserted holds then, too: contacts, where the arm really was, and where it ends. Nothing is tried twice.
"""

from __future__ import annotations

import math
import re
import runpy
import signal
import subprocess
import sys
import time
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import planner_service as ps
from auditor.checker import IndependentChecker, tables_of
from planner_service.execute import ExecutionStopped, SimulatedArm, Streaming, execute, rehearse
from planner_service.execute.mjcf import mjcf_text
from planner_service.execute.simulator import arm_file
from tests.support import errands
from tests.support.optional import present

pytestmark = pytest.mark.sim

ROBOTS = Path(__file__).parents[2] / "robots"
EXAMPLES = Path(__file__).parents[2] / "examples"
PATIENT = Streaming(latest=0.5, gripper_time=0.6)
TURNED = ps.Pose((0.4, 0.3, 0.5), (0.8, 0.36, -0.48, 0.0))


@pytest.fixture(scope="module")
def robot() -> ps.Robot:
    return ps.load_robot("wxai")


def compiled(text: str) -> Any:
    import mujoco

    return mujoco.MjModel.from_xml_string(text)


def placed(model: Any, joints: dict[str, float]) -> dict[str, tuple[Any, Any]]:
    """Position and rotation of every geom of a model, its joints where they are said to be."""
    import mujoco

    data = mujoco.MjData(model)
    for name, value in joints.items():
        data.qpos[model.joint(name).qposadr[0]] = value
    mujoco.mj_kinematics(model, data)
    return {
        model.geom(k).name: (data.geom_xpos[k].copy(), data.geom_xmat[k].reshape(3, 3).copy())
        for k in range(model.ngeom)
    }


def test_the_geoms_are_the_robots_shapes_wherever_it_stands(robot: ps.Robot) -> None:
    model = compiled(mjcf_text(arm_file(), robot, ps.Scene()))
    assert model.ngeom == len(robot.shapes)
    assert robot.gripper is not None
    rng = np.random.default_rng(3)
    for _ in range(50):
        q, width = rng.uniform(robot.limits.lower, robot.limits.upper), rng.uniform(0.0, 0.08)
        found = placed(
            model, dict(zip(robot.joint_names, q, strict=True)) | dict.fromkeys(robot.gripper.joints, width / 2)
        )
        poses, count = robot.body_poses(q.tolist()), dict[str, int]()
        for item in robot.with_gripper(width).shapes:
            k = count[item.link] = count.get(item.link, -1) + 1
            row = poses[item.body]
            turn, at = np.array(row[:9]).reshape(3, 3), np.array(row[9:])
            position, rotation = found[f"{item.link}#{k}"]
            assert position == pytest.approx(at + turn @ item.pose.position, abs=1e-9)
            assert rotation == pytest.approx(turn @ item.pose.rotation, abs=1e-9)


def test_obstacles_of_every_kind_are_where_they_are_in_the_scene(robot: ps.Robot) -> None:
    corners = np.array([[x, y, z] for x in (-0.05, 0.05) for y in (-0.04, 0.04) for z in (-0.03, 0.03)])
    shapes: dict[str, Any] = {
        "box": ps.Box((0.1, 0.2, 0.3)),
        "ball": ps.Sphere(0.05),
        "post": ps.Cylinder(0.03, 0.4),
        "pill": ps.Capsule(0.03, 0.4),
        "stone": ps.Mesh(corners),
        "stool": ps.Compound(
            ((ps.Box((0.1, 0.1, 0.02)), ps.Pose((0.0, 0.0, 0.1))), (ps.Cylinder(0.02, 0.2), ps.Pose()))
        ),
    }
    scene = ps.Scene(tuple(ps.Obstacle(name, shape, TURNED) for name, shape in shapes.items()))
    model = compiled(mjcf_text(arm_file(), robot, scene))
    found = placed(model, {})
    for name in ("box", "ball", "post", "pill", "stone", "stool"):
        position, rotation = found[f"{name}#{0 if name != 'stool' else 1}"]
        assert position == pytest.approx(TURNED.position, abs=1e-9)
        if name != "stone":  # MuJoCo turns a mesh to its own axes
            assert rotation == pytest.approx(TURNED.rotation, abs=1e-9)
    seat, _ = found["stool#0"]
    assert seat == pytest.approx((TURNED @ ps.Pose((0.0, 0.0, 0.1))).position, abs=1e-9)


def test_only_arm_and_scene_and_what_lies_loose_can_touch(robot: ps.Robot) -> None:
    model = compiled(mjcf_text(arm_file(), robot, ps.load_scene("bin"), loose=("blue_block", "tray")))

    def can_touch(a: str, b: str) -> bool:
        (one, other) = model.geom(a), model.geom(b)
        return bool((one.contype[0] & other.conaffinity[0]) or (other.contype[0] & one.conaffinity[0]))

    assert can_touch("link_5#0", "table#0")
    assert can_touch("finger_left#2", "blue_block#0")
    assert can_touch("blue_block#0", "bin_floor#0")
    assert can_touch("blue_block#0", "tray#0")
    assert not can_touch("link_2#0", "link_5#0")
    assert not can_touch("bin_floor#0", "bin_left#0")


def test_the_arm_stands_where_it_is_to_begin_and_is_the_robot(robot: ps.Robot) -> None:
    start, began = robot.poses["ready"], time.perf_counter()
    with SimulatedArm(robot, ps.load_scene("table"), start) as arm, closing(arm.connect()) as driver:
        assert driver.positions() == pytest.approx(start, abs=1e-3)
        assert driver.gripper_width() == pytest.approx(robot.gripper_width, abs=1e-4)
        limits = driver.limits()
        assert limits.lower == pytest.approx(robot.limits.lower, abs=1e-4)
        assert limits.upper == pytest.approx(robot.limits.upper, abs=1e-4)
        assert arm.contacts() == ()
        assert arm.time() > 0.0
        assert arm.behind() < time.perf_counter() - began
        assert driver.simulated


def test_the_simulation_ends_with_a_process_that_is_killed(tmp_path: Path) -> None:
    program = (
        "import time; from planner_service import load_robot, Scene\n"
        "from planner_service.execute import SimulatedArm\n"
        "arm = SimulatedArm(load_robot('wxai'), Scene()); print(arm._process.pid, flush=True); time.sleep(60)\n"
    )
    command = [sys.executable, "-c", program]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, cwd=ROBOTS.parent) as parent:
        child = int(present(parent.stdout).readline())
        parent.send_signal(signal.SIGKILL)
    for _ in range(200):
        if not Path(f"/proc/{child}").exists() or "Z" in Path(f"/proc/{child}/stat").read_text().split()[2]:
            return
        time.sleep(0.05)
    pytest.fail("the simulation is still there")


def test_seven_legs_touch_nothing_they_should_not_and_end_where_they_should(robot: ps.Robot) -> None:
    taken = "blue_block"
    with SimulatedArm(robot, ps.load_scene("bin"), loose=(taken,)) as arm:
        work = errands.errand(arm)
        done = rehearse(arm, work.task, robot, PATIENT)
    assert done.report.stopped is None
    assert [motion.name for motion in done.report.motions] == [segment.name for segment in work.task.segments]
    assert len(done.report.motions) == 7
    assert [str(contact) for contact in done.contacts] == []
    assert any(contact.pair == {"finger_left", taken} for contact in done.meant)
    assert math.dist(done.loose[taken].position, work.end.position) < 0.005
    for segment, world, motion in zip(work.task.segments, work.scenes, done.report.motions, strict=True):
        assert motion.final_error.max() < 0.005
        assert 0.0 < motion.tool_off_path <= motion.tool_lag + 1e-4
        allowed = [pair for interval in segment.result.exempt for pair in interval.pairs]
        checker = IndependentChecker(ROBOTS / "wxai", tables_of(world), gripper_width=segment.width, allowed=allowed)
        assert checker.path_touch(motion.recording.measured, motion_step=0.002) is None


def test_a_motion_through_an_obstacle_reports_a_contact(robot: ps.Robot) -> None:
    motion, done = errands.control()
    assert any("demo_post" in contact.pair for contact in done.contacts)
    assert not done.ok
    assert max(contact.force for contact in done.contacts) > 1.0
    scene = ps.load_scene("bin").without("blue_block")
    checker = IndependentChecker(ROBOTS / "wxai", tables_of(scene))
    assert not checker.path_is_free(motion.path.waypoints)


def test_an_arm_that_is_stopped_on_its_way_stays_there(robot: ps.Robot) -> None:
    service = ps.PlannerService(robot, "empty")
    off = np.array([0.6, 0.0, 0.0, 0.0, 0.0, 0.0])
    plan = service.plan(ps.PlanRequest(robot.home - off, robot.home + off))
    with SimulatedArm(robot, ps.Scene(), robot.home - off) as arm, closing(arm.connect()) as driver:
        cut = errands.Cut(driver, 0.5 * plan.unwrap()[1].duration)
        with pytest.raises(ExecutionStopped, match="hold where it was") as caught:
            execute(plan, cut, robot, PATIENT)
        time.sleep(0.5)
        first = driver.positions()
        time.sleep(0.2)
        second = driver.positions()
    assert np.abs(first - second).max() < 1e-3  # the wrist still swings by a quarter of that
    assert np.abs(first - cut.stood).max() < 0.01
    assert -0.55 < first[0] < 0.55
    assert len(caught.value.report.motions[0].recording.t) > 0


def test_the_example_executes_a_pick_and_place(capsys: pytest.CaptureFixture[str]) -> None:
    runpy.run_path(str(EXAMPLES / "08_execute_in_simulation.py"), run_name="__main__")
    printed = capsys.readouterr().out
    assert "unexpected contacts: 0" in printed
    assert len(re.findall(r"mm off its path$", printed, flags=re.MULTILINE)) == 7
    assert float(re.search(r"(\S+) mm from the tray's middle", printed).group(1)) < 5.0  # type: ignore[union-attr]


def test_the_example_lets_no_policy_touch_anything(capsys: pytest.CaptureFixture[str]) -> None:
    runpy.run_path(str(EXAMPLES / "12_gate_in_simulation.py"), run_name="__main__")
    printed = capsys.readouterr().out
    assert "contacts: 0" in printed
    refusals = re.findall(r": (\d+) refusals", printed)
    assert len(refusals) == 3
    assert sum(map(int, refusals)) > 0
