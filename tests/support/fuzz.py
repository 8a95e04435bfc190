"""Files with a few stretches exchanged."""

from __future__ import annotations

from hypothesis import strategies as st

__all__ = ["changed"]

ODD = (b"nan", b"-1", b"1e400", b"999999999", b"*", b".", b"\n", b"\0", b"null", "\u0663\u2028".encode())


def changed(content: bytes, *odd: bytes) -> st.SearchStrategy[bytes]:
    """The file with up to three stretches of it exchanged for other bytes, some of them from the file itself."""
    at = st.integers(0, len(content))
    piece = st.tuples(at, at).map(lambda ends: content[min(ends) : max(ends)]) | st.binary(max_size=12)
    change = st.tuples(at, st.integers(0, 20), piece | st.sampled_from([*ODD, *odd]))

    def apply(changes: list[tuple[int, int, bytes]]) -> bytes:
        out = content
        for start, length, new in changes:
            out = out[:start] + new + out[start + length :]
        return out

    return st.lists(change, min_size=1, max_size=3).map(apply)
