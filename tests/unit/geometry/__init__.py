"""Tests of planner_service.geometry."""
