"""Tests of planner_service.path."""
