"""What a certificate must prove apart: the pieces of a robot and its scene, and their pairs, for the proof alone.

The collision checker has a list of its own, made by other code; tests compare the two. Boxes around pieces that follow
each other, and around those boxes, keep a proof from looking at every piece: that neighbours in the list are neighbours
in space makes them small; that each holds all its pieces is worked out here.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from itertools import combinations

import numpy as np

from planner_service.certify.separation import Solids, centre_of
from planner_service.errors import InvalidRequest, UnknownName
from planner_service.geometry.arrays import BoolArray, FloatArray, IntArray, frozen
from planner_service.geometry.composite import Composite, Pieces, Solid
from planner_service.geometry.shapes import Box, Shape
from planner_service.geometry.validation import MAX_LENGTH
from planner_service.robot.model import Robot
from planner_service.scene.scene import Scene

__all__ = ["FIXED", "MANY", "Bundle", "Frame", "Piece", "ProofPairs", "bundled", "pairs_of_names"]


MANY = 64
"""Pieces from which on an obstacle is bundled; and pieces of other obstacles from which on these are, together."""

LARGE = 0.125
"""Part of the length of all obstacles beyond which one of them is in no common bundle: it would make many large."""

FAN, FAN_OF_CROWD = 8, 3
"""Pieces or bundles in a bundle, of one obstacle and of several: those are tight enough for three to be cheaper."""

ROUNDING = 1e-9
"""Metres by which a bundle is larger than what it holds: far above rounding."""


@dataclass(frozen=True, eq=False)
class Bundle:
    """A box around some pieces or bundles of one obstacle, or of several that stand in the world.

    Attributes:
        number: Its number as a piece.
        box, frame: The box, and where it is in the obstacle or world, the first three rows of a homogeneous matrix.
        first, count: The pieces in it: the number of the first, and how many follow each other.
    """

    number: int
    box: Box
    frame: tuple[tuple[float, ...], tuple[float, ...], tuple[float, ...]]
    first: int
    count: int


def bundled(pieces: Pieces, first: int, number: int, fan: int = FAN) -> list[Bundle]:
    """The bundles of pieces, what is in a bundle before it; the last holds everything, or would be beyond 1 km.

    Args:
        first: The number of the first piece.
        number: The number of the first bundle.
        fan: Pieces or bundles in a bundle.
    """
    low, high = _extents(pieces)
    out: list[Bundle] = []
    while len(low) > 1:
        starts = np.arange(0, len(low), fan)
        ends = np.minimum(starts + fan, len(low))
        low, high = np.minimum.reduceat(low, starts), np.maximum.reduceat(high, starts)
        if float((high - low).max()) + 2.0 * ROUNDING > MAX_LENGTH:  # no box is so large
            break
        size, centre = (high - low + 2.0 * ROUNDING).tolist(), (0.5 * (low + high)).tolist()
        begin = number + len(out)
        for k, ((x, y, z), (u, v, w)) in enumerate(zip(size, centre, strict=True)):
            frame = ((1.0, 0.0, 0.0, u), (0.0, 1.0, 0.0, v), (0.0, 0.0, 1.0, w))
            out.append(Bundle(begin + k, Box((x, y, z)), frame, first + int(starts[k]), int(ends[k] - starts[k])))
        first = begin
    return out


def _extents(pieces: Pieces) -> tuple[FloatArray, FloatArray]:
    """Lower and upper corners of boxes around pieces along the axes of the obstacle, (k, 3) each."""
    solids = Solids.of(pieces.shapes)
    x, y, z = np.array([centre_of(shape) for shape in pieces.shapes]).T
    R, t = pieces.frames[:, :3, :3], pieces.frames[:, :3, 3]
    centres = R[:, :, 0] * x[:, None] + R[:, :, 1] * y[:, None] + R[:, :, 2] * z[:, None] + t
    axes = R.transpose(1, 2, 0)  # the obstacle's axes in those of each piece, one after the other
    return centres - solids.extent(-axes).T, centres + solids.extent(axes).T


def _in_blocks(points: FloatArray) -> list[int]:
    """An order of points (k, 3) in which the blocks that ``bundled`` makes of a crowd are small.

    They are parted again and again across the longest side of the box around them, about in the middle, each time
    between two of the largest blocks there are.
    """
    out, parts = list[int](), [np.arange(len(points))]
    while parts:
        part = parts.pop()
        block = FAN_OF_CROWD
        if len(part) <= block:
            out += part.tolist()
            continue
        while block * FAN_OF_CROWD < len(part):
            block *= FAN_OF_CROWD
        there = points[part]
        axis = int((there.max(axis=0) - there.min(axis=0)).argmax())
        part = part[there[:, axis].argsort(kind="stable")]
        middle = max(1, round(len(part) / 2 / block)) * block
        parts += [part[middle:], part[:middle]]
    return out


Owner = tuple[str, str]
"""The kind, "link" or "object", and the name."""

Frame = tuple[tuple[float, ...], tuple[float, ...], tuple[float, ...]]

FEW_STANDING = 1_000
"""Pieces of obstacles up to which the pairs of a scene are kept for the next."""

MAX_PAIRS = 20_000_000
"""Of pieces; more take more memory than most have."""

FIXED = -1
"""The body of what stands in the world."""


@dataclass(frozen=True, eq=False)
class Piece:
    """One convex solid of ``owner``; ``frame`` is its pose in its body, or in the world: rows of a 3 x 4 matrix."""

    owner: Owner
    body: int
    shape: Shape
    frame: Frame
    held: bool = False


class ProofPairs:
    """Pieces and the pairs of them that must stay apart.

    An obstacle is judged against everything that a joint moves; two pieces of the robot if they are on different
    bodies; a held object also against the body that holds it. Not judged: pieces of one owner, two held objects, whose
    relative pose cannot change, contacts that the robot allows, a held object and its touch links, and ``allowed``.
    Where some entries of q stand ``still``, bodies count as one that only these move against each other.

    Pieces of an obstacle of many are bundled, and so is a crowd of obstacles of few that nothing may touch: a pair with
    a bundle is apart if all its children are.

    Attributes:
        riding: Pieces of the robot and what it holds.
        standing: Pieces of obstacles, numbered after these, those of the crowd last and neighbours in space behind each
            other; then the bundles.
        numbers: Of each piece without the bundles, its number if obstacles were in the order of the scene.
        pairs: (p, 2) numbers of pieces, the first of each riding; those with a bundle last.
        crowd: The pieces of the crowd.
        judged: How many have no bundle: these are what must be apart.
        children: For each pair the first of its children, which follow each other, and how many, (p, 2).
        roots: Pairs that are nobody's children, (r,).

    Raises:
        UnknownName: a pair names nothing that is there, or a touch link no link that has shapes.
        InvalidRequest: a pair names a link and an object at once; more than 20,000,000 pairs.
    """

    def __init__(
        self, robot: Robot, scene: Scene, allowed: Iterable[tuple[str, str]], still: Sequence[int] = ()
    ) -> None:
        self._moving_with: list[int] = []  # for each body the one that it moves with
        for number, body in enumerate(robot.bodies):
            own = body.parent < 0 or body.q_index not in still
            self._moving_with.append(number if own else self._moving_with[body.parent])
        tool = _frame(robot.tool_placement)
        riding = list(_links_of(robot))
        for a in scene.attached:
            frame = _times(tool, _frame(a.pose.matrix))
            solid = _pieces(a.shape, frame)
            riding += [Piece(("object", a.name), robot.tool_body, shape, at, held=True) for shape, at in solid]
        self.riding = tuple(riding)
        self._twice = robot.links & frozenset(scene.names)
        owners = [piece.owner for piece in riding] + [("object", o.name) for o in scene.obstacles]
        self._called = {self._label(owner): owner for owner in dict.fromkeys(owners)}
        self.owners = frozenset(self._called)
        self._may_touch = self._contacts(robot, scene, allowed)
        self._obstacles: list[range] = []
        self.crowd = range(0)
        self._trees: dict[range, list[Bundle]] = {}
        self.standing, self.numbers = self._stand(scene)
        self._pieces = self.riding + self.standing
        self.pairs, self.children = self._listed()
        self.judged = int((self.children[:, 1] == 0).sum())
        self._parents = np.full(len(self.pairs), -1, dtype=np.intp)
        for pair, (first, count) in enumerate(self.children[self.judged :].tolist(), start=self.judged):
            self._parents[first : first + count] = pair
        self.roots: IntArray = np.flatnonzero(self._parents < 0)

    def _stand(self, scene: Scene) -> tuple[tuple[Piece, ...], IntArray]:
        """Pieces of obstacles and then their bundles, and the numbers of all pieces in the order of the scene."""
        begin = len(self.riding)
        solids = [list(_pieces(o.shape, _frame(o.pose.matrix))) for o in scene.obstacles]
        starts = np.cumsum([begin, *map(len, solids)]).tolist()
        crowd = self._crowd(scene, solids)
        standing, numbers = list[Piece](), list(range(begin))
        trees = list[tuple[range, Pieces, Frame | None, int]]()
        for k, o in enumerate(scene.obstacles):
            if k in crowd:
                continue
            first = begin + len(standing)
            standing += [Piece(("object", o.name), FIXED, shape, at) for shape, at in solids[k]]
            numbers += range(starts[k], starts[k + 1])
            self._obstacles.append(range(first, begin + len(standing)))
            if isinstance(o.shape, Composite) and len(solids[k]) >= MANY:
                trees.append((self._obstacles[-1], o.shape.pieces, _frame(o.pose.matrix), FAN))
        if crowd:
            first = begin + len(standing)
            gathered = _gathered([piece for k in crowd for piece in solids[k]])
            owners = [(k, starts[k] + j) for k in crowd for j in range(len(solids[k]))]
            order = _in_blocks(np.sum(_extents(gathered), axis=0))
            for each in order:
                k, number = owners[each]
                shape, at = solids[k][number - starts[k]]
                standing.append(Piece(("object", scene.obstacles[k].name), FIXED, shape, at))
                numbers.append(number)
            self.crowd = range(first, begin + len(standing))
            self._obstacles.append(self.crowd)
            ordered = Pieces(tuple(gathered.shapes[k] for k in order), gathered.frames[order])
            trees.append((self.crowd, ordered, None, FAN_OF_CROWD))
        for run, pieces, at, fan in trees:
            tree = bundled(pieces, run.start, begin + len(standing), fan)
            owner = standing[run.start - begin].owner
            standing += [Piece(owner, FIXED, b.box, b.frame if at is None else _times(at, b.frame)) for b in tree]
            if tree:
                self._trees[run] = tree
        return tuple(standing), np.array(numbers, dtype=np.intp)

    def _crowd(self, scene: Scene, solids: Sequence[Sequence[tuple[Shape, Frame]]]) -> list[int]:
        """Obstacles of few pieces, none of them large, that nothing may touch, if together they have many."""
        if sum(map(len, solids)) < MANY:
            return []
        touched = {owner for pair in self._may_touch for owner in pair}
        few = [k for k, o in enumerate(scene.obstacles) if ("object", o.name) not in touched and len(solids[k]) < MANY]
        if sum(len(solids[k]) for k in few) < MANY:
            return []
        low, high = _extents(_gathered([piece for k in few for piece in solids[k]]))
        small = (high - low).max(axis=1) <= LARGE * float((high.max(axis=0) - low.min(axis=0)).max())
        ends = np.cumsum([len(solids[k]) for k in few]).tolist()
        crowd = [k for k, end in zip(few, ends, strict=True) if small[end - len(solids[k]) : end].all()]
        return crowd if sum(len(solids[k]) for k in crowd) >= MANY else []

    def opened(self, pairs: Iterable[frozenset[str]] | None) -> IntArray:
        """The roots, with those bundles of the crowd opened that hold a pair of these names, or all of them if None."""
        if self.crowd not in self._trees:
            return self.roots
        bundle = self._bundles_of_crowd
        if pairs is None:
            open_bundles = bundle.copy()
        else:
            named = frozenset(pairs)
            owners = {name for pair in named for name in pair}
            holders = [k for k, piece in enumerate(self.riding) if self._label(piece.owner) in owners]
            held = [k for k in self.crowd if self._label(self._pieces[k].owner) in owners]
            rows = np.flatnonzero(np.isin(self.pairs[:, 0], holders) & np.isin(self.pairs[:, 1], held))
            open_bundles = np.zeros(len(self.pairs), dtype=bool)
            up = self._parents[[row for row in rows.tolist() if frozenset(self.names(row)) in named]]
            while len(up := np.unique(up[up >= 0])):
                open_bundles[up] = True
                up = self._parents[up]
        above = np.where(self._parents < 0, True, open_bundles[self._parents])
        return np.flatnonzero(above & ~open_bundles)

    @cached_property
    def _bundles_of_crowd(self) -> BoolArray:
        """Which pairs are with a bundle of the crowd."""
        numbers = [each.number for each in self._trees.get(self.crowd, ())]
        return np.isin(self.pairs[:, 1], numbers)

    def is_crowd(self, pair: int) -> bool:
        """Whether it is with a bundle of several obstacles."""
        return bool(self._bundles_of_crowd[pair])

    def check_name(self, kind: str, name: str) -> None:
        """Raise unless that is what one link or object with a piece here is called."""
        if name in self._twice:
            raise InvalidRequest(kind, name, f"'{name} (link)' or '{name} (object)': the name stands for both")
        if name not in self.owners:
            raise UnknownName(kind, name, self.owners)

    def names(self, pair: int) -> tuple[str, str]:
        """What the owners of a pair are called; of the first pair in a bundle of several obstacles."""
        first, second = self.pairs[pair].tolist()
        return self._label(self._pieces[first].owner), self._label(self._pieces[second].owner)

    def are_of(self, pairs: IntArray, names: Iterable[str]) -> BoolArray:
        """Which pairs, given by their numbers, have owners of these two names; none with a bundle of several."""
        one, two = (self._numbers_by_name.get(name, -1) for name in names)
        first, second = self._owner_numbers[self.pairs[pairs]].T
        of_both = ((first == one) & (second == two)) | ((first == two) & (second == one))
        return np.asarray(of_both & ~self._bundles_of_crowd[pairs])

    @cached_property
    def _numbers_by_name(self) -> dict[str, int]:
        """A number for each owner, by what it is called."""
        return {name: number for number, name in enumerate(self._called)}

    @cached_property
    def _owner_numbers(self) -> IntArray:
        """That of each piece."""
        numbers = {owner: self._numbers_by_name[name] for name, owner in self._called.items()}
        return np.array([numbers[piece.owner] for piece in self._pieces], dtype=np.intp)

    def held_together(self, scene: Scene) -> list[tuple[str, str]]:
        """Pairs of objects that the robot holds at the same time, by what they are called."""
        return list(combinations([self._label(("object", item.name)) for item in scene.attached], 2))

    def _label(self, owner: Owner) -> str:
        """The name, and the kind where the name alone could be read as another owner."""
        kind, name = owner
        plain = name not in self._twice and not name.endswith((" (link)", " (object)"))
        return name if plain else f"{name} ({kind})"

    def _contacts(
        self, robot: Robot, scene: Scene, allowed: Iterable[tuple[str, str]]
    ) -> frozenset[tuple[Owner, Owner]]:
        """Owners that may touch, either of them first."""
        contacts = set[tuple[Owner, Owner]]()
        for attached in scene.attached:
            for link in attached.touch_links:
                if link not in (shaped := {shape.link for shape in robot.shapes}):
                    raise UnknownName("touch link", link, shaped)
                contacts.add((("object", attached.name), ("link", link)))
        for a, b in pairs_of_names("allowed", allowed):
            self.check_name("link or object", a)
            self.check_name("link or object", b)
            contacts.add((self._called[a], self._called[b]))
        known = _contacts_of(robot)
        return known.union(contacts, ((b, a) for a, b in contacts)) if contacts else known

    def _listed(self) -> tuple[IntArray, IntArray]:
        """The pairs, and the children of each."""
        kinds = tuple((piece.owner, piece.body, piece.held) for piece in self.riding)
        standing = tuple((self._pieces[run.start].owner, len(run)) for run in self._obstacles)
        few = sum(count for _, count in standing) <= FEW_STANDING
        plain, begins = (_plain_pairs if few else _plain_pairs.__wrapped__)(
            kinds, standing, self._may_touch, tuple(self._moving_with)
        )
        if not self._trees:
            return plain, np.zeros((len(plain), 2), dtype=np.intp)
        first, second, total = [plain[:, 0]], [plain[:, 1]], len(plain)
        children: list[IntArray] = [np.zeros((total, 2), dtype=np.intp)]
        for i, obstacle, begin in begins:
            numbers = self._obstacles[obstacle]
            if numbers not in self._trees:
                continue
            tree = self._trees[numbers]
            first.append(np.full(len(tree), i, dtype=np.intp))
            second.append(np.array([each.number for each in tree], dtype=np.intp))
            shift = {True: begin - numbers.start, False: total - tree[0].number}  # from pieces to pairs
            firsts = [each.first + shift[each.first < numbers.stop] for each in tree]
            children.append(np.array([firsts, [each.count for each in tree]], dtype=np.intp).T)
            total += len(tree)
        return np.stack([np.concatenate(first), np.concatenate(second)], axis=1), np.concatenate(children)


_Kind = tuple[Owner, int, bool]
"""Of a riding piece its owner, its body, and whether it is held."""


@lru_cache(maxsize=32)
def _plain_pairs(
    riding: tuple[_Kind, ...],
    standing: tuple[tuple[Owner, int], ...],
    may_touch: frozenset[tuple[Owner, Owner]],
    moving_with: tuple[int, ...],
) -> tuple[IntArray, tuple[tuple[int, int, int], ...]]:
    """The pairs of pieces that must stay apart, wherever these are: those of the scene before if only poses differ.

    Args:
        standing: Of each obstacle, in the order of the numbers of its pieces, its owner and how many these are.
        moving_with: As of ``ProofPairs``.

    Returns:
        The pairs (p, 2), and for each riding piece and obstacle with pairs the numbers of both and of their first pair.
    """
    starts = [k for k, kind in enumerate(riding) if k == 0 or kind != riding[k - 1]]
    runs = [range(first, end) for first, end in zip(starts, [*starts[1:], len(riding)], strict=False)]
    obstacles, end = list[range](), len(riding)
    for _, count in standing:
        obstacles.append(range(end, end + count))
        end += count
    heads: list[_Kind] = [*(riding[run.start] for run in runs), *((owner, FIXED, False) for owner, _ in standing)]
    others: list[range] = [*runs, *obstacles]

    def must_part(a: _Kind, b: _Kind) -> bool:
        first, second = moving_with[a[1]], FIXED if b[1] == FIXED else moving_with[b[1]]
        if not (first > 0 if second == FIXED else first != second or a[2] != b[2]):
            return False
        return a[0] != b[0] and (a[0], b[0]) not in may_touch

    firsts: list[IntArray] = [np.zeros(0, dtype=np.intp)]
    seconds: list[IntArray] = [np.zeros(0, dtype=np.intp)]
    begins, total = list[tuple[int, int, int]](), 0
    for k, run in enumerate(runs):
        partners = [j for j in range(k + 1, len(others)) if must_part(heads[k], heads[j])]
        ends = np.cumsum([0, *(len(others[j]) for j in partners)]).tolist()
        if total + len(run) * ends[-1] > MAX_PAIRS:
            count = total + len(run) * ends[-1]
            raise InvalidRequest("scene", count, f"at most {MAX_PAIRS:,} pairs of pieces that must be apart")
        blocks = (np.arange(others[j].start, others[j].stop) for j in partners)
        numbers = np.concatenate([np.zeros(0, dtype=np.intp), *blocks])
        firsts.append(np.arange(run.start, run.stop).repeat(ends[-1]))
        seconds += [numbers] * len(run)
        standing_ones = [(j - len(runs), begin) for j, begin in zip(partners, ends, strict=False) if j >= len(runs)]
        for number, i in enumerate(run):
            begins += [(i, obstacle, total + number * ends[-1] + begin) for obstacle, begin in standing_ones]
        total += len(run) * ends[-1]
    return frozen(np.stack([np.concatenate(firsts), np.concatenate(seconds)], axis=1)), tuple(begins)


def _gathered(pieces: Sequence[tuple[Shape, Frame]]) -> Pieces:
    """Shapes and their frames in the world."""
    frames = np.zeros((len(pieces), 4, 4))
    frames[:, :3], frames[:, 3, 3] = np.array([frame for _, frame in pieces]).reshape(-1, 3, 4), 1.0
    return Pieces(tuple(shape for shape, _ in pieces), frames)


@lru_cache(maxsize=16)
def _contacts_of(robot: Robot) -> frozenset[tuple[Owner, Owner]]:
    """Links that the robot allows to touch, either of them first: in every scene the same."""
    contacts = [(("link", a), ("link", b)) for a, b in (c.links for c in robot.allowed_contacts)]
    return frozenset([*contacts, *((b, a) for a, b in contacts)])


@lru_cache(maxsize=16)
def _links_of(robot: Robot) -> tuple[Piece, ...]:
    """The pieces of a robot's own links: they are the same in every scene."""
    return tuple(Piece(("link", s.link), s.body, s.shape, _frame(s.pose.matrix)) for s in robot.shapes)


def _pieces(solid: Solid, frame: Frame) -> Iterator[tuple[Shape, Frame]]:
    """The convex pieces of a solid at a frame."""
    if not isinstance(solid, Composite):
        yield solid, frame
    else:
        for shape, T in zip(solid.pieces.shapes, solid.pieces.frames, strict=True):
            yield shape, _times(frame, _frame(T))


def pairs_of_names(field: str, pairs: object) -> tuple[tuple[str, str], ...]:
    """Pairs of two different names that a caller gave.

    Raises:
        InvalidRequest: naming ``field``: something else.
    """
    expected = "pairs of two different link or object names"
    if not isinstance(pairs, (list, tuple, set, frozenset)):
        raise InvalidRequest(field, pairs, expected)
    for pair in pairs:
        good = isinstance(pair, (list, tuple)) and len(pair) == 2 and all(isinstance(name, str) for name in pair)
        if not good or pair[0] == pair[1]:
            raise InvalidRequest(field, pair, expected)
    return tuple((a, b) for a, b in pairs)


def _frame(T: FloatArray) -> Frame:
    """The first three rows of a homogeneous matrix."""
    a, b, c = T[:3].tolist()
    return (tuple(a), tuple(b), tuple(c))


def _times(a: Frame, b: Frame) -> Frame:
    """The frame b, given in a, in what a is given in."""
    rows = [[r[0] * u + r[1] * v + r[2] * w for u, v, w in zip(*b, strict=True)] for r in a]
    one, two, three = ((*row[:3], row[3] + r[3]) for row, r in zip(rows, a, strict=True))
    return (one, two, three)
