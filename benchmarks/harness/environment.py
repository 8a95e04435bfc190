"""Where results were made: interpreter, machine, versions and commit, and whether counts have to be those stored."""

from __future__ import annotations

import hashlib
import os
import platform
import re
import subprocess
from collections.abc import Mapping
from pathlib import Path
from typing import Any

__all__ = ["ROOT", "environment", "pinned", "unpinned"]

ROOT = Path(__file__).parents[2]

PACKAGES = ("coal", "numpy", "ompl", "pin", "planner-service", "python-fcl", "scipy", "toppra")
"""What planning and auditing use."""

COUNTED = ("numpy", "ompl", "pin", "python-fcl", "scipy", "toppra")
"""What a check count can depend on."""


def environment() -> dict[str, Any]:
    """The header's ``environment``."""
    from planner_service.collision.native_kernel import instruction_sets

    return {
        "python": platform.python_version(),
        "platform": platform.platform(),
        "cpu": _cpu(),
        "cores": os.cpu_count() or 1,
        "versions": versions(),
        "commit": commit(),
        "instruction_set": ("numpy", *instruction_sets())[-1],
    }


def versions() -> dict[str, str]:
    """Installed versions of ``PACKAGES``."""
    from importlib import metadata

    found = {}
    for name in PACKAGES:
        try:
            found[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            continue
    return found


def commit() -> str | None:
    """The commit of the checkout; where files differ from it, a fingerprint of the difference too; None without git."""
    head = _git("rev-parse", "HEAD")
    changed = _git("diff", "HEAD")
    if head is None or changed is None:
        return None
    return head.strip() + (f"+{hashlib.sha256(changed.encode()).hexdigest()[:12]}" if changed else "")


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


def _git(*arguments: str) -> str | None:
    try:
        done = subprocess.run(["git", *arguments], cwd=ROOT, capture_output=True, text=True, check=False, timeout=30)
    except (OSError, subprocess.TimeoutExpired, UnicodeDecodeError):
        return None
    return done.stdout if done.returncode == 0 else None


def _cpu() -> str:
    try:
        told = Path("/proc/cpuinfo").read_text("utf-8")
    except OSError:
        return platform.processor() or platform.machine()
    named = re.search(r"^model name\s*:\s*(.+)$", told, flags=re.MULTILINE)
    return named[1].strip() if named else platform.machine()
