"""Motion planning for a robot arm on a table, with every collision check counted.

::

    from planner_service import PlannerService, PlanRequest

    service = PlannerService("wxai", "table")
    result = service.plan(PlanRequest(start=service.robot.home, goal=[0.8, 1.3, 1.0, -0.8, 0.0, 0.0]))
    print(result.counts, result.trajectory.duration)
"""

from typing import TYPE_CHECKING

import planner_service.concurrency.idle_threads  # before anything imports numpy
import planner_service.conveniences  # noqa: F401  provides what methods of values call
from planner_service.certify import (
    Certificate,
)
from planner_service.collision import (
    CancelToken,
    CheckCounts,
    CollisionChecker,
    JointStep,
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
from planner_service.kinematics.inverse import inverse_kinematics
from planner_service.kinematics.pose_goal import PoseGoal
from planner_service.optimize import Optimise
from planner_service.path.joint_path import JointPath
from planner_service.path.trajectory import Trajectory
from planner_service.planning.request import PlanRequest
from planner_service.planning.result import Failure, PlanResult, Reason, Stage, StageReport
from planner_service.roadmap import Roadmap
from planner_service.roadmap.planners import PRM, LazyPRM
from planner_service.robot.model import JointLimits, Robot, robot_names
from planner_service.robot_setup.loading import load_robot
from planner_service.scene.loading import load_scene, save_scene
from planner_service.scene.scene import Attached, Obstacle, Scene, scene_names
from planner_service.search.planners import RRT, BalancedRRTConnect, RRTConnect
from planner_service.service import PlannerService
from planner_service.timing.laws import SCurve, ToppRa, Trapezoidal

if TYPE_CHECKING:
    from planner_service.grasping.grasps import top_grasps
    from planner_service.planning.task_result import Handling, TaskResult
    from planner_service.tasks.primitives import pick, place
    from planner_service.tasks.tool_motions import move_linear

    __version__: str

__all__ = [
    "PRM",
    "RRT",
    "Attached",
    "BalancedRRTConnect",
    "Box",
    "BrokenInvariant",
    "CancelToken",
    "Capsule",
    "Certificate",
    "CheckCounts",
    "CollisionChecker",
    "Compound",
    "Cylinder",
    "Failure",
    "Handling",
    "HeightField",
    "InvalidFile",
    "InvalidRequest",
    "JointLimits",
    "JointPath",
    "JointStep",
    "LazyPRM",
    "Mesh",
    "MissingDependency",
    "MotionStep",
    "NotProven",
    "Obstacle",
    "Optimise",
    "PlanRequest",
    "PlanResult",
    "PlannerService",
    "PlannerServiceError",
    "PlanningFailed",
    "PointCloud",
    "Pose",
    "PoseGoal",
    "RRTConnect",
    "Reason",
    "Roadmap",
    "Robot",
    "SCurve",
    "Scene",
    "Sphere",
    "Stage",
    "StageReport",
    "TaskResult",
    "ToppRa",
    "Trajectory",
    "Trapezoidal",
    "UnknownName",
    "inverse_kinematics",
    "load_robot",
    "load_scene",
    "move_linear",
    "pick",
    "place",
    "robot_names",
    "save_scene",
    "scene_names",
    "top_grasps",
]


def __getattr__(name: str) -> object:
    """A name of what no plan needs, imported with its first use."""
    if name == "__version__":
        from planner_service.files.release import RELEASE

        return RELEASE
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from planner_service.grasping.grasps import top_grasps
    from planner_service.planning.task_result import Handling, TaskResult
    from planner_service.tasks.primitives import pick, place
    from planner_service.tasks.tool_motions import move_linear

    globals().update(Handling=Handling, TaskResult=TaskResult, top_grasps=top_grasps)
    globals().update(pick=pick, place=place, move_linear=move_linear)
    return globals()[name]


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
