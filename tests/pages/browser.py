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


_FAULTS = """() => {
  const wide = document.documentElement.clientWidth;
  const out = [];
  if (document.documentElement.scrollWidth > wide) out.push(['the page is wider than the screen']);
  for (const e of document.querySelectorAll('main *, aside *, header *')) {
    const { width, right } = e.getBoundingClientRect();
    if (width && right > wide + 1 && !e.closest('.scroll, svg'))
      out.push(['beyond the screen', e.tagName, e.textContent.slice(0, 40)]);
  }
  for (const e of document.querySelectorAll('.scroll'))
    if (wide > 1000 && e.scrollWidth > e.clientWidth + 1) out.push(['table cut off', e.getAttribute('aria-label')]);
  for (const plot of document.querySelectorAll('.plot, .view')) {
    const box = plot.getBoundingClientRect();
    const name = plot.closest('section').id;
    const texts = [...plot.querySelectorAll('text')].filter((e) => e.textContent.trim() && !e.hasAttribute('data-mark'))
      .map((e) => ({ text: e.textContent.slice(0, 60), at: e.getBoundingClientRect() }))
      .filter(({ at }) => at.width > 0);
    texts.forEach(({ text, at }, k) => {
      if (at.left < box.left - 2 || at.right > box.right + 2 || at.top < box.top - 2 || at.bottom > box.bottom + 2)
        out.push(['text beyond its plot', name, text]);
      for (const { text: other, at: beside } of texts.slice(k + 1))
        if (Math.min(at.right, beside.right) - Math.max(at.left, beside.left) > 2
            && Math.min(at.bottom, beside.bottom) - Math.max(at.top, beside.top) > 4)
          out.push(['texts over each other', name, text, other]);
    });
  }
  return out;
}"""


def faults_of_looks(page) -> list:
    """What does not fit a page that is drawn: wider than the screen, cut off, texts that lie over each other."""
    page.wait_for_function("document.querySelector('.sketch') === null")
    page.wait_for_timeout(300)
    return page.evaluate(_FAULTS)


def _elsewhere(url: str) -> bool:
    return not url.startswith(("file:", "data:", "blob:"))
