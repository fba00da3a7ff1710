"""A page in headless Chromium, driven over the DevTools protocol."""

import base64
import itertools
import json
import os
import shutil
import subprocess
import time
import urllib.request
from contextlib import contextmanager

import pytest
import websocket

PATIENCE = 60  # seconds; only what hangs takes so long


def chromium():
    """The browser's path; the test is skipped without one, and fails where one is required."""
    found = shutil.which("chromium") or shutil.which("google-chrome")
    if found is None:
        if os.environ.get("ATARI_DQN_BROWSER") == "required":
            pytest.fail("no browser found, and one is required")
        pytest.skip("no Chromium on this machine")
    return found


class Page:
    """An open page; places are CSS pixels of the window."""

    def __init__(self, socket):
        self._socket, self._numbers = socket, itertools.count()

    def _call(self, method, **parameters):
        number = next(self._numbers)
        self._socket.send(json.dumps({"id": number, "method": method, "params": parameters}))
        while (answer := json.loads(self._socket.recv())).get("id") != number:
            pass
        assert "error" not in answer, answer
        return answer["result"]

    def evaluate(self, expression):
        """The value of a JavaScript expression."""
        result = self._call("Runtime.evaluate", expression=expression, returnByValue=True)
        assert "exceptionDetails" not in result, result
        return result["result"].get("value")

    def size(self, width, height):
        how = {"deviceScaleFactor": 1, "mobile": width < 500}
        self._call("Emulation.setDeviceMetricsOverride", width=width, height=height, **how)

    def dark(self, on):
        feature = {"name": "prefers-color-scheme", "value": "dark" if on else "light"}
        self._call("Emulation.setEmulatedMedia", features=[feature])

    def point(self, x, y):
        self._call("Input.dispatchMouseEvent", type="mouseMoved", x=x, y=y)

    def press(self, key, code):
        how = {"key": key, "windowsVirtualKeyCode": code, "text": "\r" if key == "Enter" else ""}
        self._call("Input.dispatchKeyEvent", type="keyDown", **how)
        self._call("Input.dispatchKeyEvent", type="keyUp", **how)

    def wait(self, expression):
        """Returns the expression's value once it is true."""
        end = time.monotonic() + PATIENCE
        while not (value := self.evaluate(expression)):
            assert time.monotonic() < end, expression
            time.sleep(0.05)
        return value

    def screenshot(self):
        """PNG of the window."""
        return base64.b64decode(self._call("Page.captureScreenshot")["data"])


@contextmanager
def opened(file, profile):
    """A `Page` that shows a file; `profile` is an empty folder for the browser's own."""
    command = [chromium(), "--headless", "--no-sandbox", "--disable-gpu", "--no-first-run"]
    command += ["--disable-background-networking", "--proxy-server=127.0.0.1:9"]
    command += ["--remote-debugging-port=0", f"--user-data-dir={profile}", file.as_uri()]
    process = subprocess.Popen(command, stderr=subprocess.DEVNULL)
    try:
        port, end = profile / "DevToolsActivePort", time.monotonic() + PATIENCE
        while not (port.exists() and len(port.read_text().split()) == 2):
            assert time.monotonic() < end, "the browser does not start"
            time.sleep(0.05)
        where = f"http://127.0.0.1:{port.read_text().split()[0]}/json/list"
        direct = urllib.request.build_opener(urllib.request.ProxyHandler({}))
        targets = json.load(direct.open(where, timeout=PATIENCE))
        (target,) = [one for one in targets if one["type"] == "page"]
        socket = websocket.create_connection(
            target["webSocketDebuggerUrl"], timeout=PATIENCE, suppress_origin=True
        )
        page = Page(socket)
        page.wait("document.readyState === 'complete' && location.protocol === 'file:'")
        yield page
        socket.close()
    finally:
        process.terminate()
        process.wait()
