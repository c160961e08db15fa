"""A browser without a window, driven over a pipe by the DevTools protocol.

In: a Chromium program and a page. Out: what the page's scripts return, pictures of it, and all that it complained about
or asked the network for. A browser that ends or is silent for too long raises RuntimeError with one sentence; it never
outlives its `with`.
"""

import json
import os
import select
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from types import TracebackType
from typing import Any

NAMES = ("chromium", "chromium-browser", "google-chrome", "chrome")
# Software rendering: the same picture on every machine, and no graphics card asked for.
_FLAGS = (
    "--headless=new", "--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader",
    "--disable-background-networking", "--disable-component-update", "--no-first-run", "--hide-scrollbars",
    "--disable-dev-shm-usage", "--remote-debugging-pipe",
)  # fmt: skip
# The protocol wants descriptors 3 and 4. Some shells know descriptors of one digit only, and ours may have more.
_START = """
import fcntl, os, sys
pipe = [fcntl.fcntl(int(end), fcntl.F_DUPFD, 10) for end in sys.argv[1:3]]
for end, wanted in zip(pipe, (3, 4)): os.dup2(end, wanted)
os.execv(sys.argv[3], sys.argv[3:])
"""
_COMPLAINTS = ("error", "assert", "warning")


def found() -> str | None:
    """Return the path of an installed Chromium, None if there is none."""
    return next((path for path in map(shutil.which, NAMES) if path), None)


class Browser:
    """A running browser with one page.

    Parameters
    ----------
    program
        Chromium.
    limit
        Seconds that an answer may take.

    Attributes
    ----------
    complaints
        Errors and warnings of the page's console, and exceptions that nothing caught.
    requests
        Addresses that the page asked for after itself.
    """

    def __init__(self, program: str, limit: float = 120.0) -> None:
        self._folder = tempfile.TemporaryDirectory(prefix="browser-", ignore_cleanup_errors=True)
        self._limit, self._number, self._rest = limit, 0, b""
        self.complaints: list[str] = []
        self.requests: list[str] = []
        to_browser, self._write = os.pipe()
        self._read, from_browser = os.pipe()
        ends = [str(to_browser), str(from_browser)]
        self._popen = subprocess.Popen(
            [
                sys.executable,
                "-ISc",
                _START,
                *ends,
                program,
                *_FLAGS,
                f"--user-data-dir={self._folder.name}",
                "about:blank",
            ],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            pass_fds=(to_browser, from_browser),
            start_new_session=True,
        )
        os.close(to_browser)
        os.close(from_browser)
        self._session: str | None = None

    def __enter__(self) -> "Browser":
        pages = self.ask("Target.getTargets")["targetInfos"]
        target = next(page["targetId"] for page in pages if page["type"] == "page")
        self._session = self.ask("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
        for domain in ("Page", "Runtime", "Log", "Network"):
            self.ask(f"{domain}.enable")
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """End the browser and all its processes, whatever they are at."""
        os.killpg(self._popen.pid, signal.SIGKILL)
        self._popen.wait()
        os.close(self._write)
        os.close(self._read)
        self._folder.cleanup()

    def ask(self, method: str, **parameters: object) -> dict[str, Any]:
        """Call a method of the protocol and wait for its answer.

        Raises
        ------
        RuntimeError
            If the browser ends, takes too long, or says no.
        """
        self._number += 1
        message: dict[str, object] = {"id": self._number, "method": method, "params": parameters}
        if self._session is not None:
            message["sessionId"] = self._session
        try:
            os.write(self._write, json.dumps(message).encode() + b"\0")
        except BrokenPipeError:
            raise RuntimeError("the browser ended") from None
        deadline = time.monotonic() + self._limit
        while (answer := self._next(deadline)).get("id") != self._number:
            self._hear(answer)
        if "error" in answer:
            raise RuntimeError(f"the browser refuses {method}: {answer['error'].get('message')}")
        result: dict[str, Any] = answer["result"]
        return result

    def open(self, page: Path, size: tuple[int, int] = (1280, 800), *, dark: bool = False, density: float = 1) -> None:
        """Load a page from disk into a window of that size."""
        scheme = [{"name": "prefers-color-scheme", "value": "dark" if dark else "light"}]
        self.ask("Emulation.setEmulatedMedia", features=scheme)
        width, height = size
        narrow = width < 720
        self.ask(
            "Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=density, mobile=narrow
        )
        self.ask("Page.navigate", url=page.resolve().as_uri())
        deadline = time.monotonic() + self._limit
        while self.evaluate("document.readyState") != "complete":
            if time.monotonic() > deadline:
                raise RuntimeError(f"{page} takes more than {self._limit:g} s to load")
            time.sleep(0.02)

    def evaluate(self, script: str) -> Any:
        """Return the value of an expression in the page, of a promise what it resolves to.

        Raises
        ------
        RuntimeError
            With what the page threw.
        """
        answer = self.ask("Runtime.evaluate", expression=script, awaitPromise=True, returnByValue=True)
        if "exceptionDetails" in answer:
            details = answer["exceptionDetails"]
            said = details.get("exception", {}).get("description") or details.get("text")
            raise RuntimeError(f"the page says: {str(said).splitlines()[0]}")
        return answer["result"].get("value")

    def _next(self, deadline: float) -> dict[str, Any]:
        while b"\0" not in self._rest:
            ready, _, _ = select.select([self._read], [], [], max(deadline - time.monotonic(), 0))
            if not ready:
                raise RuntimeError(f"the browser said nothing for {self._limit:g} s")
            piece = os.read(self._read, 1 << 20)
            if not piece:
                raise RuntimeError("the browser ended: it may lack a library, or memory")
            self._rest += piece
        line, self._rest = self._rest.split(b"\0", 1)
        message: dict[str, Any] = json.loads(line)
        return message

    def _hear(self, event: dict[str, Any]) -> None:
        """Keep what the page complains about and asks for."""
        parameters = event.get("params", {})
        if event.get("method") == "Runtime.exceptionThrown":
            details = parameters["exceptionDetails"]
            self.complaints.append(str(details.get("exception", {}).get("description") or details.get("text")))
        elif event.get("method") == "Runtime.consoleAPICalled" and parameters["type"] in _COMPLAINTS:
            self.complaints.append(" ".join(str(entry.get("value", "")) for entry in parameters["args"]))
        elif event.get("method") == "Log.entryAdded" and parameters["entry"]["level"] in _COMPLAINTS:
            self.complaints.append(parameters["entry"]["text"])
        elif event.get("method") == "Network.requestWillBeSent" and parameters["type"] != "Document":
            self.requests.append(parameters["request"]["url"])
