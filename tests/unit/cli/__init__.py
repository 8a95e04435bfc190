"""Tests of planner_service.cli."""
