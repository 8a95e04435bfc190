"""Draws a depth image as a camera would take it of a robot and a crate, for the guide on depth cameras.

It writes depth.npz (depth in metres, K, T_base_camera, q) and truth.toml: what really stands there.

Run: python examples/11_depth_image.py
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planner_service import Box, Cylinder, Obstacle, Pose, Robot, Scene, load_robot, save_scene
from planner_service.view.triangles import placements

FloatArray = NDArray[np.float64]

WIDTH, HEIGHT, FOCAL = 160, 120, 110.0
EYE, LOOKS_AT = (1.05, 0.0, 0.75), (0.25, 0.0, 0.05)
Q = (0.9, 1.5, 1.1, -0.6, 0.0, 0.0)
NOISE, NEARLY, FARTHEST = 0.001, 0.001, 3.0
"""Metres."""

TRUTH = Scene(
    (
        Obstacle("table", Box((1.4, 1.4, 0.1)), Pose((0.0, 0.0, -0.051))),
        Obstacle("crate", Box((0.06, 0.20, 0.24)), Pose((0.47, 0.0, 0.12))),
        Obstacle("post", Cylinder(0.03, 0.12), Pose((0.36, 0.0, 0.06))),  # hidden from the camera by the crate
    ),
    name="truth",
)


def main() -> None:
    """Draw the image and write both files."""
    K = np.array([[FOCAL, 0.0, (WIDTH - 1) / 2], [0.0, FOCAL, (HEIGHT - 1) / 2], [0.0, 0.0, 1.0]])
    T_base_camera = looking(np.array(EYE), np.array(LOOKS_AT))
    depth = depth_image(load_robot("wxai"), TRUTH, K, T_base_camera)
    np.savez("depth.npz", depth=depth, K=K, T_base_camera=T_base_camera, q=np.array(Q))
    save_scene(TRUTH, "truth.toml")


def looking(eye: FloatArray, at: FloatArray) -> FloatArray:
    """The pose of a camera: x to the right, y downwards, z ahead."""
    ahead = (at - eye) / np.linalg.norm(at - eye)
    right = np.cross(ahead, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    T = np.eye(4)
    T[:3, :3] = np.column_stack([right, np.cross(ahead, right), ahead])
    T[:3, 3] = eye
    return T


def depth_image(robot: Robot, scene: Scene, K: FloatArray, T_base_camera: FloatArray) -> FloatArray:
    """Metres ahead for each pixel, 0 for nothing: along each ray, steps as long as the way to the nearest surface."""
    links = placements(robot, Q)
    solids = [(item.shape, links[item.link] @ item.pose.matrix) for item in robot.shapes]
    surfaces = [*solids, *((obstacle.shape, obstacle.pose.matrix) for obstacle in scene.obstacles)]
    row, column = np.mgrid[:HEIGHT, :WIDTH]
    rays = np.stack([(column - K[0, 2]) / K[0, 0], (row - K[1, 2]) / K[1, 1], np.ones(row.shape)], axis=-1)
    directions = rays.reshape(-1, 3) @ T_base_camera[:3, :3].T
    depth, gap = np.zeros(len(directions)), np.full(len(directions), np.inf)
    for _ in range(60):
        points = directions * depth[:, None] + T_base_camera[:3, 3]
        gap = np.min([shape.distance((points - T[:3, 3]) @ T[:3, :3]) for shape, T in surfaces], axis=0)
        depth += np.maximum(gap, 0.0) / np.linalg.norm(directions, axis=1)
    depth += np.random.default_rng(0).normal(0.0, NOISE, len(depth))
    depth[(gap > NEARLY) | (depth > FARTHEST)] = 0.0
    return depth.reshape(HEIGHT, WIDTH)


if __name__ == "__main__":
    main()
