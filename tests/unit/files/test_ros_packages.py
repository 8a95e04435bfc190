"""ROS packages are found in the repository of a file, and nowhere above."""

from __future__ import annotations

from pathlib import Path

import pytest

from planner_service.files.ros_packages import listed_folders, packages_around, packages_below


def package(folder: Path, name: str) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "package.xml").write_text(f"<package><name>{name}</name></package>")
    return folder


def test_the_repository_is_the_folder_with_a_git_and_nothing_above(tmp_path: Path) -> None:
    own = package(tmp_path / "repo" / "arms" / "a", "a_description")
    deep = package(tmp_path / "repo" / "libs" / "deep" / "b", "b_description")
    package(tmp_path / "c", "c_description")
    (tmp_path / "repo" / ".git").mkdir()
    folders = packages_around(own / "urdf" / "a.urdf")
    assert folders == [own, tmp_path / "repo"]
    found = packages_below(folders)
    assert (found["a_description"], found["b_description"]) == (own, deep)
    assert "c_description" not in found


def test_without_a_git_there_are_the_packages_right_beside(tmp_path: Path) -> None:
    own, other = package(tmp_path / "ws" / "a", "a"), package(tmp_path / "ws" / "b", "b")
    (tmp_path / "ws" / "notes").mkdir()
    assert packages_around(own / "a.urdf") == [own, other]
    assert packages_around(tmp_path / "ws" / "notes" / "x.urdf") == []


def test_what_lies_beside_a_package_in_a_folder_that_all_may_write_to_is_not_read(tmp_path: Path) -> None:
    own = package(tmp_path / "shared" / "a", "a")
    package(tmp_path / "shared" / "b", "b")
    (tmp_path / "shared").chmod(0o1777)
    assert packages_around(own / "a.urdf") == [own]


def test_of_two_packages_of_one_name_the_nearest_is_meant(tmp_path: Path) -> None:
    (tmp_path / ".git").mkdir()
    near, far = package(tmp_path / "humble" / "arm", "arm"), package(tmp_path / "a" / "arm", "arm")
    for own, expected in ((package(tmp_path / "humble" / "x", "x"), near), (package(tmp_path / "a" / "y", "y"), far)):
        assert packages_below(packages_around(own / "x.urdf"))["arm"] == expected


def test_a_symbolic_link_leads_to_no_package_and_a_broken_one_has_its_folder_name(tmp_path: Path) -> None:
    outside = package(tmp_path / "outside", "outside_description")
    repo = tmp_path / "repo"
    (repo / ".git").mkdir(parents=True)
    (repo / "inner").mkdir()
    (repo / "inner" / "link").symlink_to(outside)
    (repo / "broken").mkdir()
    (repo / "broken" / "package.xml").write_text("<package><name>oth")
    found = packages_below([repo])
    assert "outside_description" not in found
    assert found["broken"] == repo / "broken"


def test_many_folders_are_counted_in_a_message() -> None:
    assert listed_folders([Path(f"/{k}") for k in range(6)]) == "/0, /1, /2, /3 and 2 more"


def test_a_folder_that_nobody_may_look_into_has_no_packages(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("arm", "closed"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "package.xml").write_text(f"<package><name>{name}</name></package>")
    real = Path.is_file

    def denied(path: Path) -> bool:
        if path.parent.name == "closed":
            raise PermissionError(path)
        return real(path)

    monkeypatch.setattr(Path, "is_file", denied)
    assert packages_below([tmp_path])["arm"] == tmp_path / "arm"
