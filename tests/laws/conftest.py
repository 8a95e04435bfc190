"""An arm of hulls."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.support.hull_arm import HELD, HullSetup, write_arm


@pytest.fixture(scope="session")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Where its files are."""
    place = tmp_path_factory.mktemp("hulls")
    write_arm(place)
    return place


@pytest.fixture(scope="module", params=["empty hand", "spoon in hand"])
def setup(request: pytest.FixtureRequest, folder: Path) -> HullSetup:
    """The arm among hulls."""
    return HullSetup(request.param, folder, attached=(HELD,) if request.param.startswith("spoon") else ())
