from __future__ import annotations

from lerobot.registry import Device


class Robot(Device):
    """A robot."""
