"""Convex pieces contain the mesh that they replace, whatever the cuts and whoever wrote them to the cache."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from itertools import product
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pytest

from planner_service.errors import InvalidFile, InvalidRequest
from planner_service.files.disk_cache import DiskCache
from planner_service.geometry import decomposition
from planner_service.geometry.arrays import FloatArray, IntArray
from planner_service.geometry.decomposition import hull_ratio, pieces_of_file
from planner_service.geometry.mesh import Mesh
from planner_service.geometry.mesh_formats import read_triangles
from planner_service.geometry.plane_cuts import DIRECTIONS, Cut, CutPlan, parts_of, plan_cuts

OUTLINE = ((0, 0), (10, 0), (10, 2), (2, 2), (2, 8), (10, 8), (10, 10), (0, 10))
CAP = ((0, 1, 2), (0, 2, 3), (0, 3, 4), (0, 4, 7), (4, 5, 6), (4, 6, 7))
ARMS = (((0, 0, 0), (10, 2, 5)), ((0, 2, 0), (2, 8, 5)), ((0, 8, 0), (10, 10, 5)))
"""A letter C, 10 x 10 x 5 cm, two thirds of whose hull are not filled, and the three boxes that make it up."""


def letter() -> tuple[FloatArray, IntArray]:
    vertices = np.array([(x, y, z) for z in (0, 5) for x, y in OUTLINE]) / 100.0
    sides = [f for k in range(8) for f in ((k, (k + 1) % 8, (k + 1) % 8 + 8), (k, (k + 1) % 8 + 8, k + 8))]
    caps = [f for a, b, c in CAP for f in ((a, c, b), (a + 8, b + 8, c + 8))]
    return vertices, np.array(sides + caps, dtype=np.intp)


def box(low: Sequence[float], high: Sequence[float]) -> list[list[float]]:
    return [[x / 100.0, y / 100.0, z / 100.0] for x, y, z in product(*zip(low, high, strict=True))]


def write_obj(path: Path, vertices: FloatArray, faces: IntArray) -> Path:
    rows = [f"v {x!r} {y!r} {z!r}" for x, y, z in vertices.tolist()]
    path.write_text("\n".join(rows + [f"f {a + 1} {b + 1} {c + 1}" for a, b, c in faces.tolist()]))
    return path


def convex_pieces(vertices: FloatArray, faces: IntArray, **settings: Any) -> tuple[Mesh, ...]:
    """The pieces of a mesh, by way of a file, which keeps every bit."""
    with TemporaryDirectory() as folder:
        return pieces_of_file(write_obj(Path(folder, "mesh.obj"), vertices, faces), **settings)


LETTER = letter()
PLAN = plan_cuts(*LETTER, 16)
HULL = Mesh(LETTER[0])


def on_surface(vertices: FloatArray, faces: IntArray, count: int = 1000) -> FloatArray:
    """Random points on the triangles."""
    rng = np.random.default_rng(1)
    weights = rng.dirichlet((1, 1, 1), count)
    return np.asarray((vertices[faces[rng.integers(len(faces), size=count)]] * weights[..., None]).sum(axis=1))


def in_letter(count: int = 1000) -> FloatArray:
    points = np.random.default_rng(2).uniform((0, 0, 0), (10, 10, 5), (count, 3))
    inside = [((points >= low) & (points <= high)).all(axis=1) for low, high in ARMS]
    return np.asarray(points[np.any(inside, axis=0)] / 100.0)


def depth(pieces: Sequence[Mesh], points: FloatArray) -> float:
    """How far the farthest point is from all pieces."""
    return float(np.min([piece.distance(points) for piece in pieces], axis=0).max())


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("PLANNER_SERVICE_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache"


@pytest.fixture
def planned(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """The numbers of pieces for which cuts are worked out, one after another."""
    asked: list[int] = []

    def plan(vertices: FloatArray, faces: IntArray, most: int) -> CutPlan:
        asked.append(most)
        return PLAN

    monkeypatch.setattr(decomposition, "plan_cuts", plan)
    return asked


def test_a_letter_becomes_three_pieces_that_fill_little_else() -> None:
    pieces = convex_pieces(*LETTER)
    assert len(pieces) == 3
    assert depth(pieces, on_surface(*LETTER)) < 1e-12
    assert depth(pieces, in_letter()) < 1e-12
    volumes = [hull_ratio(HULL, *LETTER) / hull_ratio(HULL, piece.vertices, piece.faces) for piece in pieces]
    assert sum(volumes) == pytest.approx(1.0, abs=0.04)


def test_what_is_between_the_arms_stays_free() -> None:
    pieces = convex_pieces(*LETTER)
    assert min(float(piece.distance(np.array([[0.06, 0.05, 0.025]])).min()) for piece in pieces) > 0.02


def ball() -> tuple[FloatArray, IntArray]:
    points = np.random.default_rng(4).normal(size=(80, 3))
    mesh = Mesh(0.1 * points / np.sqrt((points * points).sum(axis=1))[:, None])
    return mesh.vertices, mesh.faces


def in_ball(count: int = 1000) -> FloatArray:
    vertices, _faces = ball()
    points, mesh = np.random.default_rng(5).uniform(-0.1, 0.1, (count, 3)), Mesh(vertices)
    return np.asarray(points[mesh.distance(points) == 0.0])


def any_plan(rng: np.random.Generator, middle: FloatArray) -> CutPlan:
    """Cuts near the middle of a mesh, so that cells have corners inside it."""
    count = int(rng.integers(1, 12))
    cuts = []
    for k in range(count):
        direction = int(rng.integers(9))
        height = float(DIRECTIONS[direction] @ middle) + float(rng.uniform(-0.04, 0.04))
        cuts.append(Cut(int(rng.integers(k + 1)), direction, height))
    return CutPlan(tuple(cuts), tuple((k,) for k in range(count + 1)))


@pytest.mark.parametrize(("solid", "inside"), [(ball, in_ball), (letter, in_letter)])
def test_no_cuts_leave_anything_out(
    solid: Callable[[], tuple[FloatArray, IntArray]], inside: Callable[[], FloatArray]
) -> None:
    vertices, faces = solid()
    rng, points = np.random.default_rng(6), np.concatenate([on_surface(vertices, faces), inside()])
    for _ in range(12):
        parts = parts_of(vertices, faces, any_plan(rng, 0.5 * (vertices.min(axis=0) + vertices.max(axis=0))))
        pieces = [Mesh(part) for part in parts if len(part) > 3 and np.ptp(part, axis=0).min() > 1e-6]
        assert depth(pieces, points) < 1e-9


def test_a_cell_that_no_triangle_reaches_is_filled() -> None:
    """Six planes cut a small box out of the middle of a large one: its surface is none of the mesh."""
    cube = Mesh(np.array(box((0, 0, 0), (10, 10, 10))))
    cuts = [Cut(0, axis, 0.06) for axis in range(3)]
    cuts += [Cut(0, 0, 0.04), Cut(4, 1, 0.04), Cut(5, 2, 0.04)]
    plan = CutPlan(tuple(cuts), tuple((k,) for k in range(7)))
    inner = Mesh(np.array(box((4, 4, 4), (6, 6, 6))))
    assert Mesh(parts_of(cube.vertices, cube.faces, plan)[6]) == inner
    # nor does a second body around it empty it, whose triangles face inwards, nor triangles that face the wrong way
    other = Mesh(np.array(box((1, 1, 1), (9, 9, 9))))
    faces = np.concatenate([cube.faces, other.faces[:, ::-1] + len(cube.vertices)])
    assert Mesh(parts_of(np.concatenate([cube.vertices, other.vertices]), faces, plan)[6]) == inner
    mixed = np.concatenate([cube.faces[:6, ::-1], cube.faces[6:]])
    assert Mesh(parts_of(cube.vertices, mixed, plan)[6]) == inner


def test_a_tight_hull_is_the_only_piece_and_nothing_is_worked_out(planned: list[int]) -> None:
    cube = Mesh(np.array(box((0, 0, 0), (10, 10, 10))))
    assert convex_pieces(cube.vertices, cube.faces) == (cube,)
    assert convex_pieces(*LETTER, most=1) == (HULL,)
    assert planned == []


def test_there_are_no_more_pieces_than_wanted() -> None:
    for most in (2, 3):
        pieces = convex_pieces(*LETTER, most=most)
        assert len(pieces) == most
        assert depth(pieces, in_letter()) < 1e-12


def bits(pieces: Sequence[Mesh]) -> list[tuple[bytes, bytes, bytes, bytes]]:
    return [(p.vertices.tobytes(), p.faces.tobytes(), p.normals.tobytes(), p.offsets.tobytes()) for p in pieces]


def test_the_answer_has_the_same_bits_with_the_cache_and_without(
    planned: list[int], monkeypatch: pytest.MonkeyPatch
) -> None:
    first, second = convex_pieces(*LETTER), convex_pieces(*LETTER)
    assert planned == [16]
    monkeypatch.setenv("PLANNER_SERVICE_CACHE", "")
    assert bits(first) == bits(second) == bits(convex_pieces(*LETTER))
    assert planned == [16, 16]


def test_another_mesh_setting_or_version_is_cut_anew(
    planned: list[int], folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    vertices, faces = LETTER
    convex_pieces(vertices, faces)
    convex_pieces(vertices, faces, most=8)
    convex_pieces(vertices * (1.0, 1.0, 1.0 + 2e-16), faces)
    convex_pieces(vertices, faces[1:])
    convex_pieces(vertices, faces[::-1])
    monkeypatch.setattr(decomposition, "VERSION", 0)
    convex_pieces(vertices, faces)
    assert len(planned) == len(list(folder.iterdir())) == 6


def test_a_damaged_entry_is_cut_anew(planned: list[int], folder: Path) -> None:
    expected = bits(convex_pieces(*LETTER))
    (entry,) = folder.iterdir()
    entry.write_bytes(entry.read_bytes()[:-1])
    assert bits(convex_pieces(*LETTER)) == expected
    assert bits(convex_pieces(*LETTER)) == expected
    assert planned == [16, 16]


FORGED: dict[str, Any] = {"cuts": [{"part": 0, "direction": 3, "offset": 0.05}], "groups": [[1], [0]]}

NO_PLANS: tuple[dict[str, Any], ...] = (
    {"cuts": []},
    *({"cuts": [FORGED["cuts"][0] | change]} for change in ({"part": 1}, {"direction": 9}, {"direction": -1})),
    *({"cuts": [FORGED["cuts"][0] | {"offset": offset}]} for offset in (float("nan"), 1e30, "x")),
    *({"groups": groups} for groups in ([[0]], [[0, 1], [1]], [[0, 1, 2]], [0, 1])),
)


def test_an_entry_that_somebody_wrote_makes_nothing_smaller(planned: list[int], folder: Path) -> None:
    """It is a sound plan with the right digest, so it is followed: to pieces that hold the letter all the same."""
    plain = convex_pieces(*LETTER)
    (entry,) = folder.iterdir()
    DiskCache(folder).put(entry.stem, json.dumps(FORGED).encode())
    pieces = convex_pieces(*LETTER)
    assert len(pieces) == 2 != len(plain)
    assert depth(pieces, np.concatenate([on_surface(*LETTER), in_letter()])) < 1e-12
    assert planned == [16]


@pytest.mark.parametrize(
    "forged",
    [
        b"",
        b"\xff",
        b"[" * 100_000,
        b"[]",
        b"{}",
        *(json.dumps(FORGED | change).encode() for change in NO_PLANS),
    ],
)
def test_an_entry_that_is_no_plan_is_worked_out_anew(planned: list[int], folder: Path, forged: bytes) -> None:
    expected = bits(convex_pieces(*LETTER))
    (entry,) = folder.iterdir()
    DiskCache(folder).put(entry.stem, forged)
    assert bits(convex_pieces(*LETTER)) == expected
    assert planned == [16, 16]


def test_cuts_that_leave_a_flat_part_give_way_to_the_hull(folder: Path) -> None:
    convex_pieces(*LETTER)
    (entry,) = folder.iterdir()
    at_the_bottom = {"cuts": [{"part": 0, "direction": 2, "offset": 0.0}], "groups": [[0], [1]]}
    DiskCache(folder).put(entry.stem, json.dumps(at_the_bottom).encode())
    assert convex_pieces(*LETTER) == (HULL,)


def test_a_file_gives_the_pieces_of_its_triangles(tmp_path: Path) -> None:
    file = write_obj(tmp_path / "letter.obj", LETTER[0] * 1000.0, LETTER[1])
    pieces = pieces_of_file(file, (0.001, 0.001, 0.001))
    assert len(pieces) == 3
    assert depth(pieces, on_surface(*LETTER)) < 1e-12


def test_a_flat_file_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InvalidFile, match="flat"):
        pieces_of_file(write_obj(tmp_path / "flat.obj", LETTER[0] * (1, 1, 0), LETTER[1]))


@pytest.mark.parametrize("most", [0, 65, 2.5, True])
def test_settings_out_of_range_are_refused(most: Any) -> None:
    with pytest.raises(InvalidRequest, match=f"most: got {most}; expected a whole number from 1 to 64"):
        convex_pieces(*LETTER, most=most)


def test_the_ratio_says_how_much_of_a_hull_is_air() -> None:
    cube = Mesh(np.array(box((0, 0, 0), (10, 10, 10))))
    assert hull_ratio(cube, cube.vertices, cube.faces) == pytest.approx(1.0, rel=1e-12)
    assert hull_ratio(HULL, *LETTER) == pytest.approx(100.0 / 52.0, rel=1e-12)
    assert hull_ratio(HULL, LETTER[0], LETTER[1][:, ::-1]) == pytest.approx(100.0 / 52.0, rel=1e-12)


def test_triangles_with_corners_of_their_own_are_as_closed_as_with_shared_ones(tmp_path: Path) -> None:
    soup = LETTER[0][LETTER[1]].reshape(-1, 3)
    read = read_triangles(write_obj(tmp_path / "soup.obj", soup, np.arange(len(soup)).reshape(-1, 3)))
    assert hull_ratio(HULL, *read) == hull_ratio(HULL, *read_triangles(write_obj(tmp_path / "letter.obj", *LETTER)))


def test_what_is_not_closed_has_no_ratio() -> None:
    assert hull_ratio(HULL, LETTER[0], LETTER[1][1:]) == np.inf
    assert hull_ratio(HULL, LETTER[0], np.concatenate([LETTER[1], LETTER[1][:1]])) == np.inf
