"""Tests of planner_service.memory."""
