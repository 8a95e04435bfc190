"""Tests of planner_service.files."""
