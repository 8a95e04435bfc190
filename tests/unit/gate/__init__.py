"""Tests of planner_service.gate."""
