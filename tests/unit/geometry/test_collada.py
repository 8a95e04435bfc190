"""COLLADA files give the faces that their scene shows, where Coal sees them, or a reason why not."""

from __future__ import annotations

from pathlib import Path

import coal
import numpy as np
import pytest

from planner_service.files.xml_reader import Malformed
from planner_service.geometry.collada import dae_surface

CORNERS = [[0.0, 0.0, 0.0], [0.0, 0.0, 0.3], [0.0, 0.2, 0.0], [0.1, 0.0, 0.0]]
"""What the tetrahedron of ``document`` has; its fifth point is in no face."""

FACES = (
    '<triangles count="4"><input semantic="NORMAL" source="#s" offset="0"/>'
    '<input semantic="VERTEX" source="#v" offset="1"/>'
    "<p>4 0 4 2 4 1 4 0 4 1 4 3 4 0 4 3 4 2 4 1 4 2 4 3</p></triangles>"
)
GEOMETRY = '<instance_geometry url="#g"/>'
ROUNDING = 1e-6
"""Metres; Coal's reader has single precision."""


def document(
    nodes: str = f"<node>{GEOMETRY}</node>", *, asset: str = "", faces: str = FACES, library: str = "", mesh: str = ""
) -> str:
    return f"""<?xml version="1.0" encoding="utf-8"?>
<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1"><asset>{asset}</asset>
<library_geometries><geometry id="g"><mesh><source id="s">
<float_array id="a" count="15">0 0 0 0.1 0 0 0 0.2 0 0 0 0.3 9 9 9</float_array>
<technique_common><accessor source="#a" count="5" stride="3"><param name="X" type="float"/>
<param name="Y" type="float"/><param name="Z" type="float"/></accessor></technique_common></source>
<vertices id="v"><input semantic="POSITION" source="#s"/></vertices>{faces}{mesh}</mesh></geometry></library_geometries>
{library}<library_visual_scenes><visual_scene id="vs">{nodes}</visual_scene></library_visual_scenes>
<scene><instance_visual_scene url="#vs"/></scene></COLLADA>"""


def corners(text: str) -> list[list[float]]:
    found: list[list[float]] = np.unique(dae_surface(text.encode())[0], axis=0).tolist()
    return found


def test_the_vertices_are_those_that_a_face_uses() -> None:
    assert corners(document()) == CORNERS


PLACED = {
    "translate, then rotate": f"<node><translate>1 2 3</translate><rotate>0 0 1 90</rotate>{GEOMETRY}</node>",
    "a matrix": f"<node><matrix>0 -1 0 1 1 0 0 2 0 0 1 3 0 0 0 1</matrix>{GEOMETRY}</node>",
    "scale below a turn": f"<node><rotate>1 0 0 40</rotate><node><scale>2 3 0.5</scale>{GEOMETRY}</node></node>",
    "twice": f"<node>{GEOMETRY}</node><node><translate>1 0 0</translate>{GEOMETRY}</node>",
    "an instance of a node": '<node><translate>1 2 3</translate><instance_node url="#n"/></node>',
}


@pytest.mark.parametrize("nodes", PLACED.values(), ids=PLACED)
@pytest.mark.parametrize("up", ["X_UP", "Y_UP"])
def test_a_mesh_stands_where_coal_reads_it(tmp_path: Path, nodes: str, up: str) -> None:
    library = f'<library_nodes><node id="n"><scale>2 2 2</scale>{GEOMETRY}</node></library_nodes>'
    text = document(nodes, asset=f'<unit name="meter" meter="1"/><up_axis>{up}</up_axis>', library=library)
    (tmp_path / "part.dae").write_text(text)
    seen = np.unique(coal.MeshLoader().load(str(tmp_path / "part.dae"), np.ones(3)).vertices(), axis=0)
    own = np.array(corners(text))
    apart = np.sqrt(((own[:, None] - seen[None]) ** 2).sum(axis=-1))
    assert max(apart.min(axis=0).max(), apart.min(axis=1).max()) < ROUNDING


INPUT = '<input semantic="VERTEX" source="#v" offset="0"/>'
WRITTEN = [
    (f'<triangles count="1">{INPUT}<p>1 2 3</p></triangles>', [(1, 2, 3)]),
    (
        f'<polylist count="3">{INPUT}<vcount>4 3 5</vcount><p>0 1 2 3 3 2 1 0 1 2 3 1</p></polylist>',
        [(0, 1, 2), (0, 2, 3), (3, 2, 1), (0, 1, 2), (0, 2, 3), (0, 3, 1)],
    ),
    (f'<polygons count="2">{INPUT}<p>0 1 2 3</p><p>3 2 1</p></polygons>', [(0, 1, 2), (0, 2, 3), (3, 2, 1)]),
    (
        f'<tristrips count="2">{INPUT}<p>0 1 2 3 0</p><p>3 2 1</p></tristrips>',
        [(0, 1, 2), (2, 1, 3), (2, 3, 0), (3, 2, 1)],
    ),
    (f'<trifans count="1">{INPUT}<p>0 1 2 3</p></trifans>', [(0, 1, 2), (0, 2, 3)]),
    (f'<lines count="1">{INPUT}<p>2 3 1 0</p></lines>', []),
]


@pytest.mark.parametrize(("faces", "expected"), WRITTEN)
def test_polygons_strips_and_fans_become_triangles(faces: str, expected: list[tuple[int, int, int]]) -> None:
    vertices, triangles = dae_surface(document(faces=faces).encode())
    positions = np.array([[0.0, 0.0, 0.0], [0.1, 0.0, 0.0], [0.0, 0.2, 0.0], [0.0, 0.0, 0.3]])
    assert vertices[triangles()].tolist() == positions[np.array(expected, dtype=int).reshape(-1, 3)].tolist()


@pytest.mark.parametrize("sizes", ["2 3", "-1 6"])
def test_a_polygon_of_fewer_than_three_corners_is_refused(sizes: str) -> None:
    faces = f'<polylist count="2">{INPUT}<vcount>{sizes}</vcount><p>0 1 2 3 0</p></polylist>'
    _, triangles = dae_surface(document(faces=faces).encode())
    with pytest.raises(Malformed, match="expected three or more"):
        triangles()


REFUSED = [
    (
        document(library='<library_animations><animation><channel target="a/b"/></animation></library_animations>'),
        "an animation moves 'a/b'",
    ),
    (document(f"<node><skew>1 2 3 4 5 6 7</skew>{GEOMETRY}</node>"), "<skew> in a node"),
    (document(f"<node><matrix>1 0 0 0 0 1 0 0 0 0 1 0 0 0 1 1</matrix>{GEOMETRY}</node>"), "last row is not 0 0 0 1"),
    (document(f"<node><rotate>0 0 2 90</rotate>{GEOMETRY}</node>"), "a rotation about 0 0 2; expected"),
    (document('<node><instance_geometry url="b.dae#g"/></node>'), "'b.dae#g' is no <geometry>"),
    (document(faces=FACES.replace("</triangles>", "<ph/></triangles>")), "or with holes"),
    (document(faces=FACES.replace("4 3</p>", "4 5</p>")), "vertices that do not exist"),
    (document(faces=FACES.replace('"4"', '"5"')), "12 corners; expected 15"),
    (document().replace('count="5"', 'count="6"'), "6 positions X, Y, Z every 3 of 15"),
    (document().replace("9 9 9", "9 9 x"), "'x' is not a number"),
    (
        document('<node><instance_node url="#n"/></node>', library='<node id="n"/><node id="n"/>'),
        "<node> with the id 'n' twice",
    ),
    (document().replace("<scene>", "<scenes>").replace("</scene>", "</scenes>"), "with 0 <scene>"),
]


@pytest.mark.parametrize(("text", "reason"), REFUSED)
def test_what_is_not_understood_is_refused(text: str, reason: str) -> None:
    with pytest.raises(Malformed, match=reason):
        dae_surface(text.encode())


def test_nodes_that_multiply_end() -> None:
    twice = [2 * f'<instance_node url="#n{k + 1}"/>' for k in range(40)]
    nodes = "".join(f'<node id="n{k}">{below}</node>' for k, below in enumerate(twice))
    library = f'<library_nodes>{nodes}<node id="n40"/></library_nodes>'
    with pytest.raises(Malformed, match="more than 10,000"):
        dae_surface(document('<node><instance_node url="#n0"/></node>', library=library).encode())
