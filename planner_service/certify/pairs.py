"""What a certificate must prove apart: the pieces of a robot and its scene, and their pairs, for the proof alone.

The collision checker has a list of its own, made by other code; tests compare the two. Boxes around pieces that follow
each other, and around those boxes, keep a proof from looking at every piece: that neighbours in the list are neighbours
in space makes them small; that each holds all its pieces is worked out here.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from copy import copy
from dataclasses import dataclass
from functools import cached_property, lru_cache
from itertools import combinations
from typing import overload

import numpy as np

from planner_service.certify.separation import Solids, centre_of
from planner_service.errors import InvalidRequest, UnknownName
from planner_service.geometry.arrays import BoolArray, FloatArray, IntArray, frozen
from planner_service.geometry.composite import Composite, Pieces, Solid
from planner_service.geometry.shapes import Shape
from planner_service.geometry.validation import MAX_LENGTH
from planner_service.robot.model import Robot
from planner_service.scene.scene import Scene

__all__ = ["FIXED", "MANY", "BundleTree", "Frame", "Piece", "ProofPairs", "Standing", "bundled", "pairs_of_names"]


MANY = 64
"""Pieces from which on an obstacle is bundled; and pieces of other obstacles from which on these are, together."""

LARGE = 0.125
"""Part of the length of all obstacles beyond which one of them is in no common bundle: it would make many large."""

FAN, FAN_OF_CROWD, FAN_OF_MANY = 8, 3, 4
"""Pieces or bundles in a bundle, of one obstacle, of several and of one of very many pieces. Those of several are tight
enough for three to be cheaper; in a room at 5 mm a proof takes 0.7 of the time with four, 1.6 times that of 50 mm."""

VERY_MANY = 50_000
"""Pieces of an obstacle from which on it has very many."""

ROUNDING = 1e-9
"""Metres by which a bundle is larger than what it holds: far above rounding."""


@dataclass(frozen=True, eq=False)
class BundleTree:
    """Boxes around pieces that follow each other, around those boxes, and so on: the members, the pieces first.

    Attributes:
        pieces: The numbers of its pieces.
        bundles: The numbers of its bundles, as pieces.
        size: Of the bundles, (b, 3).
        rotation: How these stand in the world, (3, 3).
        centre: Where they are in it, (b, 3).
        children: Of each bundle the first member in it, and how many follow each other, (b, 2).
        owner: The obstacle, or the first of several.
    """

    pieces: range
    bundles: range
    size: FloatArray
    rotation: FloatArray
    centre: FloatArray
    children: IntArray
    owner: int

    def __len__(self) -> int:
        return len(self.pieces) + len(self.bundles)

    @cached_property
    def parents(self) -> IntArray:
        """The member that each member is in, -1 if in none."""
        out = np.full(len(self), -1, dtype=np.intp)
        for bundle, (first, count) in enumerate(self.children.tolist(), start=len(self.pieces)):
            out[first : first + count] = bundle
        return out

    @cached_property
    def ends(self) -> IntArray:
        """The first and the last piece of each member, counted from the first of all, (2, members)."""
        own, inner = np.arange(len(self)), len(self.pieces)
        first = np.concatenate([own[:inner], self.children[:, 0]])
        last = np.concatenate([own[:inner], self.children.sum(axis=1) - 1])
        while (first >= inner).any():
            first, last = first[first], last[last]
        return np.stack([first, last])

    @cached_property
    def tops(self) -> IntArray:
        """The members that are in none: the last ones."""
        held = int(self.children.sum(axis=1).max(initial=0))
        return np.arange(held, len(self))

    def numbers(self, members: IntArray) -> IntArray:
        """Members by their numbers as pieces."""
        inner = len(self.pieces)
        bundle = self.bundles.start - inner
        return np.where(members < inner, members + self.pieces.start, members + bundle)


def bundled(
    pieces: Pieces, first: int, number: int, owner: int, *, fan: int = FAN, frame: Frame | None = None
) -> BundleTree:
    """The bundles of pieces, what is in a bundle before it; the last holds everything, or would be beyond 1 km.

    Args:
        first: The number of the first piece.
        number: The number of the first bundle.
        owner: As of ``BundleTree``.
        fan: Pieces or bundles in a bundle.
        frame: Of what the pieces are given in; None if that is the world.
    """
    at = np.eye(3, 4) if frame is None else np.array(frame)
    low, high = _extents(pieces)
    sizes, centres = list[FloatArray]([np.zeros((0, 3))]), list[FloatArray]([np.zeros((0, 3))])
    children = list[IntArray]([np.zeros((0, 2), dtype=np.intp)])
    begin = 0
    while len(low) > 1:
        starts = np.arange(0, len(low), fan)
        ends = np.minimum(starts + fan, len(low))
        following = begin + len(low)
        low, high = np.minimum.reduceat(low, starts), np.maximum.reduceat(high, starts)
        if float((high - low).max()) + 2.0 * ROUNDING > MAX_LENGTH:  # no box is so large
            break
        sizes.append(high - low + 2.0 * ROUNDING)
        centres.append(0.5 * (low + high))
        children.append(np.stack([begin + starts, ends - starts], axis=1))
        begin = following
    size, centre = np.concatenate(sizes), np.concatenate(centres)
    return BundleTree(
        range(first, first + len(pieces)),
        range(number, number + len(size)),
        size,
        _turned(at, np.eye(3)[None])[0],
        _moved(at, centre),
        np.concatenate(children),
        owner,
    )


def _extents(pieces: Pieces) -> tuple[FloatArray, FloatArray]:
    """Lower and upper corners of boxes around pieces along the axes of the obstacle, (k, 3) each."""
    solids = Solids.of(pieces.kinds).take(pieces.numbers)
    x, y, z = np.array([centre_of(shape) for shape in pieces.kinds])[pieces.numbers].T
    R, t = pieces.rotations, pieces.positions
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

MAX_PAIRS = 100_000_000
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


class Standing(Sequence[Piece]):
    """Pieces that stand in the world; objects of these are made as they are looked at.

    Attributes:
        shapes: Those that occur.
        kinds: Which of them each piece is, (k,).
        rotations: How pieces stand, (r, 3, 3).
        turns: Which of these each does, (k,).
        positions: Where each is, (k, 3).
        owners: Of each its owner by number, (k,).
        called: The owners.
    """

    def __init__(self, solids: Sequence[tuple[Owner, Solid, Frame]]) -> None:
        """From whose they are, what they are and where they stand."""
        self.called = tuple(owner for owner, _, _ in solids)
        shapes, counts = list[Shape](), list[int]()
        kinds, turns = list[IntArray](), list[IntArray]()
        rotations, positions = list[FloatArray](), list[FloatArray]()
        stands = 0
        for _, solid, frame in solids:
            pieces = solid.pieces if isinstance(solid, Composite) else None
            kinds.append(np.arange(len(shapes), len(shapes) + 1) if pieces is None else pieces.numbers + len(shapes))
            shapes += solid.pieces.kinds if isinstance(solid, Composite) else [solid]
            a = np.array(frame)
            rotation = a[None, :, :3] if pieces is None else _turned(a, pieces.rotations)
            position = a[None, :, 3] if pieces is None else _moved(a, pieces.positions)
            stand = np.arange(stands, stands + len(rotation))
            turns.append(stand if len(stand) == len(position) else np.broadcast_to(stand, len(position)))
            stands += len(rotation)
            rotations.append(rotation)
            positions.append(position)
            counts.append(len(position))
        none: IntArray = np.zeros(0, dtype=np.intp)
        self.shapes = tuple(shapes)
        self.kinds = np.concatenate([none, *kinds])
        self.rotations = np.concatenate([np.zeros((0, 3, 3)), *rotations])
        self.turns = np.concatenate([none, *turns])
        self.positions = np.concatenate([np.zeros((0, 3)), *positions])
        self.owners = np.repeat(np.arange(len(counts)), counts)

    def taken(self, order: IntArray) -> Standing:
        """The pieces in another order."""
        out = copy(self)
        names = ("kinds", "turns", "positions", "owners")
        vars(out).update({name: getattr(self, name)[order] for name in names})
        return out

    @property
    def pieces(self) -> Pieces:
        """Their shapes, and their frames in the world."""
        return Pieces(self.shapes, self.kinds, self.rotations[self.turns], self.positions)

    def __len__(self) -> int:
        return len(self.kinds)

    @overload
    def __getitem__(self, index: int) -> Piece: ...
    @overload
    def __getitem__(self, index: slice) -> Sequence[Piece]: ...
    def __getitem__(self, index: int | slice) -> Piece | Sequence[Piece]:
        if isinstance(index, slice):
            return tuple(self[k] for k in range(*index.indices(len(self))))
        rows = np.column_stack([self.rotations[self.turns[index]], self.positions[index]]).tolist()
        a, b, c = map(tuple, rows)
        return Piece(self.called[self.owners[index]], FIXED, self.shapes[self.kinds[index]], (a, b, c))


class ProofPairs:
    """Pieces and the pairs of them that must stay apart.

    An obstacle is judged against everything that a joint moves; two pieces of the robot if they are on different
    bodies; a held object also against the body that holds it. Not judged: pieces of one owner, two held objects, whose
    relative pose cannot change, contacts that the robot allows, a held object and its touch links, and ``allowed``.
    Where some entries of q stand ``still``, bodies count as one that only these move against each other.

    Pieces of an obstacle of many are bundled, and so is a crowd of obstacles of few that nothing may touch: a pair with
    a bundle is apart if all its children are. Pairs with the members of these trees are numbered, but not listed: there
    may be millions.

    Attributes:
        riding: Pieces of the robot and what it holds.
        standing: Pieces of obstacles, numbered after these, those of the crowd last and neighbours in space behind each
            other. The bundles are numbered after all pieces.
        numbers: Of each piece, its number if obstacles were in the order of the scene.
        plain: Pairs of pieces of no tree, (p, 2) numbers of pieces, the first of each riding.
        trees: Pieces with their bundles.
        blocks: Pairs of one riding piece with all members of a tree: the piece and the tree, (b, 2); numbered after the
            plain ones.
        begins: The first pair of each block, (b,), then the number of all pairs.
        crowd: The pieces of the crowd.
        judged: How many pairs have no bundle: these are what must be apart.
        roots: Pairs that are nobody's children, (r,).

    Raises:
        UnknownName: a pair names nothing that is there, or a touch link no link that has shapes.
        InvalidRequest: a pair names a link and an object at once; more than 100,000,000 pairs.
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
        self._stand(scene)
        self.plain, self.blocks = self._listed()
        sizes = [len(self.trees[tree]) for tree in self.blocks[:, 1].tolist()]
        self.begins = np.cumsum([len(self.plain), *sizes])
        self.judged = len(self.plain) + sum(len(self.trees[tree].pieces) for tree in self.blocks[:, 1].tolist())
        self.roots = self._rooted([tree.tops for tree in self.trees])

    def _stand(self, scene: Scene) -> None:
        """Pieces of obstacles and their trees, and the numbers of all pieces in the order of the scene."""
        begin = len(self.riding)
        standing = Standing([(("object", o.name), o.shape, _frame(o.pose.matrix)) for o in scene.obstacles])
        counts = np.bincount(standing.owners, minlength=len(scene.obstacles)).tolist()
        crowd = set(self._crowd(standing, counts))
        in_crowd = np.isin(standing.owners, list(crowd))
        order = np.flatnonzero(~in_crowd)
        runs = list[tuple[int, range]]()  # of the other obstacles
        first = begin
        for k, count in enumerate(counts):
            if k not in crowd:
                runs.append((k, range(first, first + count)))
                first += count
        self.crowd = range(first, begin + len(standing)) if crowd else range(0)
        if crowd:
            together = standing.taken(np.flatnonzero(in_crowd))
            block = np.array(_in_blocks(np.sum(_extents(together.pieces), axis=0)), dtype=np.intp)
            order = np.concatenate([order, np.flatnonzero(in_crowd)[block]])
        self.standing = standing.taken(order) if crowd else standing
        self.numbers = np.concatenate([np.arange(begin), begin + order])
        number, trees, self._runs = begin + len(standing), list[BundleTree](), list[tuple[int, range, int]]()
        for k, run in runs:
            shape = scene.obstacles[k].shape
            tree = -1
            if len(run) >= MANY and isinstance(shape, Composite):
                at = _frame(scene.obstacles[k].pose.matrix)
                fan = FAN_OF_MANY if len(run) > VERY_MANY else FAN
                found = bundled(shape.pieces, run.start, number, k, fan=fan, frame=at)
                if len(found.bundles):
                    number, tree = number + len(found.bundles), len(trees)
                    trees.append(found)
            self._runs.append((k, run, tree))
        self._tree_of_crowd = -1
        if crowd:
            within = np.arange(self.crowd.start - begin, self.crowd.stop - begin)
            pieces, self._tree_of_crowd = self.standing.taken(within).pieces, len(trees)
            first_owner = int(self.standing.owners[within[0]])
            trees.append(bundled(pieces, self.crowd.start, number, first_owner, fan=FAN_OF_CROWD))
            self._runs.append((first_owner, self.crowd, self._tree_of_crowd))
        self.trees = tuple(trees)

    def _crowd(self, standing: Standing, counts: Sequence[int]) -> list[int]:
        """Obstacles of few pieces, none of them large, that nothing may touch, if together they have many."""
        if len(standing) < MANY:
            return []
        touched = {owner for pair in self._may_touch for owner in pair}
        few = [k for k, owner in enumerate(standing.called) if owner not in touched and counts[k] < MANY]
        if sum(counts[k] for k in few) < MANY:
            return []
        low, high = _extents(standing.taken(np.flatnonzero(np.isin(standing.owners, few))).pieces)
        small = (high - low).max(axis=1) <= LARGE * float((high.max(axis=0) - low.min(axis=0)).max())
        ends = np.cumsum([counts[k] for k in few]).tolist()
        crowd = [k for k, end in zip(few, ends, strict=True) if small[end - counts[k] : end].all()]
        return crowd if sum(counts[k] for k in crowd) >= MANY else []

    def __len__(self) -> int:
        return int(self.begins[-1])

    def _located(self, pairs: IntArray) -> tuple[IntArray, IntArray]:
        """The block of each pair, -1 for a plain one, and its member of the tree, (k,) each."""
        block = np.searchsorted(self.begins[:-1], pairs, side="right") - 1
        block = np.where(pairs < len(self.plain), -1, block)
        return block, pairs - self.begins[block]

    def of(self, pairs: IntArray) -> IntArray:
        """The two pieces of pairs by their numbers, (k,) in, (k, 2) out."""
        block, member = self._located(pairs)
        out = np.zeros((len(pairs), 2), dtype=np.intp)
        out[block < 0] = self.plain[pairs[block < 0]]
        for each in np.unique(block[block >= 0]).tolist():
            mine = block == each
            rider, tree = self.blocks[each].tolist()
            out[mine, 0], out[mine, 1] = rider, self.trees[tree].numbers(member[mine])
        return out

    def runs(self, pairs: IntArray) -> IntArray:
        """Of pairs (k,) the first piece, the first of the pieces that the second is or holds, and how many, (k, 3)."""
        block, member = self._located(pairs)
        out = np.column_stack([self.of(pairs), np.ones(len(pairs), dtype=np.intp)])
        for each in np.unique(block[block >= 0]).tolist():
            mine = block == each
            tree = self.trees[self.blocks[each, 1]]
            first, last = tree.ends[:, member[mine]]
            out[mine, 1], out[mine, 2] = tree.pieces.start + first, last - first + 1
        return out

    def leaves(self) -> IntArray:
        """The pairs without a bundle, (judged,)."""
        counts = [len(self.trees[tree].pieces) for tree in self.blocks[:, 1].tolist()]
        starts = self.begins[:-1].tolist()
        runs = (np.arange(start, start + count) for start, count in zip(starts, counts, strict=True))
        return np.concatenate([np.arange(len(self.plain)), *runs])

    def _rooted(self, tops: Sequence[IntArray]) -> IntArray:
        """The plain pairs, and those with some members of each tree."""
        starts, trees = self.begins[:-1].tolist(), self.blocks[:, 1].tolist()
        return np.concatenate(
            [np.arange(len(self.plain)), *(start + tops[tree] for start, tree in zip(starts, trees, strict=True))]
        )

    def opened(self, pairs: Iterable[frozenset[str]]) -> IntArray:
        """The roots, with those bundles of the crowd opened that hold a pair of these names."""
        if self._tree_of_crowd < 0:
            return self.roots
        tree = self.trees[self._tree_of_crowd]
        named = frozenset(pairs)
        out = [np.arange(len(self.plain))]
        for (rider, which), start in zip(self.blocks.tolist(), self.begins[:-1].tolist(), strict=True):
            members = self.trees[which].tops
            if which == self._tree_of_crowd:
                label = self._label(self.riding[rider].owner)
                held = [name for pair in named if label in pair for name in pair if name != label]
                members = self._opened_members(tree, [self._numbers_by_name[n] for n in held if n in self._called])
            out.append(start + members)
        return np.concatenate(out)

    def _opened_members(self, tree: BundleTree, owners: Sequence[int]) -> IntArray:
        """The members of the crowd's tree that stand for all, where bundles that hold pieces of some are opened."""
        open_ones = np.zeros(len(tree), dtype=bool)
        up = tree.parents[np.flatnonzero(np.isin(self._owner_numbers(np.array(tree.pieces)), owners))]
        while len(up := np.unique(up[up >= 0])):
            open_ones[up] = True
            up = tree.parents[up]
        above = np.where(tree.parents < 0, True, open_ones[tree.parents])
        return np.flatnonzero(above & ~open_ones)

    def _with_crowd(self, pairs: IntArray) -> BoolArray:
        """Which pairs are with a bundle of the crowd."""
        if self._tree_of_crowd < 0:
            return np.zeros(len(pairs), dtype=bool)
        block, member = self._located(pairs)
        inner = len(self.trees[self._tree_of_crowd].pieces)
        return np.asarray((block >= 0) & (self.blocks[block, 1] == self._tree_of_crowd) & (member >= inner))

    def is_crowd(self, pair: int) -> bool:
        """Whether it is with a bundle of several obstacles."""
        return bool(self._with_crowd(np.array([pair]))[0])

    def check_name(self, kind: str, name: str) -> None:
        """Raise unless that is what one link or object with a piece here is called."""
        if name in self._twice:
            raise InvalidRequest(kind, name, f"'{name} (link)' or '{name} (object)': the name stands for both")
        if name not in self.owners:
            raise UnknownName(kind, name, self.owners)

    def names(self, pair: int) -> tuple[str, str]:
        """What the owners of a pair are called; of the first pair in a bundle of several obstacles."""
        first, second = self._owner_numbers(self.of(np.array([pair]))[0]).tolist()
        return self._names[first], self._names[second]

    def are_of(self, pairs: IntArray, names: Iterable[str]) -> BoolArray:
        """Which pairs, given by their numbers, have owners of these two names; none with a bundle of several."""
        one, two = (self._numbers_by_name.get(name, -1) for name in names)
        first, second = self._owner_numbers(self.of(pairs).ravel()).reshape(-1, 2).T
        of_both = ((first == one) & (second == two)) | ((first == two) & (second == one))
        return np.asarray(of_both & ~self._with_crowd(pairs))

    @cached_property
    def _names(self) -> list[str]:
        """What owners are called, by their number."""
        return list(self._called)

    @cached_property
    def _numbers_by_name(self) -> dict[str, int]:
        """A number for each owner, by what it is called."""
        return {name: number for number, name in enumerate(self._called)}

    def _owner_numbers(self, pieces: IntArray) -> IntArray:
        """The numbers of the owners of pieces and bundles, (k,) in and out."""
        riding, standing, bundles = self._owners_of_pieces
        n, end = len(riding), len(riding) + len(self.standing)
        out: IntArray = np.zeros(len(pieces), dtype=np.intp)
        rides, bundle = pieces < n, pieces >= end
        stands = ~(rides | bundle)
        out[rides] = riding[pieces[rides]]
        out[stands] = standing[self.standing.owners[pieces[stands] - n]]
        out[bundle] = bundles[self._tree_of(pieces[bundle])]
        return out

    def axes_of(self, pieces: IntArray) -> FloatArray:
        """How pieces and bundles stand in the world, by their numbers, (k, 3, 3)."""
        n, end = len(self.riding), len(self.riding) + len(self.standing)
        bundle = pieces >= end
        out = np.empty((len(pieces), 3, 3))
        out[~bundle] = self.standing.rotations[self.standing.turns[pieces[~bundle] - n]]
        turns = np.concatenate([np.zeros((0, 3, 3)), *(tree.rotation[None] for tree in self.trees)])
        out[bundle] = turns[self._tree_of(pieces[bundle])]
        return out

    def _tree_of(self, bundles: IntArray) -> IntArray:
        """The trees of bundles, by their numbers."""
        return np.searchsorted([each.bundles.start for each in self.trees], bundles, side="right") - 1

    @cached_property
    def _owners_of_pieces(self) -> tuple[IntArray, IntArray, IntArray]:
        """The numbers of the owners of the pieces that ride, of obstacles, and of the first pieces of trees."""
        numbers = {owner: self._numbers_by_name[name] for name, owner in self._called.items()}
        standing = np.array([numbers[owner] for owner in self.standing.called], dtype=np.intp)
        riding = np.array([numbers[piece.owner] for piece in self.riding], dtype=np.intp)
        return riding, standing, standing[np.array([tree.owner for tree in self.trees], dtype=np.intp)]

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
        """The plain pairs, and the blocks of the others."""
        called = self.standing.called
        number: dict[Owner, int] = {}
        kinds = tuple((number.setdefault(each.owner, len(number)), each.body, each.held) for each in self.riding)
        standing = tuple(
            (number.setdefault(called[owner], len(number)), len(run), tree) for owner, run, tree in self._runs
        )
        may_touch = frozenset((number[a], number[b]) for a, b in self._may_touch if a in number and b in number)
        few = sum(count for _, count, _ in standing) <= FEW_STANDING
        return (_pairs_of if few else _pairs_of.__wrapped__)(kinds, standing, may_touch, tuple(self._moving_with))


_Kind = tuple[int, int, bool]
"""Of a riding piece its owner by number, its body, and whether it is held."""


@lru_cache(maxsize=256)
def _pairs_of(
    riding: tuple[_Kind, ...],
    standing: tuple[tuple[int, int, int], ...],
    may_touch: frozenset[tuple[int, int]],
    moving_with: tuple[int, ...],
) -> tuple[IntArray, IntArray]:
    """The pairs of pieces that must stay apart, wherever these are and whatever they are called.

    Those of a scene before are taken that differs only in poses and names.

    Args:
        standing: Of each obstacle, in the order of the numbers of its pieces, its owner, how many these are, and the
            number of their tree, -1 if there is none.
        may_touch: Owners that may touch, either of them first.
        moving_with: As of ``ProofPairs``.

    Returns:
        The plain pairs (p, 2), and the blocks (b, 2).
    """
    starts = [k for k, kind in enumerate(riding) if k == 0 or kind != riding[k - 1]]
    runs = [range(first, end) for first, end in zip(starts, [*starts[1:], len(riding)], strict=False)]
    others, end = list(runs), len(riding)
    for _, count, _ in standing:
        others.append(range(end, end + count))
        end += count
    heads: list[_Kind] = [*(riding[run.start] for run in runs), *((owner, FIXED, False) for owner, _, _ in standing)]
    trees = [-1] * len(runs) + [tree for _, _, tree in standing]

    def must_part(a: _Kind, b: _Kind) -> bool:
        first, second = moving_with[a[1]], FIXED if b[1] == FIXED else moving_with[b[1]]
        if not (first > 0 if second == FIXED else first != second or a[2] != b[2]):
            return False
        return a[0] != b[0] and (a[0], b[0]) not in may_touch

    none: IntArray = np.zeros(0, dtype=np.intp)
    firsts, seconds, blocks, total = list[IntArray]((none,)), list[IntArray]((none,)), list[tuple[int, int]](), 0
    for k, run in enumerate(runs):
        partners = [j for j in range(k + 1, len(others)) if must_part(heads[k], heads[j])]
        total += len(run) * sum(len(others[j]) for j in partners)
        if total > MAX_PAIRS:
            raise InvalidRequest("scene", total, f"at most {MAX_PAIRS:,} pairs of pieces that must be apart")
        plain = (np.arange(others[j].start, others[j].stop) for j in partners if trees[j] < 0)
        numbers = np.concatenate([none, *plain])
        firsts.append(np.arange(run.start, run.stop).repeat(len(numbers)))
        seconds += [numbers] * len(run)
        blocks += [(i, trees[j]) for i in run for j in partners if trees[j] >= 0]
    pairs = np.stack([np.concatenate(firsts), np.concatenate(seconds)], axis=1)
    return frozen(pairs), frozen(np.array(blocks, dtype=np.intp).reshape(-1, 2))


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


def _turned(a: FloatArray, rotations: FloatArray) -> FloatArray:
    """Rotations (k, 3, 3), given in a frame (3, 4), in what that is given in: the numbers of ``_times``."""
    rows = a[:, 0, None] * rotations[:, None, 0] + a[:, 1, None] * rotations[:, None, 1]
    return np.asarray(rows + a[:, 2, None] * rotations[:, None, 2])


def _moved(a: FloatArray, positions: FloatArray) -> FloatArray:
    """Positions (k, 3), likewise."""
    x, y, z = positions.T
    return np.stack([r[0] * x + r[1] * y + r[2] * z + r[3] for r in a], axis=1)


def _times(a: Frame, b: Frame) -> Frame:
    """The frame b, given in a, in what a is given in."""
    rows = [[r[0] * u + r[1] * v + r[2] * w for u, v, w in zip(*b, strict=True)] for r in a]
    one, two, three = ((*row[:3], row[3] + r[3]) for row, r in zip(rows, a, strict=True))
    return (one, two, three)
