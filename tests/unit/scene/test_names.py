"""Links and scene objects of one name are two things: each is judged, named and drawn as what it is."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from planner_service import (
    Attached,
    Box,
    Capsule,
    Handling,
    Obstacle,
    PlannerService,
    PlanRequest,
    Pose,
    Robot,
    Scene,
    Sphere,
    load_robot,
    load_scene,
    pick,
    place,
    top_grasps,
)
from planner_service.certify import Certifier, ExemptInterval
from planner_service.collision import CollisionChecker
from planner_service.errors import InvalidRequest, UnknownName
from planner_service.execute import meant_contacts, taken
from planner_service.execute.preconditions import admitted
from planner_service.planning import AllowedStretch
from planner_service.planning.task_result import TaskResult
from planner_service.view.scene_nodes import AMBER, colours_of
from planner_service.view.still.composition import TOUCHING
from tests.support.optional import present
from tests.support.refusals import refused_pair
from tests.support.small_robots import joint, link, solid, urdf

URDF = urdf(
    "swing",
    link("base", solid("box", "0.1 0.1 0.1")) + link("arm", solid("box", "0.5 0.05 0.05", "0.3 0 0")) + link("flange"),
    joint("turn", "revolute base arm -3 3", xyz="0 0 0.1"),
    joint("end", "fixed arm flange", xyz="0.55 0 0"),
)
SRDF = """<robot name="swing">
  <disable_collisions link1="arm" link2="flange" reason="Adjacent"/>
  <disable_collisions link1="arm" link2="base" reason="Adjacent"/>
</robot>"""
ACROSS = np.array([[-1.0], [1.0]])


@pytest.fixture(scope="module")
def swing(tmp_path_factory: pytest.TempPathFactory) -> Robot:
    folder = tmp_path_factory.mktemp("swing")
    (folder / "r.urdf").write_text(URDF, "utf-8")
    (folder / "r.srdf").write_text(SRDF, "utf-8")
    return Robot.from_urdf(folder / "r.urdf", srdf=folder / "r.srdf", tool_frame="flange")


def wall(name: str) -> Obstacle:
    return Obstacle(name, Box((0.1, 0.1, 0.4)), Pose((0.4, 0.0, 0.1)))


@pytest.mark.parametrize(
    ("name", "label"),
    [
        ("wall", "wall"),
        ("flange", "flange (object)"),
        ("base", "base (object)"),
        ("arm", "arm (object)"),
        ("world", "world"),
        ("universe", "universe"),
    ],
)
def test_a_wall_is_a_wall_whatever_it_is_called(name: str, label: str, swing: Robot) -> None:
    arm = "arm (link)" if name == "arm" else "arm"
    for backend in ("fcl", "native"):
        checker = CollisionChecker(swing, Scene((wall(name),)), backend=backend)
        assert not checker.state_is_free([0.0])
        assert [(c.a, c.b) for c in checker.contacts([0.0])] == [(arm, label)]
        hit = present(checker.edge_hit(*ACROSS))
        assert (hit.a, hit.b) == (arm, label)
    refusal = refused_pair(Certifier(swing, Scene((wall(name),))).certify(ACROSS))
    assert {refusal.a, refusal.b} == {arm, label}
    result = PlannerService(swing, Scene((wall(name),))).plan(PlanRequest([-1.0], [1.0], max_checks=2_000))
    assert not result.ok
    assert f"{arm} x {label}" in str(result.failure)


def test_a_name_that_stands_for_both_is_refused_where_one_is_meant(swing: Robot) -> None:
    scene = Scene((wall("arm"),))
    service = PlannerService(swing, scene)
    pairs = (("base", "arm"),)
    expected = r"got 'arm'; expected 'arm \(link\)' or 'arm \(object\)'"
    with pytest.raises(InvalidRequest, match=expected):
        PlannerService(swing, scene, allowed=pairs)
    with pytest.raises(InvalidRequest, match=expected):
        Certifier(swing, scene, allowed=pairs)
    with pytest.raises(InvalidRequest, match=expected):
        service.certify(ACROSS, exempt=[ExemptInterval(0.0, 1.0, pairs, "")])
    with pytest.raises(InvalidRequest, match=expected):
        service.follow(ACROSS, contacts=[AllowedStretch(0, 1, pairs, "")])
    meant = (("arm (object)", "arm (link)"),)
    assert PlannerService(swing, scene, allowed=meant).checker.state_is_free([0.0])
    assert Certifier(swing, scene, allowed=meant).certify(ACROSS).certified
    assert service.follow(ACROSS, contacts=[AllowedStretch(0, 1, meant, "")]).ok


def test_names_nobody_has_are_refused_everywhere(swing: Robot) -> None:
    service = PlannerService(swing, Scene((wall("wall"),)))
    for pair in (("arm", "wal"), ("arm", "wall (object)"), ("arm (link)", "wall"), ("flange", "wall")):
        with pytest.raises(UnknownName):
            PlannerService(swing, service.scene, allowed=[pair])
        with pytest.raises(UnknownName):
            service.certify(ACROSS, exempt=[ExemptInterval(0.0, 0.5, (pair,), "")])
        with pytest.raises(UnknownName):
            service.follow(ACROSS, contacts=[AllowedStretch(0, 1, (pair,), "")])


@pytest.mark.parametrize("link", ["wall", "held", "nobody", "flange", "arm (link)"])
def test_touch_links_are_links_with_shapes_and_nothing_else(link: str, swing: Robot) -> None:
    scene = Scene((wall("wall"),), (Attached("held", Sphere(0.05), Pose(), (link,)),))
    with pytest.raises(UnknownName, match="unknown touch link"):
        CollisionChecker(swing, scene)
    with pytest.raises(UnknownName, match="unknown touch link"):
        Certifier(swing, scene)


def test_an_object_called_like_its_touch_link_is_not_that_link(swing: Robot) -> None:
    held = Attached("arm", Capsule(0.02, 0.2), Pose((0.0, 0.0, 0.0)), ("arm",))
    free = CollisionChecker(swing, Scene((), (held,)))
    assert free.state_is_free([0.0])
    blocked = CollisionChecker(swing, Scene((Obstacle("base", Sphere(0.05), Pose((0.55, 0.0, 0.2))),), (held,)))
    assert [(c.a, c.b) for c in blocked.contacts([0.0])] == [("arm (object)", "base (object)")]


def test_no_object_is_called_like_a_label() -> None:
    for name in ["wall (link)", "arm (object)", "a (link) (object)"]:
        for make in (Obstacle, Attached):
            with pytest.raises(InvalidRequest, match=r"does not end in ' \(link\)' or ' \(object\)'"):
                make(name, Sphere(0.1), Pose())


def test_a_link_that_is_called_like_a_label_has_one_of_its_own(tmp_path: Path) -> None:
    (tmp_path / "r.urdf").write_text(URDF.replace('"arm"', '"wall (object)"'), "utf-8")
    robot = Robot.from_urdf(tmp_path / "r.urdf")
    contacts = CollisionChecker(robot, Scene((wall("wall"),))).contacts([0.0])
    assert [(c.a, c.b) for c in contacts] == [("wall (object) (link)", "wall")]


def test_a_fixed_way_out_exempts_links_and_no_object_of_their_name() -> None:
    robot = load_robot("wxai")
    sleep, table = robot.pose("sleep"), load_scene("table")
    far = Obstacle("link_2", Box((0.05, 0.05, 0.05)), Pose((0.0, 0.6, 0.3)))
    result = PlannerService(robot, table.with_obstacle(far)).plan(PlanRequest(sleep, robot.home))
    assert result.ok
    assert result.exempt[0].pairs == (("link_2 (link)", "link_5"), ("link_2 (link)", "link_4"))
    at = Pose(tuple(np.array(robot.tool_pose(sleep))[:3, 3].tolist()))
    near = Obstacle("link_2", Box((0.4, 0.4, 0.02)), Pose((0.1, 0.0, at.position[2] + 0.2)))
    assert not PlannerService(robot, table.with_obstacle(near)).plan(PlanRequest(sleep, robot.home, max_checks=500)).ok


@pytest.fixture(scope="module")
def carried() -> TaskResult:
    """A block called like a finger is taken from a table called like a link."""
    scene = load_scene("bin")
    block, table = scene.obstacle("blue_block"), scene.obstacle("table")
    renamed = scene.without("blue_block").without("table")
    renamed = renamed.with_obstacle(Obstacle("finger_left", block.shape, block.pose))
    renamed = renamed.with_obstacle(Obstacle("link_4", table.shape, table.pose))
    service = PlannerService("wxai", renamed)
    grasps = top_grasps(service.robot, renamed.obstacle("finger_left"))
    return pick(service, service.robot.home, "finger_left", grasps, Handling(support="link_4"))


def test_a_block_called_like_a_finger_is_taken(carried: TaskResult) -> None:
    assert carried.ok, str(carried.failure)
    descend, lift = (segment.result for segment in carried.segments[1:])
    fingers = {"finger_left (link)", "finger_right"}
    assert descend.exempt[0].pairs == tuple((finger, "finger_left (object)") for finger in sorted(fingers))
    assert lift.exempt[0].pairs == (("finger_left (object)", "link_4 (object)"),)
    service = PlannerService.of(carried.world)
    held = service.scene.attached[0]
    pose = Pose.from_matrix(service.robot.tool_pose(carried.q)) @ held.pose
    there = Pose((pose.position[0], pose.position[1], pose.position[2] - 0.08), pose.quaternion)
    placed = place(service, carried.q, "finger_left", [there])
    assert placed.ok, str(placed.failure)


def test_the_executor_knows_fingers_from_what_they_take(carried: TaskResult) -> None:
    robot = load_robot("wxai")
    _, motions, _ = admitted(carried, robot, None, allowed=(), simulated=True, allow_unproven=False, squeeze=0.0)
    assert [motion.grips for motion in motions] == [False, True, False]
    assert taken(carried, robot) == ("finger_left",)
    assert frozenset(("finger_left (link)", "finger_left (object)")) in meant_contacts(carried)


def test_only_what_touches_is_painted(swing: Robot) -> None:
    colours = colours_of([("arm", "base (object)")], [("flange (object)", "arm")], swing)
    told = {(owner.kind.name, owner.name): colour for owner, colour in colours.items()}
    assert told == {
        ("LINK", "arm"): TOUCHING,
        ("OBJECT", "base"): TOUCHING,
        ("OBJECT", "flange"): AMBER,
    }
