"""The version of the package."""

from __future__ import annotations

import importlib.metadata

__all__ = ["RELEASE"]

RELEASE = importlib.metadata.version("planner-service")
"""Such as "0.3.0"."""
