"""Headless Chromium over its debugging protocol: what a page looks like, and what stands on it."""

from __future__ import annotations

import base64
import json
import os
import shutil
import signal
import subprocess
import time
import urllib.request
from io import BytesIO
from pathlib import Path
from typing import Any

import matplotlib.image
import numpy as np
import pytest
import websocket


def chromium() -> str:
    """Its path; skips the test where there is none."""
    found = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    if found is None:
        pytest.skip("no chromium to look at the page with")
    return found


class Browser:
    def __init__(self, program: str, folder: Path) -> None:
        options = "--headless=new --no-sandbox --disable-gpu --use-gl=angle --use-angle=swiftshader"
        options += " --enable-unsafe-swiftshader --remote-debugging-port=0 --remote-allow-origins=*"
        options += f" --window-size=1400,900 --user-data-dir={folder} about:blank"
        self._process = subprocess.Popen(
            [program, *options.split()],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            start_new_session=True,
        )
        self._folder = folder
        self._number = 0

    def __enter__(self) -> Browser:
        told = self._folder / "DevToolsActivePort"
        until = time.monotonic() + 60
        while not (told.exists() and told.read_text().strip()):
            assert time.monotonic() < until, "chromium did not start"
            time.sleep(0.1)
        port = told.read_text().split()[0]
        with urllib.request.urlopen(f"http://127.0.0.1:{port}/json", timeout=30) as answer:
            page = next(t for t in json.load(answer) if t["type"] == "page")
        self._socket = websocket.create_connection(page["webSocketDebuggerUrl"], timeout=90)
        return self

    def __exit__(self, *_: object) -> None:
        self._socket.close()
        os.killpg(self._process.pid, signal.SIGKILL)
        self._process.wait()

    def _call(self, method: str, **params: object) -> dict[str, Any]:
        self._number += 1
        self._socket.send(json.dumps({"id": self._number, "method": method, "params": params}))
        while True:
            answer = json.loads(self._socket.recv())
            if answer.get("id") == self._number:
                return answer["result"]

    def open(self, address: str) -> None:
        self._call("Page.navigate", url=address)

    def resize(self, width: int, height: int) -> None:
        """The window, in CSS pixels."""
        self._call(
            "Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1, mobile=width < 1000
        )

    def run(self, script: str) -> Any:
        """What an expression of JavaScript comes to on the page, as if its user had tapped on it."""
        found = self._call("Runtime.evaluate", expression=script, returnByValue=True, userGesture=True)
        assert "exceptionDetails" not in found, found
        return found["result"].get("value")

    def wait(self, script: str, limit_s: float = 20.0) -> Any:
        """Until an expression is true on the page."""
        until = time.monotonic() + limit_s
        while not (found := self.run(script)):
            assert time.monotonic() < until, f"not within {limit_s} s: {script}"
            time.sleep(0.05)
        return found

    def png(self) -> bytes:
        return base64.b64decode(self._call("Page.captureScreenshot", format="png")["data"])

    def picture(self) -> np.ndarray:
        """(rows, columns, 3), 0..255."""
        return np.round(matplotlib.image.imread(BytesIO(self.png()))[..., :3] * 255).astype(int)
