"""Tests of planner_service.search."""
