"""One browser for the tests of a module."""

from __future__ import annotations

import pytest

from tests.browsing import CHROMIUM, QUIET


@pytest.fixture(scope="module")
def browser():
    playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    with playwright.sync_playwright() as started:
        # Without the sandbox, as it cannot be had by root, who runs these tests in a container.
        browser = started.chromium.launch(executable_path=CHROMIUM, args=[*QUIET, "--no-sandbox"])
        yield browser
        browser.close()
