"""Tests of planner_service.scene."""
