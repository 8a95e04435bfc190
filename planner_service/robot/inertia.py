"""What joint torques depend on: the masses of links and loads, and the efforts that joints are rated for."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from planner_service.errors import InvalidRequest
from planner_service.geometry.arrays import FloatArray, as_sent, read_only, set_fields
from planner_service.geometry.shapes import Pose
from planner_service.geometry.validation import MAX_LENGTH, finite_tuple, number

__all__ = ["MAX_MASS", "Dynamics", "LinkInertia", "Payload", "symmetric", "tensor_numbers"]

Tensor = tuple[float, float, float, float, float, float]

MAX_MASS = 1e4
"""Kilograms: no arm carries ten tonnes, so a larger mass is a unit mistake."""

ROUNDING = 1e-6
"""How far a tensor may be from one that a body can have, as a share of its trace."""


@dataclass(frozen=True)
class LinkInertia:
    """The mass (kg) of URDF link ``link``, or of a load.

    ``tensor`` is ixx, ixy, ixz, iyy, iyz, izz (kg m^2) about the centre of mass; ``pose`` is T_body_centre, in whose
    axes it is given.
    """

    link: str
    body: int
    mass: float
    tensor: Tensor
    pose: Pose


@dataclass(frozen=True, eq=False)
class Dynamics:
    """The masses of a robot and the rated effort of its joints.

    Attributes:
        effort: Largest torque of each joint (Nm; N of a prismatic one), shape (n,); 0 where the URDF has none.
        links: The links with a mass. Fingers are where they are with the gripper closed; their common centre of mass
            does not move as they open.
    """

    effort: FloatArray
    links: tuple[LinkInertia, ...]
    __setstate__ = as_sent

    def __post_init__(self) -> None:
        set_fields(self, effort=read_only(self.effort), links=tuple(self.links))


@dataclass(frozen=True)
class Payload:
    """What a robot carries, by its mass alone.

    Attributes:
        mass: Kilograms.
        com: Centre of mass in the tool frame, metres.
        inertia: ixx, ixy, ixz, iyy, iyz, izz about the centre of mass, along the tool frame's axes (kg m^2).

    Raises:
        InvalidRequest: A value is not finite or out of range, or no body has such an inertia.
    """

    mass: float
    com: tuple[float, float, float] = (0.0, 0.0, 0.0)
    inertia: Tensor = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        mass = number("mass", self.mass, f"kilograms in [0, {MAX_MASS:g}]", 0.0, MAX_MASS)
        com, inertia = finite_tuple("com", self.com, 3), finite_tuple("inertia", self.inertia, 6)
        if max(map(abs, com)) > MAX_LENGTH:
            raise InvalidRequest("com", com, f"metres, at most {MAX_LENGTH:g} along each axis")
        tensor = symmetric(inertia)
        trace = float(tensor[0, 0] + tensor[1, 1] + tensor[2, 2])
        second = np.eye(3) * (trace / 2.0) - tensor  # the integrals of x_j x_k, none negative along any axis
        if not float(np.linalg.eigvalsh(second).min()) >= -ROUNDING * abs(trace):
            expected = "ixx, ixy, ixz, iyy, iyz, izz of a body: no principal moment above the sum of the other two"
            raise InvalidRequest("inertia", inertia, expected)
        set_fields(self, mass=mass, com=com, inertia=inertia)


def symmetric(tensor: Sequence[float]) -> FloatArray:
    """ixx, ixy, ixz, iyy, iyz, izz as a matrix (3, 3)."""
    xx, xy, xz, yy, yz, zz = tensor
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def tensor_numbers(matrix: FloatArray) -> Tensor:
    """ixx, ixy, ixz, iyy, iyz, izz of a matrix (3, 3)."""
    (xx, xy, xz), (_, yy, yz), (_, _, zz) = matrix.tolist()
    return (xx, xy, xz, yy, yz, zz)
