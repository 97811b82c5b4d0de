"""Debian's Chromium, in which tests open pages."""

import os
import shutil
import time
from collections.abc import Callable, Iterator

import pytest


def open_browser() -> Iterator:
    """Yield a driver of the browser; skip where there is none, unless CI says that it must be there."""
    missing = [name for name in ("chromium", "chromedriver") if shutil.which(name) is None]
    if missing:
        fault = f"no {' and no '.join(missing)} here (tools/browser-packages.sh brings them)"
        if os.environ.get("SEMISYNTH_GL_EXPECT_BROWSER"):
            pytest.fail(f"a browser was expected here: {fault}")
        pytest.skip(fault)
    from selenium import webdriver
    from selenium.webdriver.chrome.service import Service

    options = webdriver.ChromeOptions()
    options.binary_location = shutil.which("chromium")
    # Containers have no sandbox to offer, and little shared memory.
    for argument in ("--headless=new", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage"):
        options.add_argument(argument)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"})
    driver = webdriver.Chrome(options=options, service=Service(shutil.which("chromedriver")))
    yield driver
    driver.quit()


def wait(browser, true: Callable[[], object], seconds: float = 120) -> None:
    end = time.monotonic() + seconds
    while not true():
        assert time.monotonic() < end, browser.get_log("browser")
        time.sleep(0.02)
