"""Tests of planner_service.scheduling."""
