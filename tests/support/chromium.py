"""A headless browser for tests: Chromium by the variable PLANNER_SERVICE_CHROMIUM, or the one that is installed."""

from __future__ import annotations

import io
import os
import shutil
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["ANY_GL", "executable", "headless", "new_window", "pixels"]

ANY_GL = (
    *("--no-sandbox", "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist"),
    *("--disable-quic", "--disable-background-networking", "--no-first-run"),
)
"""WebGL by the graphics card if there is one, and no word to anybody."""

ARGUMENTS = (*ANY_GL, "--use-angle=swiftshader")
"""WebGL without a graphics card, everywhere the same."""

PATIENCE = 180.0
"""Seconds that a page may take for anything, on a machine that does other things."""


def executable() -> str | None:
    """Its path, None if there is none."""
    return os.environ.get("PLANNER_SERVICE_CHROMIUM") or shutil.which("chromium")


@contextmanager
def headless(arguments: Sequence[str] = ARGUMENTS) -> Iterator[Any]:
    """A browser of playwright's."""
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        options = {"executable_path": executable(), "args": list(arguments), "timeout": PATIENCE * 1e3}
        browser = playwright.chromium.launch(**options)
        try:
            yield browser
        finally:
            browser.close()


def new_window(browser: Any, **options: Any) -> Any:
    """A new page of a browser, which may take its time."""
    page = browser.new_page(**options)
    page.set_default_timeout(PATIENCE * 1e3)
    return page


def pixels(page: Any) -> NDArray[np.uint8]:
    """The picture of a page, (height, width, 3)."""
    from PIL import Image

    with Image.open(io.BytesIO(page.screenshot())) as image:
        return np.asarray(image.convert("RGB"))
