"""Whether counts have to be those stored: the installed versions next to the pinned ones."""

from __future__ import annotations

import platform
import re
from collections.abc import Mapping
from pathlib import Path

__all__ = ["ROOT", "pinned", "unpinned"]

ROOT = Path(__file__).parents[2]

COUNTED = ("numpy", "ompl", "pin", "python-fcl", "scipy", "toppra")
"""What a check count can depend on."""


def versions() -> dict[str, str]:
    """Installed versions of ``COUNTED``."""
    from importlib import metadata

    found = {}
    for name in COUNTED:
        try:
            found[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            continue
    return found


def pinned() -> Mapping[str, str]:
    """The versions in constraints.txt, by name."""
    lines = (ROOT / "constraints.txt").read_text("utf-8").splitlines()
    return dict(line.split("==") for line in lines if re.match(r"[\w.-]+==", line))


def unpinned() -> list[str]:
    """How this environment is not the one in which counts are pinned; empty if it is."""
    wanted, found = pinned(), versions()
    different = [
        f"{name} {found.get(name)} is not {wanted[name]}" for name in COUNTED if found.get(name) != wanted[name]
    ]
    if (platform.system(), platform.machine()) != ("Linux", "x86_64"):
        different.append(f"{platform.system()} on {platform.machine()} is not Linux on x86_64")
    return different
