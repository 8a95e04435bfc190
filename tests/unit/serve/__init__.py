"""Tests of planner_service.serve."""
