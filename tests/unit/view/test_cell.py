"""Building a cell, without a browser: edits that make no sense are refused, and what is saved is the same scene."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from planner_service import InvalidRequest, PlannerService
from planner_service.scene.loading import load_scene
from planner_service.view.cell.edits import Cell
from planner_service.view.cell.folder import CellFolder


@pytest.fixture
def crate(bin_: PlannerService) -> Cell:
    cell = Cell(bin_.scene).added("box", (0.33, 0.0))
    return cell.shaped((0.05, 0.05, 0.05)).renamed("crate").coloured("#c86432")


def test_a_saved_scene_loads_to_the_same_scene_verdict_for_verdict(
    crate: Cell, bin_: PlannerService, tmp_path: Path
) -> None:
    path = CellFolder(tmp_path).save(crate.scene, "mine", replace=False)
    assert path is not None
    loaded = load_scene(path)
    assert loaded.hash == crate.scene.hash
    assert loaded.obstacle("crate").colour == "#c86432"
    Q = np.random.default_rng(0).uniform(*bin_.robot.bounds, (500, bin_.robot.n))
    before, after = (PlannerService(bin_.robot, scene).checker for scene in (crate.scene, loaded))
    assert [before.state_is_free(q) for q in Q] == [after.state_is_free(q) for q in Q]


@pytest.mark.parametrize("sizes", [(0.0, 1.0, 1.0), (float("nan"), 1.0, 1.0), (-1.0, 1.0, 1.0), (0.1,), (0.1, 0.2)])
def test_sizes_that_no_box_has_are_refused(crate: Cell, sizes: tuple[float, ...]) -> None:
    with pytest.raises(InvalidRequest, match="size"):
        crate.shaped(sizes)


@pytest.mark.parametrize("name", ["", " x", "tray", "x" * 65])
def test_names_that_an_obstacle_cannot_have_are_refused(crate: Cell, name: str) -> None:
    with pytest.raises(InvalidRequest, match="name"):
        crate.renamed(name)


@pytest.mark.parametrize("name", ["../x", "a/b", "", ".hidden", "/etc/x", "x\0"])
def test_nothing_is_written_outside_of_the_folder(crate: Cell, name: str, tmp_path: Path) -> None:
    with pytest.raises(InvalidRequest, match="file name"):
        CellFolder(tmp_path).save(crate.scene, name, replace=True)
    assert list(tmp_path.iterdir()) == []


def test_a_link_in_the_folder_is_not_followed(crate: Cell, tmp_path: Path) -> None:
    folder = tmp_path / "cells"
    folder.mkdir()
    (folder / "link.toml").symlink_to(tmp_path / "elsewhere.toml")
    with pytest.raises(InvalidRequest, match="link"):
        CellFolder(folder).save(crate.scene, "link", replace=True)
    assert not (tmp_path / "elsewhere.toml").exists()


def test_a_file_that_is_there_is_replaced_only_if_that_is_meant(crate: Cell, tmp_path: Path) -> None:
    folder = CellFolder(tmp_path)
    assert folder.save(crate.scene, "mine", replace=False) is not None
    assert folder.save(crate.deleted().scene, "mine", replace=False) is None
    assert load_scene(tmp_path / "mine.toml").hash == crate.scene.hash
