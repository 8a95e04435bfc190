"""Configurations that are chosen by a name."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar


@dataclass(kw_only=True)
class Config:
    """What every device's configuration has."""

    known: ClassVar[dict[str, Any]]
    id: str | None = None
    calibration_dir: Path | None = None

    @classmethod
    def register_subclass(cls, name: str) -> Callable[[Any], Any]:
        def add(subclass: Any) -> Any:
            cls.known[name] = subclass
            return subclass

        return add

    @property
    def type(self) -> str:
        return next(name for name, each in self.known.items() if each is type(self))


class Device:
    """What every device has."""

    name: str

    def __init__(self, config: Any) -> None:
        self.id = config.id

    def __str__(self) -> str:
        return f"{self.id} {type(self).__name__}"
