"""Small roadmaps of every kind as they grow, answer, learn and hear of changes: the numbers of release 0.1.0."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from benchmarks.worlds import queries
from planner_service import PRM, JointStep, LazyPRM, PlannerService, PlanRequest, PlanResult, Pose, Roadmap, Stage
from planner_service.planners import PRMstar
from planner_service.planning import RoadmapUpdate
from planner_service.roadmap import Verdict

FILE = Path(__file__).parents[2] / "golden" / "small_roadmaps.txt"
"""What is pinned; ``python -m tests.unit.roadmap.test_reference_roadmaps`` writes it anew, if a change is meant."""

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


def rows(scene: str, kind: str) -> Iterator[str]:
    """What is pinned of a roadmap of a scene."""
    service = service_of(scene)
    roadmap = service.build_roadmap(GROWERS[kind], seed=2, progress=False)
    assert roadmap.built is not None
    counts = roadmap.built.counts
    yield f"grown: {counts.states}/{counts.edges}/{counts.distances}; {known(roadmap)}"
    roadmap = replace(roadmap, remember=True)
    for request in requests(scene):
        result = service.plan(replace(request, planner=roadmap))
        yield f"asked: {answered(result)}"
        roadmap = result.roadmap or roadmap
    elsewhere = moved(service, scene)
    yield f"moved: {updated(elsewhere.update_roadmap(roadmap))}"
    result = elsewhere.plan(replace(requests(scene)[0], planner=roadmap))
    yield f"asked after the move: {answered(result)}"
    back = service.update_roadmap(result.roadmap or roadmap)
    yield f"moved back: {updated(back)}"
    wider = service.plan(replace(requests(scene)[1], planner=back.roadmap, padding=0.004))
    yield f"asked with more padding: {answered(wider)}"


CASES = [*((scene, kind) for scene in ("discs", "post") for kind in GROWERS), ("bin", "PRM")]


def pinned() -> dict[str, list[str]]:
    blocks = FILE.read_text("utf-8").strip("\n").split("\n\n")
    return {head: lines for head, *lines in (block.split("\n") for block in blocks if block)}


@pytest.mark.parametrize(("scene", "kind"), CASES)
def test_a_small_roadmap_grows_answers_and_learns_as_pinned(scene: str, kind: str) -> None:
    assert list(rows(scene, kind)) == pinned()[f"{scene}, {kind}"]


if __name__ == "__main__":
    FILE.write_text("\n".join("\n".join([f"{s}, {k}", *rows(s, k), ""]) for s, k in CASES), "utf-8")
