"""Rows as Parquet files, the same bytes for the same rows; the only module that uses pyarrow."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

from planner_service.errors import InvalidFile, MissingDependency

__all__ = [
    "REAL",
    "TABLES",
    "TEXT",
    "WHOLE",
    "Rows",
    "episode_bytes",
    "joined_bytes",
    "pyarrow_version",
    "row_count",
    "rows_of",
    "sheet_bytes",
    "table_bytes",
]

Rows = dict[str, list[dict[str, Any]]]
"""The rows of each table by its name; cells are JSON values."""

WHOLE, REAL, TEXT, FLAG = "whole", "real", "text", "flag"

COUNTS = {"states": WHOLE, "edges": WHOLE, "distances": WHOLE}
MOTION = {"request_index": WHOLE, "motion_index": WHOLE, "motion": TEXT}

TABLES: Mapping[str, Mapping[str, Any]] = {
    "episodes": {
        "episode_index": WHOLE,
        "request_index": WHOLE,
        "first_index": WHOLE,
        "length": WHOLE,
        "stats": TEXT,
    },
    "scenes": {
        "request_index": WHOLE,
        "position_in_scene": WHOLE,
        "name": TEXT,
        "shape": TEXT,
        "sizes": [REAL],
        "position": [REAL],
        "quaternion_wxyz": [REAL],
    },
    "motions": {
        "request_index": WHOLE,
        "episode_index": WHOLE,
        "motion_index": WHOLE,
        "motion": TEXT,
        "certified": FLAG,
        "carrying": FLAG,
        "begins_s": REAL,
        "duration_s": REAL,
        "settle_s": REAL,
        "gripping_s": REAL,
        "gripper_width": REAL,
        "waypoints": [[REAL]],
        "blends": [REAL],
        "durations": [REAL],
        "coefficients": [[REAL]],
        "dilation": REAL,
    },
    "counts": {**MOTION, "stage": TEXT, **COUNTS},
    "certificates": {
        **MOTION,
        "certified": FLAG,
        "clearance": REAL,
        "distances": WHOLE,
        "padding": REAL,
        "exempt": [{"s_start": REAL, "s_end": REAL, "a": TEXT, "b": TEXT, "reason": TEXT}],
    },
    "failures": {"request_index": WHOLE, "stage": TEXT, "reason": TEXT, "detail": TEXT, "motions_planned": WHOLE},
    "requests": {
        "request_index": WHOLE,
        "episode_index": WHOLE,
        "ok": FLAG,
        "planner_seed": WHOLE,
        "scene_hash": TEXT,
        "target": TEXT,
        "onto": TEXT,
        "start": [REAL],
        "frames": WHOLE,
        "motion_s": REAL,
        **COUNTS,
        "notes": [TEXT],
    },
}
"""The columns of all tables except the frames, in the order written: a row in requests implies all others."""

FIXED: Mapping[str, Any] = {
    "compression": "zstd",
    "compression_level": 3,
    "version": "2.6",
    "data_page_version": "1.0",
    "use_dictionary": False,
    "write_statistics": True,
    "store_schema": True,
}
"""Every option of the writer, so that pyarrow's defaults do not matter."""


def episode_bytes(columns: Mapping[str, Any], numbers: Mapping[str, int], length: int) -> bytes:
    """The Parquet file of one episode.

    Args:
        columns: float32 arrays (m, k) by name.
        numbers: ``episode_index``, ``task_index``, and ``index`` of the first of its m frames.

    Raises:
        MissingDependency: pyarrow is not installed (extra ``episodes``).
    """
    pa = _arrow()
    made = {}
    for name, values in columns.items():
        flat = pa.array(values.reshape(-1), pa.float32())
        made[name] = flat if values.shape[1] == 1 else pa.FixedSizeListArray.from_arrays(flat, values.shape[1])
    made["frame_index"] = pa.array(range(length), pa.int64())
    made["episode_index"] = pa.array([numbers["episode_index"]] * length, pa.int64())
    made["index"] = pa.array(range(numbers["index"], numbers["index"] + length), pa.int64())
    made["task_index"] = pa.array([numbers["task_index"]] * length, pa.int64())
    return _written(pa.table(made))


def table_bytes(groups: Iterable[Rows]) -> dict[str, bytes]:
    """The Parquet file of every table; each group of rows becomes a row group, and only one is in memory at a time.

    Raises:
        MissingDependency: see ``episode_bytes``.
    """
    pa, pq = _arrow(), _pq()
    schemas = {name: pa.schema([(c, _type(kind)) for c, kind in columns.items()]) for name, columns in TABLES.items()}
    sinks = {name: pa.BufferOutputStream() for name in TABLES}
    with ExitStack() as writers:
        into = {name: writers.enter_context(pq.ParquetWriter(sinks[name], schemas[name], **FIXED)) for name in TABLES}
        for rows in groups:
            for name in filter(rows.get, TABLES):
                into[name].write_table(pa.Table.from_pylist(rows[name], schemas[name]))
    return {name: bytes(sink.getvalue()) for name, sink in sinks.items()}


def joined_bytes(files: Iterable[Path]) -> bytes:
    """One Parquet file with the rows of several that have the same columns; each of them becomes a row group.

    Raises:
        InvalidFile: one is missing or damaged.
        MissingDependency: see ``episode_bytes``.
    """
    sink, pq = _arrow().BufferOutputStream(), _pq()
    with ExitStack() as stack:
        writer = None
        for path in files:
            with _opened(path) as file:
                table = file.read()
            writer = writer or stack.enter_context(pq.ParquetWriter(sink, table.schema, **FIXED))
            writer.write_table(table)
    return bytes(sink.getvalue())


def sheet_bytes(rows: Sequence[Mapping[str, Any]], kinds: Mapping[str, Any], index: str | None = None) -> bytes:
    """The Parquet file of some rows.

    Args:
        kinds: What each column holds, in their order: ``WHOLE``, ``REAL`` or ``TEXT``, or a list of one of these.
        index: The column of texts by which pandas is to name the rows.

    Raises:
        MissingDependency: see ``episode_bytes``.
    """
    pa = _arrow()
    schema = pa.schema([(name, _type(kind)) for name, kind in kinds.items()])
    if index is not None:
        described = [_for_pandas(name, name == index) for name in kinds]
        about = {"index_columns": [index], "column_indexes": [], "columns": described, "pandas_version": None}
        schema = schema.with_metadata({"pandas": json.dumps(about)})
    return _written(pa.Table.from_pylist(list(rows), schema))


def _written(table: Any) -> bytes:
    sink = _arrow().BufferOutputStream()
    with _pq().ParquetWriter(sink, table.schema, **FIXED) as writer:
        writer.write_table(table)
    return bytes(sink.getvalue())


def _for_pandas(name: str, text: bool) -> dict[str, Any]:
    kinds = ("unicode", "object") if text else ("int64", "int64")
    return {"name": name, "field_name": name, "pandas_type": kinds[0], "numpy_type": kinds[1], "metadata": None}


def rows_of(path: Path, columns: Sequence[str]) -> Iterator[dict[str, Any]]:
    """Some columns of the rows of a Parquet file, read by row group.

    Raises:
        InvalidFile: the file is missing or damaged.
    """
    with _opened(path) as file:
        for k in range(file.num_row_groups):
            yield from file.read_row_group(k, columns=list(columns)).to_pylist()


def row_count(path: Path) -> int:
    """The number of rows of a Parquet file, from its footer.

    Raises:
        InvalidFile: the file is missing or damaged.
    """
    with _opened(path) as file:
        return int(file.metadata.num_rows)


@contextmanager
def _opened(path: Path) -> Iterator[Any]:
    lib = _arrow().lib
    try:
        with _pq().ParquetFile(path) as file:
            yield file
    except (lib.ArrowException, OSError) as error:
        raise InvalidFile(path, [f"cannot be read: {error}"]) from error


def pyarrow_version() -> str:
    """The version of pyarrow; another one may write other bytes."""
    return str(_arrow().__version__)


def _type(kind: Any) -> Any:
    pa = _arrow()
    if isinstance(kind, list):
        return pa.list_(_type(kind[0]))
    if isinstance(kind, dict):
        return pa.struct([(name, _type(inner)) for name, inner in kind.items()])
    return {WHOLE: pa.int64(), REAL: pa.float64(), TEXT: pa.string(), FLAG: pa.bool_()}[kind]


def _arrow() -> Any:
    try:
        import pyarrow
    except ImportError:
        raise MissingDependency("pyarrow", "episodes") from None
    return pyarrow


def _pq() -> Any:
    _arrow()
    import pyarrow.parquet

    return pyarrow.parquet
