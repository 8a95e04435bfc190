"""Links and scene objects of one name are two things: each is judged, named and drawn as what it is."""

from __future__ import annotations

import numpy as np
import pytest

import planner_service as ps
from planner_service.certify import Certifier, ExemptInterval
from planner_service.collision import CollisionChecker
from planner_service.errors import InvalidRequest
from planner_service.planning import AllowedStretch
from planner_service.planning.task_result import TaskResult
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
def swing(tmp_path_factory: pytest.TempPathFactory) -> ps.Robot:
    folder = tmp_path_factory.mktemp("swing")
    (folder / "r.urdf").write_text(URDF, "utf-8")
    (folder / "r.srdf").write_text(SRDF, "utf-8")
    return ps.Robot.from_urdf(folder / "r.urdf", srdf=folder / "r.srdf", tool_frame="flange")


def wall(name: str) -> ps.Obstacle:
    return ps.Obstacle(name, ps.Box((0.1, 0.1, 0.4)), ps.Pose((0.4, 0.0, 0.1)))


@pytest.mark.parametrize(("name", "label"), [("wall", "wall"), ("arm", "arm (object)"), ("world", "world")])
def test_a_wall_is_a_wall_whatever_it_is_called(name: str, label: str, swing: ps.Robot) -> None:
    arm = "arm (link)" if name == "arm" else "arm"
    for backend in ("fcl", "native"):
        checker = CollisionChecker(swing, ps.Scene((wall(name),)), backend=backend)
        assert not checker.state_is_free([0.0])
        assert [(c.a, c.b) for c in checker.contacts([0.0])] == [(arm, label)]
        hit = present(checker.edge_hit(*ACROSS))
        assert (hit.a, hit.b) == (arm, label)
    refusal = refused_pair(Certifier(swing, ps.Scene((wall(name),))).certify(ACROSS))
    assert {refusal.a, refusal.b} == {arm, label}
    result = ps.PlannerService(swing, ps.Scene((wall(name),))).plan(ps.PlanRequest([-1.0], [1.0], max_checks=2_000))
    assert not result.ok
    assert f"{arm} x {label}" in str(result.failure)


def test_a_name_that_stands_for_both_is_refused_where_one_is_meant(swing: ps.Robot) -> None:
    scene = ps.Scene((wall("arm"),))
    service = ps.PlannerService(swing, scene)
    pairs = (("base", "arm"),)
    expected = r"got 'arm'; expected 'arm \(link\)' or 'arm \(object\)'"
    with pytest.raises(InvalidRequest, match=expected):
        ps.PlannerService(swing, scene, allowed=pairs)
    with pytest.raises(InvalidRequest, match=expected):
        Certifier(swing, scene, allowed=pairs)
    with pytest.raises(InvalidRequest, match=expected):
        service.certify(ACROSS, exempt=[ExemptInterval(0.0, 1.0, pairs, "")])
    with pytest.raises(InvalidRequest, match=expected):
        service.follow(ACROSS, contacts=[AllowedStretch(0, 1, pairs, "")])
    meant = (("arm (object)", "arm (link)"),)
    assert ps.PlannerService(swing, scene, allowed=meant).checker.state_is_free([0.0])
    assert Certifier(swing, scene, allowed=meant).certify(ACROSS).certified
    assert service.follow(ACROSS, contacts=[AllowedStretch(0, 1, meant, "")]).ok


@pytest.fixture(scope="module")
def carried() -> TaskResult:
    """A block called like a finger is taken from a table called like a link."""
    scene = ps.load_scene("bin")
    block, table = scene.obstacle("blue_block"), scene.obstacle("table")
    renamed = scene.without("blue_block").without("table")
    renamed = renamed.with_obstacle(ps.Obstacle("finger_left", block.shape, block.pose))
    renamed = renamed.with_obstacle(ps.Obstacle("link_4", table.shape, table.pose))
    service = ps.PlannerService("wxai", renamed)
    grasps = ps.top_grasps(service.robot, renamed.obstacle("finger_left"))
    return ps.pick(service, service.robot.home, "finger_left", grasps, ps.Handling(support="link_4"))


def test_a_block_called_like_a_finger_is_taken(carried: TaskResult) -> None:
    assert carried.ok, str(carried.failure)
    descend, lift = (segment.result for segment in carried.segments[1:])
    fingers = {"finger_left (link)", "finger_right"}
    assert descend.exempt[0].pairs == tuple((finger, "finger_left (object)") for finger in sorted(fingers))
    assert lift.exempt[0].pairs == (("finger_left (object)", "link_4 (object)"),)
    service = ps.PlannerService.of(carried.world)
    held = service.scene.attached[0]
    pose = ps.Pose.from_matrix(service.robot.tool_pose(carried.q)) @ held.pose
    there = ps.Pose((pose.position[0], pose.position[1], pose.position[2] - 0.08), pose.quaternion)
    placed = ps.place(service, carried.q, "finger_left", [there])
    assert placed.ok, str(placed.failure)
