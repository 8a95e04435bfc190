"""Small roadmaps of every kind as they grow, answer, learn and hear of changes: the numbers of release 0.1.0."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import pytest

from benchmarks.worlds import queries
from planner_service import PRM, JointStep, LazyPRM, PlannerService, PlanRequest, PlanResult, Pose, Roadmap, Stage
from planner_service.planners import PRMstar
from planner_service.planning import RoadmapUpdate
from planner_service.roadmap import Verdict
from tests.support.pinned import pinned

PINNED = pinned("small_roadmaps")

GROWERS: dict[str, PRM | PRMstar | LazyPRM] = {
    "PRM": PRM(milestones=120, neighbours=6),
    "PRM*": PRMstar(milestones=80),
    "LazyPRM": LazyPRM(milestones=200, neighbours=8),
}
MOVES = {"bin": "demo_post", "post": "post_left", "discs": "lesson_disc"}
PLANAR = [((-2.5, 2.0), (2.2, -2.2)), ((2.2, -2.2), (0.5, 2.0)), ((-1.2, 0.4), (1.9, 0.6))]


def service_of(scene: str) -> PlannerService:
    return PlannerService("planar2" if scene == "discs" else "wxai", scene, edge_step=JointStep(0.05))


def requests(scene: str) -> list[PlanRequest]:
    ends = PLANAR if scene == "discs" else [(query.start, query.goal) for query in queries.load(scene)[:3]]
    return [PlanRequest(start, goal, time_limit=None) for start, goal in ends]


def moved(service: PlannerService, scene: str) -> PlannerService:
    pose = service.scene.obstacle(MOVES[scene]).pose
    x, y, z = pose.position
    return service.with_scene(service.scene.moved(MOVES[scene], Pose((x + 0.06, y + 0.03, z), pose.quaternion)))


def known(roadmap: Roadmap | None) -> str:
    if roadmap is None:
        return "no roadmap"
    counts = [roadmap.edge_knowledge.count(verdict) for verdict in Verdict]
    nodes = [roadmap.milestone_knowledge.count(verdict) for verdict in Verdict]
    return f"{len(roadmap.milestones)} milestones {nodes}, {len(roadmap.edges)} edges {counts}, {roadmap.hash[:12]}"


def answered(result: PlanResult) -> str:
    counts = result.stage(Stage.SEARCH).counts if any(r.stage is Stage.SEARCH for r in result.stages) else None
    asked = "not searched" if counts is None else f"{counts.states}/{counts.edges}/{counts.distances}"
    outcome = f"{result.path.length:.6g}" if result.path is not None else str(result.failure and result.failure.reason)
    return f"{outcome}, {asked}; {known(result.roadmap)}"


def updated(update: RoadmapUpdate) -> str:
    counts = update.counts
    told = f"kept {update.kept}, judged {update.judged}, fell {update.fell}, rose {update.rose}"
    return f"{told}, {counts.states}/{counts.edges}/{counts.distances}; {known(update.roadmap)}"


def answers(scene: str, kind: str) -> Iterator[tuple[str, str]]:
    """What is pinned of a roadmap of a scene."""
    service = service_of(scene)
    roadmap = service.build_roadmap(GROWERS[kind], seed=2, progress=False)
    assert roadmap.built is not None
    counts = roadmap.built.counts
    yield "grown", f"{counts.states}/{counts.edges}/{counts.distances}; {known(roadmap)}"
    roadmap = replace(roadmap, remember=True)
    for number, request in enumerate(requests(scene)):
        result = service.plan(replace(request, planner=roadmap))
        yield f"query {number}", answered(result)
        roadmap = result.roadmap or roadmap
    elsewhere = moved(service, scene)
    yield "moved", updated(elsewhere.update_roadmap(roadmap))
    result = elsewhere.plan(replace(requests(scene)[0], planner=roadmap))
    yield "query after the move", answered(result)
    back = service.update_roadmap(result.roadmap or roadmap)
    yield "moved back", updated(back)
    wider = service.plan(replace(requests(scene)[1], planner=back.roadmap, padding=0.004))
    yield "query with more padding", answered(wider)


CASES = [*((scene, kind) for scene in ("discs", "post") for kind in GROWERS), ("bin", "PRM")]


def lines_of(scene: str, kind: str) -> dict[str, str]:
    return {f"{kind} in {scene}, {name}": line for name, line in answers(scene, kind)}


def lines() -> dict[str, str]:
    """What is to be pinned."""
    return {name: line for case in CASES for name, line in lines_of(*case).items()}


@pytest.mark.slow
@pytest.mark.parametrize(("scene", "kind"), CASES)
def test_a_small_roadmap_grows_answers_and_learns_as_pinned(scene: str, kind: str) -> None:
    assert lines_of(scene, kind) == {
        name: line for name, line in PINNED.items() if name.startswith(f"{kind} in {scene},")
    }
