"""Picks and places as visits: what is carried changes what may follow, and every order is free."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

import planner_service as ps
from planner_service.records import load_task
from planner_service.records.recertify import recertify
from planner_service.tasks import Handling
from planner_service.tasks.ordering import Move, order_moves

SIZE = 0.03
ON_TABLE = 0.011 + SIZE / 2


def block(name: str, x: float, y: float) -> ps.Obstacle:
    return ps.Obstacle(name, ps.Box((SIZE, SIZE, SIZE)), ps.Pose((x, y, ON_TABLE)))


@pytest.fixture(scope="module")
def service() -> ps.PlannerService:
    table = ps.Obstacle("table", ps.Box((0.5, 0.9, 0.02)), ps.Pose((0.35, 0.0, 0.0)))
    return ps.PlannerService("wxai", ps.Scene((table, *(block(f"b{k}", 0.2 + 0.08 * k, 0.15) for k in range(3)))))


def move(k: int, **given: Any) -> Move:
    there = ps.Pose((0.36 - 0.08 * k, -0.15, ON_TABLE))
    return Move(f"b{k}", [there], handling=Handling(support="table"), onto="table", **given)


def request(service: ps.PlannerService) -> ps.PlanRequest:
    return ps.PlanRequest(service.robot.home, service.robot.home, time_limit=None)


def test_each_pick_is_followed_by_its_place_and_all_is_proven_again_from_its_file(
    service: ps.PlannerService, tmp_path: Path
) -> None:
    found = order_moves(service, [move(k) for k in range(3)], request(service), grasps=3)
    assert found.ok
    assert found.gap <= 0.05
    for one, two in zip(found.order[::2], found.order[1::2], strict=True):
        assert (one[:4], two[:5], one[4:]) == ("pick", "place", two[5:])
    carried = [segment.result.origin.world.scene.attached for segment in found.task.segments if segment.result.origin]
    assert [len(held) for held in carried] == [0, 0, 1, 1, 1, 0] * 3 + [0]
    assert set(found.task.world.scene.names) == set(service.scene.names)
    for k in range(3):
        assert found.task.world.scene.obstacle(f"b{k}").pose.position[1] == pytest.approx(-0.15)
    found.task.save(tmp_path / "order.json")
    again = recertify(load_task(tmp_path / "order.json"))
    assert again.problems == ()
    assert again.certified
    assert len(load_task(tmp_path / "order.json").segments) == 19


def test_what_must_be_placed_before_is_placed_before_and_out_of_the_way(service: ps.PlannerService) -> None:
    where = service.scene.obstacle("b2").pose  # b0 goes where b2 stands: only once that has gone
    swap = Move("b0", [where], handling=Handling(support="table"), onto="table", after=["b2"])
    found = order_moves(service, [swap, move(1), move(2)], request(service), grasps=2)
    assert found.order.index("place b2") < found.order.index("pick b0")
    with pytest.raises(ps.PlanningFailed, match="b0: no way of picking it"):
        order_moves(service, [replace(swap, after=()), move(1), move(2)], request(service), grasps=2)


def test_an_object_that_arrives_in_its_turn_is_in_no_motion_before(service: ps.PlannerService) -> None:
    there = [ps.Pose((0.3, -0.25, ON_TABLE))]
    coming = Move(block("new", 0.3, 0.25), there, handling=Handling(support="table"), onto="table")
    found = order_moves(service, [coming, move(1)], request(service), grasps=2)
    assert found.ok
    assert found.task.world.scene.obstacle("new").pose.position[1] == pytest.approx(-0.25)
    begun = next(k for k, segment in enumerate(found.task.segments) if segment.name == "to pick new")
    assert all(s.scene is not None and "new" not in s.scene.names for s in found.task.segments[:begun])


def test_an_object_that_cannot_be_placed_is_named(service: ps.PlannerService) -> None:
    far = Move("b1", [ps.Pose((3.0, 0.0, ON_TABLE))], handling=Handling(support="table"), onto="table")
    with pytest.raises(ps.PlanningFailed, match="b1: no way of picking it"):
        order_moves(service, [far], request(service), grasps=1)


@pytest.mark.parametrize(
    ("moves", "match"),
    [
        ([], "at least one"),
        ([move(0), move(0)], "each object once"),
        ([move(0, after=["b9"])], "b9"),
        ([move(0, after=["b1"]), move(1, after=["b0"])], "wait for each other"),
        ([Move("nothing", [ps.Pose()])], "nothing"),
        ("b0", "a list of Move"),
    ],
)
def test_moves_that_make_no_sense_are_refused(service: ps.PlannerService, moves: Any, match: str) -> None:
    with pytest.raises(ps.PlannerServiceError, match=match):
        order_moves(service, moves, request(service))


@pytest.mark.parametrize(
    ("given", "match"),
    [({"object": 3}, "object"), ({"poses": []}, "poses"), ({"poses": [1]}, "poses"), ({"onto": 1}, "onto")],
)
def test_a_move_is_of_an_object_to_poses(given: dict[str, Any], match: str) -> None:
    with pytest.raises(ps.InvalidRequest, match=match):
        Move(**{"object": "b0", "poses": [ps.Pose()], **given})
