"""Mass properties of solids: those of other shapes that fill the same space."""

from __future__ import annotations

import numpy as np
import pytest

from planner_service.errors import InvalidRequest
from planner_service.geometry.composite import Compound, HeightField, PointCloud, Solid
from planner_service.geometry.mass_properties import mass_properties
from planner_service.geometry.mesh import Mesh
from planner_service.geometry.shapes import Box, Capsule, Cylinder, Pose, Sphere

BOX = Box((0.2, 0.3, 0.4))
CORNERS = np.array([[x, y, z] for x in (-0.1, 0.1) for y in (-0.15, 0.15) for z in (-0.2, 0.2)])
TURNED = Pose((0.3, -0.2, 0.1), (0.5, 0.5, 0.5, 0.5))  # x to y, y to z, z to x


@pytest.mark.parametrize(
    ("solid", "centre"),
    [
        (Mesh(CORNERS + np.array([1.0, 2.0, 3.0])), (1.0, 2.0, 3.0)),
        (
            Compound(((Box((0.2, 0.3, 0.1)), Pose((0.0, 0.0, -0.15))), (Box((0.2, 0.3, 0.3)), Pose((0.0, 0.0, 0.05))))),
            (0.0,) * 3,
        ),
        (Compound(((Box((0.3, 0.4, 0.2)), TURNED),)), (0.3, -0.2, 0.1)),
        (HeightField(np.full((2, 3), 0.4), 0.1), (0.1, 0.15, 0.2)),
        (
            PointCloud.from_cells([[x, y, z] for x in range(2) for y in range(3) for z in range(4)], 0.1),
            (0.1, 0.15, 0.2),
        ),
    ],
)
def test_what_fills_a_box_has_its_mass_properties(solid: Solid, centre: tuple[float, ...]) -> None:
    found, expected = mass_properties(solid), mass_properties(BOX)
    assert found.volume == pytest.approx(0.024, rel=1e-12)
    assert found.centre == pytest.approx(np.array(centre), abs=1e-12)
    assert found.tensor == pytest.approx(expected.tensor, rel=1e-9, abs=1e-15)
    assert expected.tensor[0, 0] == pytest.approx(0.024 * (0.09 + 0.16) / 12.0)


@pytest.mark.parametrize("solid", [Sphere(0.1), Cylinder(0.1, 0.3), Capsule(0.1, 0.3)])
def test_round_solids_have_the_mass_properties_of_their_points(solid: Solid) -> None:
    steps = np.arange(-99.5, 100.0) / 100.0 * 0.26
    x, y, z = (axis.ravel() for axis in np.meshgrid(steps, steps, steps))
    inside = solid.distance(np.stack([x, y, z], axis=1)) == 0.0
    x, y, z, cell = x[inside], y[inside], z[inside], (0.52 / 200.0) ** 3
    volume, centre, tensor = mass_properties(solid)
    assert volume == pytest.approx(len(x) * cell, rel=2e-2)
    assert centre.tolist() == [0.0, 0.0, 0.0]
    moments = (float((y * y + z * z).sum()) * cell, float((x * x + y * y).sum()) * cell)
    assert (tensor[0, 0], tensor[2, 2]) == pytest.approx(moments, rel=2e-2)
    assert tensor[0, 0] == tensor[1, 1]


def test_a_shape_of_the_callers_own_has_no_mass_properties() -> None:
    with pytest.raises(InvalidRequest, match="shape: got"):
        mass_properties(object())  # type: ignore[arg-type]
