"""A script that runs coacd in a process of its own, where it may crash, hang or use up memory without harm.

Nothing imports it. Its argument is JSON with ``path`` (the parent's sys.path), ``seconds``, ``bytes``,
``vertices`` and ``triangles`` (how many) and ``settings`` (arguments of ``coacd.run_coacd``); on standard input are the
vertices as little-endian float64 and the triangles as int32; on standard output go, little-endian too, the number of
pieces and of points of each as uint32, and the points as float64.
"""

from __future__ import annotations

import json
import os
import resource
import signal
import sys


def main() -> None:
    job = json.loads(sys.argv[1])
    sys.path[:] = job["path"]
    signal.alarm(job["seconds"])  # ends the process even inside native code, and even if the parent is gone
    for limit, value in ((resource.RLIMIT_AS, job["bytes"]), (resource.RLIMIT_CORE, 0)):
        hard = resource.getrlimit(limit)[1]
        resource.setrlimit(limit, (value if hard == resource.RLIM_INFINITY else min(value, hard), hard))
    answer = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # what a library prints is not part of the answer

    import coacd
    import numpy as np

    data = sys.stdin.buffer.read()
    points = np.frombuffer(data, "<f8", 3 * job["vertices"]).reshape(-1, 3)
    triangles = np.frombuffer(data, "<i4", 3 * job["triangles"], points.nbytes).reshape(-1, 3)
    coacd.set_log_level("error")
    pieces = [piece for piece, _ in coacd.run_coacd(coacd.Mesh(points, triangles), **job["settings"])]
    with answer:
        answer.write(np.array([len(pieces), *map(len, pieces)], "<u4").tobytes())
        for piece in pieces:
            answer.write(np.ascontiguousarray(piece, "<f8").tobytes())


if __name__ == "__main__":
    main()
