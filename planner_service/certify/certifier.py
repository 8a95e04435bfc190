"""The proof that a whole curve is free, between samples too; it shares no code with the search or its kernel."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from types import NoneType
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from planner_service.certify import hulls, separation
from planner_service.certify import interval_proof as tree
from planner_service.certify import motion_bounds as motion_terms
from planner_service.certify.diagram import Diagram, Moving
from planner_service.certify.interval_proof import NO_LEAVES, EdgeProof, EdgeVerdict, Judged, Obstruction, Roots, Span
from planner_service.certify.kept_proof import Kept, KeptRefusal, prove_kept
from planner_service.certify.motion_bounds import Motion
from planner_service.certify.native.loading import load_proof
from planner_service.certify.pairs import ProofPairs, pairs_of_names
from planner_service.certify.separation import Bounds
from planner_service.constraints.values import Constraint, JointRange, ToolRegion
from planner_service.errors import BrokenInvariant, InvalidRequest, UnknownName
from planner_service.geometry.arrays import FloatArray, IntArray, joint_distance
from planner_service.geometry.validation import (
    copied_in,
    finite_numbers,
    function_or_none,
    instance,
    items,
    number,
    numbers,
    whole,
)
from planner_service.path.joint_path import JointPath
from planner_service.presentation.measures import range_text
from planner_service.robot.model import AllowedContact, Robot
from planner_service.scene.scene import Scene

__all__ = [
    "LIMIT_SLACK",
    "MARGIN",
    "MAX_OVERLAP",
    "Certificate",
    "Certifier",
    "Charge",
    "ExemptInterval",
    "Proof",
    "Prover",
    "Refusal",
    "Trail",
    "TubeProof",
    "Tubes",
    "certify",
    "clearance_text",
    "instruction_sets",
    "proof_terms",
    "proof_text",
]

Charge = Callable[[int], None]

LIMIT_SLACK = 1e-9
"""How far a waypoint may lie outside a joint limit by rounding, in rad or m."""

FREE, NOT_TAKEN = Judged(EdgeVerdict.FREE), Judged(None)

PROVEN, CLOSE, SPENT = range(3)
"""How a compiled proof ends; any other number means that a stretch was too short to be halved."""

MARGIN = 2e-6
"""Metres that a proof keeps beyond the padding: FCL and Coal are undefined below 1 um; rounding is a thousandth."""

MAX_PADDING = 0.1
"""Metres; more is a mistake in the unit."""

OVERLAP_SLACK = 5e-9
"""Metres by which a proof of an overlap is better than what it says: room for directions that are packed in a file."""

MAX_OVERLAP = 0.1
"""Metres by which a request may let pairs overlap at its start; more is a mistake in the unit."""

END_SLACK = 1e-9
"""Rounding by which an exempt stretch may end beyond the path."""

FREE_EDGE = EdgeProof(EdgeVerdict.FREE)

NANO = 1e9
"""Bounds are reported in whole nanometres, rounded to the safe side."""

CARRIED_TOGETHER = "carried together"
"""Why two objects on the tool are not judged: nothing moves them against each other."""


@dataclass(frozen=True)
class ExemptInterval:
    """A stretch of the path, in path length s, on which named pairs need not be apart, and why.

    Attributes:
        depth: Metres by which the pairs may overlap there: that they do so by no more is proven. None: they are not
            judged there at all.

    Raises:
        InvalidRequest: ``pairs`` are not pairs of two names, the ends are no numbers in order, or the depth is
            negative or not finite.
    """

    s_start: float
    s_end: float
    pairs: tuple[tuple[str, str], ...]
    reason: str
    depth: float | None = None

    def __post_init__(self) -> None:
        start = number("s_start", self.s_start, "a number >= 0", 0.0, math.inf)
        number("s_end", self.s_end, f"a number >= {start:.9g}", start, math.inf)
        object.__setattr__(self, "pairs", pairs_of_names("pairs", self.pairs))
        if self.depth is not None:
            number("depth", self.depth, "metres >= 0, or None", 0.0, sys.float_info.max)

    def __str__(self) -> str:
        pairs = ", ".join(f"{a} x {b}" for a, b in self.pairs)
        if self.depth is not None:
            where = f"from s = {self.s_start:.3f} to {self.s_end:.3f}"
            return f"overlapping by at most {self.depth * 1e3:.4f} mm {where}: {pairs} ({self.reason})"
        return f"not judged from s = {self.s_start:.3f} to {self.s_end:.3f}: {pairs} ({self.reason})"


@dataclass(frozen=True)
class Refusal:
    """Where a proof ended.

    Attributes:
        s_start: Where, in path length s, the stretch begins on which a pair could not be proven apart.
        s_end: Where it ends.
        s: Where on it.
        a: One of the pair, by name.
        b: The other.
        detail: Why, in words.
        spent: Whether there was no end to it, rather than a place where the two are too close.
    """

    s_start: float
    s_end: float
    s: float
    a: str
    b: str
    detail: str
    spent: bool = False

    def __str__(self) -> str:
        where = f"from s = {self.s_start:.6g} to {self.s_end:.6g}"
        return f"{self.what} is not proven apart {where}: {self.detail}"

    @property
    def what(self) -> str:
        """The pair, in words."""
        return f"{self.a} x {self.b}"


@dataclass(frozen=True)
class Certificate:
    """What was proven of a curve.

    Attributes:
        clearance: Metres that every judged pair keeps on the whole curve, a lower bound in whole nanometres; infinite
            when no pair is judged, and -inf for a refused curve.
        distances: (configuration, pair) bounds asked.
        padding: Every judged pair was proven farther apart than this and ``MARGIN``.
        exempt: Stretches on which named pairs were not judged, or proven to overlap by no more than a depth.
        refusal: None when the whole curve is proven, else the pair or the constraint that is not, and where.
        part: From where to where in s the curve was judged; None: all of it.
        allowed: Pairs that were judged nowhere because the caller allows them to touch, sorted.
        kept: What is proven of each constraint, in their order; none if one of them is refused.
        contacts: The pairs that were judged nowhere, each with its reason: of links with shapes that the robot allows
            to touch, and of objects that are carried together, which cannot move against each other. They follow from
            the robot and the scene of a plan file, so a certificate read from one has none itself.
    """

    clearance: float
    distances: int
    padding: float
    exempt: tuple[ExemptInterval, ...] = ()
    refusal: Refusal | KeptRefusal | None = None
    part: Span | None = None
    allowed: tuple[tuple[str, str], ...] = ()
    kept: tuple[Kept, ...] = ()
    contacts: tuple[AllowedContact, ...] = field(default=(), compare=False, repr=False)

    def __post_init__(self) -> None:
        copied_in(self, "exempt", "kept", "contacts")

    def __str__(self) -> str:
        if self.refusal is not None:
            return self.verdict
        return "; ".join([f"proven: {proof_text(self.clearance, self.distances)}", *map(str, self.kept)])

    @property
    def verdict(self) -> str:
        """The same without what it cost."""
        if self.refusal is not None:
            return f"refused: {self.refusal}"
        return "; ".join([f"proven: {clearance_text(self.clearance)}", *map(str, self.kept)])

    @property
    def certified(self) -> bool:
        """Whether the whole curve, or the part of it that was judged, is proven."""
        return self.refusal is None

    @property
    def unjudged(self) -> tuple[str, ...]:
        """Where pairs were not judged that neither the robot nor the caller allows to touch, in words."""
        together = [contact.links for contact in self.contacts if contact.reason == CARRIED_TOGETHER]
        return (*map(str, self.exempt), *(f"not judged: {a} x {b} ({CARRIED_TOGETHER})" for a, b in together))


def clearance_text(metres: float) -> str:
    """A proven clearance in words, rounded down."""
    if metres == math.inf:
        return "nothing to touch"
    return f"{math.floor(metres * 1e5) / 100:.2f} mm clear" if metres < 0.1 else f"{metres:.3f} m clear"


def proof_text(clearance: float, bounds: int) -> str:
    """What is proven of one or more motions: their smallest clearance in metres, and what it cost."""
    return f"{clearance_text(clearance)}, between samples too ({bounds:,} bounds)"


class Proof(NamedTuple):
    """The outcome of a proof: bounds computed, the smallest gap proven for any stretch, and where it failed, if so.

    ``leaves`` is what was proven, if that was asked for: rows of nine float64, the pair, from where to where in s,
    and unit directions at both ends from the second piece towards the first, in the second's axes; zero at an end where
    none was needed.
    """

    bounds: int
    proven: float
    obstruction: Obstruction | None
    leaves: bytes = b""


class Tubes(NamedTuple):
    """How many edges are free, the bounds that were asked, and of the edge after them a pair, where, and whether the
    edge itself collides, rather than what is within its room; the pair is -1 where all are free.
    """

    free: int
    bounds: float
    pair: int
    s: float
    collides: bool


class Prover:
    """Proves motions of one robot in one scene.

    Args:
        variant: One of ``instruction_sets()``; the fastest if empty.
    """

    def __init__(self, motion: Motion, variant: str = "") -> None:
        self._prover = load_proof().Prover(proof_terms(), *motion.tables, variant)

    def prove(
        self, path: JointPath, enough: float, roots: Roots, charge: Charge | None, *, tracing: bool = False
    ) -> Proof:
        """Prove that the pairs of ``roots`` are more than ``enough`` metres apart on their spans.

        If ``enough`` is negative, that they overlap by less.

        Args:
            path: The curve; no subclass, whose curve may be another one.
            charge: Called with the number of bounds before each batch; what it raises comes out unchanged.
            tracing: Keep what is proven as ``leaves``, and prove it by plain bounds of motions: those that are checked
                with the least effort.
        """
        spans = np.array(roots.spans, dtype=np.float64).reshape(-1, 2)
        walked = path.walked.tables if tracing else None
        outcome = self._prover.prove(*path.tables, spans, roots.rows, enough, charge, walked)
        bounds, most, proven, end, pair, start, stop, s, gap, leaves = outcome
        if end == PROVEN:
            return Proof(bounds, proven, None, leaves)
        detail = tree.too_close(s, gap, enough) if end == CLOSE else tree.no_end(most if end == SPENT else None)
        return Proof(bounds, proven, Obstruction(pair, (start, stop), s, detail, end == SPENT))

    def edge(self, q1: object, q2: object, enough: float, nearer: float) -> Judged:
        """The verdict on a straight edge; none if an end is not n float64 within the limits.

        Args:
            enough: Metres by which every pair must be proven apart, and more.
            nearer: Metres; a pair that is proven nearer collides.
        """
        if type(q1) is not np.ndarray or type(q2) is not np.ndarray:  # others may hide entries
            return NOT_TAKEN
        answer = self._prover.edge(q1, q2, enough, nearer, LIMIT_SLACK)
        if not answer.taken:
            return NOT_TAKEN
        return FREE if answer.free else Judged(EdgeVerdict(answer.verdict), answer.pair, answer.s)

    def tubes(
        self,
        starts: FloatArray,
        ends: FloatArray,
        room: FloatArray,
        enough: float,
        nearer: float,
        parts: int,
        each: int,
    ) -> Tubes:
        """How many edges from ``starts`` to ``ends`` are free with ``room``, (k, n) each, before the first that is not.

        Every pair is proven more than ``enough`` metres apart at whatever is off the edge by no more than its room in
        each joint. An edge itself on which a pair is nearer than ``nearer`` collides. ``parts`` of rooms may be looked
        at, for all edges together, where the whole of one is too much, and ``each`` for one pair on one edge.
        """
        return Tubes(*self._prover.tubes(starts, ends, room, enough, nearer, parts, each))

    def diagram(self, first: Moving, second: Moving, still: FloatArray, enough: float) -> Diagram:
        """What is proven of two motions on clocks of their own: every pair more than ``enough`` metres apart."""
        motions = [
            np.ascontiguousarray(table)
            for each in (first, second)
            for table in (each.q, each.travel, each.columns.astype(np.int64))
        ]
        durations = np.array([first.duration, second.duration])
        found: Diagram = self._prover.diagram(*motions, durations, np.ascontiguousarray(still), enough)
        return found

    def boxes(self, starts: FloatArray, ends: FloatArray, room: FloatArray, out: FloatArray) -> None:
        """Boxes that riding pieces do not leave on edges with room, low and high corner, into ``out`` (riding, 6)."""
        self._prover.boxes(starts, ends, room, out)

    def clearances(self, Q: FloatArray) -> FloatArray:
        """Lower bounds (metres) of the smallest gap at configurations Q (m, n), (m,); infinite if there are no pairs.

        Of a row that is not finite, and wherever a gap is no number, it is -infinity.
        """
        out = np.zeros(len(Q))
        self._prover.clearances(Q, out)
        return out

    def near(self, Q: FloatArray, pairs: IntArray, within: float) -> tuple[IntArray, IntArray, Bounds]:
        """Pairs less than ``within`` metres apart at configurations Q (m, n): rows of Q, pairs and signed gaps.

        A gap below 0 is an overlap of no more than that. Pairs with bundles are opened. Sorted by rows and pairs.
        """
        found = self._prover.near(np.ascontiguousarray(Q), np.ascontiguousarray(pairs, dtype=np.int64), within)
        table = np.frombuffer(found).reshape(-1, 6)
        table = table[np.lexsort((table[:, 1], table[:, 0]))]
        rows, near = table[:, :2].astype(np.intp).T
        return rows, near, Bounds(table[:, 2].copy(), table[:, 3:].T.copy())

    def stretch(self, path: JointPath, ends: Span, pairs: IntArray, directions: FloatArray) -> FloatArray:
        """What a proof knows of plain pairs (k,) between two places of a curve, metres, (k, 3).

        How far their pieces move against each other at most; how far points of both leave the straight lines between
        where they are at the two places, together, seen from the last body that carries both, infinite if that is not
        known; and a lower bound of their gap all along, by a direction that stays as it is for that body.

        Args:
            directions: At the first place, in the axes of the second pieces, (k, 3).
        """
        found = self._prover.stretch(*path.tables, *ends, np.ascontiguousarray(pairs, dtype=np.int64), directions)
        return np.frombuffer(found).reshape(-1, 3)


def instruction_sets() -> tuple[str, ...]:
    """Instruction sets of the compiled prover on this processor, the fastest last."""
    return tuple(load_proof().instruction_sets())


def proof_terms() -> list[float]:
    """The constants, in the order of ``Terms`` in native/model.hpp."""
    return [
        *(motion_terms.ROUNDING, separation.TINY, separation.SHIFT, separation.STEPS_PER_ROUND, separation.DRAWS),
        *(hulls.GAIN, hulls.SHARE, hulls.THIN, hulls.TINY),
        *(tree.FRACTION, tree.MAX_BOUNDS, tree.FAR, tree.BATCH, tree.NEAR, tree.CLOSE, tree.ROUNDS, tree.LAST_ROUNDS),
        *(tree.MAX_EDGE_BOUNDS, tree.OVERLAP_STEPS, tree.CERTAIN, motion_terms.CLEARANCE_ROUNDS),
    ]


@dataclass(eq=False)
class Trail:
    """The steps of a proof, recorded by the certifier that it is passed to.

    Attributes:
        path: The curve that was judged.
        motion: The poses of the pieces that were judged, and the numbers of the pairs of these.
        leaves: What is proven, as ``ProofTree`` has it, (k, 9), by pair and stretch.
    """

    path: JointPath | None = None
    motion: Motion | None = None
    leaves: FloatArray = field(default_factory=lambda: NO_LEAVES)


@dataclass(frozen=True)
class TubeProof:
    """How many edges, from the first on, are proven free with their room.

    Attributes:
        free: That number.
        distances: Bounds asked.
        pair: What is too near on the edge after them, by name; None if all are free.
        at: Where on that edge, (n,).
        gap: Metres between the pair there, at least; below 0 if they overlap.
        collides: Whether the edge itself collides, rather than something within its room.
    """

    free: int
    distances: int
    pair: tuple[str, str] | None = None
    at: tuple[float, ...] = ()
    gap: float = math.inf
    collides: bool = False


class Certifier:
    """Proves curves of one robot in one scene; build it once and use it for many.

    The pairs to prove apart are those that ``CollisionChecker`` checks, listed independently of it.

    Args:
        allowed: Pairs of links or objects that may touch, beside those that the robot and held objects allow.
        still: Joints that stand still on every curve. What nothing but these moves against each other is not judged.

    Attributes:
        robot: Its motions are proven.
        scene: What it must not touch.
        listed: The pairs to prove apart.
        motion: Their poses and motion bounds.
        prover: Proves them.

    Raises:
        UnknownName: ``still`` names no joint, a pair nothing that is there, or a touch link no link that has shapes.
        InvalidRequest: a pair names a link and an object at once, or something else than a Robot or a Scene is given.
    """

    def __init__(
        self, robot: Robot, scene: Scene, *, allowed: Iterable[tuple[str, str]] = (), still: Sequence[str] = ()
    ) -> None:
        self._allowed = tuple(sorted({(min(pair), max(pair)) for pair in pairs_of_names("allowed", allowed)}))
        self.robot = instance("robot", robot, Robot, "a Robot")
        self.scene = instance("scene", scene, Scene, "a Scene")
        shaped = {item.link for item in robot.shapes}
        standing = items("still", still, str, "a list of names of joints")
        for name in standing:
            if name not in robot.joint_names:
                raise UnknownName("joint", name, robot.joint_names)
        self._still = [robot.joint_names.index(name) for name in standing]
        self.listed = ProofPairs(robot, scene, self._allowed, self._still)
        self._contacts = (
            *(contact for contact in robot.allowed_contacts if shaped.issuperset(contact.links)),
            *(AllowedContact(pair, CARRIED_TOGETHER) for pair in self.listed.held_together(scene)),
        )
        self.motion = Motion(robot, self.listed)
        self.prover = Prover(self.motion)
        self._bounds = robot.bounds[0] - LIMIT_SLACK, robot.bounds[1] + LIMIT_SLACK
        self._whole = _rows(self.listed.roots)

    def certify(
        self,
        path: JointPath | ArrayLike,
        *,
        padding: float = 0.0,
        exempt: Sequence[ExemptInterval] = (),
        constraints: Sequence[Constraint] = (),
        part: Span | None = None,
        charge: Charge | None = None,
        trail: Trail | None = None,
    ) -> Certificate:
        """The proof that every judged pair is farther apart than ``padding`` on the whole of ``path``, or its refusal.

        Constraints are proven first: where one of them is refused, no pair is judged.

        Args:
            path: A path with or without blends, judged as the curve it is; or waypoints (N, n) of a polyline.
            exempt: Stretches on which pairs are not judged, or if they have a depth, proven to overlap by less. At the
                ends of a stretch they are judged, unless the path ends or another stretch begins there.
            constraints: What must hold on the whole of it, too; see ``prove_kept``.
            part: The interval of s to judge; None for the whole path.
            charge: Called with numbers of bounds, all in all what is counted: before each batch of them, but by the
                compiled prover once a millisecond at most, and with 0 while constraints are proven. What it raises
                passes through.
            trail: Filled with what the proof rests on. It asks for more bounds then: those of motions are plain ones
                that others check with little effort.

        Raises:
            InvalidRequest: a path of another class or number of joints or outside the joint limits, a padding outside
                [0, 0.1], or an exempt stretch or a part that is not on the path.
            UnknownName: an exempt pair names nothing that is there, or a constraint no link or joint of the robot.
        """
        padding = number("padding", padding, f"metres in [0, {MAX_PADDING:g}]", 0.0, MAX_PADDING)
        instance("trail", trail, (Trail, NoneType), "a Trail, or None")
        stretches = items("exempt", exempt, ExemptInterval, "a list of ExemptInterval")
        curve = path if isinstance(path, JointPath) else JointPath(numbers("path", path, "waypoints of shape (N, n)"))
        if type(curve) is not JointPath:
            raise InvalidRequest("path", type(curve).__name__, "a JointPath: a subclass may be another curve")
        if curve.n != self.robot.n:
            raise InvalidRequest("path", curve.n, f"a path of {self.robot.n} joints")
        function_or_none("charge", charge, "a function of a number")
        expected = "a sequence of ToolRegion and JointRange"
        demands: tuple[Constraint, ...] = items("constraints", constraints, (ToolRegion, JointRange), expected)
        checked_part = None if part is None else _part_of(curve.length, part)
        return self.proven(curve, padding, stretches, demands, checked_part, charge, trail)

    def proven(
        self,
        curve: JointPath,
        padding: float = 0.0,
        stretches: tuple[ExemptInterval, ...] = (),
        constraints: tuple[Constraint, ...] = (),
        checked_part: Span | None = None,
        charge: Charge | None = None,
        trail: Trail | None = None,
    ) -> Certificate:
        """``certify`` of a path of the robot's joints, and of values that are known to be of their kinds.

        Raises:
            InvalidRequest: As ``certify``, for what is outside the joint limits or not on the path.
            UnknownName: As ``certify``.
        """
        self._check_limits("waypoints", curve.waypoints)  # a blend stays in the triangle of its corner
        self._check_still(curve.waypoints)
        self._check_exempt(curve.length, stretches)
        judged = checked_part or (0.0, curve.length)
        kept = prove_kept(self.robot, curve, constraints, part=judged, charge=charge) if constraints else ()
        if isinstance(kept, KeptRefusal):
            return Certificate(
                -math.inf, 0, padding, stretches, kept, checked_part, self._allowed, contacts=self._contacts
            )
        roots = self._roots(judged, stretches)
        proof = self.prover.prove(curve, padding + MARGIN, roots, charge, tracing=trail is not None)
        parts = [proof]
        for depth in sorted({stretch.depth for stretch in stretches if stretch.depth is not None}, reverse=True):
            roots = self._overlapping(judged, [stretch for stretch in stretches if stretch.depth == depth])
            if parts[-1].obstruction is None and len(roots.rows):
                enough = OVERLAP_SLACK - depth
                parts.append(self.prover.prove(curve, enough, roots, charge, tracing=trail is not None))
        if trail is not None:
            leaves = np.concatenate([np.frombuffer(part.leaves).reshape(-1, 9) for part in parts])
            order = np.lexsort((leaves[:, 1], leaves[:, 0]))
            trail.path, trail.motion, trail.leaves = curve, self.motion, leaves[order]
        obstruction, refusal, clearance = parts[-1].obstruction, None, _floored(proof.proven)
        bounds = sum(part.bounds for part in parts)
        if obstruction is not None:
            at = np.asarray(curve(np.array([obstruction.s])))
            names, clearance = self._names_at(obstruction.pair, at), -math.inf
            refusal = Refusal(*obstruction.span, obstruction.s, *names, obstruction.detail, obstruction.spent)
        allowed, contacts = self._allowed, self._contacts
        return Certificate(clearance, bounds, padding, stretches, refusal, checked_part, allowed, kept, contacts)

    def certify_edge(self, q1: ArrayLike, q2: ArrayLike, *, padding: float = 0.0) -> EdgeProof:
        """The verdict on the straight edge from q1 to q2, (n,) each: proven free, proven to collide, or neither.

        Free means the same as for a path. Colliding means that somewhere on the edge a judged pair is proven nearer
        than ``padding`` less ``MARGIN``; with a padding of 0 the two overlap. Fewer than one in a thousand edges of a
        search are undecided. float64 arrays are the fastest to pass.

        Raises:
            InvalidRequest: ends of another shape, not finite or outside the joint limits, or a padding outside
                [0, 0.1].
        """
        padding = number("padding", padding, f"metres in [0, {MAX_PADDING:g}]", 0.0, MAX_PADDING)
        terms = (padding + MARGIN, padding - MARGIN)
        judged = self.prover.edge(q1, q2, *terms)
        if self._still:
            self._check_still(np.array([q1, q2]))
        if judged.verdict is None:
            judged = self.prover.edge(self._configuration("q1", q1), self._configuration("q2", q2), *terms)
            if judged.verdict is None:
                raise BrokenInvariant("a configuration that was checked is not taken")
        if judged.verdict is EdgeVerdict.FREE:
            return FREE_EDGE
        names = self.listed.names(judged.pair)
        if self.listed.is_crowd(judged.pair):
            at = JointPath(np.array([q1, q2], dtype=np.float64))(np.array([judged.s]))
            names = self._names_at(judged.pair, np.asarray(at))
        return EdgeProof(judged.verdict, judged.s, *names)

    def certify_tubes(
        self,
        starts: ArrayLike,
        ends: ArrayLike,
        room: ArrayLike,
        *,
        padding: float = 0.0,
        parts: int = 64,
        parts_each: int | None = None,
    ) -> TubeProof:
        """The proof that straight edges are free with room: at all that is off an edge by so much in each joint.

        Edges are judged in their order, up to the first that is not free.

        Args:
            starts: Configurations within the limits, (k, n).
            ends: The same.
            room: Radians (or metres) that each joint may be off the edge, even beyond its limits, (k, n).
            padding: Metres that every pair is to keep.
            parts: Where a room is too much as a whole it is halved in one joint after the other; so many parts are
                looked at for all edges together, at most 10,000. With 0 less is proven, in less time.
            parts_each: The same for one pair on one edge; ``parts`` if None. A part that asks many bounds counts as
                several of either.

        Raises:
            InvalidRequest: other shapes, numbers that are not finite, configurations outside the joint limits, room
                below 0, a padding outside [0, 0.1], or other parts.
        """
        padding = number("padding", padding, f"metres in [0, {MAX_PADDING:g}]", 0.0, MAX_PADDING)
        parts = whole("parts", parts, 0, 10_000)
        each = parts if parts_each is None else whole("parts_each", parts_each, 0, 10_000)
        first, last, off = self._tubes(starts, ends, room)
        found = self.prover.tubes(first, last, off, padding + MARGIN, padding - MARGIN, parts, each)
        if found.free == len(first):
            return TubeProof(found.free, int(found.bounds))
        line = np.array([first[found.free], last[found.free]])
        length = joint_distance(line[0].tolist(), line[1].tolist())
        at = line[0] + (line[1] - line[0]) * (found.s / length if length > 0.0 else 0.0)
        names = self._names_at(found.pair, at[None])
        gap = float(self.prover.near(at[None], np.array([found.pair]), math.inf)[2].gaps.min(initial=math.inf))
        return TubeProof(found.free, int(found.bounds), names, tuple(at.tolist()), gap, found.collides)

    def diagram(self, first: Moving, second: Moving, still: ArrayLike, *, padding: float = 0.0) -> Diagram:
        """What is proven of two motions whose clocks run each for itself; nothing is proven before it is asked.

        Args:
            still: Values of the joints that neither moves, (n,).
            padding: Metres that every pair is to keep.

        Raises:
            InvalidRequest: values outside the joint limits, joints that stand still or that both move, or a padding
                outside [0, 0.1].
        """
        padding = number("padding", padding, f"metres in [0, {MAX_PADDING:g}]", 0.0, MAX_PADDING)
        for name, motion in (("first", first), ("second", second)):
            instance(name, motion, Moving, "a motion of some joints")
        rest = numbers("still", still, f"joint values of shape ({self.robot.n},)")
        if rest.shape != (self.robot.n,):
            raise InvalidRequest("still", rest.shape, f"joint values of shape ({self.robot.n},)")
        both = set(first.columns.tolist()) & set(second.columns.tolist())
        if both:
            raise InvalidRequest("second", self.robot.joint_names[min(both)], "other joints than those of the first")
        for name, motion in (("first", first), ("second", second)):
            rows = np.repeat(rest[None], len(motion.q), axis=0)
            rows[:, motion.columns] = motion.q
            self._check_limits(name, rows)
            self._check_still(rows)
        return self.prover.diagram(first, second, rest, padding + MARGIN)

    def tube_boxes(self, starts: ArrayLike, ends: ArrayLike, room: ArrayLike) -> FloatArray:
        """Where straight edges with room take the robot: boxes along the axes of the base frame.

        Args:
            starts: As in ``certify_tubes``, one at least.
            ends: The same.
            room: The same.

        Returns:
            Of each convex piece of the links and what they hold the low and the high corner of a box that it does not
            leave, (pieces, 2, 3).

        Raises:
            InvalidRequest: as in ``certify_tubes``.
        """
        first, last, off = self._tubes(starts, ends, room)
        if not len(first):
            raise InvalidRequest("starts", first.shape, "one edge at least")
        boxes = np.zeros((len(self.listed.riding), 6))
        self.prover.boxes(first, last, off, boxes)
        return np.asarray(boxes.reshape(-1, 2, 3) + np.array([[-MARGIN], [MARGIN]]))

    def _tubes(self, starts: ArrayLike, ends: ArrayLike, room: ArrayLike) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Edges and their room, checked."""
        expected = f"configurations of shape (k, {self.robot.n})"
        given = {"starts": starts, "ends": ends, "room": room}
        first, last, off = (numbers(name, value, expected) for name, value in given.items())
        for name, rows in (("starts", first), ("ends", last), ("room", off)):
            if rows.ndim != 2 or rows.shape != (len(first), self.robot.n):
                raise InvalidRequest(name, rows.shape, f"{expected}, k the same for all")
        self._check_limits("starts", first)
        self._check_limits("ends", last)
        usable = (off >= 0.0) & (off < math.inf)
        if not usable.all():
            raise InvalidRequest("room", float(off[~usable][0]), "finite radians (or metres) >= 0")
        if self._still and len(first):
            self._check_still(np.concatenate([first, last]))
            if off[:, self._still].any():
                raise InvalidRequest("room", float(off[:, self._still].max()), "no room for joints that stand still")
        return np.ascontiguousarray(first), np.ascontiguousarray(last), np.ascontiguousarray(off)

    def clearances(self, Q: ArrayLike) -> FloatArray:
        """Proven lower bounds (metres) of the smallest gap of any judged pair at configurations Q (m, n), (m,).

        Negative where pieces may overlap, then by no more than that; infinite if no pair is judged.

        Raises:
            InvalidRequest: another shape, a number that is not finite or outside the joint limits.
        """
        rows = numbers("Q", Q, f"configurations of shape (m, {self.robot.n})")
        if rows.ndim != 2 or rows.shape[1] != self.robot.n:
            raise InvalidRequest("Q", rows.shape, f"configurations of shape (m, {self.robot.n})")
        self._check_limits("Q", rows)
        return self.prover.clearances(rows)

    def near(self, Q: FloatArray, within: float, pairs: IntArray | None = None) -> tuple[IntArray, IntArray, Bounds]:
        """As ``near_gaps``: of configurations Q (m, n) within the limits, and of all pairs if none are given."""
        return self.prover.near(Q, self.listed.roots if pairs is None else pairs, within)

    def overlaps(self, Q: FloatArray, pairs: IntArray | None = None) -> list[dict[tuple[str, str], float]]:
        """The pairs that are not proven apart, at each of configurations Q (m, n), and how deep they overlap at most.

        In metres by the names of the two, rounded up, and larger by what ``OVERLAP_SLACK`` takes.
        """
        rows, near, found = self.near(Q, MARGIN, pairs)
        out: list[dict[tuple[str, str], float]] = [{} for _ in Q]
        for row, pair, gap in zip(rows.tolist(), near.tolist(), found.gaps.tolist(), strict=True):
            names = self.listed.names(pair)
            out[row][names] = max(out[row].get(names, 0.0), (math.ceil(-gap * NANO) + 10.0) / NANO)
        return out

    def roots(self, length: float, exempt: Sequence[ExemptInterval] = ()) -> Roots:
        """What ``ProofTree`` is to prove of a path of that length.

        Raises:
            InvalidRequest: a length that is negative or not finite, or an exempt stretch that is longer.
            UnknownName: an exempt pair names nothing that is there.
        """
        length = number("length", length, "a finite length >= 0", 0.0, sys.float_info.max)
        stretches = items("exempt", exempt, ExemptInterval, "a list of ExemptInterval")
        self._check_exempt(length, stretches)
        return self._roots((0.0, length), stretches)

    def _roots(self, judged: Span, exempt: Sequence[ExemptInterval]) -> Roots:
        """The same of a part of a path."""
        spans: dict[Span, int] = {judged: 0}
        cuts: dict[frozenset[str], list[Span]] = {}
        for interval in exempt:
            for names in interval.pairs:
                cuts.setdefault(frozenset(names), []).append((interval.s_start, min(interval.s_end, judged[1])))
        if not cuts:
            return Roots(list(spans), self._whole)
        whole = self._opened(cuts)
        cut_at = {row: spans_cut for names, spans_cut in cuts.items() for row in self._rows_of(whole, names)}
        parts, after = [], 0
        for row in sorted(cut_at):
            pair, left = int(whole[row, 0]), _left_over(judged, cut_at[row])
            numbered = [(pair, spans.setdefault(span, len(spans))) for span in left]
            parts += [whole[after:row], np.array(numbered, dtype=np.intp).reshape(-1, 2)]
            after = row + 1
        return Roots(list(spans), np.concatenate([*parts, whole[after:]]) if parts else whole)

    def _overlapping(self, judged: Span, exempt: Sequence[ExemptInterval]) -> Roots:
        """What stretches with a depth say of the pairs that they name.

        The bounds of ``ProofTree`` hold for overlaps as for gaps: seen from b, no point of a moves by more than m, so
        along a direction fixed in b the least height of a over b sinks by no more than m, whatever its sign; and that
        height is never above the signed distance of the two, which is minus the shortest way out where they overlap.
        """
        spans: dict[Span, int] = {}
        rows: set[tuple[int, int]] = set()
        whole = self._opened({frozenset(names) for interval in exempt for names in interval.pairs})
        for interval in exempt:
            span = max(interval.s_start, judged[0]), min(interval.s_end, judged[1])
            if span[0] <= span[1]:
                number = spans.setdefault(span, len(spans))
                named = (row for names in interval.pairs for row in self._rows_of(whole, names))
                rows |= {(int(whole[row, 0]), number) for row in named}
        return Roots(list(spans), np.array(sorted(rows), dtype=np.intp).reshape(-1, 2))

    def _opened(self, named: Iterable[frozenset[str]]) -> IntArray:
        """Rows of all roots, those of pairs of names one by one."""
        roots = self.listed.opened(named)
        return self._whole if np.array_equal(roots, self.listed.roots) else _rows(roots)

    def _rows_of(self, whole: IntArray, names: Iterable[str]) -> list[int]:
        """Which rows have the pairs of two names."""
        rows: list[int] = np.flatnonzero(self.listed.are_of(whole[:, 0], names)).tolist()
        return rows

    def _names_at(self, pair: int, Q: FloatArray) -> tuple[str, str]:
        """The names of a pair; with a bundle of several obstacles, of that nearest at configuration Q (1, n)."""
        if self.listed.is_crowd(pair):
            _, pairs, found = self.prover.near(Q, np.array([pair]), math.inf)
            pair = int(pairs[int(found.gaps.argmin())]) if len(pairs) else pair
        return self.listed.names(pair)

    def _configuration(self, name: str, q: ArrayLike) -> FloatArray:
        values = numbers(name, q, f"{self.robot.n} joint values")
        if values.shape != (self.robot.n,):
            raise InvalidRequest(name, values.shape, f"{self.robot.n} joint values")
        self._check_limits(name, values[None])
        return values

    def _check_limits(self, name: str, rows: FloatArray) -> None:
        lower, upper = self.robot.bounds
        inside = (rows >= self._bounds[0]) & (rows <= self._bounds[1])  # False for NaN
        if not inside.all():
            row, joint = np.argwhere(~inside)[0].tolist()
            value = float(rows[row, joint])
            expected = f"{self.robot.joint_names[joint]} in {range_text(lower[joint], upper[joint], value)}"
            where = f"{name}[{joint}]" if name in ("q1", "q2") else f"{name}[{row}][{joint}]"
            raise InvalidRequest(where, value, expected)

    def _check_still(self, rows: FloatArray) -> None:
        for joint in self._still:
            if np.any(rows[:, joint] != rows[0, joint]):
                raise InvalidRequest("path", self.robot.joint_names[joint], "a joint that stands still")

    def _check_exempt(self, length: float, exempt: Iterable[ExemptInterval]) -> None:
        for interval in exempt:
            stretch = (interval.s_start, interval.s_end)
            if interval.s_end > length + END_SLACK:
                raise InvalidRequest("exempt", stretch, f"0 <= s_start <= s_end <= {length:.12g}")
            for name in (name for pair in interval.pairs for name in pair):
                self.listed.check_name("link or object", name)


def _rows(roots: IntArray) -> IntArray:
    """Roots on the first span."""
    return np.stack([roots, np.zeros_like(roots)], axis=1)


def certify(
    robot: Robot,
    scene: Scene,
    path: JointPath | ArrayLike,
    *,
    allowed: Iterable[tuple[str, str]] = (),
    padding: float = 0.0,
    exempt: Sequence[ExemptInterval] = (),
    constraints: Sequence[Constraint] = (),
) -> Certificate:
    """The proof of a path from anywhere, or its refusal: a ``JointPath``, or waypoints (N, n); see ``Certifier``."""
    return Certifier(robot, scene, allowed=allowed).certify(
        path, padding=padding, exempt=exempt, constraints=constraints
    )


def _floored(gap: float) -> float:
    return math.floor(gap * NANO) / NANO if math.isfinite(gap) else gap


def _part_of(length: float, part: Span) -> Span:
    """A part of a path, checked."""
    begin, end = finite_numbers("part", part, 2).tolist()
    if not 0.0 <= begin <= end <= length:
        raise InvalidRequest("part", (begin, end), f"0 <= begin <= end <= {length:.12g}")
    return begin, end


def _left_over(judged: Span, cut: Iterable[Span]) -> list[Span]:
    """What closed intervals leave of the judged one, with its ends."""
    start, length = judged
    if not length > start:
        return [] if any(low - END_SLACK <= start <= high + END_SLACK for low, high in cut) else [judged]
    out = []
    for low, high in sorted(span for span in cut if span[1] > span[0] and span[0] < length):
        if low > start:
            out.append((start, low))
        start = max(start, high)
    if start < length:
        out.append((start, length))
    return out
