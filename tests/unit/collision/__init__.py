"""Tests of planner_service.collision."""
