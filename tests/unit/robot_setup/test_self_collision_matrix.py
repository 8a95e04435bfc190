"""The table of contacts: what it calls never is never, what it calls always is always, and the rest stays judged."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from planner_service.collision import CollisionChecker
from planner_service.errors import InvalidFile, UnknownName
from planner_service.files.package_data import data_folder
from planner_service.parallel.processes import Processes
from planner_service.robot.model import AllowedContact, Robot
from planner_service.robot_setup.import_robot import Source, import_robot
from planner_service.robot_setup.loading import load_robot
from planner_service.robot_setup.self_collision_matrix import ContactKind, ContactTable, contact_table, quick_table
from planner_service.scene.scene import Scene
from tests.support.optional import present
from tests.support.small_robots import joint, link, solid, urdf

# A post turns; on it slides a block within a ball that always reaches down into the base; a small ball swings at the
# end. Post and ball are nearest with the slide at its lower end and the ball swung back: 0.05 m + that end apart.
SMALL = urdf(
    "small",
    link("base", solid("box", "0.2 0.2 0.2", "0 0 -0.3")),
    link("post", solid("cylinder", 'radius="0.05" length="0.2"')),
    link("block", solid("sphere", 'radius="0.6"')) + link("ball", solid("sphere", 'radius="0.05"', "0.1 0 0")),
    joint("turn", "continuous base post"),
    joint("slide", "prismatic post block LOWER 0.2", axis="1 0 0"),
    joint("swing", "revolute block ball -3.2 3.2", xyz="0.25 0 0"),
)
WXAI = data_folder("robots") / "wxai" / "wxai.urdf"
POST_BALL = ("post", "ball")


def small(folder: Path, lower: float = 0.0, text: str = SMALL) -> Path:
    path = folder / "small.urdf"
    path.write_text(text.replace("LOWER", repr(lower)), "utf-8")
    return path


def kinds(table: ContactTable) -> dict[tuple[str, str], ContactKind]:
    return {finding.links: finding.kind for finding in table.findings}


@pytest.fixture(scope="module")
def wxai() -> Robot:
    return Robot.from_urdf(WXAI, tool_frame="ee_gripper_link", locked_joints={"left_carriage_joint": 0.04})


@pytest.fixture(scope="module")
def wxai_table(wxai: Robot) -> ContactTable:
    return contact_table(wxai, samples=300)


def test_every_kind_of_pair_is_told_from_the_others(tmp_path: Path) -> None:
    table = contact_table(Robot.from_urdf(small(tmp_path)), samples=50)
    assert kinds(table) == {
        ("base", "post"): ContactKind.ADJACENT,
        ("base", "block"): ContactKind.ALWAYS,
        ("base", "ball"): ContactKind.NEVER,
        ("post", "block"): ContactKind.ADJACENT,
        ("post", "ball"): ContactKind.NEVER,
        ("block", "ball"): ContactKind.ADJACENT,
    }
    always = table.of(ContactKind.ALWAYS)[0]
    assert (always.share, always.at_home, always.joints) == (1.0, True, ("turn", "slide"))
    assert "each of 3,969 points swept over turn and slide, steps of 0.2, 0.0032" in always.reason
    assert [f.reason for f in table.of(ContactKind.ADJACENT)] == [
        "adjacent: turn",
        "adjacent: slide",
        "adjacent: swing",
    ]


@pytest.mark.parametrize("gap", [0.04, 0.0001])
def test_a_pair_that_is_barely_apart_is_proven_so_and_no_farther_than_it_is(tmp_path: Path, gap: float) -> None:
    table = contact_table(Robot.from_urdf(small(tmp_path, gap - 0.05)), samples=10)
    (found,) = [finding for finding in table.findings if finding.links == POST_BALL]
    assert found.kind is ContactKind.NEVER
    assert min(0.01, 0.3 * gap) <= found.gap <= gap
    assert found.joints == ("slide", "swing")


@pytest.mark.parametrize("overlap", [0.0, 1e-4])
def test_a_pair_that_touches_in_one_corner_of_the_joint_box_stays_judged(tmp_path: Path, overlap: float) -> None:
    table = contact_table(Robot.from_urdf(small(tmp_path, -0.05 - overlap)), samples=1, max_bounds=20_000)
    assert not kinds(table)[POST_BALL].allowed
    assert frozenset(POST_BALL) not in {frozenset(contact.links) for contact in table.allowed}


def test_a_collision_that_no_sample_found_is_found_by_the_proof(tmp_path: Path) -> None:
    robot = Robot.from_urdf(small(tmp_path, -0.08))
    (found,) = [f for f in contact_table(robot, samples=1).findings if f.links == POST_BALL]
    assert (found.kind, found.share) == (ContactKind.SOMETIMES, 0.0)
    touching = {(c.a, c.b) for c in CollisionChecker(robot, Scene()).contacts(present(found.example))}
    assert {frozenset(pair) for pair in touching} >= {frozenset(POST_BALL)}


def test_without_the_bounds_for_a_proof_a_pair_stays_judged_and_says_so(tmp_path: Path) -> None:
    table = contact_table(Robot.from_urdf(small(tmp_path)), samples=10, max_bounds=1)
    (found,) = [finding for finding in table.findings if finding.links == POST_BALL]
    assert found.kind is ContactKind.UNPROVEN
    assert found.reason == "no collision was found, but 1 bounds did not suffice for a proof that it never collides"
    assert math.isnan(found.gap)


@pytest.mark.slow
def test_the_same_robot_gives_the_same_table_whoever_works_it_out(tmp_path: Path) -> None:
    robot = Robot.from_urdf(small(tmp_path, -0.06))
    one, two = (contact_table(robot, samples=20, engine=each) for each in (None, Processes(2)))
    assert [(f.links, f.kind, f.reason, f.share, f.bounds) for f in one.findings] == [
        (f.links, f.kind, f.reason, f.share, f.bounds) for f in two.findings
    ]
    for a, b in zip(one.findings, two.findings, strict=True):
        assert (a.example is None) == (b.example is None)
        assert a.example is None or b.example is None or a.example.tolist() == b.example.tolist()


def test_a_quick_table_allows_what_always_overlaps_and_leaves_the_rest_checked(tmp_path: Path) -> None:
    robot = Robot.from_urdf(small(tmp_path))
    quick, whole = quick_table(robot), contact_table(robot)
    assert [f.links for f in quick.findings] == [f.links for f in whole.findings]
    kept = (ContactKind.ADJACENT, ContactKind.ALWAYS)
    assert [f.links for f in quick.of(*kept)] == [f.links for f in whole.of(*kept)]
    assert {f.kind for f in quick.findings} == {*kept, ContactKind.UNPROVEN}


def test_what_is_proven_never_to_touch_does_not_in_5000_random_states(wxai: Robot, wxai_table: ContactTable) -> None:
    never = {frozenset(finding.links) for finding in wxai_table.of(ContactKind.NEVER)}
    bare = replace(wxai, allowed_contacts=())
    others = tuple(AllowedContact(pair, "") for pair in bare.link_pairs if frozenset(pair) not in never)
    checker = CollisionChecker(replace(bare, allowed_contacts=others), Scene())
    assert checker.pair_count > 0
    Q = np.random.default_rng(5).uniform(wxai.limits.lower, wxai.limits.upper, (5000, wxai.n))
    assert all(checker.state_is_free(q) for q in Q)


@pytest.mark.parametrize(("name", "tool"), [("planar2", "tip"), ("small", "ball")])
def test_an_imported_robot_is_the_robot_of_the_urdf_but_for_what_may_touch(
    tmp_path: Path, name: str, tool: str
) -> None:
    urdf = small(tmp_path) if name == "small" else data_folder("robots") / name / f"{name}.urdf"
    found = import_robot(Source(urdf), tmp_path / "out")
    direct, loaded = Robot.from_urdf(urdf), load_robot(found.path)
    assert replace(loaded, allowed_contacts=direct.allowed_contacts).hash == direct.hash
    assert loaded.tool_frame == tool
    assert [(c.links, c.reason) for c in loaded.allowed_contacts] == [
        (f.links, f.reason) for f in found.table.of(ContactKind.ADJACENT, ContactKind.ALWAYS, ContactKind.NEVER)
    ]
    assert found.urdf.read_bytes() == urdf.read_bytes()


def test_a_name_with_a_line_break_cannot_end_a_comment(tmp_path: Path) -> None:
    text = SMALL.replace('"ball"', '"ball&#10;settle_time = 9 \\ &quot;"').replace('"swing"', '"sw&#10;ing"')
    found = import_robot(Source(small(tmp_path, -0.09, text)), tmp_path / "out")
    assert found.robot.tool_frame == 'ball\nsettle_time = 9 \\ "'
    assert load_robot(found.path).settle_time == 0.0


def test_nothing_is_written_for_a_robot_that_cannot_be_imported(tmp_path: Path) -> None:
    out = tmp_path / "out"
    shapeless = small(tmp_path, text='<robot name="r"><link name="a"/></robot>')
    with pytest.raises(InvalidFile, match="no link of the URDF has a collision shape"):
        import_robot(Source(shapeless), out)
    urdf = small(tmp_path)
    with pytest.raises(UnknownName, match="unknown joint 'slid'; did you mean 'slide'"):
        import_robot(Source(urdf, locked_joints={"slid": 0.0}), out)
    with pytest.raises(InvalidFile, match="cannot be written"):
        import_robot(Source(urdf), tmp_path / "missing" / "out")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["small.urdf"]
