"""This package as it is here, and as it was at 0.1.0: each in a process of its own, asked in the same way.

0.1.0 is installed from its commit into an environment among those of the peers, with the interpreter that runs this and
the dependencies that it was measured with.
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from benchmarks.baselines.peers.catalogue import Peer
from benchmarks.baselines.peers.child import Child, Reply
from benchmarks.baselines.peers.environments import Environment
from benchmarks.harness.environment import ROOT
from planner_service.errors import InvalidRequest

__all__ = ["HERE", "THEN", "TURNS", "replies", "version_here", "version_then"]

HERE, THEN = "planner_service", "planner_service-0.1.0"

COMMIT = "845d88545504b88c429164dc5ec60ee01dd8ad82"
"""0.1.0."""

PINS = (
    *("numpy==2.2.6", "ompl==2.0.1", "pin==4.1.0", "python-fcl==0.7.0.11", "scipy==1.15.3", "toppra==0.6.10"),
    *("piqp==0.7.0", "yourdfpy==0.0.60", "example-robot-data==6.0.0"),
)
"""Of that commit's constraints.txt, those that planning uses."""

TURNS = 3
"""Plans of each request, of which the fastest counts: what disturbs only adds."""


def _peer(name: str, *requirements: str) -> Peer:
    module = "planner_service"
    return Peer(name, requirements, module, {"default": {"turns": TURNS}}, module=module)


def version_here() -> Environment:
    """The environment of this process."""
    return Environment(_peer(HERE), Path(sys.executable).parents[1])


def version_then(against: Path | None = None) -> Environment:
    """The environment of 0.1.0, which is made if it is not there.

    Args:
        against: The python of another virtual environment that has the version to be compared with.

    Raises:
        InvalidRequest: it cannot be made, which is explained; or there is no such python.
    """
    peer = _peer(THEN, f"git+file://{ROOT}@{COMMIT}", *PINS)
    if against is not None:
        if not against.is_file():
            raise InvalidRequest("--against", str(against), "the python of a virtual environment")
        return Environment(peer, against.absolute().parents[1])
    made = Environment.of(peer)
    same = (made.folder / "lib" / "python{}.{}".format(*sys.version_info)).is_dir()  # interpreter as here
    state = "installed" if made.ready and same else made.install()
    if state != "installed":
        message = f"{THEN} cannot be installed: {state}; name an environment that has it with --against PYTHON"
        raise InvalidRequest("--against", "none", "the python of an environment", message=message)
    return made


def replies(version: Environment, robot: str, problems: list[Mapping[str, Any]]) -> Iterator[Reply]:
    """The plans of default requests; each is made when it is asked for."""
    settings = dict(version.peer.planners["default"])
    job = {"version": 1, "robot": {"name": robot}, "settings": settings, "problems": problems}
    with tempfile.TemporaryDirectory(prefix="version-") as folder:
        command = (str(version.python), "-m", version.peer.adapter)
        yield from Child(command, version.surroundings(), Path(folder)).replies(job)
