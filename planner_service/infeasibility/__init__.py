"""Answers where there is no plan: proofs that there is no path, and changes that give one."""

from planner_service.decomposition.no_path import NoPath, prove_no_path
from planner_service.infeasibility.reached import Reached
from planner_service.infeasibility.remedies import Explanation, Remedy

__all__ = ["Explanation", "NoPath", "Reached", "Remedy", "prove_no_path"]
