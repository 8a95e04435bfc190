"""The compiled core (module.cpp)."""

from collections.abc import Callable, Mapping, Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

def instruction_sets() -> list[str]:
    """Those this processor can run, the fastest last."""

class _Check:
    """What is known of a configuration or an edge: one of the four is True.

    Attributes:
        refused: It was not checked: it is not in the form the kernel takes, or outside the joint limits.
        free: All of it is.
        colliding: A pair surely overlaps, by more than 0.1 mm.
        undecided: FCL decides: a pair is neither proven apart nor proven to overlap. Or not all rows were checked.
        fraction: Where on the edge it collides or is undecided, 0 to 1; 0 for a configuration of no edge.
        pair: Number of the first pair that collides, or that may.
    """

    @property
    def refused(self) -> bool: ...
    @property
    def free(self) -> bool: ...
    @property
    def colliding(self) -> bool: ...
    @property
    def undecided(self) -> bool: ...
    @property
    def fraction(self) -> float: ...
    @property
    def pair(self) -> int: ...

class RowCheck(_Check):
    """The first row that is not free, if there is one.

    Attributes:
        row: Its number.
        q: The configuration.
        pairs: Numbers of the pairs that may collide, in their order, up to the first that surely does.
    """

    @property
    def row(self) -> int: ...
    @property
    def q(self) -> list[float]: ...
    @property
    def pairs(self) -> list[int]: ...

class EdgeCheck(_Check):
    """How far an edge was checked.

    Attributes:
        judged: Rows found free, and the one that collides.
        ends: Ends that were to be judged: 1 for the first, 2 for the second, 3 for both.
        segments: Equal parts the edge is split into.
        rows: Where the rows that were to be judged end.
        next: The row to go on with if the edge is undecided.
    """

    @property
    def judged(self) -> int: ...
    @property
    def ends(self) -> int: ...
    @property
    def segments(self) -> int: ...
    @property
    def rows(self) -> int: ...
    @property
    def next(self) -> int: ...

class NearArrays:
    """What ``NearPairs`` holds, and how many pairs were measured."""

    @property
    def rows(self) -> NDArray[np.int64]: ...
    @property
    def pairs(self) -> NDArray[np.int64]: ...
    @property
    def distances(self) -> NDArray[np.float64]: ...
    @property
    def points(self) -> NDArray[np.float64]: ...
    @property
    def gradients(self) -> NDArray[np.float64]: ...
    @property
    def measured(self) -> int: ...

class CollisionKernel:
    """Checks configurations of one robot in one scene. Nothing in it changes once it is configured.

    Args:
        joints, solids, hulls, riders, turns, standers, positions, runs, pairs, count: See ``build_kernel``.
        margin: Metres by which a pair must be proven apart.
        variant: One of ``instruction_sets()``; the fastest if empty.
    """

    def __init__(
        self,
        joints: NDArray[np.float64],
        solids: NDArray[np.float64],
        hulls: Sequence[NDArray[np.float64]],
        riders: NDArray[np.float64],
        turns: NDArray[np.float64],
        standers: NDArray[np.int64],
        positions: NDArray[np.float64],
        runs: NDArray[np.int64],
        pairs: NDArray[np.int64],
        count: int,
        margin: float,
        variant: str = "",
    ) -> None: ...
    @property
    def variant(self) -> str:
        """The instruction set it uses."""

    def configure(
        self,
        lower: Sequence[float],
        upper: Sequence[float],
        table_lower: Sequence[float],
        table_upper: Sequence[float],
        reach: Sequence[float],
        *,
        motion_steps: Sequence[float],
        joint_steps: Sequence[float],
        coarse_segments: int,
    ) -> None:
        """Set what ``check_state`` and ``check_edge`` need: joint limits, and the steps, of which the finest holds.

        Args:
            coarse_segments: Segments between two samples of a coarse check.
        """

    def check_state(self, q: ArrayLike, /) -> RowCheck:
        """Check one configuration; refused unless it is a tuple or an array of n floats within the limits."""

    def check_edge(self, q1: ArrayLike, q2: ArrayLike, known: int, samples: int, max_rows: int) -> EdgeCheck:
        """Check an edge; refused unless its ends are as in ``check_state`` and it has at most 1,000,000 segments.

        Args:
            known: Ends that are not judged, the value of a ``Known``.
            samples: Which samples are judged, the value of a ``Samples``.
            max_rows: How many rows to judge at most; the edge is undecided if there are more.
        """

    def check_rows(self, Q: NDArray[np.float64], start: int, stop: int, /) -> RowCheck:
        """Check rows [start, stop) of Q (m, n)."""

    def check_edge_rows(
        self, a: Sequence[float], b: Sequence[float], ends: int, segments: int, start: int, stop: int, /
    ) -> RowCheck:
        """Check rows [start, stop) of an edge: the ends to judge (1 for a, 2 for b), then the interior."""

    def candidates(self, Q: NDArray[np.float64], /) -> tuple[list[int], list[int]]:
        """Rows of Q (m, n) and numbers of their pairs that are not proven apart, sorted by row, then pair."""

    def near(self, Q: NDArray[np.float64], within: float, /) -> NearArrays:
        """All pairs nearer than ``within`` metres at rows of Q (m, n), by row. Equal bits on every processor."""

class Oracle:
    """What compiled searching and smoothing ask; see search/oracle.hpp. Any of its answers may raise."""

    def state_is_free(self, q: Sequence[float], /) -> bool: ...
    def edge_is_free(self, a: Sequence[float], b: Sequence[float], known: int, /) -> bool: ...
    def edge_is_free_coarse(self, a: Sequence[float], b: Sequence[float], known: int, /) -> bool: ...

class AskedOracle(Oracle):
    """An oracle behind functions, which take configurations as tuples and known ends as numbers.

    Args:
        state, edge: Whether a state or an edge is free.
        coarse: As ``edge``, at a first look; None if there is none.
        last: Of the collision found last where it was on its edge, and a number.
        poll: Called often; what it raises ends the call.
    """

    def __init__(
        self,
        state: Callable[[tuple[float, ...]], bool],
        edge: Callable[[tuple[float, ...], tuple[float, ...], int], bool],
        coarse: Callable[[tuple[float, ...], tuple[float, ...], int], bool] | None,
        last: Callable[[], tuple[float, int]],
        poll: Callable[[], None],
    ) -> None: ...

class EdgeOracle(Oracle):
    """What compiled searches ask: ``SearchOracle.core`` (search/problem.py). Used by one thread at a time.

    Args:
        kernel: Configured for edges.
        starts, goals: Configurations at which motions are counted apart.
        decide: The first pair that touches at a configuration, given those in doubt there; -1 if none does.
        poll: Raises if the call is over its time or cancelled; called every few milliseconds.
        split: Equal parts of an edge with some joint differences; None if the kernel splits edges by its own rules.
    """

    def __init__(
        self,
        kernel: CollisionKernel,
        starts: Sequence[tuple[float, ...]],
        goals: Sequence[tuple[float, ...]],
        decide: Callable[[list[float], list[int]], int],
        poll: Callable[[], None],
        split: Callable[[list[float]], int] | None,
    ) -> None: ...
    def allow(self, room: int, poll_first: bool, /) -> None:
        """Set how many states may be judged, below 0 any number, and whether ``poll`` is called before the first."""

    def take(self) -> tuple[int, int, dict[int, int]]:
        """States and edges judged since the last time, and how often which pair, by its number, collided."""

    @property
    def spent(self) -> bool:
        """Whether the last question ended since no more states might be judged."""

    @property
    def refused(self) -> tuple[list[float], list[float]] | None:
        """The edge that the last question ended at, which leaves the joint limits or has too many samples."""

    @property
    def last_fraction(self) -> float:
        """Where the collision found last is on its edge."""

    @property
    def last_pair(self) -> int:
        """The pair that collided last, by its number."""

    @property
    def motions(self) -> tuple[tuple[int, int], tuple[int, int]]:
        """Free and colliding motions tried at starts, then at goals."""

class TieredOracle(Oracle):
    """``TieredOracle`` of search/problem.py: what its oracles judge is counted by ``roomy``.

    Args:
        roomy: Judges what is not near one of the ends.
        tight: The oracle of each end that needs less padding; kept alive by the caller.
        near_end: Radians from such an end in which its oracle judges.
    """

    def __init__(
        self, roomy: EdgeOracle, tight: Sequence[tuple[Sequence[float], EdgeOracle]], near_end: float
    ) -> None: ...

class ConstrainedOracle(Oracle):
    """``ConstrainedOracle`` of search/problem.py."""

    def __init__(self, oracle: Oracle, projector: Projector) -> None: ...

class BalancedSearch:
    """One search as ``BalancedRRTConnect`` describes it; releases the interpreter's lock."""

    def __init__(
        self,
        oracle: Oracle,
        lower: Sequence[float],
        upper: Sequence[float],
        weights: Sequence[float],
        range: float,
        seed: int,
        projector: Projector | None = None,
        longest: float = ...,
    ) -> None: ...
    def run(self, start: Sequence[float], goals: Sequence[Sequence[float]], /) -> list[list[float]]:
        """A path from the start to the goal reached first; only an exception ends it without one."""

    def grown(self) -> tuple[list[list[float]], list[tuple[int, int]]]:
        """The milestones of both trees, and which of them are joined."""

def shortcut(
    waypoints: NDArray[np.float64], oracle: Oracle, draws: Sequence[float], misses: int, /
) -> NDArray[np.float64]:
    """``smoothing.shortcut`` with two draws for each of the tries."""

def shortcut_on(
    waypoints: NDArray[np.float64], oracle: ConstrainedOracle, draws: Sequence[float], misses: int, longest: float
) -> NDArray[np.float64]:
    """The polyline (M, n) that ``shortcut_on_constraints`` makes of one (N, n), with two numbers for each try."""

def pulled_in(waypoints: NDArray[np.float64], oracle: Oracle, /) -> NDArray[np.float64]:
    """``smoothing.pulled_in``."""

def without_short_pieces(waypoints: NDArray[np.float64], oracle: Oracle, /) -> NDArray[np.float64]:
    """``smoothing.without_short_pieces``."""

def blend_widths(
    waypoints: NDArray[np.float64],
    knots: NDArray[np.float64],
    tangents: NDArray[np.float64],
    corners: Sequence[int],
    sizes: NDArray[np.float64],
    oracle: Oracle,
    least: float,
    /,
) -> list[float]:
    """The width of the blend at each corner as ``smoothing.blended`` finds it, 0 for a stop."""

class Projector:
    """Keeps configurations and edges on constraints (kinematics/constraint_set.py).

    Args:
        table: ``Robot.body_table``.
        bodies: Of each body but the base its parent, joint, whether it slides, axis, and multiplier (k, 7).
        lower, upper: The joint limits (n,).
        regions: The numbers of each region, its reach and its turns (r, 37 + 2 n).
    """

    def __init__(
        self,
        table: NDArray[np.float64],
        bodies: NDArray[np.float64],
        lower: NDArray[np.float64],
        upper: NDArray[np.float64],
        regions: NDArray[np.float64],
    ) -> None: ...
    def share(self, q: Sequence[float]) -> float:
        """The largest share of a tolerance that is used at q (n,)."""

    def project(self, q: Sequence[float]) -> tuple[float, ...] | None:
        """A configuration near q that keeps them with room; None if there is none."""

    def keeps(self, a: Sequence[float], b: Sequence[float]) -> bool:
        """Whether the edge from a to b keeps them."""

    def step(
        self,
        start: Sequence[float],
        end: Sequence[float],
        target: Sequence[float],
        distance: float,
        step: float,
        fixed: bool,
    ) -> tuple[float, ...] | None:
        """Where a step ends that was to lead from ``start`` to ``end``, on the way to a target ``distance`` away.

        That is ``end``, projected unless it is ``fixed``; None if it is not nearer to the target then, or the edge does
        not keep the constraints.
        """

    def take(self) -> int:
        """How often ``project`` was called since the last time this was asked."""

def body_poses(table: NDArray[np.float64], q: NDArray[np.float64]) -> NDArray[np.float64]:
    """Pose of every body (b, 12): ``BodyPose`` (robot/kinematic_tree.py).

    Args:
        table: ``BodyTree.table``.
        q: Finite joint values (n,).

    Raises:
        ValueError: They are not finite.
    """

def body_poses_batch(table: NDArray[np.float64], q: NDArray[np.float64], portable: bool) -> NDArray[np.float64]:
    """For configurations (m, n): body, column of T, row of T, configuration (b, 4, 3, m).

    Args:
        portable: With sines that have the same bits on every processor.
    """

class ClosedLoop:
    """An arm whose configurations for a pose are found completely (kinematics/complete_inverse.py).

    Args:
        joints: From the base to the tool, of each whether it slides, its entry of q, its multiplier, and its axis and a
            point on the axis at q = 0 (m, 9).
        tool: Rows of the tool's pose at q = 0 (12,).
        lower, upper: Where it is searched (n,).
    """

    def __init__(
        self,
        joints: NDArray[np.float64],
        tool: NDArray[np.float64],
        lower: NDArray[np.float64],
        upper: NDArray[np.float64],
    ) -> None: ...
    def solve(
        self,
        rows: NDArray[np.float64],
        axis: Sequence[float],
        wanted: int,
        position_error: float,
        turn_error: float,
        most_boxes: int,
    ) -> tuple[NDArray[np.float64], NDArray[np.float64], int, NDArray[np.float64]]:
        """Solutions (k, 5, n), boxes in doubt (u, 2, n), how many boxes were looked at, and witnesses (w, n).

        Of each solution q, the lower and upper values of its box, and of the larger box in which it is alone. Witnesses
        are in boxes in doubt, and their tool is at the target.

        Args:
            rows: Of the target (12,).
            axis: In the tool frame; for ``wanted`` 1.
            wanted: 0 for the pose, 1 for position and axis, 2 for the position.
        """

    def arcs(
        self,
        rows: NDArray[np.float64],
        axis: Sequence[float],
        wanted: int,
        position_error: float,
        turn_error: float,
        most_boxes: int,
    ) -> tuple[NDArray[np.float64], NDArray[np.float64], int]:
        """Of an arm with one joint more than equations: arcs, boxes in doubt and boxes seen.

        Arcs (k, 2 + 4 n): the joint, its reach, q, the direction, and half widths of the box and of where it is alone.
        """

    def shown(
        self,
        rows: NDArray[np.float64],
        axis: Sequence[float],
        wanted: int,
        position_error: float,
        turn_error: float,
        most_boxes: int,
    ) -> tuple[
        NDArray[np.float64],
        NDArray[np.float64],
        int,
        NDArray[np.float64],
        NDArray[np.float64],
        NDArray[np.float64],
        NDArray[np.float64],
        NDArray[np.float64],
    ]:
        """``solve``, and what shows it: steps (s, 6), sums (t, 14), equations (e, 6) and what they follow (f, 5)."""

    def reached_in(
        self,
        rows: NDArray[np.float64],
        axis: Sequence[float],
        wanted: int,
        position_error: float,
        turn_error: float,
        box: NDArray[np.float64],
    ) -> NDArray[np.float64]:
        """A configuration (1, n) of a box (2, n) whose tool is at the target, by steps from its middle; or (0, n)."""

    def cover(
        self,
        centres: NDArray[np.float64],
        half: NDArray[np.float64],
        rows: NDArray[np.float64],
        axis: Sequence[float],
        wanted: int,
        errors: tuple[float, float],
        offsets: NDArray[np.int64],
        boxes: NDArray[np.float64],
        obstructed: Obstructed | None,
        width: float,
        most: tuple[int, int],
        most_near: int,
        threads: int,
    ) -> tuple[NDArray[np.uint8], NDArray[np.int64], NDArray[np.float64], NDArray[np.int64], NDArray[np.float64]]:
        """What can bring the tool into each of k boxes of positions.

        Returns whether boxes of joint values were dropped because they collide (k,); those that are left (b, 2, n), of
        each from one offset (k + 1,) to the next; and configurations (c, n) whose tool is there, likewise.

        Args:
            centres: Of the boxes of positions (k, 3).
            half: Half of their sides (3,).
            rows: Of a target whose orientation is wanted (12,).
            errors: Metres by which a position may be outside, radians by which the tool may be turned.
            offsets: Where in ``boxes`` those of each begin (k + 1,).
            boxes: Of joint values, to begin with (b, 2, n).
            width: Of boxes of joint values that are not split (rad).
            most: Such boxes of one box of positions from which on none is split; boxes looked at, likewise.
            most_near: In how many of them a configuration is looked for.
            threads: How many work; that changes nothing.
        """

class Obstructed:
    """Convex solids of which some pairs collide where they overlap (native/kinematics/obstruction.hpp).

    Args:
        solids: Of each the link, kind, size (3,), frame (12,), and the ball around it (4,), as rows (s, 21).
        ball_offsets, balls: Balls inside of each (b, 4), and where those of each begin (s + 1,).
        plane_offsets, planes: Planes that each is behind (p, 4), likewise.
        pairs: (k, 2).
    """

    def __init__(
        self,
        solids: NDArray[np.float64],
        ball_offsets: NDArray[np.int64],
        balls: NDArray[np.float64],
        plane_offsets: NDArray[np.int64],
        planes: NDArray[np.float64],
        pairs: NDArray[np.int64],
    ) -> None: ...

class ToolArm:
    """An arm as inverse kinematics sees it (kinematics/tool_arm.py).

    Args:
        table: ``Robot.body_table``.
        chain: Of each body from the tool to the base its number, joint, whether it slides, axis, and multiplier (k, 7).
        tool: Rows of T_body_tool (12,).
        scale: Radians that a metre counts as.
        lower, upper: The joint limits (n,).
        closed_form: The numbers of ``ClosedForm`` (native/kinematics/line.hpp); empty for an arm without one.
        hypot: ``math.hypot``.
    """

    def __init__(
        self,
        table: NDArray[np.float64],
        tool_body: int,
        chain: NDArray[np.float64],
        tool: NDArray[np.float64],
        scale: float,
        lower: NDArray[np.float64],
        upper: NDArray[np.float64],
        closed_form: Sequence[float],
        hypot: Callable[..., float],
    ) -> None: ...
    def descend(
        self,
        target: NDArray[np.float64],
        starts: NDArray[np.float64],
        lower: NDArray[np.float64],
        upper: NDArray[np.float64],
        steps: int,
    ) -> tuple[NDArray[np.float64], list[bool]]:
        """Where the starts (m, n) end, within bounds (n,), on their way to tool rows ``target`` (12,); which arrive."""

    def solve(self, pose: Sequence[float], near: Sequence[ArrayLike]) -> list[list[float]]:
        """Every configuration for a pose (position, quaternion) by the closed form, verified by forward kinematics.

        Those that reach forward come before those backwards. A pose may leave an angle free (approach axis parallel to
        the shoulder's axis, or wrist above the waist): then an even spread of infinitely many, after those with the
        angles of ``near``.
        """

    def determined(self, pose: Sequence[float]) -> bool:
        """Whether a pose leaves no angle free: then ``solve`` returns every solution there is."""

    def walk(
        self, begin: Sequence[float], end: Sequence[float], start: NDArray[np.float64], points: int
    ) -> tuple[NDArray[np.float64], list[float], float | None, list[float]]:
        """The line between two poses (position, quaternion): waypoints, and the share of it behind each.

        If it ends early, also the share at which the pose is that was not reached, and the nearest configuration there,
        if there is one.
        """

    def thinned(self, waypoints: NDArray[np.float64], stops: Sequence[int]) -> list[int]:
        """The rows that keep the tool on its line, ``stops`` among them."""

def farthest(
    points: NDArray[np.float64], directions: NDArray[np.float64], reached: NDArray[np.float64], /
) -> NDArray[np.float64]:
    """The largest component of points (n, 3) along each unit vector of (k, 3), (k,), or ``reached`` (k,) if larger."""

def laid_polyline(
    points: NDArray[np.float64], merged: bool, /
) -> tuple[list[int] | None, NDArray[np.float64], NDArray[np.float64], tuple[int, ...]] | None:
    """The points that stay (None: all), knots, tangents and inner points that turn; None if something is not finite.

    Args:
        points: Shape (N, n).
        merged: Whether points that coincide with the one before them are left out; the ends stay.
    """

def laid_blends(
    waypoints: NDArray[np.float64],
    knots: NDArray[np.float64],
    tangents: NDArray[np.float64],
    turns: Sequence[int],
    widths: Sequence[float],
    /,
) -> tuple[int, int, tuple[NDArray[np.generic], ...] | None]:
    """The corner with a blend that turns back, the first of two waypoints whose blends overlap, or else, both being -1,
    the tables of the curve: blends, breaks, lines and rows of the pieces, and the table of ``JointPath.tables``."""

def polyline_length(points: NDArray[np.float64], /) -> float:
    """The L2 length of a polyline (N, n): the exact sum of its steps, rounded once."""

def turns_back(tangents: NDArray[np.float64], /) -> bool:
    """Whether a corner almost turns back, with the tangents before and after it (2, n)."""

Peak = tuple[float, int, float]
"""Ratio to the limit, joint and time, as in ``trajectory.Peak``."""

def time_path(
    waypoints: NDArray[np.float64],
    knots: NDArray[np.float64],
    tangents: NDArray[np.float64],
    breaks: NDArray[np.float64],
    lines: NDArray[np.int64],
    rows: NDArray[np.int64],
    blends: NDArray[np.float64],
    corners: Sequence[int],
    velocity: NDArray[np.float64],
    acceleration: NDArray[np.float64],
    jerk: NDArray[np.float64],
    gridpoints: int,
    /,
) -> tuple[tuple[object, ...], tuple[Peak, Peak, Peak]] | str | None:
    """The arguments of ``Trajectory.checked`` after the path, and the peaks before the motion was slowed down.

    None where ``laws.reference_time_with_peaks`` has to decide; words where the law fails.

    Args:
        waypoints, knots, tangents, breaks, lines, rows, blends: ``JointPath.tables``.
        gridpoints: TOPP-RA's; 0 for trapezoids with a constant speed on each blend.
    """

def continue_to_rest(
    waypoints: NDArray[np.float64],
    knots: NDArray[np.float64],
    tangents: NDArray[np.float64],
    breaks: NDArray[np.float64],
    lines: NDArray[np.int64],
    rows: NDArray[np.int64],
    blends: NDArray[np.float64],
    corners: Sequence[int],
    velocity: NDArray[np.float64],
    acceleration: NDArray[np.float64],
    jerk: NDArray[np.float64],
    gridpoints: int,
    s_start: float,
    speed: float,
    blend_share: float,
    /,
) -> NDArray[np.float64] | str | None:
    """The phases of ``ToppRa.continue_to_rest``, (m, 5).

    None where the reference has to decide; words where the law fails.
    """

def lawful_motion(
    waypoints: NDArray[np.float64],
    knots: NDArray[np.float64],
    tangents: NDArray[np.float64],
    breaks: NDArray[np.float64],
    lines: NDArray[np.int64],
    rows: NDArray[np.int64],
    blends: NDArray[np.float64],
    corners: Sequence[int],
    durations: NDArray[np.float64],
    coefficients: NDArray[np.float64],
    begin: float,
    end: float,
    from_rest: bool,
    /,
) -> (
    tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], NDArray[np.int64], float]
    | None
):
    """The arguments of ``Trajectory.checked`` after the path, the last being 1; None where Python has to decide."""

def path_at(
    waypoints: NDArray[np.float64],
    knots: NDArray[np.float64],
    tangents: NDArray[np.float64],
    breaks: NDArray[np.float64],
    lines: NDArray[np.int64],
    rows: NDArray[np.int64],
    blends: NDArray[np.float64],
    places: NDArray[np.float64],
    order: int,
    /,
) -> NDArray[np.float64]:
    """Configurations (order 0) or tangents (1) of a path at arc lengths (k,), (k, n); see ``JointPath.tables``."""

class Underway:
    """What is left of a motion (``replanning/splice.py``)."""

    def __init__(
        self,
        waypoints: NDArray[np.float64],
        knots: NDArray[np.float64],
        tangents: NDArray[np.float64],
        breaks: NDArray[np.float64],
        lines: NDArray[np.int64],
        rows: NDArray[np.int64],
        blends: NDArray[np.float64],
        durations: NDArray[np.float64],
        coefficients: NDArray[np.float64],
        times: NDArray[np.float64],
        ends: NDArray[np.float64],
        begin: float,
        end: float,
        splice: float,
        /,
    ) -> None:
        """See ``JointPath.tables``, of what is left, and ``Trajectory.tables``.

        Args:
            begin: Arc length at which what is left begins on the whole path.
            end: Arc length at which the motion ends on it.
            splice: Seconds on its clock at which another begins.
        """

    def moved(self, s: float, /) -> float:
        """An arc length of the whole path on what is left."""

    def at(self, t: float, /) -> tuple[float, float]:
        """s on what is left, and ds/dt, at an instant."""

    def rows(self, until: float, /) -> NDArray[np.float64]:
        """The law from the splice to an instant: seconds and four coefficients of each piece, (m, 5)."""

    def braking(
        self, s: float, rate: float, rest: float, acceleration: NDArray[np.float64], margin: float, /
    ) -> tuple[NDArray[np.float64], float] | None:
        """Rows of the stop that begins at s, and where it ends; None if there is none before ``rest``.

        Args:
            margin: Share of the possible braking that is not used.
        """

def setpoints(
    place: NDArray[np.float64],
    radius: NDArray[np.float64],
    speed: NDArray[np.float64],
    change: NDArray[np.float64],
    due: NDArray[np.float64],
    targets: NDArray[np.float64],
    shares: tuple[float, float, float],
    goal_time: float,
    aside: bool,
) -> tuple[NDArray[np.float64], ...]:
    """The six of ``gate.tracking.Course``, of a setpoint (n,) and targets (k, n).

    ``aside``: where it is due is not where it is about; else the last of them is the first.
    """

def stop_duration(
    waypoints: NDArray[np.float64],
    knots: NDArray[np.float64],
    tangents: NDArray[np.float64],
    turns: Sequence[int],
    velocity: NDArray[np.float64],
    acceleration: NDArray[np.float64],
    /,
) -> float | None:
    """``laws.stop_duration`` of trapezoids; None where the reference has to decide."""

class RoadmapTrunk:
    """``graph.Trunk``.

    Args:
        milestones, edges, reach: As there.
        spacing: Metres of motion between the points on an edge.
        starts: The neighbours of milestone k are the rows from ``starts[k]`` to ``starts[k + 1]``.
        other, lengths, numbers: Of each row the other milestone, the length of the edge and its number.
        components: Of each milestone.
    """

    def __init__(
        self,
        milestones: NDArray[np.float64],
        edges: NDArray[np.int64],
        reach: NDArray[np.float64],
        spacing: float,
        starts: NDArray[np.int64],
        other: NDArray[np.int64],
        lengths: NDArray[np.float64],
        numbers: NDArray[np.int64],
        components: NDArray[np.int64],
        /,
    ) -> None: ...

class RoadmapGraph:
    """``graph.Graph``, made of its trunk and what was added to that."""

    def __init__(
        self,
        trunk: RoadmapTrunk,
        milestones: NDArray[np.float64],
        edges: NDArray[np.int64],
        reach: NDArray[np.float64],
        spacing: float,
        added: Mapping[int, Sequence[tuple[int, float, int]]],
        merged: Mapping[int, int],
        /,
    ) -> None: ...

class Places:
    """The milestones and edges of a graph that a query may use; whether ``few`` edges of the trunk are free."""

    def __init__(
        self, graph: RoadmapGraph, offered: NDArray[np.bool_], free: NDArray[np.bool_], few: bool, /
    ) -> None: ...

class NearestPlaces:
    """About a thousand places nearest to q, nearest first and one for each edge; looks no further than it is asked."""

    def __init__(self, places: Places, q: Sequence[float]) -> None: ...
    def next(self) -> tuple[float, int, int, tuple[float, ...]] | None:
        """The next place; None after the last.

        The most that any point of the robot moves on the way to it (m), its edge (-1: none), its milestone (-1: it is
        a point on an edge), and its configuration.
        """

class RoadmapQuery:
    """One query as roadmap/query.py describes it; releases the interpreter's lock."""

    def __init__(
        self,
        graph: RoadmapGraph,
        places: Places,
        milestones: NDArray[np.int8],
        edges: NDArray[np.int8],
        start: Sequence[float],
        goals: Sequence[Sequence[float]],
        oracle: Oracle,
        /,
    ) -> None: ...
    def route(
        self, carried: Callable[[list[int], list[int]], Sequence[bool]] | None
    ) -> tuple[list[list[float]], int] | None:
        """The path and the goal it reaches; None if the roadmap has none.

        Args:
            carried: Which of some milestones, and then of some edges, all free before, are free still.
        """

    @property
    def learned(self) -> tuple[list[tuple[int, int, int]], list[tuple[int, int, int]]]:
        """The new verdicts on milestones and edges: number, verdict, and the pair that collides or -1."""
