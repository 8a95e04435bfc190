from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

from lerobot.registry import Config


@dataclass(kw_only=True)
class TeleoperatorConfig(Config):
    known: ClassVar[dict[str, Any]] = {}
