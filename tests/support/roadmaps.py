"""What a roadmap claims, and whether a fresh checker agrees."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache

from planner_service import CollisionChecker, JointStep, PlannerService, Roadmap
from planner_service.roadmap import Verdict
from tests.support.optional import present

__all__ = ["cell", "checker_of", "lies"]

FREE, BLOCKED = Verdict.FREE, Verdict.BLOCKED


@cache
def cell(scene: str = "bin") -> PlannerService:
    """An arm in a scene, with steps so coarse that roadmaps grow quickly."""
    return PlannerService("wxai", scene, edge_step=JointStep(0.05))


def checker_of(roadmap: Roadmap, service: PlannerService) -> CollisionChecker:
    """A checker of its own that judges on the roadmap's terms."""
    padding = present(roadmap.terms).padding
    return CollisionChecker(service.robot, service.scene, edge_step=service.checker.edge_step, padding=padding)


def _claims(roadmap: Roadmap, checker: CollisionChecker) -> Iterator[tuple[str, bool, bool]]:
    """What a roadmap says of its milestones and edges, and what a checker says."""
    for k, verdict in enumerate(roadmap.milestone_knowledge.verdicts.tolist()):
        if verdict in (FREE, BLOCKED):
            yield f"milestone {k}", verdict == FREE, checker.state_is_free(roadmap.milestones[k])
    for k, verdict in enumerate(roadmap.verdicts.tolist()):
        if verdict in (FREE, BLOCKED):
            a, b = roadmap.milestones[roadmap.edges[k]]
            yield f"edge {k}", verdict == FREE, checker.edge_is_free(a, b)


def lies(roadmap: Roadmap | None, service: PlannerService) -> list[tuple[str, bool]]:
    """Verdicts that a fresh checker does not share, and whether they are of the service's scene at all."""
    known = present(roadmap)
    if present(known.terms).scene_hash != service.scene.hash:
        return [("the scene", True)]
    told = _claims(known, checker_of(known, service))
    return [(what, claimed) for what, claimed, found in told if claimed != found]
