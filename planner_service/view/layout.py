"""How the page is laid out on screens of all sizes, and where it is seen from."""

from __future__ import annotations

from typing import Any

import numpy as np

from planner_service.geometry.arrays import FloatArray
from planner_service.view.state import ViewState
from planner_service.view.triangles import GROUND, placements, robot_solids, scene_solids

__all__ = ["extent", "fit_window", "set_up"]

NARROW = 576
"""Pixels of a window's width up to which viser shows the panel as a sheet at the bottom."""

PHONE, PANEL = 480, 360
"""Pixels: a scene that is no wider is on a phone; beside any other, the panel is so wide."""

STYLE = f"""<style>
@media (max-width: {NARROW}px) {{
  div[style*="width: 20em"] {{ width: 100% !important; }}
  div[style*="max-height: 60%"] {{ max-height: 52% !important; }}
  .timeline {{ --curve: 24px; }}
}}
</style>"""
"""viser's sheet on a phone is 20 em wide, whatever the screen, and covers more than half of it."""

LOOKS_FROM = (1.1, -1.0, 0.7)
"""From the middle of robot and scene, in their sizes."""

UPRIGHT, SHEET = 1.9, 0.7
"""On a phone: how much farther the camera is away, and by how much of their size it looks below their middle, as the
sheet covers the lower part of the screen."""


def set_up(server: Any, state: ViewState) -> None:
    """Theme, lights, the panel's place, and the first camera."""
    gui, scene = server.gui, server.scene
    gui.configure_theme(control_width="large", show_logo=False, show_share_button=False)
    gui.main_panel.dock_right()
    gui.add_html(STYLE)
    scene.configure_environment_map(None)  # the default is fetched from another server
    scene.configure_default_lights(True, cast_shadow=False)
    scene.add_light_hemisphere("/light", sky_color=(255, 255, 255), ground_color=(170, 170, 175), intensity=2.6)
    camera = server.initial_camera
    middle, size = extent(state)
    camera.up, camera.fov = (0.0, 0.0, 1.0), 0.75
    camera.position = tuple(middle + size * np.array(LOOKS_FROM))
    camera.look_at = tuple(middle)


def fit_window(client: Any, state: ViewState) -> None:
    """Leave to the scene what the panel does not need, and see all of it on a phone that is held upright."""
    camera = client.camera
    width, height = camera.image_width, camera.image_height
    if width > PHONE:
        client.gui.main_panel.set_width(PANEL)
    if 0 < width <= PHONE and width < height:
        middle, size = extent(state)
        below = np.array([0.0, 0.0, -SHEET * size])
        camera.position = tuple(middle + below + UPRIGHT * size * np.array(LOOKS_FROM))
        camera.look_at = tuple(middle + below)


def extent(state: ViewState) -> tuple[FloatArray, float]:
    """The centre of robot and obstacles, the ground left out, and their size (the diagonal), in metres."""
    robot = state.service.robot
    frames = placements(robot, state.q)
    corners = [
        solid.vertices @ frames[solid.frame][:3, :3].T + frames[solid.frame][:3, 3]
        for solid in robot_solids(robot)
        if solid.frame is not None
    ]
    standing = [solid for solid in scene_solids(state.service.scene) if solid.frame is None]
    corners += [solid.vertices for solid in standing if solid.colour != GROUND]
    low = np.min([points.min(axis=0) for points in corners], axis=0)
    high = np.max([points.max(axis=0) for points in corners], axis=0)
    return np.asarray((low + high) / 2.0), max(float(np.sqrt(((high - low) ** 2).sum())), 0.3)
