"""Which links of a robot may touch, worked out from its shapes: a table to review, with a reason for every line."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import closing
from dataclasses import dataclass, replace

import numpy as np

from planner_service.collision import CollisionChecker
from planner_service.errors import BrokenInvariant
from planner_service.geometry.arrays import FloatArray
from planner_service.geometry.mesh import Mesh
from planner_service.geometry.validation import instance, whole
from planner_service.parallel.engine import Engine, Lost
from planner_service.parallel.sequential import Sequential
from planner_service.presentation.progress import bar
from planner_service.robot.model import AllowedContact, Robot
from planner_service.robot_setup.link_pair import (
    ContactKind,
    LinkPair,
    PairFinding,
    columns_between,
    listed,
    names_between,
    never_touches,
)
from planner_service.scene.scene import Scene

__all__ = [
    "SAMPLES",
    "ContactKind",
    "ContactTable",
    "PairFinding",
    "always_overlapping",
    "contact_table",
    "draws",
    "quick_table",
]


MAX_BOUNDS = 500_000
"""(box, pair of shapes) bounds per pair of links, about five seconds; a proof takes 100 to 100,000."""
SAMPLES = 1000
"""Configurations checked over the whole joint box: gives shares to a few per cent, in seconds."""
SWEPT, MAX_SWEPT_JOINTS = 4000, 3
"""Points of the sweep behind "always"; over more joints, so many points are too few."""
FIRST = 20
"""Configurations looked at before the rest: most pairs come apart in some of them."""
MOST_KEPT = 64
"""Robots whose always overlapping links are remembered."""
DRAWN = "configurations drawn at random, which is no proof"
ADJACENT = "adjacent"


@dataclass(frozen=True, eq=False)
class ContactTable:
    """What was found out about every pair of links with shapes on different bodies, in the order of the links."""

    findings: tuple[PairFinding, ...]
    samples: int

    @property
    def allowed(self) -> tuple[AllowedContact, ...]:
        """The pairs that need not be checked, with reasons."""
        return tuple(AllowedContact(f.links, f.reason) for f in self.findings if f.kind.allowed)

    def of(self, *kinds: ContactKind) -> tuple[PairFinding, ...]:
        """The findings of some kinds, kind by kind."""
        return tuple(finding for kind in kinds for finding in self.findings if finding.kind is kind)


def contact_table(
    robot: Robot,
    *,
    samples: int = SAMPLES,
    max_bounds: int = MAX_BOUNDS,
    engine: Engine | None = None,
    progress: bool | None = False,
) -> ContactTable:
    """The contacts that a robot should be allowed, its gripper standing as it does; the same in every run.

    Contacts that it is allowed already are kept: those whose reason begins with "adjacent" as such, others as given.
    Each pair is looked at by itself, so the table is the same whatever the engine. After Ctrl-C nothing goes on.

    Args:
        samples: Configurations checked over the whole joint box.
        max_bounds: Bounds computed for one pair of links before it is left unproven.
        engine: Where pairs are looked at, such as ``Processes()``; None: in this process.
        progress: Whether standard error shows how many pairs are done; None: if it is a terminal.

    Raises:
        InvalidRequest: ``samples`` or ``max_bounds`` is no positive integer.
    """
    instance("robot", robot, Robot, "a Robot")
    whole("samples", samples, 1, 1_000_000)
    whole("max_bounds", max_bounds, 1, 10**12)
    found, rest = _known(robot)
    if not rest:
        return ContactTable(tuple(found.values()), samples)
    bare = replace(robot, allowed_contacts=())
    given = {frozenset(contact.links): contact.reason for contact in reversed(robot.allowed_contacts)}
    hard = sorted(rest, key=lambda links: -len(columns_between(bare, links)))  # those that take longest first
    answers = (engine or Sequential()).run(_Findings(bare, given, samples, max_bounds), hard)
    with bar("pairs of links", progress) as tell, closing(answers):
        for done, finding in answers:
            if isinstance(finding, Lost):
                raise BrokenInvariant(f"no answer about {' x '.join(hard[done])}: {finding.detail}")
            found[hard[done]] = finding
            if tell is not None:
                tell(done + 1, len(hard))
    return ContactTable(tuple(found[links] for links in bare.link_pairs), samples)


def quick_table(robot: Robot, *, progress: bool | None = False) -> ContactTable:
    """As ``contact_table``, in seconds: pairs that do not always overlap are checked, whether they can touch or not."""
    instance("robot", robot, Robot, "a Robot")
    found, rest = _known(robot)
    always = {frozenset(contact.links): contact.reason for contact in always_overlapping(robot, progress=progress)}
    at_home = _touching(robot)
    for links in rest:
        names, pair = names_between(robot, links), frozenset(links)
        home = pair in at_home
        given = next((c.reason for c in robot.allowed_contacts if frozenset(c.links) == pair), None)
        kind = ContactKind.GIVEN if given else ContactKind.ALWAYS if pair in always else ContactKind.UNPROVEN
        reason = given or always.get(pair) or "whether they can touch was not looked at; --prove does"
        found[links] = PairFinding(links, kind, names, reason, at_home=home)
    bare = replace(robot, allowed_contacts=())
    return ContactTable(tuple(found[links] for links in bare.link_pairs), SAMPLES)


def _known(robot: Robot) -> tuple[dict[tuple[str, str], PairFinding], list[tuple[str, str]]]:
    """The findings on adjacent pairs of links, and the other pairs."""
    adjacent = {frozenset(c.links) for c in robot.allowed_contacts if c.reason.startswith(ADJACENT)}
    found, rest = {}, []
    for links in replace(robot, allowed_contacts=()).link_pairs:
        if frozenset(links) in adjacent:
            names = names_between(robot, links)
            found[links] = PairFinding(links, ContactKind.ADJACENT, names, f"adjacent: {listed(names)}")
        else:
            rest.append(links)
    return found, rest


@dataclass(frozen=True, eq=False)
class _Findings:
    """The work of finding out about a pair of links, for an engine."""

    robot: Robot
    given: Mapping[frozenset[str], str]
    samples: int
    max_bounds: int

    def prepare(self) -> None:
        """See ``Work``; there is nothing that pairs share but their samples."""

    def __call__(self, links: tuple[str, str]) -> PairFinding:
        """The finding on a pair that is not adjacent."""
        Q = draws(self.robot, self.samples)
        return _found(LinkPair(self.robot, links), Q, self.given.get(frozenset(links)), self.max_bounds)


_worked_out = dict[str, tuple[AllowedContact, ...]]()
"""By the hash of a robot."""


def always_overlapping(robot: Robot, *, progress: bool | None = None) -> tuple[AllowedContact, ...]:
    """The checked pairs that overlap wherever they were looked at, so that the robot would never be free.

    They overlap at home and in each of 1,000 configurations drawn over the whole joint box. Where at most three joints
    lie between them, they also overlap all over a dense sweep of these, as ``ContactKind.ALWAYS`` says. A pair that was
    ever seen apart is not among them. The same in every run; for a robot of the same content it is worked out once in a
    process. It is not kept on disk, where somebody could add a pair.

    Args:
        progress: Whether standard error shows how many pairs are done; None: if it is a terminal.
    """
    key = instance("robot", robot, Robot, "a Robot").hash
    if key in _worked_out:
        return _worked_out[key]
    at_home = _touching(robot)
    touching = [links for links in robot.link_pairs if frozenset(links) in at_home]
    Q = draws(robot, SAMPLES)
    found = []
    with bar("links that always overlap", progress if touching else False) as tell:
        for done, links in enumerate(touching, 1):
            pair = LinkPair(robot, links)
            if not any(pair.are_free(part).any() for part in (Q[:FIRST], Q[FIRST:])):
                reason = _always_overlaps(pair, SAMPLES)
                found += [AllowedContact(links, reason)] if reason else []
            if tell is not None:
                tell(done, len(touching))
    if len(_worked_out) == MOST_KEPT:
        _worked_out.clear()
    return _worked_out.setdefault(key, tuple(found))


def _touching(robot: Robot) -> set[frozenset[str]]:
    """The pairs of links that overlap at home."""
    return {frozenset((c.a, c.b)) for c in CollisionChecker(robot, Scene()).contacts(robot.home)}


def draws(robot: Robot, samples: int) -> FloatArray:
    """Configurations (samples, n) all over the joint box, the same in every run."""
    lower, upper = robot.limits.lower, robot.limits.upper
    unit = np.random.default_rng(0).random((samples, robot.n))
    return np.minimum(lower + (upper - lower) * unit, upper)


def _found(pair: LinkPair, Q: FloatArray, given: str | None, max_bounds: int) -> PairFinding:
    """The finding on a pair that is not adjacent: from the samples Q (m, n), else from a proof."""
    hits, at_home = pair.collides(Q), bool(pair.collides(pair.robot.home[None])[0])
    share = int(hits.sum()) / len(Q)
    words = f"collides in {100.0 * share:.1f} % of {len(Q):,} sampled configurations"
    seen = PairFinding(pair.links, ContactKind.SOMETIMES, pair.names, words, share, at_home=at_home)
    if share or at_home:
        seen = replace(seen, example=Q[hits.argmax()] if share else pair.robot.home)
    if given is not None:
        return replace(seen, kind=ContactKind.GIVEN, reason=f"{given}; yet it {words}" if share or at_home else given)
    if share == 1.0 and at_home and (reason := _always_overlaps(pair, len(Q))):
        return replace(seen, kind=ContactKind.ALWAYS, reason=reason)
    return seen if share or at_home else never_touches(pair, max_bounds)


def _always_overlaps(pair: LinkPair, drawn: int) -> str:
    """The reason to allow a pair that collides in all of the configurations ``drawn``; empty if it comes apart.

    Where few enough joints lie between, it has to collide all over a grid of them, too, limits included.
    """
    count, columns = len(pair.columns), pair.columns
    if count > MAX_SWEPT_JOINTS:
        return f"always: the shapes overlap in each of {drawn:,} {DRAWN}"
    each = max(side for side in range(2, SWEPT + 1) if side**count <= SWEPT)
    lower, upper = pair.robot.limits.lower[columns], pair.robot.limits.upper[columns]
    share = np.arange(each) / (each - 1)
    lines = [np.minimum(lo + (hi - lo) * share, hi) for lo, hi in zip(lower.tolist(), upper.tolist(), strict=True)]
    grid = np.stack([axis.ravel() for axis in np.meshgrid(*lines, indexing="ij")], axis=1)
    if pair.are_free(pair.configurations(grid)).any():
        return ""
    steps = ", ".join(f"{step:.2g}" for step in ((upper - lower) / (each - 1)).tolist())
    swept = f"{len(grid):,} points swept over {listed(pair.names)}, steps of {steps}"
    meshes = {item.link for item in pair.robot.shapes if isinstance(item.shape, Mesh)}
    filled = [link for link in pair.links if link in meshes]
    hulls = f"; {' and '.join(filled)} judged as the solid hull of the mesh, hollows filled" if filled else ""
    return f"always: the shapes overlap at each of {swept}{hulls}"
