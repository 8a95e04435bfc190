"""Orders of visits of the planar arm among discs, against all orders, and what is refused."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise, permutations, product
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import planner_service as ps
from planner_service.geometry.arrays import FloatArray
from planner_service.parallel import Processes
from planner_service.records import load_task
from planner_service.tasks import Segment
from planner_service.tasks.ordering import Branch, Visit, order

START = [0.0, 0.0]


@pytest.fixture(scope="module")
def service() -> ps.PlannerService:
    return ps.PlannerService("planar2", "discs")


def request(**given: Any) -> ps.PlanRequest:
    return ps.PlanRequest(START, START, time_limit=None, max_checks=100_000, **given)


def free(service: ps.PlannerService, count: int, seed: int = 0) -> list[FloatArray]:
    """Free configurations."""
    rng = np.random.default_rng(seed)
    found: list[FloatArray] = []
    while len(found) < count:
        q = rng.uniform(-3.0, 3.0, 2)
        if service.checker.variant(padding=0.01).state_is_free(q):
            found.append(q)
    return found


def visits(service: ps.PlannerService, count: int, branches: int = 2, seed: int = 0) -> list[Visit]:
    Q = np.array(free(service, count * branches, seed)).reshape(count, branches, 2)
    return [Visit(f"v{k}", rows) for k, rows in enumerate(Q)]


def q_of(visit: Visit, number: int) -> FloatArray:
    branch = visit.ways[number]
    assert isinstance(branch, Branch)
    return branch.q


def tool_pose(robot: ps.Robot, q: FloatArray) -> ps.Pose:
    return ps.Pose.from_matrix(robot.tool_pose(q))


def seconds(service: ps.PlannerService, one: FloatArray, two: FloatArray) -> float:
    result = service.plan(replace(request(), start=one, goal=two))
    return math.inf if result.trajectory is None else result.trajectory.duration


@pytest.mark.parametrize("seed", range(3))
def test_with_no_gap_the_order_is_the_best_of_all_planned_orders(service: ps.PlannerService, seed: int) -> None:
    asked = visits(service, 4, seed=seed)
    found = order(service, asked, request(), gap=0.0)
    Q = [np.array(START), *(q_of(visit, k) for visit in asked for k in range(2))]
    table = np.array([[seconds(service, one, two) for two in Q] for one in Q])
    best = math.inf
    for jobs in permutations(range(4)):
        for chosen in product(range(2), repeat=4):
            stops = [0, *(1 + 2 * job + chosen[job] for job in jobs), 0]
            best = min(best, sum(table[one, two] for one, two in pairwise(stops)))
    assert found.duration == pytest.approx(best, rel=1e-9)
    assert found.floor <= found.bound <= found.duration
    assert found.bound == pytest.approx(best, rel=0.05)
    assert found.plans < 72, "legs that cannot help are not planned"


def test_every_motion_is_proven_and_joins_the_one_before(service: ps.PlannerService, tmp_path: Path) -> None:
    asked = visits(service, 8, seed=5)
    found = order(service, asked, request())
    assert found.ok
    assert sorted(found.order) == sorted(visit.name for visit in asked)
    results = [segment.result for segment in found.task.segments]
    assert all(result.certificate is not None and result.certificate.certified for result in results)
    assert found.duration == pytest.approx(found.task.duration, rel=1e-12)
    ends = [START, *(q_of(asked[int(stop.name[1:])], stop.branch).tolist() for stop in found.stops), START]
    for result, one, two in zip(results, ends, ends[1:], strict=False):
        path = result.unwrap()[0].waypoints
        assert path[0].tolist() == one
        assert path[-1].tolist() == two
    assert found.gap >= 0.0
    assert found.floor_gap >= found.gap
    found.task.save(tmp_path / "order.json")
    loaded = load_task(tmp_path / "order.json")
    assert [s.name for s in loaded.segments] == [s.name for s in found.task.segments]
    assert found.counts == found.task.counts


def test_no_bound_of_a_leg_is_above_its_planned_time(service: ps.PlannerService) -> None:
    for seed in range(4):
        found = order(service, visits(service, 5, seed=seed), request(seed=seed), gap=0.0)
        assert found.floor <= found.bound * (1.0 + 1e-12)
        assert found.bound <= found.duration
        assert 0.0 <= found.gap <= found.floor_gap


def test_equal_calls_have_equal_results_whatever_the_engine(service: ps.PlannerService) -> None:
    asked = visits(service, 5, seed=8)
    one = order(service, asked, request())
    two = order(service, asked, request(), engine=Processes(2))
    assert [s.result.unwrap()[0].waypoints.tobytes() for s in one.task.segments] == [
        s.result.unwrap()[0].waypoints.tobytes() for s in two.task.segments
    ]
    assert (one.order, one.bound, one.floor, one.plans) == (two.order, two.bound, two.floor, two.plans)
    assert one.deterministic


def test_what_must_come_before_comes_before(service: ps.PlannerService) -> None:
    plain = visits(service, 6, seed=3)
    usual = order(service, plain, request()).order
    last, first = usual[0], usual[-1]
    asked = [replace(visit, after=(first,)) if visit.name == last else visit for visit in plain]
    found = order(service, asked, request())
    assert found.order.index(first) < found.order.index(last)


def test_a_visit_that_must_follow_follows_at_once(service: ps.PlannerService) -> None:
    Q = free(service, 12, 4)
    asked = [Visit(f"pick{k}", Q[k : k + 1], then=Visit(f"place{k}", Q[6 + k : 7 + k])) for k in range(6)]
    found = order(service, asked, request())
    assert len(found.order) == 12
    for one, two in zip(found.order[::2], found.order[1::2], strict=True):
        assert (one[:4], two[:5], one[4:]) == ("pick", "place", two[5:])


def test_the_arm_ends_where_it_is_told(service: ps.PlannerService) -> None:
    end = free(service, 1, 9)[0]
    found = order(service, visits(service, 3), request(), end=end)
    assert found.task.q.tolist() == end.tolist()
    assert found.task.segments[-1].result.unwrap()[0].waypoints[-1].tolist() == end.tolist()


def test_motions_of_a_branch_are_made_and_count(service: ps.PlannerService) -> None:
    one, two, three = free(service, 3, 2)
    there = service.plan(replace(request(), start=one, goal=two))
    branch = Branch(one, motions=(Segment("work", there, 0.0, service.scene),))
    found = order(service, [Visit("line", [branch]), Visit("point", [three])], request())
    assert branch.end.tolist() == two.tolist()
    assert "line: work" in [segment.name for segment in found.task.segments]
    assert found.duration == pytest.approx(sum(s.result.unwrap()[1].duration for s in found.task.segments))


def test_branches_follow_one_another_only_with_the_same_load(service: ps.PlannerService) -> None:
    held = ps.Attached("held", ps.Sphere(0.01), ps.Pose(), touch_links=("forearm",))
    carrying = service.with_scene(service.scene.with_attached(held))
    one, two, three, four = free(service, 4, 6)
    pick = [Branch(np.array(START)), Branch(two), Branch(one, after=carrying)]
    place = [Branch(three, before=carrying), Branch(four, before=carrying)]
    found = order(service, [Visit("pick", pick, then=Visit("place", place))], request())
    assert found.stops[0].branch == 2
    leg = found.stops[1].leg
    assert leg.origin is not None
    assert leg.origin.world.scene == carrying.scene


def test_poses_stand_for_their_configurations() -> None:
    service = ps.PlannerService("ur5", "empty")
    robot = service.robot
    rng = np.random.default_rng(0)
    poses = [tool_pose(robot, robot.home + rng.uniform(-0.4, 0.4, 6)) for _ in range(4)]
    asked = ps.PlanRequest(robot.home, robot.home, time_limit=None)
    found = order(service, [Visit(f"hole {k}", pose) for k, pose in enumerate(poses)], asked)
    assert found.ok
    assert found.gap <= 0.05
    for stop in found.stops:
        reached = tool_pose(robot, stop.leg.unwrap()[0].waypoints[-1])
        assert reached.position == pytest.approx(poses[int(stop.name[5:])].position, abs=1e-6)


def test_a_visit_without_a_free_branch_is_named_with_what_it_touches(service: ps.PlannerService) -> None:
    blocked = np.array([math.atan2(0.6, 1.1), 0.0])  # through the lesson's disc
    found = order(service, [Visit("open", free(service, 1)), Visit("shut", [blocked])], request())
    assert not found.ok
    assert found.failure is not None
    assert found.plans == 0
    assert [each.partition(":")[0] for each in found.refused] == ["shut [0]"]
    assert "shut" in found.failure.detail
    assert "lesson_disc" in found.failure.detail
    assert (found.gap, found.duration) == (math.inf, math.inf)
    assert "no order" in str(found)


def test_a_visit_out_of_reach_is_named(service: ps.PlannerService) -> None:
    wxai = ps.PlannerService("wxai", "empty")
    asked = ps.PlanRequest(wxai.robot.home, wxai.robot.home)
    found = order(wxai, [Visit("far", ps.Pose((5.0, 0.0, 0.0)))], asked)
    assert found.failure is not None
    assert found.failure.reason is ps.Reason.NO_IK_SOLUTION
    assert "far" in found.failure.detail


def test_legs_without_a_plan_are_named_and_avoided(service: ps.PlannerService) -> None:
    few = replace(request(), max_checks=1, planner=ps.RRT())
    found = order(service, visits(service, 6, 3, seed=1), few, gap=0.0, plans=400)
    assert found.failed
    assert all(leg.why for leg in found.failed)
    assert "->" in str(found.failed[0])
    if found.ok:
        used = {stop.name for stop in found.stops}
        assert len(used) == 6
    else:
        assert found.failure is not None
        assert "no order was found" in found.failure.detail


def test_it_stops_after_so_many_plans(service: ps.PlannerService) -> None:
    asked = visits(service, 8, 3, seed=2)
    few = order(service, asked, request(), gap=0.0, plans=1)
    more = order(service, asked, request(), gap=0.0, plans=500)
    assert few.plans < more.plans <= 500
    assert more.duration <= few.duration


@pytest.mark.parametrize("plans", [17, 48])
def test_an_order_that_was_planned_in_full_is_kept_whatever_the_plans_are_spent_on(
    service: ps.PlannerService, plans: int
) -> None:
    """The first order takes 17 plans; what the others are spent on is not complete, and none of it may replace it."""
    found = order(service, visits(service, 16, 3, seed=2), request(), gap=0.0, plans=plans)
    assert found.ok
    assert len(found.stops) == 16
    assert found.bound <= found.duration < math.inf


def test_a_start_that_touches_in_one_scene_closes_no_leg_that_is_planned_in_another(service: ps.PlannerService) -> None:
    one, far, end = free(service, 3, 0)
    near = one + np.array([0.4, 0.0])
    ball = ps.Obstacle("ball", ps.Sphere(0.02), ps.Pose(tool_pose(service.robot, one).position))
    shut = service.with_scene(service.scene.with_obstacle(ball))
    assert not shut.checker.state_is_free(one)
    assert shut.checker.state_is_free(near)
    second = Visit("second", [Branch(near, before=shut), Branch(far)], after=["first"])
    found = order(service, [Visit("first", [one]), second], request(), end=end, gap=0.0)
    assert [leg.goal for leg in found.failed] == [("second", 0)], "the nearer of both is planned first"
    assert found.order == ("first", "second")
    assert found.stops[1].branch == 1


def test_a_call_that_was_cancelled_plans_nothing(service: ps.PlannerService) -> None:
    cancel = ps.CancelToken()
    cancel.cancel()
    with pytest.raises(ps.PlannerServiceError, match="cancelled"):
        order(service, visits(service, 3), request(), cancel=cancel)


@pytest.mark.parametrize(
    ("asked", "match"),
    [
        ([], "at least one Visit"),
        ("visits", "a list of Visit"),
        ([Visit("a", [START]), Visit("a", [START])], "each name once"),
        ([Visit("a", [START], after=["a"])], "do not wait for each other"),
        ([Visit("a", [START], after=["b"]), Visit("b", [START], after=["a"])], "do not wait for each other"),
        ([Visit("a", [START], after=["c"])], "unknown visit 'c'"),
        ([Visit("a", [[0.0, 0.0, 0.0]])], "a \\[0\\]"),
        ([Visit("a", [[9.0, 0.0]])], "a \\[0\\]"),
    ],
)
def test_visits_that_make_no_sense_are_refused(service: ps.PlannerService, asked: Any, match: str) -> None:
    with pytest.raises(ps.PlannerServiceError, match=match):
        order(service, asked, request())


@pytest.mark.parametrize(
    ("given", "match"),
    [({"gap": -0.1}, "gap"), ({"gap": math.nan}, "gap"), ({"plans": 0}, "plans"), ({"end": 3}, "end")],
)
def test_settings_out_of_range_are_refused(service: ps.PlannerService, given: dict[str, Any], match: str) -> None:
    with pytest.raises(ps.InvalidRequest, match=match):
        order(service, visits(service, 2), request(), **given)


@pytest.mark.parametrize("branches", [[], [None], 3, [[]], [[math.inf, 0.0]], {"a": 1}, [[START]]])
def test_branches_are_configurations(branches: Any) -> None:
    with pytest.raises(ps.InvalidRequest, match="branches"):
        Visit("a", branches)


def test_a_visit_keeps_its_branches_as_they_were_given() -> None:
    given = [np.array([0.5, 0.0])]
    visit = Visit("here", given)
    given[0][0] = 1.0
    assert [branch.q.tolist() for branch in visit.ways if isinstance(branch, Branch)] == [[0.5, 0.0]]
    assert visit.branches is visit.ways


def test_motions_of_a_branch_begin_and_end_where_it_does(service: ps.PlannerService) -> None:
    one, two, three = free(service, 3, 2)
    motions = [Segment("work", service.plan(replace(request(), start=one, goal=two)), 0.0)]
    with pytest.raises(ps.InvalidRequest, match="where the motions begin"):
        Branch(three, motions=tuple(motions))
    with pytest.raises(ps.InvalidRequest, match="where the motions end"):
        Branch(one, three, tuple(motions))
