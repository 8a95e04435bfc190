"""Planners, the problem they search, and what a search reports."""
