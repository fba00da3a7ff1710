"""A headless Chromium, driven over its DevTools protocol."""

import base64
import json
import os
import shutil
import subprocess
import time
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
import websocket

PATIENCE = 300  # seconds; only what hangs takes so long


class Browser:
    """One tab. What it is asked for is JavaScript; what it finds is Python."""

    def __init__(self, address: str) -> None:
        self._socket = websocket.create_connection(
            address, suppress_origin=True, timeout=PATIENCE, skip_utf8_validation=True
        )
        self._count = 0
        for domain in ("Page", "Runtime", "Log"):
            self.command(f"{domain}.enable")

    def command(self, method: str, **parameters: Any) -> dict[str, Any]:
        """Sends a command of the protocol and returns its result."""
        self._count += 1
        self._socket.send(json.dumps({"id": self._count, "method": method, "params": parameters}))
        while True:
            answer = json.loads(self._socket.recv())
            if answer.get("id") == self._count:
                assert "error" not in answer, answer
                return answer["result"]

    def open(self, path: Path, width: int = 1280, dark: bool = False, motion: bool = True) -> None:
        """Shows a page in a window 800 pixels high, as a phone where it is narrow."""
        self.resize(width, 800)
        wishes = {
            "prefers-color-scheme": "dark" if dark else "light",
            "prefers-reduced-motion": "no-preference" if motion else "reduce",
        }
        features = [{"name": name, "value": value} for name, value in wishes.items()]
        self.command("Emulation.setEmulatedMedia", features=features)
        self.command("Page.navigate", url=path.as_uri())
        self.wait("document.readyState === 'complete' && location.protocol === 'file:'")
        self.move(0, 0)

    def resize(self, width: int, height: int) -> None:
        self.command(
            "Emulation.setDeviceMetricsOverride",
            **{"width": width, "height": height, "deviceScaleFactor": 1, "mobile": width < 600},
        )

    def __call__(self, script: str) -> Any:
        """The value of an expression, or of the promise that it is."""
        result = self.command(
            "Runtime.evaluate", expression=script, returnByValue=True, awaitPromise=True
        )
        assert "exceptionDetails" not in result, result["exceptionDetails"]
        return result["result"].get("value")

    def wait(self, condition: str) -> Any:
        """The value of an expression, once it is true."""
        end = time.monotonic() + PATIENCE
        while not (value := self(condition)):
            assert time.monotonic() < end, condition
            time.sleep(0.02)
        return value

    def move(self, x: float, y: float) -> None:
        self.command("Input.dispatchMouseEvent", type="mouseMoved", x=x, y=y)

    def hover(self, selector: str) -> None:
        """Points at the middle of an element, once it is in view."""
        self.move(*self._middle(selector))

    def click(self, selector: str) -> None:
        x, y = self._middle(selector)
        for kind in ("mousePressed", "mouseReleased"):
            self.command(
                "Input.dispatchMouseEvent", type=kind, x=x, y=y, button="left", clickCount=1
            )

    def _middle(self, selector: str) -> list[float]:
        return self(
            f"""(() => {{
              const one = document.querySelector({json.dumps(selector)});
              one.scrollIntoView({{ block: "center", behavior: "instant" }});
              const box = one.getClientRects()[0];
              return [box.left + box.width / 2, box.top + box.height / 2];
            }})()"""
        )

    def press(self, key: str) -> None:
        text = {"Enter": "\r"}.get(key, "")  # by which a button is pressed
        for kind in ("keyDown", "keyUp"):
            self.command("Input.dispatchKeyEvent", type=kind, key=key, code=key, text=text)

    def picture(self) -> bytes:
        """What the window shows, as a PNG image."""
        return base64.b64decode(self.command("Page.captureScreenshot")["data"])


def command(folder: Path, *options: str) -> list[str]:
    """What starts a browser with its profile in `folder`, cut off from the network; the test is
    skipped where there is none, and fails where one is required."""
    chromium = shutil.which("chromium") or shutil.which("google-chrome")
    if chromium is None:
        if os.environ.get("ATARI_DQN_BROWSER") == "required":
            pytest.fail("no browser found, and one is required")
        pytest.skip("no Chromium on this machine")
    return [
        *(chromium, "--headless", "--no-sandbox", "--disable-gpu", "--no-first-run"),
        *("--disable-background-networking", "--disable-component-update", "--disable-sync"),
        *("--proxy-server=127.0.0.1:9", f"--user-data-dir={folder}", *options),
    ]


@contextmanager
def running(folder: Path) -> Iterator[Browser]:
    """A browser with its profile in `folder`."""
    process = subprocess.Popen(
        command(folder, "--hide-scrollbars", "--remote-debugging-port=0", "about:blank"),
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    try:
        port_file = folder / "DevToolsActivePort"
        end = time.monotonic() + PATIENCE
        while not (port_file.exists() and port_file.read_text().count("\n")):
            assert time.monotonic() < end, "the browser does not start"
            time.sleep(0.05)
        port = port_file.read_text().split()[0]
        with urllib.request.urlopen(f"http://127.0.0.1:{port}/json/list") as answer:
            (tab,) = (target for target in json.load(answer) if target["type"] == "page")
        yield Browser(tab["webSocketDebuggerUrl"])
    finally:
        process.terminate()
        process.wait()
