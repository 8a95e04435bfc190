"""Tests of planner_service.execute."""
