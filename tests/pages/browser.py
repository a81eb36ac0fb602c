"""Debian's Chromium without a screen, driven by Playwright: what it says and loads is noted."""

from __future__ import annotations

import contextlib
import os
import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
needs_chromium = pytest.mark.skipif(
    CHROMIUM is None and not os.environ.get("CI"),
    reason="chromium is not installed (Debian package chromium); in CI it must be",
)
_ARGUMENTS = ["--no-sandbox", "--enable-unsafe-swiftshader"]
"""The processor paints, WebGL too: as on a machine without a graphics card."""
_OF_CHROMIUM = ("willReadFrequently", "GPU stall due to ReadPixels")
"""Advice of the browser about its own speed, where it draws without a graphics card."""
_SLOW_MS = 60_000


@contextlib.contextmanager
def running() -> Iterator:
    """Yield a browser."""
    from playwright.sync_api import sync_playwright

    with sync_playwright() as play:
        browser = play.chromium.launch(executable_path=CHROMIUM, args=_ARGUMENTS)
        yield browser
        browser.close()


@contextlib.contextmanager
def without_webgl(browser) -> Iterator:
    """Yield another browser, which cannot draw in space."""
    other = browser.browser_type.launch(executable_path=CHROMIUM, args=[*_ARGUMENTS, "--disable-3d-apis"])
    yield other
    other.close()


@contextlib.contextmanager
def opened(browser, path: Path, *, width: int = 1440, height: int = 1000, dark: bool = False, ready: bool = True):
    """Yield a page opened from disk; afterwards it has loaded nothing else, and said nothing on the console.

    :param ready: wait until the views are drawn.
    """
    said: list[str] = []
    context = browser.new_context(
        viewport={"width": width, "height": height}, color_scheme="dark" if dark else "light", offline=True
    )
    page = context.new_page()
    page.set_default_timeout(_SLOW_MS)
    page.on("console", lambda message: None if any(known in message.text for known in _OF_CHROMIUM) else
            said.append(message.text))  # fmt: skip
    page.on("pageerror", lambda error: said.append(str(error)))
    page.on("request", lambda request: said.append(request.url[:100]) if _elsewhere(request.url) else None)
    page.goto(path.resolve().as_uri())
    if ready:
        page.wait_for_function("typeof stage !== 'undefined' && stage.empty")
        page.wait_for_function("document.querySelector('.main-svg') !== null")
        page.wait_for_timeout(300)
    yield page
    said.extend(f"loaded {url}" for url in page.evaluate("performance.getEntriesByType('resource').map((e) => e.name)")
                if _elsewhere(url))  # fmt: skip
    context.close()
    assert said == [], said


def _elsewhere(url: str) -> bool:
    return not url.startswith(("file:", "data:", "blob:"))
