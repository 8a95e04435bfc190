"""Tasks with a memory: what worked is tried first, nothing is believed, and what a cycle costs falls."""

from __future__ import annotations

from functools import lru_cache

import pytest

import planner_service as ps
from benchmarks.studies.cells.work import objections
from benchmarks.worlds.cells import Cell, cell
from planner_service.errors import InvalidRequest
from planner_service.geometry.arrays import FloatArray
from planner_service.memory import Memory
from planner_service.tasks import Task, pick_steps, place_steps

JOBS = 3


def task_of(number: int) -> Task:
    job = palletising().jobs[number]
    taking, leaving = ps.Handling(support=job.support), ps.Handling(support=job.onto)
    return Task((*pick_steps(job.name, None, taking), *place_steps(job.name, job.places, leaving)))


@lru_cache
def palletising() -> Cell:
    return cell("palletise", "wxai")


def facing(service: ps.PlannerService, number: int) -> ps.PlannerService:
    return service.with_scene(palletising().before(service.scene, palletising().jobs[number]))


def solved(service: ps.PlannerService, number: int, q: FloatArray, memory: Memory | None) -> ps.TaskResult:
    return service.solve(task_of(number), q, request=ps.PlanRequest(q, q, time_limit=None), memory=memory)


def pallet(memory: Memory | None) -> list[ps.TaskResult]:
    """The first jobs, one after the other, each with what is remembered after the one before."""
    service = ps.PlannerService("wxai", palletising().scene)
    q, done = service.robot.home, list[ps.TaskResult]()
    for number in range(JOBS):
        result = solved(facing(service, number), number, q, memory)
        assert result.ok, result.failure
        memory = None if memory is None else result.memory
        service, q = ps.PlannerService.of(result.world), result.q
        done.append(result)
    return done


@lru_cache
def pallets() -> tuple[list[ps.TaskResult], ...]:
    """One without a memory, one with an empty one, and one with what that learned."""
    first = pallet(Memory())
    return pallet(None), first, pallet(first[-1].memory)


def states(results: list[ps.TaskResult]) -> int:
    return sum(result.counts.states for result in results)


def motions(results: list[ps.TaskResult]) -> list[bytes]:
    return [segment.result.unwrap()[0].waypoints.tobytes() for result in results for segment in result.segments]


def test_a_second_pallet_takes_less_than_a_third_of_the_states_and_no_search() -> None:
    without, first, second = pallets()
    assert states(first) < states(without)
    assert 3 * states(second) < states(without)
    assert sum(segment.result.attempts for result in second for segment in result.segments) == 0


def test_what_is_remembered_is_proven_and_the_auditor_finds_nothing_touching() -> None:
    for results in pallets()[1:]:
        for result in results:
            assert objections("wxai", result) == []


def test_the_same_memory_and_task_give_the_same_motions_counts_and_memory() -> None:
    _, first, second = pallets()
    again = pallet(first[-1].memory)
    assert motions(again) == motions(second)
    assert [result.counts for result in again] == [result.counts for result in second]
    assert [result.memory.hash for result in again] == [result.memory.hash for result in second]


def test_a_task_remembers_its_motions_and_where_it_gripped() -> None:
    without, first, _ = pallets()
    assert len(first[0].memory.grips) == 2
    assert len(first[0].memory.motions) == 6
    assert without[0].memory.hash == first[0].memory.hash, "a first task learns without being given a memory"


def test_an_obstacle_on_a_remembered_way_is_gone_around_or_the_task_says_so() -> None:
    _, first, _ = pallets()
    service = ps.PlannerService("wxai", palletising().scene)
    transfer = next(segment for segment in first[0].segments if segment.name == "transfer").result.unwrap()[0]
    x, y, z = service.robot.tool_pose(transfer(transfer.length / 2))[:3, 3].tolist()
    post = ps.Obstacle("intruder", ps.Box((0.03, 0.03, 0.03)), ps.Pose((x, y, z)))
    changed = facing(service.with_scene(service.scene.with_obstacle(post)), 0)
    result = solved(changed, 0, service.robot.home, first[-1].memory)
    assert result.ok
    assert objections("wxai", result) == []
    assert motions([result]) != motions(first[:1])


def test_a_remembered_grip_does_not_bring_back_a_place_that_is_taken() -> None:
    _, first, _ = pallets()
    job = palletising().jobs[0]
    service = ps.PlannerService("wxai", palletising().scene)
    taken = ps.Obstacle("taken", job.shape, job.places[0])
    changed = facing(service.with_scene(service.scene.with_obstacle(taken)), 0)
    result = solved(changed, 0, service.robot.home, first[-1].memory)
    assert not result.ok
    assert "taken" in str(result.failure)


@pytest.mark.parametrize("wrong", ["joints", "kind"])
def test_a_memory_of_another_robot_is_refused(wrong: str) -> None:
    service = facing(ps.PlannerService("wxai", palletising().scene), 0)
    memory = Memory().with_motion([[0.0], [1.0]], ("other",)) if wrong == "joints" else 3
    with pytest.raises(InvalidRequest, match=r"^memory: got"):
        solved(service, 0, service.robot.home, memory)  # type: ignore[arg-type]


def test_forged_grips_and_motions_cost_proofs_and_no_contact() -> None:
    _, first, _ = pallets()
    known = first[-1].memory
    service = facing(ps.PlannerService("wxai", palletising().scene), 0)
    lifted = tuple(motion + 0.2 for motion in known.motions)
    forged = Memory(known.joint_names, lifted, tuple(replace_openings(grip) for grip in known.grips))
    result = solved(service, 0, service.robot.home, forged)
    assert result.ok
    assert objections("wxai", result) == []


def replace_openings(grip: FloatArray) -> FloatArray:
    out = grip.copy()
    out[-2:] = out[-2:][::-1]
    return out


def test_a_grasp_like_one_that_worked_is_tried_first() -> None:
    service = facing(ps.PlannerService("wxai", palletising().scene), 0)
    job, home = palletising().jobs[0], service.robot.home
    handling = ps.Handling(support=job.support)
    grasps = ps.top_grasps(service.robot, service.scene.obstacle(job.name))[:2]
    usual, other = (ps.pick(service, home, job.name, given, handling) for given in (grasps, grasps[1:]))
    assert usual.notes[0].startswith("way 1 of 2")
    again = ps.pick(service, home, job.name, grasps, handling, memory=other.memory)
    assert again.notes[0].startswith("way 2 of 2")
    assert motions([again]) == motions([other])
    assert again.counts.states < other.counts.states
