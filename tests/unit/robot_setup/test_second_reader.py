"""A URDF in which yourdfpy, which shares no code with our reader, sees another robot is not imported."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from xml.etree import ElementTree

import pytest

from planner_service.errors import InvalidFile
from planner_service.files.package_data import data_folder
from planner_service.geometry.shapes import Pose
from planner_service.robot.model import Robot
from planner_service.robot_setup.second_reader import compare_with_yourdfpy

ARM = data_folder("robots") / "planar2" / "planar2.urdf"
ROOT = ElementTree.parse(ARM).getroot()


def moved_body(robot: Robot) -> Robot:
    placement = robot.bodies[2].placement.copy()
    placement[0, 3] += 1e-3
    return replace(robot, bodies=(*robot.bodies[:2], replace(robot.bodies[2], placement=placement)))


def turned_axis(robot: Robot) -> Robot:
    return replace(robot, bodies=(*robot.bodies[:2], replace(robot.bodies[2], axis=-robot.bodies[2].axis)))


def moved_shape(robot: Robot) -> Robot:
    shape = robot.shapes[-1]
    x, y, z = shape.pose.position
    other = replace(shape, pose=Pose((x, y, z + 1e-3), shape.pose.quaternion))
    return replace(robot, shapes=(*robot.shapes[:-1], other))


def moved_tool(robot: Robot) -> Robot:
    placement = robot.tool_placement.copy()
    placement[1, 3] += 1e-3
    return replace(robot, tool_placement=placement)


def test_every_shape_and_the_tool_are_compared() -> None:
    robot = Robot.from_urdf(ARM)
    agreement = compare_with_yourdfpy(robot, ARM, ROOT, {})
    assert (agreement.frames, agreement.configurations) == (1 + len(robot.shapes), 16)
    assert agreement.difference < 1e-12


@pytest.mark.parametrize("fault", [moved_body, turned_axis, moved_shape, moved_tool])
def test_a_robot_read_wrongly_is_refused(fault: Callable[[Robot], Robot]) -> None:
    with pytest.raises(InvalidFile, match=r"yourdfpy, the second reader, puts '\w+' elsewhere, by "):
        compare_with_yourdfpy(fault(Robot.from_urdf(ARM)), ARM, ROOT, {})


def test_what_yourdfpy_cannot_read_is_refused() -> None:
    with pytest.raises(InvalidFile, match="cannot be read by yourdfpy, the second reader: "):
        compare_with_yourdfpy(Robot.from_urdf(ARM), ARM, ElementTree.fromstring("<robot name='a'><joint/></robot>"), {})
