"""Tests of planner_service.replanning."""
