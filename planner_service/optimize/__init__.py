"""Trajectory optimisation: short, smooth curves that keep their distance, in two families behind one ``Method``.

Nothing here says that a curve is free: distances suggest, the checker and the certificate decide.
"""

from planner_service.optimize.chomp import Chomp
from planner_service.optimize.method import Found, Method
from planner_service.optimize.problem import Figures
from planner_service.optimize.qp_step import load_solver
from planner_service.optimize.settings import FEW_CORNERS, METHODS, MOST_CLEARANCE, Optimise, Optimum
from planner_service.optimize.trajopt import TrajOpt

__all__ = [
    "FEW_CORNERS",
    "METHODS",
    "MOST_CLEARANCE",
    "Chomp",
    "Figures",
    "Found",
    "Method",
    "Optimise",
    "Optimum",
    "TrajOpt",
    "load_solver",
]
