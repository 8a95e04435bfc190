"""Tests of planner_service.cell."""
