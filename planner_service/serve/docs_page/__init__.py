"""The page ``/docs``: the interface, to be read and tried out. It loads nothing from other hosts.

It is Swagger UI 5.35.0, packed by gzip in ``swagger-ui/`` as its package ``swagger-ui-dist`` has it, in this package's
colours.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

__all__ = ["FILES", "SECURITY"]

SECURITY = (
    "default-src 'none'; script-src 'self'; style-src 'self' 'unsafe-inline'; img-src 'self' data:; "
    "connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
"""What the page may load and do: all of it with this server alone."""

HERE = Path(__file__).parent

FILES: Mapping[str, tuple[Path, str]] = {
    "/docs": (HERE / "page.html", "text/html"),
    "/docs/page.css": (HERE / "page.css", "text/css"),
    "/docs/page.js": (HERE / "page.js", "text/javascript"),
    "/docs/swagger-ui.css": (HERE / "swagger-ui" / "swagger-ui.css.gz", "text/css"),
    "/docs/swagger-ui-bundle.js": (HERE / "swagger-ui" / "swagger-ui-bundle.js.gz", "text/javascript"),
}
"""The page and what it loads, by address: the file, packed by gzip if its name says so, and its media type."""
