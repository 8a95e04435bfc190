"""Planning as tools for agents: a server of the Model Context Protocol, over standard input and output."""

from planner_service.mcp.motion import ArmMover, Mover, SimulatedMover
from planner_service.mcp.session import Session

__all__ = ["ArmMover", "Mover", "Session", "SimulatedMover"]
