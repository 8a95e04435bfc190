from __future__ import annotations

from lerobot.registry import Device


class Teleoperator(Device):
    """A leader."""
