"""YAML files as plain values: no tags, no aliases, no key twice, and no more than their size deserves."""

from __future__ import annotations

import re
import reprlib
from functools import cache
from pathlib import Path
from typing import Any

from planner_service.errors import InvalidFile, MissingDependency

__all__ = ["parse_yaml"]

MAX_DEPTH = 100
"""Mappings and lists inside one another."""

FLOAT = re.compile(r"[-+]?(?:\d+(?:\.\d*)?|\.\d+)(?:[eE][-+]?\d+)?$")
"""YAML 1.1 takes ``1e-05`` for a text; writers of numbers mean one."""


def parse_yaml(path: Path, data: bytes) -> Any:
    """The value of the YAML text that a file at ``path`` holds.

    Raises:
        InvalidFile: not UTF-8, malformed (with the line), with an alias, a tag, a key twice in one mapping, or nested
            more than 100 deep.
        MissingDependency: PyYAML is not installed.
    """
    try:
        import yaml
    except ImportError:
        raise MissingDependency("yaml", "yaml") from None
    try:
        text = data.decode("utf-8")
        _require_plain(text, getattr(yaml, "CSafeLoader", yaml.SafeLoader))
        return yaml.load(text, _loader())
    except UnicodeDecodeError as error:
        raise InvalidFile(path, [f"not UTF-8: byte {data[error.start]:#04x} at {error.start}"]) from None
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        raise InvalidFile(path, [f"malformed YAML: {' '.join(str(error).split())}"]) from None


def _require_plain(text: str, loader: Any) -> None:
    import yaml

    depth = 0
    for event in yaml.parse(text, loader):
        if isinstance(event, yaml.AliasEvent):
            raise ValueError(f"an alias, *{event.anchor}, in line {event.start_mark.line + 1}; write it out")
        depth += isinstance(event, yaml.CollectionStartEvent) - isinstance(event, yaml.CollectionEndEvent)
        if depth > MAX_DEPTH:
            raise ValueError(f"nested more than {MAX_DEPTH} deep in line {event.start_mark.line + 1}")


@cache
def _loader() -> Any:
    import yaml

    class Loader(getattr(yaml, "CSafeLoader", yaml.SafeLoader)):  # type: ignore[misc]
        """Refuses a key that is there twice, and reads every number as one."""

        def construct_mapping(self, node: Any, deep: bool = False) -> dict[Any, Any]:
            seen = set[Any]()
            for key, _ in node.value:
                if key.value in seen:
                    raise ValueError(f"key {reprlib.repr(key.value)} twice, line {key.start_mark.line + 1}")
                seen.add(key.value)
            return dict(super().construct_mapping(node, deep))

    Loader.add_implicit_resolver("tag:yaml.org,2002:float", FLOAT, list("-+0123456789."))
    return Loader
