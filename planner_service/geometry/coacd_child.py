"""A script that runs coacd in a process of its own; see ``run_confined``.

Nothing imports it. Its job has ``vertices`` and ``triangles`` (how many) and ``settings`` (arguments of
``coacd.run_coacd``); it is given the vertices as little-endian float64 and the triangles as int32, and answers, little-
endian too, with the number of pieces and of points of each as uint32, and the points as float64.
"""

from __future__ import annotations

from typing import Any


def answer(job: dict[str, Any], data: bytes) -> bytes:
    import coacd
    import numpy as np

    points = np.frombuffer(data, "<f8", 3 * job["vertices"]).reshape(-1, 3)
    triangles = np.frombuffer(data, "<i4", 3 * job["triangles"], points.nbytes).reshape(-1, 3)
    coacd.set_log_level("error")
    pieces = [piece for piece, _ in coacd.run_coacd(coacd.Mesh(points, triangles), **job["settings"])]
    counts = np.array([len(pieces), *map(len, pieces)], "<u4").tobytes()
    return b"".join([counts, *(np.ascontiguousarray(piece, "<f8").tobytes() for piece in pieces)])
