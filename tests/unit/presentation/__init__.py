"""Tests of planner_service.presentation."""
