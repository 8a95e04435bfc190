"""The peers: what is installed for each, and the settings its makers or users recommend."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

__all__ = ["PEERS", "Peer"]


@dataclass(frozen=True)
class Peer:
    """Another planner.

    Attributes:
        name: As on the command line.
        requirements: What pip is asked for, pinned.
        imports: A module whose import shows that it works.
        planners: Settings handed to the adapter, by the planner's name; the first is the default.
        module: What its adapter is called, ``_adapter`` added; the peer's name if empty.
    """

    name: str
    requirements: tuple[str, ...]
    imports: str
    planners: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    module: str = ""

    @property
    def adapter(self) -> str:
        """The module that is run in the peer's environment."""
        return f"benchmarks.baselines.peers.{(self.module or self.name).replace('-', '_')}_adapter"


PEERS: Mapping[str, Peer] = {
    "ompl-coal": Peer(
        "ompl-coal",
        ("ompl==2.0.1", "pin==4.1.0", "coal==3.0.3", "numpy==2.2.6"),
        "ompl.geometric",
        {"rrtconnect": {"range": 0.5, "step": 0.05}},
    ),
    "vamp": Peer(
        "vamp",
        ("vamp-planner==0.6.4", "numpy==2.2.6"),
        "vamp",
        {
            "rrtc": {"robot": "panda", "planner": "rrtc", "samples": 100_000}
        },  # its default: each search makes room for all
    ),
}
"""OMPL as one sets it up by hand, each state judged by Pinocchio and Coal; VAMP, which pip compiles with cmake."""
