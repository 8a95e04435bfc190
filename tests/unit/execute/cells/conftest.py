"""These tests run in real time, with arms in threads of their own."""

from __future__ import annotations

import pytest


@pytest.fixture(autouse=True)
def clock() -> None:
    """Time is what it is."""
