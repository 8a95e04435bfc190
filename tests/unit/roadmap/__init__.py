"""Tests of planner_service.roadmap."""
