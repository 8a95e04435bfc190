from __future__ import annotations

from typing import Any


def make_cameras_from_configs(configs: dict[str, Any]) -> dict[str, Any]:
    return {name: config.make() for name, config in configs.items()}
