"""The simulated arm: our shapes where we have them, contacts reported, and pick-and-place through the vendor's driver.

The simulation runs in real time, and so do these tests. A machine that does other things makes the stream late; what is
asserted holds then, too: contacts, where the arm really was, and where it ends. Nothing is tried twice.
"""

from __future__ import annotations

import math
import os
import re
import runpy
import signal
import socket
import subprocess
import sys
import threading
import time
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from auditor.checker import IndependentChecker, tables_of
from planner_service import (
    Attached,
    Box,
    BrokenInvariant,
    Capsule,
    Compound,
    Cylinder,
    InvalidRequest,
    Mesh,
    MissingDependency,
    Obstacle,
    PlannerService,
    PlanRequest,
    PointCloud,
    Pose,
    Robot,
    Scene,
    Sphere,
    load_robot,
    load_scene,
)
from planner_service.cli.commands import app
from planner_service.execute import ExecutionStopped, SimulatedArm, Streaming, TrossenDriver, execute, rehearse
from planner_service.execute import simulator as simulator_module
from planner_service.execute.mjcf import link_of, mjcf_text
from planner_service.execute.simulator import TCP_PORT, UDP_PORT, arm_file
from planner_service.records.evidence import save_plan
from planner_service.records.plan_file import SavedPlan
from tests.support import errands
from tests.support.optional import present

pytestmark = pytest.mark.sim

ROBOTS = Path(__file__).parents[2] / "robots"
EXAMPLES = Path(__file__).parents[2] / "examples"
PATIENT = Streaming(latest=0.5, gripper_time=0.6)
TURNED = Pose((0.4, 0.3, 0.5), (0.8, 0.36, -0.48, 0.0))


@pytest.fixture(scope="module")
def robot() -> Robot:
    return load_robot("wxai")


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


def test_the_geoms_are_the_robots_shapes_wherever_it_stands(robot: Robot) -> None:
    model = compiled(mjcf_text(arm_file(), robot, Scene()))
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


def test_the_geoms_are_as_large_as_the_robots_shapes(robot: Robot) -> None:
    model, count = compiled(mjcf_text(arm_file(), robot, Scene())), dict[str, int]()
    for item in robot.shapes:
        k = count[item.link] = count.get(item.link, -1) + 1
        size = model.geom(f"{item.link}#{k}").size
        shape: Any = item.shape
        lengths = list(shape.size) if isinstance(shape, Box) else [2 * shape.radius, shape.length]
        assert (2 * size[: len(lengths)]).tolist() == pytest.approx(lengths, abs=1e-12)


def test_masses_are_those_of_the_vendors_model(robot: Robot) -> None:
    import mujoco

    vendor = mujoco.MjModel.from_xml_path(str(arm_file()))
    ours = compiled(mjcf_text(arm_file(), robot, load_scene("bin")))
    assert ours.body_mass.tolist() == vendor.body_mass.tolist()
    assert ours.actuator_gainprm.tolist() == vendor.actuator_gainprm.tolist()


def test_obstacles_of_every_kind_are_where_they_are_in_the_scene(robot: Robot) -> None:
    corners = np.array([[x, y, z] for x in (-0.05, 0.05) for y in (-0.04, 0.04) for z in (-0.03, 0.03)])
    shapes: dict[str, Any] = {
        "box": Box((0.1, 0.2, 0.3)),
        "ball": Sphere(0.05),
        "post": Cylinder(0.03, 0.4),
        "pill": Capsule(0.03, 0.4),
        "stone": Mesh(corners),
        "stool": Compound(((Box((0.1, 0.1, 0.02)), Pose((0.0, 0.0, 0.1))), (Cylinder(0.02, 0.2), Pose()))),
    }
    scene = Scene(tuple(Obstacle(name, shape, TURNED) for name, shape in shapes.items()))
    model = compiled(mjcf_text(arm_file(), robot, scene))
    found = placed(model, {})
    for name in ("box", "ball", "post", "pill", "stone", "stool"):
        position, rotation = found[f"{name}#{0 if name != 'stool' else 1}"]
        assert position == pytest.approx(TURNED.position, abs=1e-9)
        if name != "stone":  # MuJoCo turns a mesh to its own axes
            assert rotation == pytest.approx(TURNED.rotation, abs=1e-9)
    seat, _ = found["stool#0"]
    assert seat == pytest.approx((TURNED @ Pose((0.0, 0.0, 0.1))).position, abs=1e-9)


def test_what_the_robot_carries_is_on_its_hand_and_can_touch(robot: Robot) -> None:
    held = Attached("cup", Box((0.05, 0.06, 0.07)), TURNED, touch_links=("finger_left",))
    scene = load_scene("table").with_attached(held)
    model = compiled(mjcf_text(arm_file(), robot, scene))
    rng = np.random.default_rng(5)
    for q in rng.uniform(robot.limits.lower, robot.limits.upper, (5, robot.n)):
        position, rotation = placed(model, dict(zip(robot.joint_names, q.tolist(), strict=True)))["cup#0"]
        wanted = Pose.from_matrix(robot.tool_pose(q)) @ TURNED
        assert position == pytest.approx(wanted.position, abs=1e-9)
        assert rotation == pytest.approx(wanted.rotation, abs=1e-9)
    cup, table, link = (model.geom(name) for name in ("cup#0", "table#0", "link_2#0"))
    assert (2 * cup.size).tolist() == pytest.approx([0.05, 0.06, 0.07])
    assert cup.contype[0] & table.conaffinity[0] or table.contype[0] & cup.conaffinity[0]
    assert not cup.contype[0] & link.conaffinity[0]
    assert not link.contype[0] & cup.conaffinity[0]
    assert model.body_mass.tolist() == compiled(mjcf_text(arm_file(), robot, Scene())).body_mass.tolist()


@pytest.mark.parametrize("name", ["world", "carriage_left", 'a "b" <c/> & #0', "a#"])
def test_a_scenes_names_are_taken_as_they_are(name: str, robot: Robot) -> None:
    scene = Scene((Obstacle(name, Box((0.1, 0.1, 0.1)), TURNED), Obstacle("stone", Sphere(0.05), TURNED)))
    for loose in ((), (name,)):
        model = compiled(mjcf_text(arm_file(), robot, scene, loose=loose))
        names = {model.geom(k).name for k in range(model.ngeom)}
        assert {f"{name}#0", "stone#0"} < names
        assert link_of(f"{name}#0") == name


def test_only_arm_and_scene_and_what_lies_loose_can_touch(robot: Robot) -> None:
    model = compiled(mjcf_text(arm_file(), robot, load_scene("bin"), loose=("blue_block",)))

    def can_touch(a: str, b: str) -> bool:
        (one, other) = model.geom(a), model.geom(b)
        return bool((one.contype[0] & other.conaffinity[0]) or (other.contype[0] & one.conaffinity[0]))

    assert can_touch("link_5#0", "table#0")
    assert can_touch("finger_left#2", "blue_block#0")
    assert can_touch("blue_block#0", "bin_floor#0")
    assert not can_touch("link_2#0", "link_5#0")
    assert not can_touch("bin_floor#0", "bin_left#0")


def test_names_of_geoms_tell_whose_they_are() -> None:
    assert [link_of(name) for name in ("link_2#1", "a#b#12", "floor")] == ["link_2", "a#b", "floor"]


@pytest.mark.parametrize(
    ("scene", "loose", "message"),
    [
        (Scene((Obstacle("cloud", PointCloud(np.zeros((1, 3)), 0.01)),)), (), "boxes, spheres, cylinders, capsules"),
        (Scene(), ("blue_block",), "blue_block"),
    ],
)
def test_what_the_simulator_has_not_is_refused(
    scene: Scene, loose: tuple[str, ...], message: str, robot: Robot
) -> None:
    with pytest.raises(InvalidRequest, match=message):
        mjcf_text(arm_file(), robot, scene, loose=loose)


def test_an_object_called_like_a_link_has_geoms_of_its_own(robot: Robot) -> None:
    scene = Scene((Obstacle("link_1", Sphere(0.05), TURNED),))
    for loose in ((), ("link_1",)):
        model = compiled(mjcf_text(arm_file(), robot, scene, loose=loose))
        assert model.geom("link_1 (object)#0").size[0] == 0.05
        assert model.geom("link_1 (link)#0").type != model.geom("link_1 (object)#0").type


def test_another_robot_is_refused() -> None:
    with pytest.raises(InvalidRequest, match="an arm with the simulated arm's joints"):
        mjcf_text(arm_file(), load_robot("planar2"), Scene())


def test_an_arm_with_longer_links_is_refused(robot: Robot) -> None:
    longer = robot.bodies[3].placement.copy()
    longer[0, 3] += 0.001
    bodies = (*robot.bodies[:3], replace(robot.bodies[3], placement=longer), *robot.bodies[4:])
    with pytest.raises(InvalidRequest, match="joint_2 is elsewhere on it"):
        mjcf_text(arm_file(), replace(robot, bodies=bodies), Scene())


def test_without_the_simulator_the_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    def missing(name: str) -> Path:
        raise MissingDependency(name, "wxai-meshes")

    monkeypatch.setattr(simulator_module, "package_folder", missing)
    with pytest.raises(MissingDependency, match=r"planner-service\[sim\]"):
        arm_file()


def test_the_arm_stands_where_it_is_to_begin_and_is_the_robot(robot: Robot) -> None:
    start = robot.poses["ready"]
    with SimulatedArm(robot, load_scene("table"), start) as arm, closing(arm.connect()) as driver:
        assert driver.positions() == pytest.approx(start, abs=1e-3)
        assert driver.gripper_width() == pytest.approx(robot.gripper_width, abs=1e-4)
        limits = driver.limits()
        assert limits.lower == pytest.approx(robot.limits.lower, abs=1e-4)
        assert limits.upper == pytest.approx(robot.limits.upper, abs=1e-4)
        assert arm.contacts() == ()
        assert driver.simulated


def test_two_arms_run_next_to_each_other_and_leave_nothing_behind(robot: Robot) -> None:
    with SimulatedArm(robot, Scene()) as one, SimulatedArm(robot, Scene(), robot.poses["ready"]) as two:
        assert one.host != two.host
        pids = [arm._process.pid for arm in (one, two) if arm._process is not None]
        with closing(one.connect()) as a, closing(two.connect()) as b:
            assert np.abs(a.positions() - b.positions()).max() > 0.1
        folder = Path(one._folder.name)
    assert not folder.exists()
    for pid in pids:
        with pytest.raises(ProcessLookupError):
            os.kill(pid, 0)


def test_a_host_in_use_is_refused(robot: Robot) -> None:
    with SimulatedArm(robot, Scene()) as arm, pytest.raises(InvalidRequest, match="TCP 50001 and UDP 50000 are free"):
        SimulatedArm(robot, Scene(), host=arm.host)


@pytest.mark.parametrize("host", ["0.0.0.0", "", "192.168.1.2"])
def test_a_simulated_arm_is_reached_from_this_machine_only(host: str, robot: Robot) -> None:
    with pytest.raises(InvalidRequest, match="a loopback address"):
        SimulatedArm(robot, Scene(), host=host)


def test_a_host_whose_udp_port_is_in_use_is_refused(robot: Robot) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)  # as the simulator's own, which would share it
        taken.bind(("127.0.0.78", UDP_PORT))
        with pytest.raises(InvalidRequest, match="UDP 50000 are free"):
            SimulatedArm(robot, Scene(), host="127.0.0.78")


def test_an_address_without_an_arm_is_refused() -> None:
    with socket.socket() as probe:  # of a port where nothing listens
        assert probe.connect_ex(("127.0.0.77", TCP_PORT)) != 0
    with pytest.raises(InvalidRequest, match="that of an arm, switched on"):
        TrossenDriver("127.0.0.77", timeout=0.2)


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


@pytest.mark.parametrize("name", ["bin", "shelf"])
def test_seven_legs_touch_nothing_they_should_not_and_end_where_they_should(name: str, robot: Robot) -> None:
    scene, taken = errands.ERRANDS[name]
    with SimulatedArm(robot, scene, loose=(taken,)) as arm:
        work = errands.errand(name, arm)
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


def test_a_motion_through_an_obstacle_reports_a_contact(robot: Robot) -> None:
    motion, done = errands.control()
    assert any("demo_post" in contact.pair for contact in done.contacts)
    assert not done.ok
    assert max(contact.force for contact in done.contacts) > 1.0
    scene = load_scene("bin").without("blue_block")
    checker = IndependentChecker(ROBOTS / "wxai", tables_of(scene))
    assert not checker.path_is_free(motion.path.waypoints)


def test_an_arm_that_is_stopped_on_its_way_stays_there(robot: Robot) -> None:
    service = PlannerService(robot, "empty")
    off = np.array([0.6, 0.0, 0.0, 0.0, 0.0, 0.0])
    plan = service.plan(PlanRequest(robot.home - off, robot.home + off))
    with SimulatedArm(robot, Scene(), robot.home - off) as arm, closing(arm.connect()) as driver:
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


def test_of_a_simulation_that_dies_on_the_way_the_report_is_kept(robot: Robot) -> None:
    service = PlannerService(robot, "empty")
    plan = service.plan(PlanRequest(robot.home, robot.home + np.array([1.0, 0.0, 0.0, 0.0, 0.0, 0.0])))
    with SimulatedArm(robot, Scene()) as arm:
        threading.Timer(2.0, present(arm._process).kill).start()
        with pytest.raises(ExecutionStopped) as caught:
            rehearse(arm, plan, robot, Streaming(speed=0.1, latest=0.5, gripper_time=0.1))
    (motion,) = caught.value.report.motions
    assert len(motion.recording.t) > 0


@pytest.mark.parametrize("line", ["no JSON", "[1, 2]", '{"type": "end"}'])
def test_a_simulation_that_talks_nonsense_is_ended_at_once(line: str, monkeypatch: pytest.MonkeyPatch) -> None:
    spawned = subprocess.Popen

    def babbling(command: list[str], **how: Any) -> Any:
        return spawned(["sh", "-c", 'echo \'{"ready": 1}\'; echo "$0"; cat', line], **how)

    monkeypatch.setattr(subprocess, "Popen", babbling)
    arm = SimulatedArm(load_robot("wxai"), Scene())
    with pytest.raises(BrokenInvariant, match="ended by itself"):
        arm.contacts()
    arm.close()


def test_a_simulation_that_dies_is_quoted(monkeypatch: pytest.MonkeyPatch) -> None:
    spawned = subprocess.Popen

    def failing(command: list[str], **how: Any) -> Any:
        return spawned(["sh", "-c", 'echo \'{"ready": 1}\'; read line; echo "the table is on fire" >&2'], **how)

    monkeypatch.setattr(subprocess, "Popen", failing)
    arm = SimulatedArm(load_robot("wxai"), Scene())
    with pytest.raises(BrokenInvariant, match="ended by itself: the table is on fire"):
        arm.contacts()
    arm.close()


def test_a_simulation_may_complain_at_length(monkeypatch: pytest.MonkeyPatch) -> None:
    spawned = subprocess.Popen

    def wordy(command: list[str], **how: Any) -> Any:
        script = "import sys; sys.stderr.write('x' * 1_000_000); print('{\"ready\": 1}', flush=True)\n"
        return spawned([sys.executable, "-c", f"{script}for _ in sys.stdin: print('{{}}', flush=True)"], **how)

    monkeypatch.setattr(subprocess, "Popen", wordy)
    monkeypatch.setattr(simulator_module, "SECONDS", 5.0)
    with SimulatedArm(load_robot("wxai"), Scene()) as arm:
        assert arm.contacts() == ()


def test_a_saved_plan_is_rehearsed_by_the_command(robot: Robot, tmp_path: Path) -> None:
    service = PlannerService("wxai", "table")
    plan = service.plan(PlanRequest(robot.home, robot.home + np.array([0.3, 0.0, 0.0, 0.0, 0.0, 0.0])))
    save_plan(SavedPlan(service.world, None, plan), tmp_path / "plan.json")
    done = CliRunner().invoke(app, ["run", str(tmp_path / "plan.json"), "--sim"])
    assert (done.exit_code, done.stderr) == (0, "note: using the scene in this file: table\n")
    assert "executed in simulation" in done.stdout
    assert re.search(r"^motion +\d\.\d\d ", done.stdout, flags=re.MULTILINE)
    assert "unexpected contacts: 0" in done.stdout


def test_the_example_executes_a_pick_and_place(capsys: pytest.CaptureFixture[str]) -> None:
    runpy.run_path(str(EXAMPLES / "08_execute_in_simulation.py"), run_name="__main__")
    printed = capsys.readouterr().out
    assert "unexpected contacts: 0" in printed
    assert len(re.findall(r"mm off its path$", printed, flags=re.MULTILINE)) == 7
    assert float(re.search(r"(\S+) mm from the tray's middle", printed).group(1)) < 5.0  # type: ignore[union-attr]
