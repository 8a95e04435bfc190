"""Tests of planner_service.smoothing."""
