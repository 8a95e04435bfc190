"""Proofs that there is no path: cells of configuration space in which the robot collides wherever it is."""

from planner_service.infeasibility.no_path import NoPath, prove_no_path

__all__ = ["NoPath", "prove_no_path"]
