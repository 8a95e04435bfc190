"""Planners, the problem they search, and what a search reports."""

from planner_service.search.trace import SearchGraph, Trace

__all__ = ["SearchGraph", "Trace"]
