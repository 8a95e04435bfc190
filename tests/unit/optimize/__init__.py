"""Tests of planner_service.optimize."""
