"""What the attacks draw from: the domain inside which the promises were tested, in numbers and in words."""

from __future__ import annotations

__all__ = ["DOMAIN", "JOINTS", "LENGTHS", "LONGEST", "OBSTACLES", "ROBOTS", "described"]

ROBOTS = ("wxai", "panda_mbm", "ur5", "planar2")
"""Robots that come with the package, beside drawn ones."""

JOINTS = (1, 8)
"""Joints that move in a drawn robot."""

LENGTHS = (0.01, 0.4)
"""Metres: edges, diameters and lengths of drawn solids."""

OBSTACLES = 12
"""In a drawn scene, at most."""

LONGEST = 12
"""Waypoints of a drawn polyline, at most."""

HISTORY = 12
"""Changes in the history of a roadmap, at most."""

GAPS = (1e-6, 0.05)
"""Metres between a curve and the obstacle that is pushed towards it."""

SPEEDS = (0.05, 1.0)
"""Parts of the joint velocity limits at which motions are timed."""

DOMAIN = {
    "robots": f"{', '.join(ROBOTS)}, and random trees of {JOINTS[0]} to {JOINTS[1]} moving joints (revolute, "
    "continuous, prismatic, and fixed ones between them) with up to two shapes a link",
    "solids": f"boxes, cylinders, spheres, capsules and convex meshes of 4 to 60 corners, {LENGTHS[0]:g} to "
    f"{LENGTHS[1]:g} m in each dimension",
    "scenes": f"up to {OBSTACLES} obstacles, at most 1 m from the base along each axis",
    "curves": f"polylines of 2 to {LONGEST} waypoints anywhere within the joint limits, rounded or not; gaps to the "
    f"nearest obstacle from {GAPS[0] * 1e6:g} um to {GAPS[1] * 1e3:g} mm",
    "constraints": "up to three on a curve or a part of it: ranges of joints, and regions for a frame on any link in "
    "that of any other, with bounds on coordinates, tilt and turn; tolerances from 0.1 mm and 1 mrad",
    "speeds": f"{SPEEDS[0]:g} to {SPEEDS[1]:g} of the joint velocity limits",
    "roadmaps": f"histories of up to {HISTORY} changes of the scene",
}


def described() -> str:
    """The domain as a list in Markdown."""
    return "".join(f"- **{key.capitalize()}**: {text}.\n" for key, text in DOMAIN.items())
