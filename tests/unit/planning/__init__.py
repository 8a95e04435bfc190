"""Tests of planner_service.planning."""
