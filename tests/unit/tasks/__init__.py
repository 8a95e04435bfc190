"""Tests of planner_service.tasks."""
