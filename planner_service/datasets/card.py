"""The data card: the README.md of a data set."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from planner_service.datasets.summary import EpisodesSummary

__all__ = ["card"]


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
