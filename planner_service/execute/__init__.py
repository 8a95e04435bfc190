"""Executes plans on an arm through a driver, and compares the measured motion with the plan; and the simulated arm.

``execute`` is here and not in ``planner_service`` itself, where a function of that name would hide this package.
"""

from planner_service.execute.driver import ArmLimits, Driver, DriverGroup
from planner_service.execute.gated_arm import GatedArm
from planner_service.execute.preconditions import Executable
from planner_service.execute.report import ExecutedMotion, ExecutionReport, ExecutionStopped, Recording
from planner_service.execute.settings import HARDWARE_SPEED, Streaming
from planner_service.execute.simulate import Rehearsal, meant_contacts, rehearse, taken
from planner_service.execute.simulator import ArmContact, SimulatedArm
from planner_service.execute.stream import execute
from planner_service.execute.target_stream import TargetStream
from planner_service.execute.trossen import TrossenDriver

__all__ = [
    "HARDWARE_SPEED",
    "ArmContact",
    "ArmLimits",
    "Driver",
    "DriverGroup",
    "Executable",
    "ExecutedMotion",
    "ExecutionReport",
    "ExecutionStopped",
    "GatedArm",
    "Recording",
    "Rehearsal",
    "SimulatedArm",
    "Streaming",
    "TargetStream",
    "TrossenDriver",
    "execute",
    "meant_contacts",
    "rehearse",
    "taken",
]
