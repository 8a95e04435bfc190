"""Tests of planner_service.kinematics."""
