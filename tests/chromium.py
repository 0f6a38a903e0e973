"""A page in headless Chromium, driven over its DevTools protocol."""

import base64
import contextlib
import json
import pathlib
import shutil
import subprocess
import time
from collections.abc import Iterator
from typing import Any

import websocket


NAMES = ("chromium", "chromium-browser", "google-chrome", "chrome")
PATIENCE = 60.0  # s, for anything the browser is asked


def installed() -> str | None:
    """The first browser of the family on the path."""
    return next(filter(None, map(shutil.which, NAMES)), None)


@contextlib.contextmanager
def opened(file: pathlib.Path, folder: pathlib.Path, width: int = 1280) -> Iterator["Page"]:
    """A report in a browser that ends with the block."""
    page = Page(folder)
    try:
        page.open(file, width)
        yield page
    finally:
        page.close()


class Page:
    """A window of a browser of its own, which keeps its files in `folder`.

    Keeps the errors and warnings of the console and the addresses of all requests.
    """

    def __init__(self, folder: pathlib.Path):
        self.folder = folder
        self.complaints: list[str] = []
        self.requests: list[str] = []
        self._number = 0
        program = installed()
        assert program is not None
        self._browser = subprocess.Popen(
            [
                program, "--headless", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage",
                "--remote-debugging-port=0", "--remote-allow-origins=*", "--no-first-run",
                f"--user-data-dir={self.folder}", "about:blank",
            ],
            stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
        )  # fmt: skip

    def open(self, file: pathlib.Path, width: int) -> None:
        """Show a report in a window so wide, and wait for its plots."""
        self._socket = websocket.create_connection(self._address(), timeout=PATIENCE)
        target = self.send("Target.createTarget", url="about:blank")["targetId"]
        self._session = self.send("Target.attachToTarget", targetId=target, flatten=True)
        for domain in ("Page", "Runtime", "Network", "Log"):
            self.send(f"{domain}.enable")
        self.resize(width, 900)
        self.show(file)

    def show(self, file: pathlib.Path) -> None:
        """Go to a report, and wait for its plots."""
        address = file.resolve().as_uri()
        self.send("Page.navigate", url=address)
        self.until(
            f"location.href === {json.dumps(address)} && "
            "document.documentElement?.dataset.plots === 'drawn'"
        )

    def close(self) -> None:
        """End the browser."""
        if hasattr(self, "_socket"):
            self._socket.close()
        self._browser.terminate()
        self._browser.wait(PATIENCE)

    def _address(self) -> str:
        """Where the browser listens, which it writes into its folder."""
        told = self.folder / "DevToolsActivePort"
        end = time.monotonic() + PATIENCE
        while not told.exists() or len(told.read_text().split()) < 2:
            assert time.monotonic() < end and self._browser.poll() is None, "no browser came up"
            time.sleep(0.1)
        port, path = told.read_text().split()
        return f"ws://127.0.0.1:{port}{path}"

    def send(self, method: str, **parameters: object) -> dict:
        """Ask the browser, and note what it tells on its own until it answers."""
        self._number += 1
        message = {"id": self._number, "method": method, "params": parameters}
        if hasattr(self, "_session") and not method.startswith(("Target.", "Browser.")):
            message["sessionId"] = self._session["sessionId"]
        self._socket.send(json.dumps(message))
        while True:
            answer = json.loads(self._socket.recv())
            if answer.get("id") == self._number:
                assert "error" not in answer, answer["error"]
                return answer["result"]
            self._note(answer.get("method", ""), answer.get("params", {}))

    def _note(self, event: str, told: dict) -> None:
        if event == "Runtime.exceptionThrown":
            self.complaints.append(str(told["exceptionDetails"]))
        elif event == "Runtime.consoleAPICalled" and told["type"] in ("error", "warning"):
            self.complaints.append(str(told["args"]))
        elif event == "Log.entryAdded" and told["entry"]["level"] in ("error", "warning"):
            self.complaints.append(told["entry"]["text"])
        elif event == "Network.requestWillBeSent":
            self.requests.append(told["request"]["url"])

    def run(self, expression: str) -> Any:
        """The value of a JavaScript expression."""
        told = self.send("Runtime.evaluate", expression=expression, returnByValue=True,
                         awaitPromise=True)  # fmt: skip
        assert "exceptionDetails" not in told, told["exceptionDetails"]
        return told["result"].get("value")

    def until(self, expression: str) -> None:
        """Wait for a condition."""
        end = time.monotonic() + PATIENCE
        while not self.run(expression):
            assert time.monotonic() < end, f"never came true: {expression}"
            time.sleep(0.05)

    def resize(self, width: int, height: int, phone: bool = False) -> None:
        """Another size of the window, in CSS pixels."""
        self.send(
            "Emulation.setDeviceMetricsOverride", width=width, height=height,
            deviceScaleFactor=1, mobile=phone,
        )  # fmt: skip

    def mouse(self, x: float, y: float, click: bool = False) -> None:
        """Move the mouse there, and click."""
        self.send("Input.dispatchMouseEvent", type="mouseMoved", x=x, y=y)
        for kind in ("mousePressed", "mouseReleased") if click else ():
            self.send("Input.dispatchMouseEvent", type=kind, x=x, y=y, button="left", clickCount=1)

    def press(self, key: str) -> None:
        """Press a key, where the focus is."""
        text = {"text": "\r"} if key == "Enter" else {"text": key} if len(key) == 1 else {}
        for kind in ("keyDown", "keyUp"):
            self.send("Input.dispatchKeyEvent", type=kind, key=key, **text)

    def prefer(self, scheme: str) -> None:
        """The reader's colours, `light` or `dark`."""
        features = [{"name": "prefers-color-scheme", "value": scheme}]
        self.send("Emulation.setEmulatedMedia", features=features)

    def picture(self, file: pathlib.Path) -> None:
        """The whole page as PNG."""
        data = self.send("Page.captureScreenshot", captureBeyondViewport=True, format="png")
        file.write_bytes(base64.b64decode(data["data"]))
