"""Where a robot's tool can be: reachability maps with proofs, and where to put the robot."""

from planner_service.workspace.grid import VoxelGrid
from planner_service.workspace.map_file import load_map, save_map
from planner_service.workspace.mapping import prove_again, reachability
from planner_service.workspace.orientation import ToolOrientation
from planner_service.workspace.placement import BasePlacement, BaseRegion, PlacedBase, place_base, seen_from
from planner_service.workspace.reachability_map import ReachabilityMap, VoxelVerdict

__all__ = [
    "BasePlacement",
    "BaseRegion",
    "PlacedBase",
    "ReachabilityMap",
    "ToolOrientation",
    "VoxelGrid",
    "VoxelVerdict",
    "load_map",
    "place_base",
    "prove_again",
    "reachability",
    "save_map",
    "seen_from",
]
