"""The table of contacts: what it calls never is never, what it calls always is always, and the rest stays judged."""

from __future__ import annotations

import math
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from planner_service.collision import CollisionChecker
from planner_service.errors import InvalidFile, InvalidRequest, UnknownName
from planner_service.files.package_data import data_folder
from planner_service.parallel.engine import Engine
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


@pytest.mark.parametrize("gap", [0.04, 0.005, 0.001, 0.0001])
def test_a_pair_that_is_barely_apart_is_proven_so_and_no_farther_than_it_is(tmp_path: Path, gap: float) -> None:
    table = contact_table(Robot.from_urdf(small(tmp_path, gap - 0.05)), samples=10)
    (found,) = [finding for finding in table.findings if finding.links == POST_BALL]
    assert found.kind is ContactKind.NEVER
    assert min(0.01, 0.3 * gap) <= found.gap <= gap
    assert found.joints == ("slide", "swing")


@pytest.mark.parametrize("overlap", [0.0, 1e-6, 1e-4, 1e-3])
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


def test_a_pair_apart_in_a_few_configurations_is_not_always_overlapping(tmp_path: Path) -> None:
    """The ball reaches the base in all but the upper hundredth of the slide: most small samples miss that."""
    reach = math.sqrt(0.6**2 - 0.2**2)
    text = SMALL.replace('upper="0.2"', f'upper="{reach + 0.1 + 0.01}"')
    table = contact_table(Robot.from_urdf(small(tmp_path, text=text)), samples=1)
    assert kinds(table)["base", "block"] is ContactKind.SOMETIMES


@pytest.mark.parametrize("engine", [None, pytest.param(Processes(2), marks=pytest.mark.slow)])
def test_the_same_robot_gives_the_same_table_whoever_works_it_out(tmp_path: Path, engine: Engine | None) -> None:
    robot = Robot.from_urdf(small(tmp_path, -0.06))
    one, two = (contact_table(robot, samples=20, engine=each) for each in (None, engine))
    assert [(f.links, f.kind, f.reason, f.share, f.bounds) for f in one.findings] == [
        (f.links, f.kind, f.reason, f.share, f.bounds) for f in two.findings
    ]
    for a, b in zip(one.findings, two.findings, strict=True):
        assert (a.example is None) == (b.example is None)
        assert a.example is None or b.example is None or a.example.tolist() == b.example.tolist()


@pytest.mark.slow
def test_ctrl_c_ends_all_who_work_on_a_table(tmp_path: Path) -> None:
    """The proofs about the arm take longer than it takes to see both workers."""
    program = (
        "import os, sys\n"
        "from planner_service.parallel.processes import Processes\n"
        "from planner_service.robot_setup.import_robot import Source, import_robot\n"
        "lock = {'left_carriage_joint': 0.0, 'right_carriage_joint': 0.0}\n"
        "source = Source(sys.argv[1], locked_joints=lock)\n"
        "import_robot(source, sys.argv[2], prove=True, engine=Processes(2))\n"
    )
    urdf = data_folder("robots") / "wxai" / "wxai.urdf"
    out = tmp_path / "out"
    command = [sys.executable, "-c", program, str(urdf), str(out)]
    with subprocess.Popen(command, stderr=subprocess.DEVNULL) as child:
        workers: list[str] = []
        until = time.monotonic() + 30.0
        while len(workers) < 2 and time.monotonic() < until:
            workers = Path(f"/proc/{child.pid}/task/{child.pid}/children").read_text().split()
            time.sleep(0.05)
        child.send_signal(signal.SIGINT)
        assert child.wait(20.0) != 0
    assert len(workers) == 2
    assert not out.exists()
    assert not any(Path(f"/proc/{worker}").exists() for worker in workers)


def test_links_that_always_overlap_are_found_over_many_joints_too(tmp_path: Path) -> None:
    """Too many for a sweep: the trunk holds the tip, wherever the four joints between them are."""
    ball = solid("sphere", 'radius="0.05"')
    text = urdf(
        "nested",
        link("trunk", solid("sphere", 'radius="1.0"')) + link("stub", ball),
        link("one") + link("two") + link("tip", ball),
        joint("a", "revolute trunk stub -2 2"),
        joint("b", "revolute stub one -2 2", axis="0 1 0", xyz="0.1 0 0"),
        joint("c", "revolute one two -2 2", axis="0 1 0", xyz="0.1 0 0"),
        joint("d", "revolute two tip -2 2", axis="0 1 0", xyz="0.1 0 0"),
    )
    path = tmp_path / "nested.urdf"
    path.write_text(text)
    (found,) = contact_table(Robot.from_urdf(path), samples=50).of(ContactKind.ALWAYS)
    assert found.links == ("trunk", "tip")
    assert found.reason == (
        "always: the shapes overlap in each of 50 configurations drawn at random, which is no proof"
    )


def test_a_quick_table_allows_what_always_overlaps_and_leaves_the_rest_checked(tmp_path: Path) -> None:
    robot = Robot.from_urdf(small(tmp_path))
    quick, whole = quick_table(robot), contact_table(robot)
    assert [f.links for f in quick.findings] == [f.links for f in whole.findings]
    kept = (ContactKind.ADJACENT, ContactKind.ALWAYS)
    assert [f.links for f in quick.of(*kept)] == [f.links for f in whole.of(*kept)]
    assert {f.kind for f in quick.findings} == {*kept, ContactKind.UNPROVEN}


def test_contacts_that_are_given_keep_their_reasons_and_say_when_they_collide(tmp_path: Path) -> None:
    robot = Robot.from_urdf(small(tmp_path, -0.09))
    given = (AllowedContact(POST_BALL, "User"), AllowedContact(("ball", "base"), "Never"))
    table = contact_table(replace(robot, allowed_contacts=(*robot.allowed_contacts, *given)), samples=400)
    reasons = {f.links: f.reason for f in table.of(ContactKind.GIVEN)}
    assert reasons["base", "ball"] == "Never"
    assert reasons[POST_BALL].startswith("User; yet it collides in ")


def test_an_adjacent_pair_that_an_srdf_lists_too_is_listed_once(tmp_path: Path) -> None:
    robot = Robot.from_urdf(small(tmp_path))
    twice = (*robot.allowed_contacts, AllowedContact(("post", "base"), "Adjacent"))
    table = contact_table(replace(robot, allowed_contacts=twice), samples=1)
    assert len({frozenset(c.links) for c in table.allowed}) == len(table.allowed)
    assert kinds(table)["base", "post"] is ContactKind.ADJACENT


@pytest.mark.parametrize("value", [0, -1, 1.5, True])
def test_a_number_of_samples_or_bounds_that_is_none_is_refused(tmp_path: Path, value: int) -> None:
    robot = Robot.from_urdf(small(tmp_path))
    with pytest.raises(InvalidRequest, match="samples: got"):
        contact_table(robot, samples=value)
    with pytest.raises(InvalidRequest, match="max_bounds: got"):
        contact_table(robot, max_bounds=value)


@pytest.mark.slow
def test_the_adjacent_pairs_of_wxai_are_those_listed_by_hand(wxai: Robot, wxai_table: ContactTable) -> None:
    """But for links that the gripper's carriages move, or that are bolted on: these share a body with link_6 here."""
    found = {frozenset(finding.links) for finding in wxai_table.of(ContactKind.ADJACENT)}
    body = {shape.link: shape.body for shape in wxai.shapes}
    by_hand = {
        frozenset(contact.links)
        for contact in load_robot("wxai").allowed_contacts
        if contact.reason.startswith("adjacent") and len({body[link] for link in contact.links}) == 2
    }
    assert found == by_hand


def test_what_is_proven_never_to_touch_was_found_so_by_hand_too(wxai_table: ContactTable) -> None:
    never = {frozenset(finding.links) for finding in wxai_table.of(ContactKind.NEVER)}
    by_hand = {frozenset(c.links) for c in load_robot("wxai").allowed_contacts if c.reason.startswith("never")}
    assert never <= by_hand
    assert len(never) == 8


def test_what_is_proven_never_to_touch_does_not_in_5000_random_states(wxai: Robot, wxai_table: ContactTable) -> None:
    never = {frozenset(finding.links) for finding in wxai_table.of(ContactKind.NEVER)}
    bare = replace(wxai, allowed_contacts=())
    others = tuple(AllowedContact(pair, "") for pair in bare.link_pairs if frozenset(pair) not in never)
    checker = CollisionChecker(replace(bare, allowed_contacts=others), Scene())
    assert checker.pair_count > 0
    Q = np.random.default_rng(5).uniform(wxai.limits.lower, wxai.limits.upper, (5000, wxai.n))
    assert all(checker.state_is_free(q) for q in Q)


def test_examples_collide_and_shares_are_of_the_samples(wxai: Robot, wxai_table: ContactTable) -> None:
    checker = CollisionChecker(wxai, Scene())
    for finding in wxai_table.of(ContactKind.SOMETIMES):
        touching = {frozenset((c.a, c.b)) for c in checker.contacts(present(finding.example))}
        assert frozenset(finding.links) in touching
        assert finding.share * wxai_table.samples == pytest.approx(round(finding.share * wxai_table.samples))


def test_pairs_that_collide_at_home_are_named(wxai_table: ContactTable) -> None:
    at_home = {finding.links for finding in wxai_table.findings if finding.at_home}
    assert at_home == {("link_2", "link_4"), ("link_2", "link_5"), ("link_3", "link_5")}


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


def test_the_file_says_where_limits_come_from_and_what_is_judged(tmp_path: Path) -> None:
    text = import_robot(Source(small(tmp_path, -0.09)), tmp_path / "out", prove=True).path.read_text("utf-8")
    assert 'source = "URDF <limit>; convention: turn continuous, 6.2832 rad (a turn) either way"' in text
    assert 'source = "URDF <limit>; convention: 1 rad/s (0.1 m/s sliding) for turn, which has none"' in text
    assert (
        '"convention: 3.141596 rad/s^2 (0.5 m/s^2 sliding), usual in MoveIt configurations; URDF states none"' in text
    )
    assert (
        "# Checked, because they collide somewhere; with an example of turn, slide, swing:\n#   post x ball: coll"
        in text
    )
    assert all(c.isprintable() or c == "\n" for c in text)


def test_locked_joints_stand_where_they_were_locked(tmp_path: Path) -> None:
    urdf = small(tmp_path)
    path = import_robot(Source(urdf, locked_joints={"slide": 0.1}), tmp_path / "out").path
    direct = Robot.from_urdf(urdf, locked_joints={"slide": 0.1})
    loaded = load_robot(path)
    assert loaded.joint_names == ("turn", "swing")
    assert replace(loaded, allowed_contacts=direct.allowed_contacts).hash == direct.hash


def test_an_srdf_is_taken_with_its_reasons(tmp_path: Path) -> None:
    srdf = tmp_path / "small.srdf"
    rows = (
        '<disable_collisions link1="ball" link2="post" reason="User"/><disable_collisions link1="base" link2="post"/>'
    )
    srdf.write_text(f'<robot name="small">{rows}</robot>', "utf-8")
    robot = import_robot(Source(small(tmp_path), srdf), tmp_path / "out").robot
    assert {c.links: c.reason for c in robot.allowed_contacts}[POST_BALL] == "User"


def test_a_name_with_a_line_break_cannot_end_a_comment(tmp_path: Path) -> None:
    text = SMALL.replace('"ball"', '"ball&#10;settle_time = 9 \\ &quot;"').replace('"swing"', '"sw&#10;ing"')
    found = import_robot(Source(small(tmp_path, -0.09, text)), tmp_path / "out")
    assert found.robot.tool_frame == 'ball\nsettle_time = 9 \\ "'
    assert load_robot(found.path).settle_time == 0.0


def test_what_is_there_is_replaced_only_on_demand(tmp_path: Path) -> None:
    source, out = Source(small(tmp_path)), tmp_path / "out"
    first = import_robot(source, out).path.read_bytes()
    (out / "robot.toml").write_text("mine", "utf-8")
    with pytest.raises(InvalidRequest, match=r"robot\.toml'; expected a folder without it; --force replaces it"):
        import_robot(source, out)
    assert (out / "robot.toml").read_text("utf-8") == "mine"
    assert import_robot(source, out, force=True).path.read_bytes() == first


def test_a_urdf_that_lies_in_the_folder_already_is_left_alone(tmp_path: Path) -> None:
    urdf = small(tmp_path)
    before = urdf.read_bytes()
    found = import_robot(Source(urdf), tmp_path)
    assert (found.urdf, urdf.read_bytes()) == (urdf, before)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["robot.toml", "small.urdf"]


def test_nothing_is_written_for_a_robot_that_cannot_be_imported(tmp_path: Path) -> None:
    out = tmp_path / "out"
    shapeless = small(tmp_path, text='<robot name="r"><link name="a"/></robot>')
    with pytest.raises(InvalidFile, match="no link of the URDF has a collision shape"):
        import_robot(Source(shapeless), out)
    with pytest.raises(InvalidFile, match="no such file"):
        import_robot(Source(tmp_path / "none.urdf"), out)
    urdf = small(tmp_path)
    with pytest.raises(UnknownName, match="unknown joint 'slid'; did you mean 'slide'"):
        import_robot(Source(urdf, locked_joints={"slid": 0.0}), out)
    with pytest.raises(UnknownName, match="unknown tool frame 'bal'; did you mean 'ball'"):
        import_robot(Source(urdf, tool_frame="bal"), out)
    with pytest.raises(InvalidFile, match="cannot be written"):
        import_robot(Source(urdf), urdf)
    with pytest.raises(InvalidFile, match="cannot be written"):
        import_robot(Source(urdf), tmp_path / "missing" / "out")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["small.urdf"]


def test_a_urdf_called_like_the_file_to_write_is_refused(tmp_path: Path) -> None:
    urdf = small(tmp_path).rename(tmp_path / "robot.toml")
    with pytest.raises(InvalidRequest, match=r"another name than robot\.toml"):
        import_robot(Source(urdf), tmp_path / "out")
