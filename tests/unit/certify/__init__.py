"""Tests of planner_service.certify."""
