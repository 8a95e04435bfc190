"""Tests of planner_service.client."""
