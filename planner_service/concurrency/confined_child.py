"""The program of the process that ``run_confined`` starts: limits itself, then runs the script.

Nothing imports it. Its argument is JSON with ``path`` (the parent's sys.path), ``script``, ``seconds``, ``memory`` (in
bytes), ``bare`` and ``job``.
"""

from __future__ import annotations

import json
import os
import resource
import runpy
import signal
import sys


def main() -> None:
    order = json.loads(sys.argv[1])
    sys.path[:] = order["path"]
    signal.alarm(order["seconds"])  # ends the process even inside native code, and even if the parent is gone
    limits = [(resource.RLIMIT_AS, order["memory"]), (resource.RLIMIT_CORE, 0)]
    for limit, value in limits + ([(resource.RLIMIT_FSIZE, 0)] if order["bare"] else []):  # pipes are no files
        hard = resource.getrlimit(limit)[1]
        resource.setrlimit(limit, (value if hard == resource.RLIM_INFINITY else min(value, hard), hard))
    out = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # what a library prints is not part of the answer
    script = runpy.run_path(order["script"])
    with out:
        out.write(script["answer"](order["job"], sys.stdin.buffer.read()))


if __name__ == "__main__":
    main()
