"""Tests of planner_service.datasets."""
