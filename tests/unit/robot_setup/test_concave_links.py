"""Links are cut into convex pieces where their hulls block what is free, and only there."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from planner_service import InvalidRequest, Mesh, Robot, Scene, load_robot
from planner_service.collision import CollisionChecker
from planner_service.files.disk_cache import DiskCache
from planner_service.robot_setup import concave_links
from planner_service.robot_setup.check_robot import FindingKind, check_robot
from planner_service.robot_setup.import_robot import Source, import_robot
from tests.unit.geometry.test_decomposition import LETTER, write_obj

ARM = """<robot name="arm">
  <link name="base"/>
  <link name="letter"><collision><geometry><mesh filename="letter.obj" scale="2 2 2"/></geometry></collision></link>
  <link name="bar"><collision><origin xyz="{at}"/><geometry><box size="0.16 0.02 0.02"/></geometry></collision></link>
  <link name="top"><collision><origin xyz="0 0 1"/><geometry><box size="0.02 0.02 0.02"/></geometry></collision></link>
  <joint name="turn" type="revolute"><parent link="base"/><child link="letter"/><axis xyz="0 0 1"/>
    <limit lower="-1" upper="1" velocity="1" effort="1"/></joint>
  <joint name="up" type="fixed"><parent link="letter"/><child link="top"/></joint>
  <joint name="slide" type="prismatic"><parent link="top"/><child link="bar"/><axis xyz="1 0 0"/>
    <limit lower="0" upper="0.6" velocity="1" effort="1"/></joint>
</robot>"""
"""A bar slides through the gap of a letter C, 20 cm high, and out of it: it never touches the letter, only its hull."""

IN_THE_GAP, AWAY = "0.14 0.1 0.05", "0.14 0.1 0.5"


def arm(folder: Path, at: str = IN_THE_GAP) -> Path:
    write_obj(folder / "letter.obj", *LETTER)
    (folder / "arm.urdf").write_text(ARM.format(at=at))
    return folder / "arm.urdf"


def pieces(robot: Robot, link: str = "letter") -> int:
    return sum(item.link == link for item in robot.shapes)


def test_a_link_whose_hull_blocks_what_is_free_is_cut(tmp_path: Path) -> None:
    path = arm(tmp_path)
    robot, hulls = load_robot(path), load_robot(path, cut_meshes=False)
    Q = np.stack([np.zeros(50), np.linspace(0.0, 0.6, 50)], axis=1)
    assert (pieces(robot), pieces(hulls)) == (3, 1)
    assert CollisionChecker(robot, Scene()).states_are_free(Q).all()
    assert not CollisionChecker(hulls, Scene()).states_are_free(Q[:10]).any()


def test_robot_check_tells_of_it(tmp_path: Path) -> None:
    found = check_robot(arm(tmp_path)).findings
    assert "hulls of letter touch what their meshes do not; load_robot cuts these" in " ".join(map(str, found))
    assert FindingKind.HULLS not in [finding.kind for finding in check_robot(arm(tmp_path, AWAY)).findings]


def test_a_link_whose_hull_blocks_nothing_keeps_it(tmp_path: Path) -> None:
    robot = load_robot(arm(tmp_path, AWAY))
    assert pieces(robot) == 1
    assert robot.hash == load_robot(arm(tmp_path, AWAY), cut_meshes=False).hash


def test_a_hull_that_touches_no_more_than_its_pieces_is_kept(tmp_path: Path) -> None:
    """The bar comes from behind, through the letter's back."""
    path = arm(tmp_path, "-0.32 0.1 0.05")
    path.write_text(path.read_text().replace('upper="0.6"', 'upper="0.3"'))
    robot = load_robot(path)
    assert pieces(robot) == 1
    assert not CollisionChecker(robot, Scene()).state_is_free([0.0, 0.3])


def test_two_links_that_touch_by_their_hulls_everywhere_are_still_checked(tmp_path: Path) -> None:
    path = arm(tmp_path)
    path.write_text(path.read_text().replace('upper="0.6"', 'upper="0.05"'))
    assert ("letter", "bar") in load_robot(path).link_pairs
    assert ("letter", "bar") not in load_robot(path, cut_meshes=False).link_pairs


def counted(monkeypatch: pytest.MonkeyPatch, name: str) -> list[int]:
    """A list that grows with each call of a function of the module."""
    calls, real = list[int](), getattr(concave_links, name)

    def call(*arguments: Any) -> Any:
        calls.append(1)
        return real(*arguments)

    monkeypatch.setattr(concave_links, name, call)
    return calls


def test_where_triangles_touch_no_mesh_is_cut_to_find_out(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = arm(tmp_path, "-0.32 0.1 0.05")
    path.write_text(path.read_text().replace('upper="0.6"', 'upper="0.3"'))
    tried = counted(monkeypatch, "pieces_of_surface")
    assert pieces(load_robot(path)) == 1
    assert not tried
    assert pieces(load_robot(arm(tmp_path))) == 3
    assert tried


def test_which_links_are_cut_is_found_out_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    looks = counted(monkeypatch, "draws")
    first, second = load_robot(arm(tmp_path)), load_robot(arm(tmp_path))
    assert first.hash == second.hash
    assert len(looks) == 1
    monkeypatch.setenv("PLANNER_SERVICE_CACHE", "")
    assert load_robot(arm(tmp_path)).hash == first.hash
    assert len(looks) == 2


def test_another_mesh_with_the_same_hull_is_looked_at_anew(tmp_path: Path) -> None:
    path, hull = arm(tmp_path), Mesh(LETTER[0])
    write_obj(tmp_path / "letter.obj", hull.vertices, hull.faces)
    assert pieces(load_robot(path)) == 1
    assert pieces(load_robot(arm(tmp_path))) == 3


@pytest.mark.parametrize("kept", [b"", b"{}", b"[" * 100_000, b'["arm"]', b'[["letter"]]', b"[1]"])
def test_a_kept_choice_that_names_no_links_is_made_anew(tmp_path: Path, kept: bytes) -> None:
    expected = load_robot(arm(tmp_path)).hash
    for entry in (tmp_path / "cache").iterdir():
        DiskCache(tmp_path / "cache").put(entry.stem, kept)
    assert load_robot(arm(tmp_path)).hash == expected


def test_a_kept_choice_that_somebody_wrote_makes_shapes_looser_but_never_smaller(tmp_path: Path) -> None:
    load_robot(arm(tmp_path))
    for entry in (tmp_path / "cache").iterdir():
        DiskCache(tmp_path / "cache").put(entry.stem, b"[]")
    assert load_robot(arm(tmp_path)).hash == load_robot(arm(tmp_path), cut_meshes=False).hash


def test_an_imported_robot_says_which_links_are_cut(tmp_path: Path) -> None:
    imported = import_robot(Source(arm(tmp_path)), tmp_path / "out")
    assert "[decompose]" in imported.path.read_text()
    assert pieces(imported.robot) == 3


@pytest.fixture(autouse=True)
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PLANNER_SERVICE_CACHE", str(tmp_path / "cache"))


def test_hulls_are_no_choice_for_a_robot_that_says_itself_what_to_cut() -> None:
    with pytest.raises(InvalidRequest, match="cut_meshes: got False; expected none"):
        load_robot("wxai", cut_meshes=False)
