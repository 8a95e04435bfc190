from __future__ import annotations

from collections.abc import Callable
from enum import Enum
from typing import Any, ClassVar


class TransitionKey(str, Enum):
    OBSERVATION = "observation"
    ACTION = "action"


class ProcessorStepRegistry:
    known: ClassVar[dict[str, Any]] = {}

    @classmethod
    def register(cls, name: str) -> Callable[[Any], Any]:
        def add(step: Any) -> Any:
            cls.known[name] = step
            return step

        return add


class RobotActionProcessorStep:
    def __call__(self, transition: dict[Any, Any]) -> dict[Any, Any]:
        self._current_transition = transition.copy()
        return {**transition, TransitionKey.ACTION: self.action(transition[TransitionKey.ACTION].copy())}

    def action(self, action: dict[str, Any]) -> dict[str, Any]:
        raise NotImplementedError
