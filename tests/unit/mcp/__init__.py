"""Tests of planner_service.mcp."""
