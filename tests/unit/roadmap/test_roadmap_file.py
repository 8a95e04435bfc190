"""Roadmaps in files: what was saved comes back bit for bit, and nothing else is taken for a roadmap."""

from __future__ import annotations

import io
import json
import warnings
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from planner_service import CheckCounts, Roadmap
from planner_service.errors import InvalidFile, InvalidRequest
from planner_service.roadmap import Built, Terms, Verdict
from planner_service.roadmap.verdicts import SELF, Lesson

TERMS = Terms(
    "arm",
    "00ff",
    ("j1", "j2"),
    "bench “é”",
    "aa",
    (("köln", "1"), ("塔", "2")),
    "bb",
    (("a", "b"),),
    0.001,
    "MotionStep(distance=0.01)",
)


@lru_cache
def sample() -> Roadmap:
    rng = np.random.default_rng(0)
    points = np.concatenate([rng.random((20, 2)), [[-0.0, 1e-300]]])
    edges = [(a, b) for a in range(21) for b in range(a + 1, 21) if rng.random() < 0.2]
    lessons: dict[int, Lesson] = {
        0: (Verdict.FREE, None),
        1: (Verdict.BLOCKED, "köln"),
        2: (Verdict.BLOCKED, SELF),
        3: (Verdict.BLOCKED, None),
        4: (Verdict.FREE_BEFORE, None),
        5: (Verdict.BLOCKED_BEFORE, None),
    }
    built = Built("prm", {"milestones": 20}, 2**80, CheckCounts(1, 2, 3))
    whole = replace(Roadmap.of(points, edges, reach=[1.0, 0.25]), terms=TERMS, pending=("köln",), built=built)
    return whole.with_lessons(lessons, lessons).with_path([[0.5, 0.5], [2.0, 2.0], points[3].tolist()])


def saved(tmp_path: Path, roadmap: Roadmap | None = None) -> Path:
    path = tmp_path / "a.roadmap.npz"
    (sample() if roadmap is None else roadmap).save(path)
    return path


def refused(path: Path, data: bytes) -> bool:
    """Whether a file of these bytes is refused; if not, it has to be the same roadmap."""
    path.write_bytes(data)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        try:
            same = Roadmap.load(path).hash == sample().hash
        except (InvalidFile, InvalidRequest):
            return True
    assert same
    return False


NOTHING_KNOWN = Roadmap.of([[0.0], [1.0]], [(0, 1)])


@pytest.mark.parametrize(
    "roadmap",
    [
        sample(),
        NOTHING_KNOWN,
        Roadmap.of(np.zeros((0, 6))),
        replace(NOTHING_KNOWN, fallback=False, remember=True, built=Built("mine", {}, 0, CheckCounts())),
    ],
)
def test_what_was_saved_comes_back_bit_for_bit(roadmap: Roadmap, tmp_path: Path) -> None:
    back = Roadmap.load(saved(tmp_path, roadmap))
    assert back.hash == roadmap.hash
    assert json.dumps(back.head) == json.dumps(roadmap.head)
    assert back.terms == roadmap.terms
    assert back.built == roadmap.built
    assert back.graph.grown == roadmap.graph.grown
    for name, array in roadmap.arrays.items():
        assert back.arrays[name].tobytes() == np.ascontiguousarray(array).tobytes(), name
        assert back.arrays[name].dtype == array.dtype
        assert not back.arrays[name].flags.writeable
    back.save(tmp_path / "b.npz")
    assert (tmp_path / "b.npz").stat().st_size == (tmp_path / "a.roadmap.npz").stat().st_size


def test_a_truncated_file_is_refused(tmp_path: Path) -> None:
    path = saved(tmp_path)
    data = path.read_bytes()
    assert all(refused(path, data[:length]) for length in range(0, len(data), 256))


@pytest.mark.slow
def test_a_file_with_a_flipped_bit_is_refused_or_the_same(tmp_path: Path) -> None:
    path = saved(tmp_path)
    data, rng = path.read_bytes(), np.random.default_rng(0)
    told = 0
    for at in rng.integers(0, len(data), 250).tolist():
        told += refused(path, data[:at] + bytes([data[at] ^ (1 << int(rng.integers(8)))]) + data[at + 1 :])
    assert told > 120


def parts(path: Path) -> dict[str, np.ndarray[Any, Any]]:
    with np.load(path) as archive:
        return {name: archive[name] for name in archive.files}


def written(arrays: dict[str, Any]) -> bytes:
    packed = io.BytesIO()
    np.savez(packed, **arrays)
    return packed.getvalue()


BAD = [
    np.zeros(0),
    np.full((21, 2), np.nan),
    np.full((23, 2), 1e300),
    np.full((23, 2), -1),
    np.array(["a"]),
    np.array([{}], dtype=object),
    np.full(40, 2**63, dtype=np.uint64),
]


@pytest.mark.parametrize("bad", range(len(BAD)))
def test_an_array_of_another_kind_is_refused(bad: int, tmp_path: Path) -> None:
    path = saved(tmp_path)
    arrays = parts(path)
    for name in arrays:
        assert refused(path, written({**arrays, name: BAD[bad]})), name
    for name in arrays:
        assert refused(path, written({key: array for key, array in arrays.items() if key != name})), name


def headed(path: Path, **changes: Any) -> bytes:
    arrays = parts(path)
    head = json.loads(arrays["head"].tobytes())
    for key, value in changes.items():
        at = head
        *where, last = key.split("__")
        for step in where:
            at = at[step]
        at[last] = value
    return written({**arrays, "head": np.frombuffer(json.dumps(head).encode(), dtype=np.uint8)})


@pytest.mark.parametrize(
    "changes",
    [
        {"format": "other"},
        {"version": 2},
        {"hash": "0" * 64},
        {"terms": {}},
        {"terms__padding": float("nan")},
        {"terms__obstacles": [["a"]]},
        {"terms__allowed": [[1, 2]]},
        {"pending": ["köln", 3]},
        {"built__settings": {"a": "b"}},
        {"built__seed": -1},
        {"fallback": 1},
        {"grown": [3, 60]},
        {"grown": [0, 0]},
        {"edge_names": [["a"]]},
    ],
)
def test_a_head_that_says_something_else_is_refused(changes: dict[str, Any], tmp_path: Path) -> None:
    path = saved(tmp_path)
    assert refused(path, headed(path, **changes))


@pytest.mark.parametrize("name", ["\x1b[2J", "\u202e"])
def test_a_name_that_a_terminal_would_obey_is_refused(name: str, tmp_path: Path) -> None:
    path = saved(tmp_path)
    path.write_bytes(headed(path, terms__scene=name))
    with pytest.raises(InvalidFile, match=r"terms.scene: got .* expected a text of printable characters") as caught:
        Roadmap.load(path)
    assert caught.value.problems[0].isprintable()


@pytest.mark.parametrize("change", ["twice", "reversed", "beyond", "below", "loop", "threes"])
def test_edges_that_are_none_are_refused_by_name(change: str, tmp_path: Path) -> None:
    path = saved(tmp_path)
    arrays = parts(path)
    edges = arrays["edges"].copy()
    if change == "twice":
        edges[1] = edges[0]
    if change == "reversed":
        edges[0] = edges[0][::-1]
    if change == "beyond":
        edges[0, 1] = len(arrays["milestones"])
    if change == "below":
        edges[0, 0] = -1
    if change == "loop":
        edges[0, 1] = edges[0, 0]
    if change == "threes":
        edges = np.hstack([edges, edges[:, :1]])
    path.write_bytes(written({**arrays, "edges": edges}))
    with pytest.raises(InvalidFile, match=r"edges: got .* expected each edge once, as two different milestones of 23"):
        Roadmap.load(path)


@pytest.mark.parametrize("kind", ["milestone", "edge"])
@pytest.mark.parametrize(("what", "least", "most"), [("verdicts", 0, 4), ("blockers", -1, 1)])
def test_what_is_known_of_a_roadmap_is_read_in_its_range(
    kind: str, what: str, least: int, most: int, tmp_path: Path
) -> None:
    path = saved(tmp_path)
    arrays = parts(path)
    name = f"{kind}_{what}"
    too_low, too_high = arrays[name].astype(np.int64), arrays[name].astype(np.int64)
    too_low[0], too_high[0] = least - 1, most + 1
    for numbers in (too_low, too_high, arrays[name][:-1]):
        path.write_bytes(written({**arrays, name: numbers}))
        with pytest.raises(InvalidFile, match=rf"{name}: got .* whole numbers in \[{least}, {most}\]"):
            Roadmap.load(path)


def test_other_files_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.npz"
    assert refused(path, b"")
    assert refused(path, b"PK\x05\x06" + bytes(18))
    assert refused(path, written({"points": np.zeros((3, 3))}))
    assert refused(path, written({"head": np.arange(-5, 5)}))
    assert refused(path, written({"head": np.full(5, np.nan)}))
    assert refused(path, written({"head": np.full(5, 1e300)}))
