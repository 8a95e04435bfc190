"""The tube of a gate's decision: the pieces of the arm, thicker by as far as they can be from where they are drawn."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from planner_service.certify.certifier import Certifier
from planner_service.certify.pairs import Piece
from planner_service.gate import Decision, Whereabouts
from planner_service.geometry.arrays import FloatArray, IntArray
from planner_service.robot.kinematic_tree import body_matrix
from planner_service.view.triangles import Triangles, triangles_of

__all__ = ["Part", "Tube", "margin_of", "tube_of"]

PLACES = 12
"""At which the arm is drawn for the targets that pass, and again for those that brake it."""

SHARPEST = 3.0
"""Times the room by which a corner moves out at most; a sharper one would become a needle."""

WIDEST, FINEST = 0.05, 0.0005
"""Metres: a margin that is larger is told as this, and to within which it is told."""


class Part(NamedTuple):
    """Where an arm can be on some of its ways: triangles in the base frame, and at how many places it is drawn."""

    triangles: Triangles
    places: int


class Tube(NamedTuple):
    """Where an arm can be on its way to the targets that pass, and while it brakes."""

    passing: Part
    braking: Part


def tube_of(decision: Decision) -> Tube:
    """The tube of what may be sent of a decision's rows.

    At each of some places the moving pieces of the arm are drawn thicker by an upper bound of how far any of their
    points is from there, on the ways up to the next place and beside them.
    """
    ahead, passing = decision.ahead, 1 + decision.verdict.accepted
    first = Whereabouts(*(np.concatenate([a, b[:passing]]) for a, b in zip(decision.here, ahead, strict=True)))
    rest = Whereabouts(*(rows[passing:] for rows in ahead))
    return Tube(*(_thickened(decision.certifier, part) for part in (first, rest)))


def margin_of(decision: Decision) -> float:
    """Metres that everything keeps in the tube, a lower bound up to ``WIDEST``; 0 if the verdict is not proven."""
    low, high = 0.0, 2.0 * WIDEST if decision.verdict.proven else 0.0
    while high - low > FINEST:
        middle = 0.5 * (low + high)
        proof = decision.certifier.certify_tubes(*decision.ahead, padding=middle)
        if proof.pair is None:
            low = middle
        else:
            high = middle
        if low >= WIDEST:
            return WIDEST
    return low


def _thickened(certifier: Certifier, ways: Whereabouts) -> Part:
    """The pieces in the middle of groups of ways that follow each other, thicker by all that is on these ways."""
    count = len(ways.starts)
    cuts = np.unique(np.linspace(0, count, min(count, PLACES) + 1).round().astype(np.intp))
    pieces = [_Thick.of(piece) for piece in certifier.listed.riding]
    corners, faces, total = list[FloatArray](), list[IntArray](), 0
    for first, last in zip(cuts[:-1].tolist(), cuts[1:].tolist(), strict=True):
        ends = np.concatenate([ways.starts[first:last], ways.ends[first:last]])
        low, high = ends.min(axis=0), ends.max(axis=0)
        middle = 0.5 * (low + high)
        room = 0.5 * (high - low) + ways.rooms[first:last].max(axis=0)
        bodies = [body_matrix(pose) for pose in certifier.robot.body_poses(middle)]
        for piece, moved in zip(pieces, _moved(certifier, middle, room).tolist(), strict=True):
            if piece.body == 0:  # stands still
                continue
            corners.append(piece.at(bodies[piece.body], moved))
            faces.append(piece.faces + total)
            total += len(corners[-1])
    if not corners:
        return Part((np.zeros((0, 3)), np.zeros((0, 3), dtype=np.intp)), 0)
    return Part((np.concatenate(corners), np.concatenate(faces)), len(cuts) - 1)


def _moved(certifier: Certifier, q: FloatArray, room: FloatArray) -> FloatArray:
    """How far points of each piece are from where they are at q (n,), at most, anywhere within a room (n,) of it."""
    there, around = (certifier.tube_boxes(q[None], q[None], each[None]) for each in (np.zeros_like(room), room))
    return np.asarray(np.maximum((around - there)[:, 1], (there - around)[:, 0]).max(axis=1))


class _Thick(NamedTuple):
    """The triangles of a piece in the frame of its body, and which way each corner goes as the piece thickens."""

    body: int
    vertices: FloatArray
    faces: IntArray
    outwards: FloatArray

    @classmethod
    def of(cls, piece: Piece) -> _Thick:
        vertices, faces = triangles_of(piece.shape)
        frame = np.array(piece.frame)
        vertices = vertices @ frame[:, :3].T + frame[:, 3]
        corners = vertices[faces]
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
        sums = np.zeros_like(vertices)
        np.add.at(sums, faces, normals[:, None])
        sums /= np.maximum(np.linalg.norm(sums, axis=1, keepdims=True), 1e-300)
        least = np.ones(len(vertices))
        np.minimum.at(least, faces, (sums[faces] * normals[:, None]).sum(axis=2))
        return cls(piece.body, vertices, faces, sums / np.maximum(least, 1.0 / SHARPEST)[:, None])

    def at(self, pose: FloatArray, thicker: float) -> FloatArray:
        """The corners in the base frame, of a piece that is thicker by so much, (k, 3)."""
        return np.asarray((self.vertices + thicker * self.outwards) @ pose[:3, :3].T + pose[:3, 3])
