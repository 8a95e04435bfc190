"""Five work cells for three robots: what stands in them, what is to be moved, and where it may go.

Each kind of cell is a function of its sizes; ``cell`` has the sizes for each robot. Draw 0 has them as they are below,
other draws vary them. Poses are in the robot's base frame, whose z axis points up.
"""

from __future__ import annotations

import math
import random
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import product
from typing import Any

import planner_service as ps
from planner_service.geometry import Compound
from planner_service.geometry.shapes import Shape

__all__ = ["KINDS", "ROBOTS", "Cell", "Job", "cell"]

ROBOTS = ("wxai", "panda", "ur5_vacuum")

GAP = 0.001
"""Metres between what stands and what it stands on."""

WALL = 0.008
"""Thickness of the walls of bins and trays, in metres."""

Point = tuple[float, float, float]


@dataclass(frozen=True, eq=False)
class Job:
    """One object: where it is, and where it may go.

    Attributes:
        name: Of the object.
        shape: Its shape.
        at: Its pose before.
        support: The obstacle that it stands on before.
        places: Poses of the object, best first; the same place may be offered to several objects.
        onto: The obstacle that it stands on afterwards.
        station: Where it may be set down on the way, to be taken anew; none if it is not to be.
        via: The obstacle that it then stands on.
        side: Whether it is to be taken from the side, which is how a thing gets onto a shelf.
        plain: Whether grasps from above about its middle will do.
        inserted: Whether it goes straight down into a hole.
    """

    name: str
    shape: Shape | Compound
    at: ps.Pose
    support: str
    places: tuple[ps.Pose, ...]
    onto: str
    station: tuple[ps.Pose, ...] = ()
    via: str = ""
    side: bool = False
    plain: bool = False
    inserted: bool = False

    @property
    def obstacle(self) -> ps.Obstacle:
        """The object where it is before."""
        return ps.Obstacle(self.name, self.shape, self.at)


@dataclass(frozen=True, eq=False)
class Cell:
    """A robot's surroundings, and what it has to do there, in an order that works.

    Attributes:
        kind: One of ``KINDS``.
        robot: Its name.
        scene: What stands there at the beginning. Objects that arrive one after the other are not in it.
        jobs: In the order in which they are done.
    """

    kind: str
    robot: str
    scene: ps.Scene
    jobs: tuple[Job, ...] = field(repr=False)

    @property
    def name(self) -> str:
        """Of the cell and the robot, for tables."""
        return f"{self.kind}, {self.robot}"

    def before(self, scene: ps.Scene, job: Job) -> ps.Scene:
        """The scene with the object of a job in it, which may have arrived only now."""
        return scene if job.name in scene.names else scene.with_obstacle(job.obstacle)


def cell(kind: str, robot: str, draw: int = 0) -> Cell:
    """The cell of a kind for a robot.

    Args:
        draw: 0 for the sizes in the tables; others are varied by up to a tenth, and by two centimetres of position.
    """
    make, sizes = _MAKERS[kind], _SIZES[kind][robot]
    chance = random.Random(f"{kind} {robot} {draw}")
    given = {key: value if draw == 0 else _varied(key, value, chance) for key, value in sizes.items()}
    scene, jobs = make(chance, **given)
    return Cell(kind, robot, replace(scene, name=kind), tuple(jobs))


def _varied(key: str, value: Any, chance: random.Random) -> Any:
    """Sizes smaller by up to a tenth, positions moved by up to 2 cm; heights, gaps and counts as they are."""
    if key.startswith(("at_",)):
        x, y, z = value
        return (x + chance.uniform(-0.02, 0.02), y + chance.uniform(-0.02, 0.02), z)
    if key.startswith("size_"):
        return tuple(length * chance.uniform(0.9, 1.0) for length in value)
    return value


def palletise(
    chance: random.Random, *, floor: float, size_box: Point, gap: tuple[float, float], at_pallet: Point, at_belt: Point,
    guard: float,
) -> tuple[ps.Scene, list[Job]]:  # fmt: skip
    """24 boxes from the end of a belt over a guard onto a pallet: two layers of four by three.

    Args:
        gap: Between boxes along x and y, in metres.
        at_pallet: Middle of the pallet's top.
        at_belt: Where a box's underside is when it has arrived.
        guard: Height of the guard's top.
    """
    del chance
    length, width, height = size_box
    pitch = (length + gap[0], width + gap[1])
    area = (4 * pitch[0] + 0.02, 3 * pitch[1] + 0.02)
    x, y, top = at_pallet
    u, v, w = at_belt
    between = 0.5 * (y - area[1] / 2 + v + width / 2)
    scene = ps.Scene(
        (
            *_ground(floor),
            _block("pallet", (*area, top - floor), (x, y, floor)),
            _block("belt", (1.6 * length, 3.0 * width, w - floor), (u, v - 0.75 * width, floor)),
            _block("guard", (area[0], 0.01, guard - floor), (x, between, floor)),
        )
    )
    jobs = list[Job]()
    for layer, i, j in product(range(2), reversed(range(4)), reversed(range(3))):
        z = top + GAP + height / 2 + layer * (height + GAP)
        place = ps.Pose((x + (i - 1.5) * pitch[0], y + (j - 1.0) * pitch[1], z))
        number = len(jobs)
        under = "pallet" if layer == 0 else f"box_{number - 12}"
        at = ps.Pose((u, v, w + GAP + height / 2))
        jobs.append(Job(f"box_{number}", ps.Box(size_box), at, "belt", (place,), under, plain=True))
    return scene, jobs


def bin_to_tray(
    chance: random.Random, *, floor: float, side: float, size_bin: Point, at_bin: Point, apart: float,
    trays: Sequence[Point], pitch: float,
) -> tuple[ps.Scene, list[Job]]:  # fmt: skip
    """12 objects out of a bin, turned anyhow: boxes onto one tray and cylinders onto another, wherever there is room.

    Args:
        side: Of a box, and the diameter and height of a cylinder, in metres.
        size_bin: Inside.
        at_bin: Middle of its floor's top.
        apart: Between the middles of objects in it, along x and y.
        trays: Middles of their tops.
        pitch: Between places on a tray.
    """
    x, y, z = at_bin
    things = [*_ground(floor), *_open_box("bin", size_bin, at_bin, floor)]
    for name, (u, v, top) in zip(("tray_a", "tray_b"), trays, strict=True):
        things.append(_block(name, (2 * pitch, 3 * pitch, top - floor), (u, v, floor)))
    jobs = list[Job]()
    spots = list(product(range(4), range(3)))
    chance.shuffle(spots)
    for number, (i, j) in enumerate(spots):
        kind = number % 2
        shape: Shape = ps.Cylinder(side / 2, side) if kind else ps.Box((side, side, side))
        at = (x + (i - 1.5) * apart, y + (j - 1.0) * apart, z + GAP + side / 2)
        yaw = chance.uniform(-math.pi, math.pi)
        u, v, top = trays[kind]
        middles = [
            (u + (a - 0.5) * pitch, v + (b - 1.0) * pitch, top + GAP + side / 2)
            for a, b in product((1, 0), (2, 1, 0) if v > 0 else (0, 1, 2))
        ]
        turns = (0.0,) if kind else (0.0, 0.5 * math.pi)
        places = tuple(_turned(middle, turn) for middle, turn in product(middles, turns))
        name = f"{'cylinder' if kind else 'block'}_{number}"
        jobs.append(Job(name, shape, _turned(at, yaw), "bin_floor", places, ("tray_a", "tray_b")[kind], plain=True))
    things += [job.obstacle for job in jobs]
    return ps.Scene(tuple(things)), jobs


def shelf(
    chance: random.Random, *, floor: float, size_item: Point, carts: Sequence[Sequence[float]], at_shelf: Point,
    boards: Sequence[float], pitch: float, depth: float, margin: float,
) -> tuple[ps.Scene, list[Job]]:  # fmt: skip
    """Ten items from two carts beside the robot into a shelf of two boards before it, open to its front.

    Args:
        carts: x, y and top of each cart's middle; on it stand five items in a row along x.
        at_shelf: x and y of the middle of the row in which items are to stand.
        boards: Heights of the two boards' tops.
        pitch: Between items.
        depth: Of the boards; items stand in the middle of it.
        margin: Of a board beyond its items' share, on either side.
    """
    _, width, height = size_item
    x, y, _ = at_shelf
    wide, thick = 5 * pitch + 2 * margin, 0.012
    top = boards[-1] + (boards[1] - boards[0])
    things = [*_ground(floor)]
    for k, board in enumerate((*boards, top)):
        name = "roof" if k == len(boards) else f"board_{k}"
        things.append(_block(name, (depth, wide, thick), (x, y, board - thick)))
    low = boards[0] - thick
    for name, aside in (("left", 0.5), ("right", -0.5)):
        things.append(
            _block(f"shelf_{name}", (depth, thick, top - floor), (x, y + aside * (wide + thick + GAP), floor))
        )
    things.append(_block("shelf_back", (thick, wide, top - thick - floor), (x + 0.5 * (depth + thick) + GAP, y, floor)))
    things.append(_block("shelf_foot", (depth, 0.8 * wide, low - GAP - floor), (x, y, floor)))
    jobs = list[Job]()
    for k, (u, v, w) in enumerate(carts):
        things.append(_block(f"cart_{k}", (5 * pitch, 1.5 * width, w - floor), (u, v, floor)))
        for i in range(5):
            at = ps.Pose((u + (i - 2) * pitch, v + chance.uniform(-0.003, 0.003), w + GAP + height / 2))
            side = 1 if v > y else -1
            place = (x, y + side * (2 - i) * pitch, boards[k] + GAP + height / 2)
            places = tuple(_turned(place, -side * quarters * 0.5 * math.pi) for quarters in (1, 2, 0, 3))
            name = f"item_{len(jobs)}"
            jobs.append(Job(name, ps.Box(size_item), at, f"cart_{k}", places, f"board_{k}", side=True))
    things += [job.obstacle for job in jobs]
    return ps.Scene(tuple(things)), jobs


def kitting(
    chance: random.Random, *, floor: float, size_pin: Point, at_tray: Point, at_station: Point, at_kit: Point,
    room: float, pitch: float, foot: Sequence[float],
) -> tuple[ps.Scene, list[Job]]:  # fmt: skip
    """Eight pins that lie in a tray into the pockets of a kit, upright: each is taken anew where it was stood up.

    Args:
        size_pin: Lying, its length along x.
        at_tray: Middle of its top.
        at_station: Middle of the top of the block on which a pin is stood up.
        at_kit: Middle of the pockets' floor.
        room: Between a pin and the walls of its pocket, in metres.
        pitch: Between pins in the tray.
        foot: Length and width of the station.
    """
    length, width, height = size_pin
    x, y, z = at_tray
    u, v, w = at_kit
    inner, wall = max(width, height) + 2 * room, 0.006
    step = inner + 2 * wall + 0.02
    deep = 0.5 * length
    things = [*_ground(floor)]
    things.append(_block("tray", (2 * (length + 0.03), 4 * pitch, z - floor), (x, y, floor)))
    things.append(_block("station", (*foot, at_station[2] - floor), (at_station[0], at_station[1], floor)))
    things.append(_block("kit_floor", (2 * step, 4 * step, w - floor), (u, v, floor)))
    jobs = list[Job]()
    for number, (i, j) in enumerate(product((1, 0), reversed(range(4)) if v > 0 else range(4))):
        middle = (u + (i - 0.5) * step, v + (j - 1.5) * step)
        things.append(_pocket(f"pocket_{number}", inner, wall, deep, (*middle, w)))
        lies = (x + (i - 0.5) * (length + 0.03), y + (j - 1.5) * pitch, z + GAP + height / 2)
        at = _turned(lies, chance.uniform(-0.06, 0.06))
        upright = [_stood((*middle, w + GAP + length / 2), k, way) for way in (1, -1) for k in range(4)]
        stands = (*at_station[:2], at_station[2] + GAP + length / 2)
        station = [_stood(stands, 0.5 * k, way) for way in (1, -1) for k in range(8)]
        jobs.append(
            Job(
                f"pin_{number}",
                ps.Box(size_pin),
                at,
                "tray",
                tuple(upright),
                "kit_floor",
                station=tuple(station),
                via="station",
                inserted=True,
            )
        )
    things += [job.obstacle for job in jobs]
    return ps.Scene(tuple(things)), jobs


def screws(
    chance: random.Random, *, floor: float, size_screw: Point, at_feeder: Point, at_plate: Point, pitch: float,
    room: float,
) -> tuple[ps.Scene, list[Job]]:  # fmt: skip
    """30 screws from a feeder into the holes of a plate, six by five, each resting on its head.

    Args:
        size_screw: Radius of the head, its height, and the length of the shank, whose radius is half the head's.
        at_feeder: Where the underside of a head is when a screw is presented.
        at_plate: Middle of the plate's top.
        pitch: Between holes.
        room: Between a shank and its hole, in metres.
    """
    del chance
    radius, head, shank = size_screw
    x, y, top = at_plate
    u, v, w = at_feeder
    shape = Compound(
        (
            (ps.Cylinder(radius, head), ps.Pose((0.0, 0.0, head / 2))),
            (ps.Cylinder(radius / 2, shank), ps.Pose((0.0, 0.0, -shank / 2))),
        )
    )
    hole = radius + 2 * room
    feeder = _pocket("feeder", hole, radius, w - floor, (u, v, floor))
    scene = ps.Scene((*_ground(floor), feeder, _holes("plate", (6, 5), pitch, hole, shank + 0.01, (x, y, top))))
    jobs = list[Job]()
    for i, j in product(reversed(range(6)), reversed(range(5)) if y > 0 else range(5)):
        place = (x + (i - 2.5) * pitch, y + (j - 2.0) * pitch, top + GAP)
        at = ps.Pose((u, v, w + GAP))
        places = tuple(_turned(place, 0.25 * math.pi * k) for k in range(8))
        jobs.append(Job(f"screw_{len(jobs)}", shape, at, "feeder", places, "plate", inserted=True))
    return scene, jobs


def _ground(floor: float) -> Iterator[ps.Obstacle]:
    """A floor, and under a robot that stands higher a pedestal."""
    yield ps.Obstacle("floor", ps.Box((2.6, 2.6, 0.1)), ps.Pose((0.0, 0.0, floor - 0.05 - GAP)))
    if floor < -0.05:
        yield _block("pedestal", (0.2, 0.2, -floor - 0.02), (0.0, 0.0, floor))


def _block(name: str, size: Sequence[float], foot: Sequence[float]) -> ps.Obstacle:
    """A box by the middle of its underside."""
    length, width, height = size
    x, y, z = foot
    return ps.Obstacle(name, ps.Box((length, width, height)), ps.Pose((x, y, z + height / 2)))


def _open_box(name: str, inside: Point, at: Point, floor: float) -> Iterator[ps.Obstacle]:
    """A box without a lid, on a foot: five plates."""
    length, width, height = inside
    x, y, z = at
    yield _block(f"{name}_floor", (length, width, z - floor), (x, y, floor))
    for key, along, sign in (("back", 0, 1), ("front", 0, -1), ("left", 1, 1), ("right", 1, -1)):
        size = [length + 2 * WALL, width + 2 * WALL, z + height - floor]
        size[along] = WALL
        foot = [x, y, floor]
        foot[along] += sign * ((length, width)[along] / 2 + WALL / 2 + GAP)
        if along == 0:
            size[1] = width
        yield _block(f"{name}_{key}", size, foot)


def _pocket(name: str, inner: float, wall: float, height: float, foot: Point) -> ps.Obstacle:
    """Four walls around a square hole, as one thing."""
    aside = (inner + wall) / 2
    parts = []
    for sign in (1, -1):
        parts.append((ps.Box((wall, inner + 2 * wall, height)), ps.Pose((sign * aside, 0.0, height / 2))))
        parts.append((ps.Box((inner, wall, height)), ps.Pose((0.0, sign * aside, height / 2))))
    return ps.Obstacle(name, Compound(tuple(parts)), ps.Pose(foot))


def _holes(name: str, count: tuple[int, int], pitch: float, hole: float, thick: float, at: Point) -> ps.Obstacle:
    """A plate with square holes: bars along y, and short ones between them along x; ``at`` is the middle of its top."""
    across, along = count
    bar = pitch - hole
    parts = []
    for i in range(across + 1):
        at_x = (i - across / 2) * pitch
        parts.append((ps.Box((bar, along * pitch + bar, thick)), ps.Pose((at_x, 0.0, -thick / 2))))
    for i, j in product(range(across), range(along + 1)):
        middle = ((i - (across - 1) / 2) * pitch, (j - along / 2) * pitch, -thick / 2)
        parts.append((ps.Box((hole, bar, thick)), ps.Pose(middle)))
    return ps.Obstacle(name, Compound(tuple(parts)), ps.Pose(at))


def _turned(position: Sequence[float], yaw: float) -> ps.Pose:
    x, y, z = position
    return ps.Pose((x, y, z), (math.cos(yaw / 2), 0.0, 0.0, math.sin(yaw / 2)))


def _stood(position: Sequence[float], quarters: float, way: int) -> ps.Pose:
    """A thing that lies along x stood up on either end, then turned about the vertical."""
    half = math.sqrt(0.5)
    up = ps.Pose(quaternion=(half, 0.0, -way * half, 0.0))  # its x axis points up, or down
    return ps.Pose(_turned(position, 0.0).position) @ _turned((0.0, 0.0, 0.0), quarters * 0.5 * math.pi) @ up


_MAKERS: dict[str, Callable[..., tuple[ps.Scene, list[Job]]]] = {
    "palletise": palletise,
    "bin": bin_to_tray,
    "shelf": shelf,
    "kitting": kitting,
    "screws": screws,
}

KINDS = tuple(_MAKERS)
"""Palletise 24, bin to tray 12, shelf restocking 10, kitting with regrasp 8, screws on a plate 30."""

_SIZES: dict[str, dict[str, dict[str, Any]]] = {
    "palletise": {
        "wxai": {
            "floor": 0.0, "size_box": (0.036, 0.03, 0.03), "gap": (0.01, 0.024), "at_pallet": (0.27, 0.17, 0.02),
            "at_belt": (0.25, -0.2, 0.03), "guard": 0.08,
        },
        "panda": {
            "floor": 0.0, "size_box": (0.06, 0.05, 0.05), "gap": (0.012, 0.036), "at_pallet": (0.45, 0.28, 0.03),
            "at_belt": (0.45, -0.3, 0.1), "guard": 0.25,
        },
        "ur5_vacuum": {
            "floor": -0.4, "size_box": (0.12, 0.1, 0.1), "gap": (0.01, 0.01), "at_pallet": (0.58, 0.1, -0.28),
            "at_belt": (0.1, -0.55, -0.15), "guard": -0.05,
        },
    },
    "bin": {
        "wxai": {
            "floor": 0.0, "side": 0.03, "size_bin": (0.28, 0.22, 0.05), "at_bin": (0.3, -0.16, 0.006), "apart": 0.062,
            "trays": ((0.2, 0.17, 0.01), (0.34, 0.17, 0.01)), "pitch": 0.06,
        },
        "panda": {
            "floor": 0.0, "side": 0.045, "size_bin": (0.4, 0.31, 0.05), "at_bin": (0.48, -0.26, 0.01), "apart": 0.09,
            "trays": ((0.38, 0.25, 0.015), (0.6, 0.25, 0.015)), "pitch": 0.09,
        },
        "ur5_vacuum": {
            "floor": -0.3, "side": 0.06, "size_bin": (0.42, 0.33, 0.12), "at_bin": (0.5, -0.32, -0.28), "apart": 0.092,
            "trays": ((0.38, 0.25, -0.28), (0.65, 0.25, -0.28)), "pitch": 0.11,
        },
    },
    "shelf": {
        "wxai": {
            "floor": 0.0, "size_item": (0.03, 0.03, 0.06), "carts": ((0.05, 0.38, 0.14), (0.05, -0.38, 0.14)),
            "at_shelf": (0.46, 0.0, 0.0), "boards": (0.14, 0.28), "pitch": 0.075, "depth": 0.1, "margin": 0.02,
        },
        "panda": {
            "floor": 0.0, "size_item": (0.04, 0.04, 0.09), "carts": ((0.1, 0.55, 0.15), (0.1, -0.55, 0.15)),
            "at_shelf": (0.66, 0.0, 0.0), "boards": (0.12, 0.42), "pitch": 0.1, "depth": 0.12, "margin": 0.07,
        },
        "ur5_vacuum": {
            "floor": -0.3, "size_item": (0.07, 0.07, 0.11), "carts": ((0.1, 0.6, 0.0), (0.1, -0.6, 0.0)),
            "at_shelf": (0.72, 0.0, 0.0), "boards": (0.05, 0.35), "pitch": 0.12, "depth": 0.16, "margin": 0.02,
        },
    },
    "kitting": {
        "wxai": {
            "floor": 0.0, "size_pin": (0.08, 0.022, 0.022), "at_tray": (0.27, -0.17, 0.02),
            "at_station": (0.4, 0.0, 0.12), "foot": (0.05, 0.05), "at_kit": (0.28, 0.17, 0.01), "room": 0.006,
            "pitch": 0.055,
        },
        "panda": {
            "floor": 0.0, "size_pin": (0.1, 0.03, 0.03), "at_tray": (0.45, -0.3, 0.03),
            "at_station": (0.6, 0.0, 0.12), "foot": (0.06, 0.06), "at_kit": (0.45, 0.28, 0.02), "room": 0.004,
            "pitch": 0.08,
        },
        "ur5_vacuum": {
            "floor": -0.3, "size_pin": (0.14, 0.06, 0.06), "at_tray": (0.5, -0.3, -0.25),
            "at_station": (0.65, 0.0, -0.05), "foot": (0.1, 0.1), "at_kit": (0.45, 0.28, -0.28), "room": 0.005,
            "pitch": 0.09,
        },
    },
    "screws": {
        "wxai": {
            "floor": 0.0, "size_screw": (0.007, 0.012, 0.016), "at_feeder": (0.26, -0.18, 0.05),
            "at_plate": (0.28, 0.12, 0.04), "pitch": 0.034, "room": 0.002,
        },
        "panda": {
            "floor": 0.0, "size_screw": (0.008, 0.026, 0.02), "at_feeder": (0.45, -0.25, 0.08),
            "at_plate": (0.45, 0.22, 0.05), "pitch": 0.05, "room": 0.002,
        },
        "ur5_vacuum": {
            "floor": -0.3, "size_screw": (0.018, 0.015, 0.03), "at_feeder": (0.45, -0.3, -0.2),
            "at_plate": (0.5, 0.22, -0.22), "pitch": 0.055, "room": 0.003,
        },
    },
}  # fmt: skip
