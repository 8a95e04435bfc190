"""Tests of planner_service.parallel."""
