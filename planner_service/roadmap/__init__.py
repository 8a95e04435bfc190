"""Roadmaps as values: built once, saved, asked, and told the truth when the scene changes."""

from planner_service.roadmap.knowledge import Verdict
from planner_service.roadmap.reference import RoadmapReference
from planner_service.roadmap.roadmap import Built, Roadmap
from planner_service.roadmap.terms import Terms

__all__ = ["Built", "Roadmap", "RoadmapReference", "Terms", "Verdict"]
