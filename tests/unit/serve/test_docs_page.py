"""The page ``/docs`` in a browser: it loads nothing from elsewhere, and requests are tried out on it with a token."""

from __future__ import annotations

import hashlib
from pathlib import Path

import pytest

from planner_service.serve.docs_page import FILES
from tests.support.chromium import executable, headless, new_window
from tests.support.served import served

TOKEN = "f" * 32
PLANS = "#operations-Requests-plans"


@pytest.mark.browser
@pytest.mark.slow
@pytest.mark.skipif(executable() is None, reason="needs Chromium")
def test_a_plan_is_tried_out_on_a_page_that_loads_nothing_from_elsewhere(tmp_path: Path) -> None:
    token = tmp_path / "token"
    token.write_text(TOKEN)
    token.chmod(0o600)
    options = ("--robot", "wxai", "--scene", "bin", "--workers", "1", "--token-file", str(token))
    with served(tmp_path, *options) as url, headless() as browser:
        asked: list[str] = []
        wrong: list[str] = []
        page = new_window(browser, viewport={"width": 1440, "height": 900})
        page.on("request", lambda request: asked.append(request.url))
        page.on("pageerror", lambda error: wrong.append(str(error)))
        page.on("console", lambda said: wrong.append(said.text) if said.type == "error" else None)
        page.goto(f"{url}/docs")
        page.locator(f"{PLANS} .opblock-summary-control").click()
        page.locator(f"{PLANS} .execute").wait_for()
        for width in (1440, 900, 390):
            page.set_viewport_size({"width": width, "height": 900})
            page.wait_for_function(f"innerWidth === {width}")
            assert page.evaluate("document.documentElement.scrollWidth") == width
        assert wrong == []
        page.locator(".auth-wrapper .authorize").click()
        page.get_by_role("textbox", name="auth-bearer-value").fill(TOKEN)
        page.locator(".auth-btn-wrapper .authorize").click()
        page.locator(".auth-btn-wrapper .btn-done").click()
        with page.expect_response(f"{url}/plans*") as answered:
            page.locator(f"{PLANS} .execute").click()
        answer = answered.value
        assert answer.status == 200
        assert answer.json()["result"]["ok"]
        assert wrong == []
        assert [each for each in asked if not each.startswith((f"{url}/", "data:"))] == []


def test_its_script_is_that_of_the_package_it_names() -> None:
    packed, _ = FILES["/docs/swagger-ui-bundle.js"]
    assert packed.stat().st_size < 500_000
    assert {each.name for each in packed.parent.iterdir()} >= {"LICENSE", "NOTICE", "LICENSE-of-parts"}
    assert hashlib.sha256(packed.read_bytes()).hexdigest() == SHIPPED


SHIPPED = "942e6424651db3a09f5a820c2bf585474ce8546335017a2b4384119b59e2309c"
