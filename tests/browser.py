"""A headless Chromium for tests, through Selenium: offline, and with a log of what its pages say."""

import shutil
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

FLAGS = (
    "headless=new", "no-sandbox", "disable-dev-shm-usage", "disable-extensions", "disable-component-update",
    "disable-background-networking", "no-first-run", "host-resolver-rules=MAP * ~NOTFOUND, EXCLUDE localhost",
)  # fmt: skip
FLAT, WEBGL = ("disable-gpu",), ("use-gl=angle", "use-angle=swiftshader", "enable-unsafe-swiftshader")
"""What draws the pages: of WebGL only the second knows."""
WAIT = 60.0
"""Seconds that a busy machine may take."""


@contextmanager
def chromium(width: int = 1280, height: int = 900, graphics=FLAT, downloads: Path | None = None) -> Iterator[Any]:
    """A Selenium driver whose window is `width` x `height`; skips the test where there is no browser."""
    webdriver = pytest.importorskip("selenium.webdriver", reason="needs selenium (pip install selenium)")
    browser = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
    driver = shutil.which("chromedriver")
    if not (browser and driver):
        pytest.skip("needs chromium and chromedriver (Debian: chromium, chromium-driver)")
    options = webdriver.ChromeOptions()
    options.binary_location = browser
    for flag in (*FLAGS, *graphics, f"window-size={width},{height}"):
        options.add_argument(f"--{flag}")
    if downloads is not None:
        options.add_experimental_option("prefs", {"download.default_directory": str(downloads)})
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    opened = webdriver.Chrome(options=options, service=webdriver.ChromeService(driver))
    try:
        yield opened
    finally:
        opened.quit()


def until(found: Callable[[], Any], what: str = "it") -> Any:
    """What `found()` gives as soon as that is something."""
    end = time.monotonic() + WAIT
    while not (value := found()):
        assert time.monotonic() < end, f"waited in vain for {what}"
        time.sleep(0.05)
    return value
