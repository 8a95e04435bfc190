"""Roadmaps as values: built once, saved, queried, and kept true when the scene changes."""

from planner_service.roadmap.reference import RoadmapReference
from planner_service.roadmap.roadmap import Built, Roadmap
from planner_service.roadmap.verdicts import Terms, Verdict

__all__ = ["Built", "Roadmap", "RoadmapReference", "Terms", "Verdict"]
