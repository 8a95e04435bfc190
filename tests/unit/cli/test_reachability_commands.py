"""``planner-service reachability``: maps are made, resumed, shown and drawn, and bad input is refused by name."""

from __future__ import annotations

import io
import json
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

from planner_service import load_robot, load_scene
from planner_service.workspace import ToolOrientation, VoxelVerdict, load_map
from tests.support import command

ROBOT = ("--robot", "planar2", "--scene", "discs")
GRID = ("--lower=-2.2,-2.2,-0.1", "--upper", "2.2,2.2,0.1", "--voxel", "0.2")

run = partial(command.run, "reachability")
document = partial(command.document, "reachability")
refused = partial(command.refused, "reachability")


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    file = tmp_path_factory.mktemp("maps") / "map.npz"
    assert run("build", *ROBOT, *GRID, "--out", file).exit_code == 0
    return file


def test_a_map_is_what_the_library_makes_and_shows(made: Path) -> None:
    robot, scene = load_robot("planar2"), load_scene("discs")
    found = load_map(made, robot, scene, trusted=True)
    assert found.orientations == (ToolOrientation(tolerance=np.pi),)
    assert found.grid.counts == (22, 22, 1)
    assert found.complete
    told = document("show", made, *ROBOT, "--trust", "--at", "1,1,0")
    assert told["orientations"][0]["voxels"]["reachable"] == int((found.verdicts == VoxelVerdict.REACHABLE).sum()) > 50
    (there,) = told["at"]
    assert there["verdict"] == "reachable"
    assert there["witness"] == found.witness((1.0, 1.0, 0.0)).tolist()  # type: ignore[union-attr]


def test_what_a_file_calls_proven_is_only_said_until_it_is_proven_here(made: Path) -> None:
    shown, proven = (" ".join(run("show", made, *ROBOT, *more).stdout.split()) for more in ((), ("--prove",)))
    assert "said to be unreachable" in shown
    assert "out of reach" not in shown
    assert "said to be" not in proven
    assert "out of reach" in proven


def test_a_map_that_was_cut_short_goes_on(made: Path, tmp_path: Path) -> None:
    file = tmp_path / "map.npz"
    asked = ("build", *ROBOT, "--lower=-2.2,-2.2,-0.1", "--upper", "2.2,2.2,0.1", "--voxel", "0.05", "--out", file)
    begun = run(*asked, "--time-limit", "0")
    assert "note: 0 of 36 blocks are done, the rest is unknown; --resume goes on" in " ".join(begun.stdout.split())
    assert document(*asked, "--resume", "--workers", "2")["complete"]
    before = file.read_bytes()
    assert document(*asked, "--resume")["seconds"] < 60.0
    assert file.read_bytes() == before
    assert "resume" in refused("build", *ROBOT, *GRID, "--out", file, "--resume")


def test_a_picture_shows_the_verdicts_in_their_colours(made: Path, tmp_path: Path) -> None:
    shares = []
    for across in ((), ("--slice", "y=1.0")):
        assert run("show", made, *ROBOT, "--trust", "--png", tmp_path / "map.png", *across).exit_code == 0
        with Image.open(tmp_path / "map.png") as image:
            r, g, b = np.moveaxis(np.asarray(image.convert("RGB")).astype(int), -1, 0)
        shares.append(float(((g > r + 30) & (g > b + 20)).mean()))
    assert shares[0] > 0.05
    assert shares[0] > 4.0 * shares[1] > 0.0  # a row of the map is less of it than the whole level


@pytest.mark.parametrize(
    ("given", "words"),
    [
        (("--voxel", "0"), "--voxel: got 0.0"),
        (("--voxel", "nan"), "--voxel: got nan"),
        (("--voxel", "0.0001"), "20,000,000 voxels together"),
        (("--lower", "1,2"), "--lower: got '1,2'"),
        (("--lower", "3,3,3"), "upper"),
        (("--orientation", "0,0,0,0"), "quaternion"),
        (("--orientation", "1,0,0,up"), "--orientation"),
        (("--tolerance", "0.1"), "--tolerance"),
        (("--free-axis", "0,0,1"), "--free-axis"),
        (("--still", "nowhere"), "--still"),
        (("--time-limit", "nan"), "--time-limit"),
        (("--workers", "0"), "workers"),
        (("--halvings", "9"), "halvings"),
        (("--slice", "w=1"), "--slice"),
        (("--slice", "z=7"), "--slice: got 'z=7'; expected z from"),
        (("--png", "map.jpg"), "--png"),
        (("--out", "map.txt"), "--out: got 'map.txt'"),
        (("--robot", "panda"), "lock some"),
    ],
)
def test_bad_input_is_refused_by_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, given: tuple[str, ...], words: str
) -> None:
    monkeypatch.chdir(tmp_path)
    base = ["build", *ROBOT, *GRID, "--out", "map.npz"]
    if given[0] in base:
        at = base.index(given[0])
        del base[at : at + 2]
    assert words in " ".join(refused(*base, *given).split())
    assert not list(tmp_path.iterdir())


def test_words_of_a_file_that_are_not_known_are_named(made: Path, tmp_path: Path) -> None:
    with np.load(made) as archive:
        arrays = dict(archive)
    head = json.loads(bytes(arrays["head"]))
    for changed, words in (
        ({"head": _bytes({**head, "padding": 1.0})}, "padding"),
        ({"head": _bytes({**head, "format": "planner-service/roadmap"})}, "format"),
        ({"head": _bytes({**head, "orientations": [{**head["orientations"][0], "spin": 1.0}]})}, "spin"),
        ({"proofs": np.zeros(3)}, "'proofs': no such array"),
        ({"verdicts": np.full_like(arrays["verdicts"], 7)}, "verdicts: got 7"),
    ):
        packed = io.BytesIO()
        np.savez(packed, **{**arrays, **changed})
        (tmp_path / "map.npz").write_bytes(packed.getvalue())
        assert words in " ".join(refused("show", tmp_path / "map.npz", *ROBOT).split())


def _bytes(head: object) -> NDArray[np.uint8]:
    return np.frombuffer(json.dumps(head).encode(), dtype=np.uint8)


PLACE = ("place", "--scene", "bin", "--pose", "0.2,0.28,0.15,0.70711,0,0.70711,0")


def test_a_base_is_found_and_drawn(tmp_path: Path) -> None:
    asked = (*PLACE, "--lower=-0.1,-0.1,0", "--upper", "0.1,0.1,0", "--yaw=-0.3,0.3", "--bases", "2")
    told = document(*asked, "--png", tmp_path / "base.png")
    assert len(told["bases"]) == 2
    assert not told["proven"]
    assert (tmp_path / "base.png").exists()
    shown = " ".join(run(*asked).stdout.split())
    assert "placed: wxai in bin, 1 pose " in shown
    assert "to the limits" in shown


def test_no_base_ends_with_1_and_says_whether_that_is_proven() -> None:
    asked = (*PLACE, "--lower", "2,2,0", "--upper", "3,3,0")
    told = document(*asked, code=1)
    assert (told["proven"], told["bases"], told["ruled_out"]) == (True, [], [1.0])
    assert "no base: no base in the region, proven: ruled out by pose 0 100 %" in run(*asked).stderr
    for given, words in (
        (("--yaw", "1"), "--yaw"),
        (("--yaw", "0,9"), "yaw"),
        (("--room", "nan"), "room"),
        (("--pose", "1,2,3"), "--pose"),
        (("--pose", "0,0,0,0,0,0,0"), "--pose"),
        (("--free-axis", "0,0,0"), "free_axis"),
    ):
        assert words in refused(*asked, *given)
