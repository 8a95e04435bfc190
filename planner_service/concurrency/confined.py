"""Runs a script in a process of its own, where it may crash, hang or use up memory without harm."""

from __future__ import annotations

import json
import os
import signal
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

__all__ = ["ScriptFailed", "run_confined"]

RUNNER = Path(__file__).with_name("confined_child.py")


class ScriptFailed(Exception):
    """A script gave no answer; the message says why."""


def run_confined(
    script: Path, job: Mapping[str, Any], *, seconds: int, memory: int, given: bytes = b"", bare: bool = False
) -> bytes:
    """What ``answer(job, given)`` returns in ``script``, called in another process.

    The script imports what this process could. What it prints is no part of its answer.

    Args:
        job: What JSON can hold.
        seconds: After which it is killed.
        memory: Bytes of address space.
        bare: It sees no environment variables, and can write to no file.

    Raises:
        ScriptFailed: it raised, crashed, took too long or wanted too much memory.
    """
    import subprocess  # few files need a script

    order = {"path": sys.path, "script": str(script), "seconds": seconds + 5, "memory": memory, "bare": bare}
    command = [sys.executable, "-I", str(RUNNER), json.dumps({**order, "job": job})]
    few = {"OMP_NUM_THREADS": "4", "OPENBLAS_NUM_THREADS": "1"}  # each thread reserves memory
    environment = few if bare else {**os.environ, **few}
    try:
        done = subprocess.run(command, input=given, capture_output=True, timeout=seconds, env=environment, check=False)
    except subprocess.TimeoutExpired:
        raise ScriptFailed(f"it took more than {seconds} s") from None
    if done.returncode < 0:
        raise ScriptFailed(f"it died: {signal.strsignal(-done.returncode)}")
    if done.returncode > 0:
        last = done.stderr.decode("utf-8", "replace").strip().splitlines()[-1:]
        raise ScriptFailed(f"its last message was {' '.join(last)[:200]!r}")
    return done.stdout
