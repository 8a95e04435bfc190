"""Tables as text, HTML and Markdown: their width, their alignment, and names from files that steer nothing."""

from __future__ import annotations

import pytest

from planner_service.presentation.tables import CostTable, Row, Table, render_html, render_text

HOSTILE = "\x1b[2J<script>|*x*\n"
"""A name that clears the terminal, runs in a notebook, and breaks a Markdown table."""

ROWS = (Row("search", "rrtconnect", 1234, 5, 0, 0.0123, 1.5), Row("total", "", 1234, 5, 0, 0.0123, 1.5, 2.25))


@pytest.mark.parametrize(
    "part",
    [
        CostTable(HOSTILE, (Row(HOSTILE, HOSTILE, 0, 0, 0, 0.0),)),
        Table(("name",), ((HOSTILE,),)),
        HOSTILE,
    ],
    ids=["costs", "cells", "line"],
)
def test_a_hostile_name_does_nothing(part: CostTable | Table | str) -> None:
    text, html = render_text([part]), render_html([part])
    assert "\\x1b[2J" in text
    assert "\x1b" not in text + html
    assert "<script>" not in html
    assert "&lt;script&gt;" in html


def test_a_hostile_name_is_one_cell_of_a_markdown_table() -> None:
    _, _, line = CostTable("", (Row("<a>|*x*", "", 1, 2, 3, 0.0),)).markdown().splitlines()
    assert line == "| **\\<a\\>\\|\\*x\\*** | 1 | 2 | 3 | 0.0 |"


@pytest.mark.parametrize("width", [20, 88, 300])
def test_no_line_of_costs_is_wider_than_it_may_be(width: int) -> None:
    rows = (*ROWS, Row("a motion", "a long note of many words " * 8, 10**7, 10**5, 10**7, 10.0, 10.0, 10.0))
    lines = CostTable("a title of many words " * 8, rows, "rad").text(width).splitlines()
    assert max(map(len, lines)) <= min(width, 100)
    assert "10,000,000 " in "".join(lines)


def test_numbers_are_aligned_to_the_right_and_long_cells_are_wrapped() -> None:
    table = Table(("name", "count"), (("a", "1"), ("b", "1000"), ("word " * 30, "2")), numeric=("count",))
    head, first, second, *more = table.text(40).splitlines()
    assert head.index("count") + 5 == len(first) == len(second) == len(head)
    assert len(more) > 3
    assert all(len(line) <= 40 for line in more)


PROJECTED = (*ROWS[:1], Row("total", "", 1234, 5, 0, 0.0123, 1.5, 2.25, projections=6789))


def test_projections_have_a_column_only_where_there_are_any() -> None:
    for table, shown in ((CostTable("a plan", ROWS, "rad"), 0), (CostTable("a plan", PROJECTED, "rad"), 1)):
        texts = (table.text(), table.text(60), table.html(), table.markdown())
        assert [text.count("projections") > 0 for text in texts] == [bool(shown)] * 4
    head, search, total = CostTable("a plan", PROJECTED, "rad").text().splitlines()
    assert head.split() == ["a", "plan", "states", "edges", "distances", "projections", "ms"]
    assert search.split()[-5:] == ["1,234", "5", "0", "0", "12.3"]
    assert total.split()[-5:] == ["1,234", "5", "0", "6,789", "12.3"]
    assert len(head) == len(search) == len(total) == 100
    *_, line = CostTable("", PROJECTED).markdown().splitlines()
    assert line == "| **total** | 1,234 | 5 | 0 | 6,789 | 12.3 |"
