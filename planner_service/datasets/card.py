"""What a data set holds, in numbers, and its data card, the README.md."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from planner_service.geometry.validation import copied_in

__all__ = ["EpisodesSummary", "card"]


@dataclass(frozen=True)
class EpisodesSummary:
    """The size of a data set.

    Attributes:
        requests: Worlds drawn.
        episodes: Worlds in which every motion has a plan; the others are in the table of failures.
        frames: Frames of all episodes.
        failures: Number of failures by reason.
        motions: Motions of all episodes.
        certified: Motions that are proven: all of them.
        motion_seconds: Time in motion, without the gripper's.
        states: States checked for all requests.
        edges: Edges checked.
        distances: Distance bounds computed.
        new: Requests added by this run.
    """

    requests: int
    episodes: int
    frames: int
    failures: Mapping[str, int]
    motions: int
    certified: int
    motion_seconds: float
    states: int
    edges: int
    distances: int
    new: int

    def __post_init__(self) -> None:
        copied_in(self, "failures")


def card(about: Mapping[str, Any], info: Mapping[str, Any], carrying: Sequence[str], summary: EpisodesSummary) -> str:
    """The text of the card; it depends only on the content of the data set."""
    rows = [f"| {reason} | {number:,} |" for reason, number in summary.failures.items()]
    failures = "\n".join(["| reason | requests |", "|---|---|", *rows]) if rows else "None: every request has one."
    columns = "\n".join(
        f"| `{name}` | {feature['dtype']}, {feature['shape'][0]} | {', '.join(feature['names'] or ())} |"
        for name, feature in info["features"].items()
    )
    words = {"failures": failures, "columns": columns, "generation": json.dumps(about, indent=1)}
    words["carrying"] = " and ".join(carrying)
    text = Path(__file__).with_suffix(".md").read_text("utf-8")
    return text.format(**{**about, **asdict(summary), **words})
