"""What the certificate proves, refuses and is asked for, where the answer has a closed form."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from auditor.checker import IndependentChecker, tables_of
from planner_service.certify import MARGIN, Certificate, Certifier, ExemptInterval, Refusal, certify
from planner_service.certify import interval_proof as proof_tree
from planner_service.collision import CollisionChecker
from planner_service.errors import InvalidRequest
from planner_service.geometry.mesh import Mesh
from planner_service.geometry.shapes import Box, Pose, Sphere
from planner_service.path.joint_path import JointPath
from planner_service.robot_setup.loading import load_robot
from planner_service.scene.loading import load_scene
from planner_service.scene.scene import Attached, Obstacle, Scene
from tests.support.refusals import refused_pair
from tests.support.small_robots import SLIDER, built

ROOT = Path(__file__).parents[3]
PLANAR = load_robot("planar2")
WXAI = load_robot("wxai")
DISCS = load_scene("discs")
OPEN = Scene()
LESSON = np.array([[0.0, 0.0], [math.pi / 2, -math.pi / 2]])
"""Link 2 of the planar arm sweeps through the lesson's disc on this line, and through nothing else."""
SWEEP = np.array([[-0.5, 0.0], [0.5, 0.0]])
"""The outstretched planar arm turns about its shoulder."""
RIM = math.hypot(1.5, 0.01)
"""Radius of the circle on which the outermost points of the outstretched planar arm move."""
BALL = 0.05
MICRON = 1e-6


def ball_beyond(gap: float, angle: float = 0.123) -> Scene:
    """A ball that the outstretched planar arm passes at a distance of exactly ``gap``."""
    far = RIM + gap + BALL
    return Scene((Obstacle("ball", Sphere(BALL), Pose((far * math.cos(angle), far * math.sin(angle), 0.0))),))


def sheet_at(angle: float, radius: float = 1.45) -> Scene:
    """A sheet of 2 mm across the way of the outstretched planar arm, which meets its edge first."""
    place = (radius * math.cos(angle), radius * math.sin(angle), 0.0)
    return Scene((Obstacle("sheet", Box((0.05, 0.002, 0.05)), Pose.from_rpy(place, (0.0, 0.0, angle))),))


def refused(certificate: Certificate) -> Refusal:
    assert not certificate.certified
    assert certificate.clearance == -math.inf
    return refused_pair(certificate)


def test_a_free_curve_is_certified_and_its_clearance_is_the_gap_at_most() -> None:
    found = certify(PLANAR, ball_beyond(0.02), SWEEP)
    assert found.certified
    assert 0.5 * 0.02 < found.clearance <= 0.02


def test_a_gap_of_ten_microns_is_certified() -> None:
    for gap in [10 * MICRON, 100 * MICRON, 0.001, 0.03]:
        found = certify(PLANAR, ball_beyond(gap), SWEEP)
        assert found.certified
        assert MARGIN <= found.clearance <= gap


def test_a_gap_of_one_micron_is_refused_and_so_is_every_overlap() -> None:
    for gap in [MICRON, 0.0, -MICRON, -10 * MICRON, -0.001, -0.02]:
        refusal = refused(certify(PLANAR, ball_beyond(gap), SWEEP))
        assert {refusal.a, refusal.b} == {"forearm", "ball"}
        at = 0.5 + 0.123  # the ball meets the rim up to 0.02 rad before and after
        assert refusal.s_start - 0.05 <= at <= refusal.s_end + 0.05


@pytest.mark.parametrize("padding", [0.02])
def test_padding_is_the_distance_that_is_proven(padding: float) -> None:
    near, far = ball_beyond(padding + MICRON), ball_beyond(padding + 10 * MICRON)
    assert certify(PLANAR, far, SWEEP, padding=padding).clearance >= padding + MARGIN - 1e-9
    refused(certify(PLANAR, near, SWEEP, padding=padding))


def test_a_refusal_is_a_sentence() -> None:
    refusal = refused(certify(PLANAR, DISCS, LESSON))
    assert str(refusal).startswith("forearm x lesson_disc is not proven apart from s = ")
    assert " mm" in str(refusal)
    at_the_rim = 0.123 - math.atan2(0.01, 1.5)
    tight = str(refused(certify(PLANAR, ball_beyond(1.5 * MICRON), [[at_the_rim, 0.0]])))
    assert tight.endswith("at s = 0 a gap of 0.0015 mm is proven; more than 0.0020 mm is needed")


@pytest.mark.slow
def test_a_sheet_is_refused_wherever_it_stands() -> None:
    rng = np.random.default_rng(4)
    for angle, radius in zip(rng.uniform(-0.45, 0.45, 15), rng.uniform(0.2, 1.5, 15), strict=True):
        scene = sheet_at(angle, radius)
        second = IndependentChecker(ROOT / "robots" / "planar2", tables_of(scene))
        assert not second.path_is_free(SWEEP, 0.0002)
        refused(certify(PLANAR, scene, SWEEP))


def test_one_configuration_is_certified_by_itself() -> None:
    certifier = Certifier(PLANAR, ball_beyond(0.02, 0.0))
    found = certifier.certify(JointPath(np.zeros((1, 2))))
    assert found.certified
    assert found.distances == len(certifier.listed)
    assert 0.02 - 1e-5 < found.clearance <= 0.02 + 4e-5  # the rim stands 33 um beyond the axis
    assert not certify(PLANAR, ball_beyond(-0.02, 0.0), np.zeros((1, 2))).certified


def test_a_blend_is_judged_as_the_curve_it_is() -> None:
    corner = np.array([[-0.4, 0.0], [0.3, 0.0], [0.3, 0.7]])
    blended = JointPath(corner, np.array([0.0, 0.6, 0.0]))
    at_the_corner = ball_beyond(-0.001, 0.3)  # stretched out, the arm points there at the corner only
    refused(certify(PLANAR, at_the_corner, corner))
    assert certify(PLANAR, at_the_corner, blended).certified
    shoulder, elbow = blended(0.7)
    x = math.cos(shoulder) + 0.5 * math.cos(shoulder + elbow)
    y = math.sin(shoulder) + 0.5 * math.sin(shoulder + elbow)
    assert refused(certify(PLANAR, Scene((Obstacle("pin", Sphere(0.001), Pose((x, y, 0.0))),)), blended)).b == "pin"


def lesson_stretch() -> tuple[float, float]:
    """Where on the lesson's line link 2 is nearer than the proof's margin to the disc, in s, by the checker."""
    checker, path = CollisionChecker(PLANAR, DISCS), JointPath(LESSON)
    s = np.linspace(0.0, path.length, 20_001)
    hits = s[[not checker.state_is_free(q) for q in path(s)]]
    return float(hits[0]), float(hits[-1])


def test_an_exempt_stretch_is_not_judged_and_the_certificate_names_it() -> None:
    enters, leaves = lesson_stretch()
    stretch = ExemptInterval(enters - 0.01, leaves + 0.01, (("lesson_disc", "forearm"),), "meant")
    found = certify(PLANAR, DISCS, LESSON, exempt=[stretch])
    assert found.certified
    assert found.exempt == (stretch,)
    assert (
        str(stretch) == f"not judged from s = {enters - 0.01:.3f} to {leaves + 0.01:.3f}: lesson_disc x forearm (meant)"
    )


@pytest.mark.parametrize(("late", "early"), [(0.01, 0.0), (0.0, 0.01)], ids=["starts late", "ends early"])
def test_outside_an_exempt_stretch_its_pairs_are_judged(late: float, early: float) -> None:
    enters, leaves = lesson_stretch()
    pairs = (("lesson_disc", "forearm"),)
    stretch = ExemptInterval(enters - 0.01 + 2 * late, leaves + 0.01 - 2 * early, pairs, "meant")
    refusal = refused(certify(PLANAR, DISCS, LESSON, exempt=[stretch]))
    assert {refusal.a, refusal.b} == set(pairs[0])


def test_other_pairs_are_judged_on_an_exempt_stretch() -> None:
    length = JointPath(LESSON).length
    other = ExemptInterval(0.0, length, (("lesson_disc", "upper_arm"), ("forearm", "far_disc")), "meant")
    refused(certify(PLANAR, DISCS, LESSON, exempt=[other]))
    whole = ExemptInterval(0.0, length, (("lesson_disc", "forearm"),), "meant")
    assert certify(PLANAR, DISCS, LESSON, exempt=[whole]).certified


def test_an_exempt_point_exempts_nothing_but_a_path_of_one_point() -> None:
    at = sum(lesson_stretch()) / 2
    point = ExemptInterval(at, at, (("lesson_disc", "forearm"),), "meant")
    refused(certify(PLANAR, DISCS, LESSON, exempt=[point]))
    here = ExemptInterval(0.0, 0.0, (("lesson_disc", "forearm"),), "meant")
    assert certify(PLANAR, DISCS, [JointPath(LESSON)(at)], exempt=[here]).certified


def test_what_is_held_is_judged_against_obstacles_and_the_hand() -> None:
    ball = Attached("held", Sphere(0.02), Pose((0.1, 0.0, 0.0)))
    turn = np.array([[-0.5, 0.0], [0.5, 0.0]])
    ring = Scene((Obstacle("post", Sphere(0.01), Pose((1.6, 0.0, 0.0))),), (ball,))
    refusal = refused(certify(PLANAR, ring, turn))
    assert (refusal.a, refusal.b) == ("held", "post")
    inside = Scene((), (Attached("held", Sphere(0.02), Pose((-0.1, 0.0, 0.0))),))
    touched = Scene((), (Attached("held", Sphere(0.02), Pose((-0.1, 0.0, 0.0)), ("forearm",)),))
    refused(certify(PLANAR, inside, turn))
    assert certify(PLANAR, touched, turn).certified


def test_nothing_to_judge_is_certified_with_infinite_clearance() -> None:
    found = certify(PLANAR, OPEN, SWEEP)
    assert (found.certified, found.clearance, found.distances) == (True, math.inf, 0)


@pytest.mark.parametrize(("gap", "free"), [(10 * MICRON, True), (MICRON, False)])
def test_a_sliding_joint_is_proven_to_its_last_microns(tmp_path: Path, gap: float, free: bool) -> None:
    robot = built(tmp_path, SLIDER)
    away = 0.8 + 0.05 + gap + 0.01  # the rail points 0.3 rad to the left; the wall is 20 mm thick
    pose = Pose.from_rpy((away * math.cos(0.3), away * math.sin(0.3), 0.5), (0.0, 0.0, 0.3))
    wall = Scene((Obstacle("wall", Box((0.02, 0.3, 0.3)), pose),))
    found = certify(robot, wall, [[-0.7, 0.3], [0.8, -0.4]])
    assert found.certified == free
    if found.refusal:
        assert (refused(found).a, refused(found).b) == ("cart", "wall")


def test_every_bound_is_charged_before_it_is_asked_and_counted_once() -> None:
    asked: list[int] = []
    found = Certifier(PLANAR, DISCS).certify(JointPath(np.array([[0.0, 0.0], [-0.5, 0.3]])), charge=asked.append)
    assert sum(asked) == found.distances > 0


def test_a_curve_that_needs_too_many_bounds_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(proof_tree, "MAX_BOUNDS", 5)
    refusal = refused(certify(PLANAR, ball_beyond(10 * MICRON), SWEEP))
    assert refusal.detail.endswith("bounds did not suffice")
    assert refusal.spent
    assert refusal.s_start <= refusal.s <= refusal.s_end


def test_a_mistake_is_named() -> None:
    arguments: Any
    for arguments, told in [
        ({"path": JointPath(np.zeros((1, 3)))}, "path: got 3; expected a path of 2 joints"),
        ({"path": JointPath(np.array([[0.0, 0.0], [3.2, 0.0]]))}, r"waypoints\[1\]\[0\]: got 3\.2; expected shoulder"),
        ({"padding": -0.001}, "padding: got -0.001"),
        ({"padding": math.nan}, "padding: got nan"),
        ({"exempt": [ExemptInterval(0.0, 1.1, (), "")]}, "exempt: got"),
        ({"exempt": ExemptInterval(0.0, 0.1, (), "")}, "exempt: got .* expected a list of ExemptInterval"),
        ({"exempt": [(0.0, 0.1)]}, r"exempt\[0\]: got"),
    ]:
        certifier = Certifier(PLANAR, DISCS)
        with pytest.raises(InvalidRequest, match=told):
            certifier.certify(**{"path": JointPath(SWEEP), **arguments})


def test_an_impossible_exempt_stretch_is_refused() -> None:
    values: Any
    for values, told in [
        ((-0.1, 0.1, ()), "s_start: got -0.1"),
        ((0.2, 0.1, ()), "s_end: got 0.1; expected a number >= 0.2"),
        ((0.0, 0.1, (("forearm",),)), r"pairs: got \('forearm',\)"),
        ((0.0, 0.1, (("forearm", "forearm"),)), "pairs of two different"),
    ]:
        with pytest.raises(InvalidRequest, match=told):
            ExemptInterval(values[0], values[1], values[2], "")


def test_allowed_pairs_that_are_no_pairs_of_names_are_refused() -> None:
    allowed: Any
    for allowed in ["ab", [("forearm",)], [("forearm", "base", "x")], None, [1], {"forearm": "base"}]:
        with pytest.raises(InvalidRequest, match="allowed: got"):
            Certifier(PLANAR, DISCS, allowed=allowed)


def test_scenes_that_are_alike_but_for_names_differ_in_what_may_touch() -> None:
    """Pairs are kept for scenes of the same build: an allowance goes with its name, not with the place in the list."""
    arms = [link for link in PLANAR.links if any(shape.link == link for shape in PLANAR.shapes)]
    box = Box((0.1, 0.1, 0.1))
    for names in (("a", "b"), ("b", "a"), ("c", "d")):
        obstacles = [Obstacle(name, box, Pose((2.0, y, 0.0))) for name, y in zip(names, (0.0, 1.0), strict=True)]
        scene = Scene(tuple(obstacles))
        near = Scene(tuple(Obstacle(each.name, box, Pose((0.5, 0.0, 0.0))) for each in obstacles))
        free, usual = Certifier(PLANAR, scene).listed, CollisionChecker(PLANAR, near)
        every = {frozenset(free.names(k)) for k in range(len(free.plain))}
        for link in arms[-2:]:
            for name in names:
                pair, allowed = frozenset((link, name)), [(link, name)]
                listed = Certifier(PLANAR, scene, allowed=allowed).listed
                assert {frozenset(listed.names(k)) for k in range(len(listed.plain))} == every - {pair}
                lenient = CollisionChecker(PLANAR, near, allowed=allowed)
                assert lenient.pair_count == usual.pair_count - 1
                q = np.zeros(PLANAR.n)
                assert set(map(frozenset, lenient.touching(q))) == set(map(frozenset, usual.touching(q))) - {pair}


def test_thousands_of_far_obstacles_cost_less_than_a_bound_each() -> None:
    rng = np.random.default_rng(0)
    directions = rng.standard_normal((3000, 3))
    places = 4.0 * directions / np.linalg.norm(directions, axis=1)[:, None]
    far = tuple(Obstacle(f"far_{k}", Sphere(0.1), Pose((x, y, z))) for k, (x, y, z) in enumerate(places.tolist()))
    certifier = Certifier(PLANAR, Scene((*far, *DISCS.obstacles)))
    path = np.array([[0.0, 0.0], [-0.6, 0.3]])
    near, found = Certifier(PLANAR, DISCS).certify(path), certifier.certify(path)
    assert found.certified
    assert found.clearance >= 0.75 * near.clearance
    assert found.distances <= near.distances + len(far)


def test_a_long_compiled_proof_can_be_stopped_every_few_milliseconds() -> None:
    rng = np.random.default_rng(1)
    places = rng.uniform(-0.4, 0.4, (9_000, 3)) + np.array([1.45, 0.0, 0.0])
    near = tuple(Obstacle(f"near_{k}", Sphere(0.001), Pose((x, y, z))) for k, (x, y, z) in enumerate(places.tolist()))
    calls: list[int] = []
    found = Certifier(PLANAR, Scene(near)).certify(JointPath(SWEEP), charge=calls.append)
    assert sum(calls) == found.distances
    assert len(calls) > 3


def test_the_compiled_proof_includes_nothing_of_the_search() -> None:
    folder = ROOT / "planner_service" / "certify" / "native"
    sources = [path for path in folder.iterdir() if path.suffix in (".cpp", ".hpp", ".inc", ".h")]
    lines = [line for path in sources for line in path.read_text("utf-8").splitlines()]
    ours = {line.split('"')[1] for line in lines if line.startswith('#include "')}
    assert len(sources) > 5
    assert ours <= {path.name for path in sources}
    assert not [line for line in lines if "kernel" in line]


# Overlaps of a known depth.


def test_a_pair_is_proven_to_overlap_by_no_more_than_a_depth_and_by_nothing_less() -> None:
    """The arm turns away from a ball in which it begins 2 mm deep, and is 20 mm clear of it in the end."""
    deep, clear = (math.asin((BALL + 0.01 + gap) / 1.3) for gap in (-0.002, 0.02))
    ball = Obstacle("ball", Sphere(BALL), Pose((1.3, 0.0, 0.0)))
    certifier = Certifier(PLANAR, Scene((ball,)))
    path = JointPath(np.array([[deep, 0.0], [clear, 0.0]]))
    apart = math.asin((BALL + 0.01 + 1e-5) / 1.3) - deep

    def proof(depth: float | None, s_end: float = apart) -> Certificate:
        stretch = ExemptInterval(0.0, s_end, (("forearm", "ball"),), "it begins there", depth)
        return certifier.certify(path, exempt=[stretch])

    assert proof(0.002 + 1e-8).certified
    assert 0.7e-5 < proof(0.002 + 1e-8).clearance <= 1e-5
    refusal = refused_pair(proof(0.002 - 1e-8))
    assert (refusal.a, refusal.b) == ("forearm", "ball")
    assert "they overlap by at most 2.0000 mm; less than 2.0000 mm is allowed" in refusal.detail
    assert not proof(0.002 + 1e-8, 0.9 * apart).certified  # from there on it has to be apart


def test_overlaps_of_hulls_are_those_of_the_boxes_that_they_are() -> None:
    """A box and the hull of its corners, in many places in a box: the least way out is along a face or an edge pair."""
    rng = np.random.default_rng(0)
    half = np.array([0.02, 0.03, 0.05])
    corners = np.array([[x, y, z] for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)]) * half
    for _ in range(60):
        turn, place = rng.normal(size=4), rng.normal(size=3) * 0.01
        pose = Pose(tuple(place), tuple(turn / np.linalg.norm(turn)))
        depths = []
        for shape in (Box(tuple(2.0 * half)), Mesh(corners)):
            scene = Scene((Obstacle("thing", shape, pose @ Pose((1.25, 0.0, 0.0))),))
            (found,) = Certifier(PLANAR, scene).overlaps(np.array([[0.0, 0.0]]))
            depths.append(found)
        assert depths[0].keys() == depths[1].keys()
        for pair, depth in depths[0].items():
            assert depths[1][pair] == pytest.approx(depth, abs=1e-5)


def test_an_exempt_stretch_may_end_a_rounding_beyond_the_path() -> None:
    pairs = (("forearm", "lesson_disc"),)
    length = JointPath(LESSON).length
    assert certify(PLANAR, DISCS, LESSON, exempt=[ExemptInterval(0.0, length + 1e-12, pairs, "")]).certified


def test_a_joint_that_was_said_to_stand_still_is_not_moved_and_what_it_alone_moves_is_not_judged() -> None:
    first, second = PLANAR.joint_names
    still = Certifier(PLANAR, ball_beyond(-0.01), still=[first])  # which link 2 meets only if link 1 turns
    assert still.certify([[-0.5, 0.0], [-0.5, 0.2]]).certified
    assert not Certifier(PLANAR, ball_beyond(-0.01)).certify(SWEEP).certified
    for judge in (still.certify, lambda path: still.certify_edge(*np.array(path))):
        with pytest.raises(InvalidRequest, match=f"path: got '{first}'; expected a joint that stands still"):
            judge(SWEEP.tolist())
    wall = Scene((Obstacle("wall", Box((0.05, 0.05, 0.05)), Pose((0.5, 0.0, 0.0))),))  # on link 1
    touching = [[0.0, 0.0], [0.0, 0.2]]
    assert Certifier(PLANAR, wall, still=[first]).certify(touching).certified
    assert refused_pair(Certifier(PLANAR, wall, still=[second]).certify([[0.0, 0.0], [0.1, 0.0]]))
