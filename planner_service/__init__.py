"""Motion planning for a robot arm on a table, with every collision check counted.

::

    from planner_service import PlannerService, PlanRequest

    service = PlannerService("wxai", "table")
    result = service.plan(PlanRequest(start=service.robot.home, goal=[0.8, 1.3, 1.0, -0.8, 0.0, 0.0]))
    print(result.counts, result.trajectory.duration)
"""

import importlib.metadata

from planner_service.certify import (
    Certificate,
    Certifier,
    EdgeProof,
    EdgeVerdict,
    ExemptInterval,
    GripperMotion,
    Refusal,
)
from planner_service.collision import (
    Cancelled,
    CancelToken,
    CheckCounts,
    CollisionChecker,
    Contact,
    JointStep,
    Known,
    MotionStep,
)
from planner_service.errors import (
    BrokenInvariant,
    InvalidFile,
    InvalidRequest,
    MissingDependency,
    NotProven,
    PlannerServiceError,
    PlanningFailed,
    UnknownName,
)
from planner_service.geometry.composite import Compound, HeightField, PointCloud
from planner_service.geometry.mesh import Mesh
from planner_service.geometry.shapes import Box, Capsule, Cylinder, Pose, Sphere
from planner_service.grasping.grasps import top_grasps
from planner_service.kinematics.inverse import inverse_kinematics, straight_tool_line
from planner_service.kinematics.pose_goal import PoseGoal
from planner_service.optimize import Chomp, Optimise, TrajOpt
from planner_service.parallel import Processes, Ray, Sequential
from planner_service.path.joint_path import JointPath
from planner_service.path.trajectory import Trajectory
from planner_service.planners import (
    AORRTC,
    BFMT,
    BKPIECE1,
    FMT,
    KPIECE1,
    LBKPIECE1,
    PRM,
    RRT,
    BITstar,
    InformedRRTstar,
    LazyPRM,
    PRMstar,
    RRTConnect,
    RRTstar,
    SORRTstar,
)
from planner_service.planning.batch import Interrupted
from planner_service.planning.follow import AllowedStretch
from planner_service.planning.request import Pace, PlanRequest
from planner_service.planning.result import Failure, MotionReport, PlanResult, PolishReport, Reason, Stage, StageReport
from planner_service.planning.roadmap_work import RoadmapUpdate
from planner_service.replanning.result import Outcome, Replanned
from planner_service.roadmap import Roadmap, Verdict
from planner_service.robot.model import JointLimits, Robot, load_robot, robot_names
from planner_service.scene.scene import Attached, Obstacle, Scene, load_scene, save_scene, scene_names
from planner_service.search.trace import SearchGraph, Trace
from planner_service.service import PlannerService
from planner_service.tasks.primitives import move_linear, pick, place
from planner_service.tasks.result import Handling, Segment, TaskResult
from planner_service.tasks.seeds import best_of_seeds, plan_seeds
from planner_service.timing.laws import SCurve, ToppRa, Trapezoidal

__version__ = importlib.metadata.version("planner-service")

__all__ = [
    "AORRTC",
    "BFMT",
    "BKPIECE1",
    "FMT",
    "KPIECE1",
    "LBKPIECE1",
    "PRM",
    "RRT",
    "AllowedStretch",
    "Attached",
    "BITstar",
    "Box",
    "BrokenInvariant",
    "CancelToken",
    "Cancelled",
    "Capsule",
    "Certificate",
    "Certifier",
    "CheckCounts",
    "Chomp",
    "CollisionChecker",
    "Compound",
    "Contact",
    "Cylinder",
    "EdgeProof",
    "EdgeVerdict",
    "ExemptInterval",
    "Failure",
    "GripperMotion",
    "Handling",
    "HeightField",
    "InformedRRTstar",
    "Interrupted",
    "InvalidFile",
    "InvalidRequest",
    "JointLimits",
    "JointPath",
    "JointStep",
    "Known",
    "LazyPRM",
    "Mesh",
    "MissingDependency",
    "MotionReport",
    "MotionStep",
    "NotProven",
    "Obstacle",
    "Optimise",
    "Outcome",
    "PRMstar",
    "Pace",
    "PlanRequest",
    "PlanResult",
    "PlannerService",
    "PlannerServiceError",
    "PlanningFailed",
    "PointCloud",
    "PolishReport",
    "Pose",
    "PoseGoal",
    "Processes",
    "RRTConnect",
    "RRTstar",
    "Ray",
    "Reason",
    "Refusal",
    "Replanned",
    "Roadmap",
    "RoadmapUpdate",
    "Robot",
    "SCurve",
    "SORRTstar",
    "Scene",
    "SearchGraph",
    "Segment",
    "Sequential",
    "Sphere",
    "Stage",
    "StageReport",
    "TaskResult",
    "ToppRa",
    "Trace",
    "TrajOpt",
    "Trajectory",
    "Trapezoidal",
    "UnknownName",
    "Verdict",
    "best_of_seeds",
    "inverse_kinematics",
    "load_robot",
    "load_scene",
    "move_linear",
    "pick",
    "place",
    "plan_seeds",
    "robot_names",
    "save_scene",
    "scene_names",
    "straight_tool_line",
    "top_grasps",
]
