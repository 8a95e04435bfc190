"""Tests of planner_service.concurrency."""
