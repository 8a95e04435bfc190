"""What runs cost is compared with benchmarks/pinned."""

from __future__ import annotations

import pytest

from benchmarks.harness.pins import FOLDER, REGENERATE, Pins, differences, load_pins

__all__ = ["require_pinned"]


def require_pinned(name: str, now: Pins) -> None:
    """Fails the test with what changed against a file of pins."""
    changed = differences(load_pins(FOLDER / f"{name}.json"), now)
    if changed:
        lines = "\n  ".join(map(str, changed))
        pytest.fail(f"{name}:\n  {lines}\nIf that is meant, store it, with a line in CHANGELOG.md: {REGENERATE}")
