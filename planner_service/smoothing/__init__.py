"""Shorter paths with rounded corners."""

from planner_service.smoothing.smoothing import shortcut

__all__ = ["shortcut"]
