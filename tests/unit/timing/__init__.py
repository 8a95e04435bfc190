"""Tests of planner_service.timing."""
