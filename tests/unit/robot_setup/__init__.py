"""Tests of planner_service.robot_setup."""
