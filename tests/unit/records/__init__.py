"""Tests of planner_service.records."""
