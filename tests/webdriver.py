"""A browser without a screen, driven over the WebDriver protocol: the few verbs that tests need."""

from __future__ import annotations

import base64
import json
import shutil
import subprocess
import time
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

FLAGS = [
    "--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run",
    "--disable-background-networking", "--disable-component-update", "--disable-sync",
    "--enable-unsafe-swiftshader",
]  # fmt: skip
PATIENCE = 60.0  # seconds


class Browser:
    """One window of Chromium."""

    def __init__(self, base: str) -> None:
        self._base = base

    def call(self, path: str, body: Any = None, method: str = "POST") -> Any:
        """One command of the protocol; `path` begins behind the session."""
        data = None if method == "GET" else json.dumps(body or {}).encode()
        request = urllib.request.Request(self._base + path, data, method=method)
        request.add_header("Content-Type", "application/json")
        # Without the proxies of the environment: the driver is on this machine.
        opener = urllib.request.build_opener(urllib.request.ProxyHandler({}))
        with opener.open(request, timeout=PATIENCE) as answer:
            return json.load(answer)["value"]

    def open(self, path: Path) -> None:
        """Open a file and wait until its charts are drawn."""
        self.call("/url", {"url": path.resolve().as_uri()})
        self.wait("document.documentElement.dataset.ready === 'true'")

    def run(self, script: str) -> Any:
        """The value of an expression of JavaScript."""
        return self.call("/execute/sync", {"script": f"return {script}", "args": []})

    def wait(self, condition: str) -> None:
        """Wait until an expression is true."""
        end = time.monotonic() + PATIENCE
        while not self.run(condition):
            assert time.monotonic() < end, f"still not true: {condition}"
            time.sleep(0.05)

    def devtools(self, command: str, **parameters: Any) -> Any:
        """A command of Chromium's own protocol."""
        return self.call("/goog/cdp/execute", {"cmd": command, "params": parameters})

    def click(self, selector: str) -> None:
        """Click where a person would."""
        found = self.call("/element", {"using": "css selector", "value": selector})
        self.call(f"/element/{next(iter(found.values()))}/click")

    def log(self) -> list[str]:
        """What the console has said since it was last asked, warnings and errors."""
        said = self.call("/se/log", {"type": "browser"})
        return [entry["message"] for entry in said if entry["level"] in ("WARNING", "SEVERE")]

    def screenshot(self) -> bytes:
        """The window as PNG."""
        return base64.b64decode(self.call("/screenshot", method="GET"))


@contextmanager
def chromium(folder: Path) -> Iterator[Browser]:
    """A new browser with an empty profile in `folder`; skips where there is none."""
    driver = shutil.which("chromedriver")
    program = shutil.which("chromium") or shutil.which("chromium-browser")
    if driver is None or program is None:
        pytest.skip("chromium and chromedriver are not installed")
    with subprocess.Popen(
        [driver, "--port=0"], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
    ) as process:
        try:
            assert process.stdout is not None
            line = next(text for text in process.stdout if "started successfully on port" in text)
            base = f"http://127.0.0.1:{line.split()[-1].rstrip('.')}"
            options = {
                "binary": program,
                "args": [*FLAGS, f"--user-data-dir={folder / 'profile'}"],
            }
            wanted = {"goog:chromeOptions": options, "goog:loggingPrefs": {"browser": "ALL"}}
            session = Browser(base).call("/session", {"capabilities": {"alwaysMatch": wanted}})[
                "sessionId"
            ]
            browser = Browser(f"{base}/session/{session}")
            try:
                yield browser
            finally:
                browser.call("", method="DELETE")
        finally:
            process.terminate()
