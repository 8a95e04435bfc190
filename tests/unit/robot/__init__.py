"""Tests of planner_service.robot."""
