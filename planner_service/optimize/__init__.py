"""Trajectory optimisation: short, smooth curves that keep their distance, by TrajOpt or CHOMP.

The result need not be free: the collision checker and the certificate decide that afterwards.
"""

from planner_service.optimize.chomp import Chomp
from planner_service.optimize.problem import Figures, Method, MethodResult
from planner_service.optimize.qp_step import load_solver
from planner_service.optimize.settings import FEW_CORNERS, MAX_CLEARANCE, METHODS, Optimise, Optimum
from planner_service.optimize.trajopt import TrajOpt

__all__ = [
    "FEW_CORNERS",
    "MAX_CLEARANCE",
    "METHODS",
    "Chomp",
    "Figures",
    "Method",
    "MethodResult",
    "Optimise",
    "Optimum",
    "TrajOpt",
    "load_solver",
]
