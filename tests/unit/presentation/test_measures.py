"""Numbers in messages are true as they are written."""

import math
import random
import re

from planner_service.presentation.measures import outside_text, range_text

NUMBER = r"(-?[0-9.e+-]+)"


def outside(written: str, low: str, high: str) -> bool:
    return not float(low) <= float(written) <= float(high)


def test_a_value_outside_a_range_is_outside_as_written() -> None:
    chance = random.Random(1)
    for _ in range(10_000):
        low, high = sorted(chance.uniform(-7.0, 7.0) for _ in range(2))
        beyond = 10.0 ** chance.uniform(-16.0, 1.0)
        value = chance.choice([low - beyond, high + beyond, math.nextafter(low, -9.0), math.nextafter(high, 9.0)])
        if low <= value <= high:
            continue
        found = re.fullmatch(rf"{NUMBER} is outside \[{NUMBER}, {NUMBER}\]", outside_text(value, low, high))
        assert found is not None
        assert outside(*found.groups())
        both = re.fullmatch(rf"\[{NUMBER}, {NUMBER}\]", range_text(low, high, value))
        assert both is not None
        assert outside(repr(value), *both.groups())
