"""Changing what windows show, and nothing that they show already: each change is a message to each of them."""

from __future__ import annotations

from typing import Any

__all__ = ["update"]


def update(handle: Any, **values: Any) -> None:
    """Set the attributes of a control or a node that have other values."""
    for name, value in values.items():
        if getattr(handle, name) != value:
            setattr(handle, name, value)
