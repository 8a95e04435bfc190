"""Tests of planner_service.view."""
