"""Pages in a real headless browser: how it is started, and what must stay text in them.

Needs Debian's chromium and chromium-driver (`make test` installs them where it may); skipped loudly elsewhere.
"""

import json
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

PROGRAM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
DRIVER = shutil.which("chromedriver")
ARGUMENTS = ("--headless=new", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage", "--window-size=1280,900")
NASTY = "<script>alert(1)</script><img src=x onerror=alert(2)>"

needs_chromium = pytest.mark.skipif(
    PROGRAM is None or DRIVER is None, reason="needs system package chromium and chromium-driver"
)


@contextmanager
def chromium() -> Iterator[Any]:
    """A browser that logs its console and what it asks for."""
    from selenium import webdriver
    from selenium.webdriver.chrome.service import Service

    options = webdriver.ChromeOptions()
    options.binary_location = str(PROGRAM)
    for argument in ARGUMENTS:
        options.add_argument(argument)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"})
    driver = webdriver.Chrome(options=options, service=Service(str(DRIVER)))
    try:
        yield driver
    finally:
        driver.quit()


def opened_alone(browser: Any, path: Path, folder: Path | None = None) -> Iterator[Any]:
    """The browser with the page open; afterwards its console must be empty and nothing else been asked for.

    folder: whose files may be asked for too.
    """
    browser.get_log("browser"), browser.get_log("performance")
    browser.get(path.as_uri())
    yield browser
    assert browser.get_log("browser") == []
    asked = [json.loads(entry["message"])["message"] for entry in browser.get_log("performance")]
    urls = {m["params"]["request"]["url"].split("#")[0] for m in asked if m["method"] == "Network.requestWillBeSent"}
    assert path.as_uri() in urls
    assert all(url == path.as_uri() or (folder and url.startswith(folder.as_uri())) for url in urls)
