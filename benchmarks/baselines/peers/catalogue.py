"""The peers: what is installed for each, which Python it needs, and the settings its makers or users recommend."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

__all__ = ["PEERS", "Peer", "peer_named"]


@dataclass(frozen=True)
class Peer:
    """Another planner.

    Attributes:
        name: As on the command line.
        requirements: What pip is asked for, pinned.
        imports: A module whose import shows that it works.
        pythons: Versions that do, the preferred first.
        planners: Settings handed to the adapter, by the planner's name; the first is the default.
        note: What to know when installing it.
        module: What its adapter is called, ``_adapter`` added; the peer's name if empty.
    """

    name: str
    requirements: tuple[str, ...]
    imports: str
    pythons: tuple[str, ...]
    planners: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    note: str = ""
    module: str = ""

    @property
    def adapter(self) -> str:
        """The module that is run in the peer's environment."""
        return f"benchmarks.baselines.peers.{(self.module or self.name).replace('-', '_')}_adapter"


_ALL = (
    Peer(
        "mplib",
        ("mplib==0.2.1", "numpy==1.26.4", "toppra==0.6.10"),
        "mplib",
        ("3.12", "3.11", "3.10"),
        {"rrtconnect": {"range": 0.1}, "rrtconnect-auto-range": {"range": 0.0}},
        note="needs numpy < 2; Linux on x86-64, Python 3.10 to 3.12 only",
    ),
    Peer(
        "roboplan",
        ("roboplan==0.7.0",),
        "roboplan.rrt",
        ("3.12", "3.13", "3.11", "3.10"),
        {"rrtconnect": {"step": 0.05, "max_nodes": 1_000_000}},
        note="600 MB, most of it the headers of what it is built on",
    ),
    Peer(
        "ompl-coal",
        ("ompl==2.0.1", "pin==4.1.0", "coal==3.0.3", "numpy==2.2.6"),
        "ompl.geometric",
        ("3.12", "3.13", "3.11", "3.10"),
        {"rrtconnect": {"range": 0.5, "step": 0.05}},
        note="OMPL as one sets it up by hand, each state judged by Pinocchio and Coal",
    ),
)

PEERS: Mapping[str, Peer] = {peer.name: peer for peer in _ALL}


def peer_named(name: str) -> Peer:
    """A peer by its name.

    Raises:
        UnknownName: there is none of that name.
    """
    from planner_service.errors import UnknownName

    if name not in PEERS:
        raise UnknownName("peer", name, tuple(PEERS))
    return PEERS[name]
