"""Convex pieces hold the mesh they stand for, whatever the library that cuts them answers, or does not."""

from __future__ import annotations

import importlib.metadata
import json
from collections.abc import Sequence
from importlib.util import find_spec
from itertools import product
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pytest

from planner_service.errors import InvalidFile, InvalidRequest, MissingDependency
from planner_service.files.disk_cache import DiskCache
from planner_service.geometry import decomposition
from planner_service.geometry.arrays import FloatArray, IntArray
from planner_service.geometry.covering import covering, longest_gap, slack
from planner_service.geometry.decomposition import hull_ratio, pieces_of_file
from planner_service.geometry.mesh import Mesh
from planner_service.geometry.mesh_formats import read_triangles

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
BOXES = [box(low, high) for low, high in ARMS]


class Fake:
    """A package ``coacd`` in a folder of its own, which the child process imports; counts how often it is asked."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        (folder / "coacd").mkdir(parents=True)
        self.release("1.0.14")
        self.answers(BOXES)

    def release(self, version: str) -> None:
        for old in self.folder.glob("*.dist-info"):
            (old / "METADATA").unlink()
            old.rmdir()
        about = self.folder / f"coacd-{version}.dist-info"
        about.mkdir()
        (about / "METADATA").write_text(f"Metadata-Version: 2.1\nName: coacd\nVersion: {version}\n")

    def does(self, body: str) -> None:
        (self.folder / "coacd" / "__init__.py").write_text(
            "import os, sys, time\n"
            "import numpy as np\n"
            "class Mesh:\n"
            "    def __init__(self, vertices, indices): self.vertices, self.indices = vertices, indices\n"
            "def set_log_level(level): pass\n"
            "def run_coacd(mesh, **settings):\n"
            f"    with open({str(self.folder / 'calls')!r}, 'a') as file: file.write('x')\n"
            f"    {body}\n"
        )

    def answers(self, pieces: object) -> None:
        text = json.dumps(pieces)
        self.does(f"import json; return [(np.array(p, float).reshape(-1, 3), None) for p in json.loads({text!r})]")

    @property
    def calls(self) -> int:
        path = self.folder / "calls"
        return len(path.read_text()) if path.exists() else 0


@pytest.fixture
def fake(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Fake:
    monkeypatch.setenv("PLANNER_SERVICE_CACHE", "")
    made = Fake(tmp_path / "fake")
    monkeypatch.syspath_prepend(str(made.folder))
    return made


def on_surface(vertices: FloatArray, faces: IntArray, count: int = 4000) -> FloatArray:
    """Random points on the triangles."""
    rng = np.random.default_rng(1)
    weights = rng.dirichlet((1, 1, 1), count)
    return np.asarray((vertices[faces[rng.integers(len(faces), size=count)]] * weights[..., None]).sum(axis=1))


def in_letter(count: int = 4000) -> FloatArray:
    points = np.random.default_rng(2).uniform((0, 0, 0), (10, 10, 5), (count, 3))
    inside = [((points >= low) & (points <= high)).all(axis=1) for low, high in ARMS]
    return np.asarray(points[np.any(inside, axis=0)] / 100.0)


def depth(pieces: Sequence[Mesh], points: FloatArray) -> float:
    """How far the farthest point is from all pieces."""
    return float(np.min([piece.distance(points) for piece in pieces], axis=0).max())


def test_a_letter_becomes_the_boxes_it_is_made_of(fake: Fake) -> None:
    pieces = convex_pieces(*LETTER)
    assert len(pieces) == 3
    assert depth(pieces, on_surface(*LETTER)) == 0.0
    assert depth(pieces, in_letter()) == 0.0
    for piece, corners in zip(pieces, BOXES, strict=True):
        assert len(piece.vertices) == 8
        assert Mesh(np.array(corners)).distance(piece.vertices).max() < 1e-9


def test_what_is_between_the_arms_stays_free(fake: Fake) -> None:
    pieces = convex_pieces(*LETTER)
    assert min(float(piece.distance(np.array([[0.06, 0.05, 0.025]])).min()) for piece in pieces) > 0.029


def lossy(how: str) -> list[list[list[float]]]:
    rng = np.random.default_rng(3)
    boxes = [np.array(b) for b in BOXES]
    answers = {
        "jittered": [b + rng.uniform(-5e-6, 5e-6, b.shape) for b in boxes],
        "without an arm": boxes[:2],
        "shrunk": [b.mean(axis=0) + 0.8 * (b - b.mean(axis=0)) for b in boxes],
        "cut askew": [boxes[0] + (0, 0, 0.001), boxes[1] + (0.003, 0.001, 0), boxes[2]],
        "all flat": [b * (1, 1, 0) for b in boxes],
        "far away": [b + 5.0 for b in boxes],
    }
    return [np.asarray(b).tolist() for b in answers[how]]


@pytest.mark.slow
@pytest.mark.parametrize(
    "how",
    ["jittered", "without an arm", "shrunk", "cut askew", "all flat", "far away"],
)
def test_the_surface_is_held_whatever_the_cut_left_out(fake: Fake, how: str) -> None:
    fake.answers(lossy(how))
    assert depth(convex_pieces(*LETTER), on_surface(*LETTER)) < 1e-15


@pytest.mark.slow
def test_pieces_grow_by_no_more_than_they_left_out() -> None:
    cut = [Mesh(np.array(b)) for b in lossy("shrunk")]
    left_out = max(depth(cut, LETTER[0]), depth(cut, on_surface(*LETTER)))
    pieces = covering(cut, *LETTER)
    grown = max(float(a.distance(b.vertices).max()) for a, b in zip(cut, pieces, strict=True))
    assert 0.0 < grown < left_out + 11 * slack(LETTER[0])


def test_a_tight_hull_is_the_only_piece_and_nobody_is_asked(fake: Fake) -> None:
    fake.does("os.abort()")
    cube = Mesh(np.array(box((0, 0, 0), (10, 10, 10))))
    assert convex_pieces(cube.vertices, cube.faces) == (cube,)
    assert convex_pieces(*LETTER, most=1) == (Mesh(LETTER[0]),)
    assert fake.calls == 0


@pytest.mark.slow
def test_pieces_that_are_hollow_give_way_to_the_hull(fake: Fake) -> None:
    skin = []
    for (x, y, z), (u, v, w) in ARMS:
        skin += [box((x, y, z), (u, v, 0.1)), box((x, y, 4.9), (u, v, w))]
    for (x, y), (u, v) in zip(OUTLINE, (*OUTLINE[1:], OUTLINE[0]), strict=True):
        a, b = sorted((x, u)), sorted((y, v))
        inward = np.sign([v - y, u - x]) * (-0.1, 0.1)
        thick = np.array([(a[0], b[0], 0), (a[1], b[1], 5)], dtype=float)
        side = int(np.flatnonzero(inward)[0])
        thick[int(inward[side] > 0), side] += inward[side]
        skin.append(box(thick[0], thick[1]))
    solids = [Mesh(np.array(b)) for b in skin]
    assert depth(solids, on_surface(*LETTER)) < 1e-15
    fake.answers(skin)
    assert longest_gap(solids, *LETTER) > 0.01
    assert convex_pieces(*LETTER) == (Mesh(LETTER[0]),)


@pytest.mark.parametrize(
    ("body", "why"),
    [
        ("os.abort()", "it died: Aborted"),
        ("bytearray(10**11)", "its last message was 'MemoryError'"),
        ("return []", "its answer is not 1 to 16 pieces"),
        ("return [(np.eye(3), None)] * 17", "its answer is not 1 to 16 pieces"),
    ],
)
def test_a_library_that_fails_is_reported_and_harms_nobody(fake: Fake, body: str, why: str) -> None:
    fake.does(body)
    with pytest.raises(InvalidRequest, match=f"coacd did not cut the mesh: {why}"):
        convex_pieces(*LETTER)


@pytest.mark.slow
def test_a_library_that_hangs_is_ended(fake: Fake, monkeypatch: pytest.MonkeyPatch) -> None:
    fake.does("time.sleep(1000)")
    monkeypatch.setattr(decomposition, "SECONDS", 1)
    with pytest.raises(InvalidRequest, match="it took more than 1 s"):
        convex_pieces(*LETTER)


def test_without_the_library_the_extra_is_named(fake: Fake, monkeypatch: pytest.MonkeyPatch) -> None:
    def absent(name: str) -> str:
        raise importlib.metadata.PackageNotFoundError(name)

    monkeypatch.setattr(importlib.metadata, "version", absent)
    with pytest.raises(MissingDependency, match=r"coacd is not installed; pip install 'planner-service\[decompose\]'"):
        convex_pieces(*LETTER)


def bits(pieces: Sequence[Mesh]) -> list[tuple[bytes, bytes, bytes, bytes]]:
    return [(p.vertices.tobytes(), p.faces.tobytes(), p.normals.tobytes(), p.offsets.tobytes()) for p in pieces]


@pytest.fixture
def folder(fake: Fake, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("PLANNER_SERVICE_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache"


@pytest.mark.slow
def test_the_answer_has_the_same_bits_with_the_cache_and_without(
    fake: Fake, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    fake.answers(lossy("jittered"))
    first, second = convex_pieces(*LETTER), convex_pieces(*LETTER)
    assert fake.calls == 1
    monkeypatch.setenv("PLANNER_SERVICE_CACHE", "")
    assert bits(first) == bits(second) == bits(convex_pieces(*LETTER))
    assert fake.calls == 2


@pytest.mark.slow
def test_another_mesh_setting_or_release_is_cut_anew(fake: Fake, folder: Path) -> None:
    vertices, faces = LETTER
    convex_pieces(vertices, faces)
    convex_pieces(vertices, faces, tolerance=0.02)
    convex_pieces(vertices, faces, most=8)
    convex_pieces(vertices * (1.0, 1.0, 1.0 + 2e-16), faces)
    convex_pieces(vertices, faces[1:])
    convex_pieces(vertices, faces[::-1])
    fake.release("1.0.15")
    convex_pieces(vertices, faces)
    assert fake.calls == len(list(folder.iterdir())) == 7


@pytest.mark.slow
def test_an_entry_that_somebody_wrote_makes_nothing_smaller(fake: Fake, folder: Path) -> None:
    """Its digest is right, so that nothing but the check against the mesh stands between it and a collision."""
    convex_pieces(*LETTER)
    (entry,) = folder.iterdir()
    tiny = np.array(lossy("shrunk")) * 0.01
    forged = np.array([3, 8, 8, 8], "<u4").tobytes() + tiny.astype("<f8").tobytes()
    DiskCache(folder).put(entry.stem, forged)
    assert depth(convex_pieces(*LETTER), on_surface(*LETTER)) < 1e-15
    assert fake.calls == 1


@pytest.mark.slow
@pytest.mark.parametrize(
    "forged",
    [
        b"",
        np.array([1, 2**32 - 1], "<u4").tobytes(),
        np.array([1, 4], "<u4").tobytes() + bytes(95),
        np.array([1, 4], "<u4").tobytes() + np.full(12, 1e30).tobytes(),
    ],
)
def test_an_entry_that_is_no_list_of_pieces_is_cut_anew(fake: Fake, folder: Path, forged: bytes) -> None:
    expected = bits(convex_pieces(*LETTER))
    (entry,) = folder.iterdir()
    DiskCache(folder).put(entry.stem, forged)
    assert bits(convex_pieces(*LETTER)) == expected
    assert fake.calls == 2


def test_a_file_that_cannot_be_cut_is_named(fake: Fake, tmp_path: Path) -> None:
    fake.does("os.abort()")
    with pytest.raises(InvalidFile, match=r"letter\.obj: 1 problem.*\n.*coacd did not cut the mesh: it died"):
        pieces_of_file(write_obj(tmp_path / "letter.obj", *LETTER))


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"most": 0}, "most: got 0; expected a whole number from 1 to 64"),
        ({"tolerance": 0.0}, "tolerance: got 0.0; expected metres from 0.0001 to 1000"),
        ({"tolerance": float("nan")}, "tolerance: got nan"),
    ],
)
def test_settings_out_of_range_are_refused(settings: dict[str, Any], message: str) -> None:
    with pytest.raises(InvalidRequest, match=message):
        convex_pieces(*LETTER, **settings)


HULL = Mesh(LETTER[0])


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


def test_the_real_library_cuts_a_letter_twice_alike(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where it is installed; where it is not, that is said."""
    monkeypatch.setenv("PLANNER_SERVICE_CACHE", "")
    if find_spec("coacd") is None:
        with pytest.raises(MissingDependency, match="coacd"):
            convex_pieces(*LETTER)
        return
    pieces = convex_pieces(*LETTER)
    assert 1 < len(pieces) <= 16
    assert depth(pieces, on_surface(*LETTER)) < 1e-15
    assert depth(pieces, in_letter()) == 0.0
    assert bits(convex_pieces(*LETTER)) == bits(pieces)
