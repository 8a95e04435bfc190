"""Whatever happens to the folder, a cache gives back what was put in, or nothing."""

from __future__ import annotations

import os
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from planner_service.errors import BrokenInvariant
from planner_service.files import disk_cache
from planner_service.files.disk_cache import DiskCache, cache_folder

KEY, OTHER = "0" * 64, "1" * 64


@pytest.fixture
def cache(tmp_path: Path) -> DiskCache:
    return DiskCache(tmp_path / "not" / "yet")


def entry(cache: DiskCache, key: str = KEY) -> Path:
    assert cache.folder is not None
    return cache.folder / f"{key}.bin"


def test_what_was_put_comes_back(cache: DiskCache) -> None:
    cache.put(KEY, b"some bytes")
    cache.put(OTHER, b"")
    assert (cache.get(KEY), cache.get(OTHER), cache.get("2" * 64)) == (b"some bytes", b"", None)
    cache.put(KEY, b"others")
    assert cache.get(KEY) == b"others"


def test_a_damaged_or_foreign_entry_is_not_there_and_is_replaced(cache: DiskCache) -> None:
    cache.put(KEY, b"some bytes")
    whole = entry(cache).read_bytes()
    flipped = whole[:-1] + bytes([whole[-1] ^ 1])
    for data in (whole[:-1], whole[:10], b"", whole + b"x", flipped, b"PK\x03\x04" + whole, b"\x80\x04."):
        entry(cache).write_bytes(data)
        assert cache.get(KEY) is None
        cache.put(KEY, b"some bytes")
        assert cache.get(KEY) == b"some bytes"


def test_a_folder_a_pipe_or_a_link_to_a_device_in_place_of_an_entry_is_not_there(cache: DiskCache) -> None:
    entry(cache).mkdir(parents=True)
    os.mkfifo(entry(cache, OTHER))
    entry(cache, "2" * 64).symlink_to("/dev/zero")
    for key in (KEY, OTHER, "2" * 64):
        assert cache.get(key) is None
    cache.put(KEY, b"some bytes")
    assert cache.get(KEY) is None
    assert sorted(path.name for path in entry(cache).parent.iterdir()) == [f"{k * 64}.bin" for k in "012"]


def test_an_entry_that_is_too_large_is_neither_kept_nor_read(cache: DiskCache, monkeypatch: pytest.MonkeyPatch) -> None:
    cache.put(KEY, bytes(100))
    monkeypatch.setattr(disk_cache, "MAX_ENTRY", 99)
    cache.put(OTHER, bytes(100))
    assert (cache.get(KEY), cache.get(OTHER), entry(cache, OTHER).exists()) == (None, None, False)


def test_a_folder_that_cannot_be_written_keeps_nothing_and_fails_nothing(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("no folder")
    for folder in (tmp_path / "file", tmp_path / "file" / "below", Path("/dev/null/x"), Path("a\0b"), Path("x" * 300)):
        cache = DiskCache(folder)
        cache.put(KEY, b"some bytes")
        assert cache.get(KEY) is None


def test_a_full_disk_leaves_nothing_behind(cache: DiskCache, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "replace", full)
    cache.put(KEY, b"some bytes")
    assert list(entry(cache).parent.iterdir()) == []


def test_what_was_not_used_for_longest_goes_first_and_nothing_of_others(tmp_path: Path) -> None:
    size = 1000 + disk_cache.DIGEST
    cache = DiskCache(tmp_path, most_bytes=3 * size)
    (tmp_path / "precious.bin").write_bytes(bytes(10_000))
    leftover = tmp_path / f".{'a' * 32}.tmp"
    leftover.write_bytes(bytes(size))
    os.utime(leftover, (1, 1))
    for age, digit in enumerate("012"):
        cache.put(digit * 64, bytes(1000))
        os.utime(entry(cache, digit * 64), (100 + age, 100 + age))
    assert not leftover.exists()
    assert cache.get("0" * 64) is not None  # used just now
    cache.put("3" * 64, bytes(1000))
    assert sorted(path.name for path in tmp_path.iterdir()) == [*(f"{k * 64}.bin" for k in "023"), "precious.bin"]


def test_many_at_once_get_whole_entries_or_none(tmp_path: Path) -> None:
    cache = DiskCache(tmp_path, most_bytes=200_000)
    contents = [bytes([k]) * 50_000 for k in range(8)]

    def work(k: int) -> set[bytes | None]:
        key = str(k % 4) * 64
        seen = set()
        for _ in range(20):
            cache.put(key, contents[k])
            seen.add(cache.get(key))
        return seen

    with ThreadPoolExecutor(8) as pool:
        found = set[bytes | None]().union(*pool.map(work, range(8)))
    assert found - {None} <= set(contents)
    assert not list(tmp_path.glob("*.tmp"))
    assert sum(path.stat().st_size for path in tmp_path.iterdir()) <= 200_000


def test_a_key_is_no_path() -> None:
    with pytest.raises(BrokenInvariant, match="64 hexadecimal digits"):
        DiskCache(Path("somewhere")).get("../../etc/passwd")


def test_the_folder_is_the_one_asked_for_or_among_the_users_caches(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HOME", "/home/me")
    assert cache_folder({"PLANNER_SERVICE_CACHE": "/a/b", "XDG_CACHE_HOME": "/c"}) == Path("/a/b")
    assert cache_folder({"PLANNER_SERVICE_CACHE": "", "XDG_CACHE_HOME": "/c"}) is None
    assert cache_folder({"XDG_CACHE_HOME": "/c"}) == Path("/c/planner-service")
    assert cache_folder({"XDG_CACHE_HOME": "relative"}) == Path("/home/me/.cache/planner-service")
