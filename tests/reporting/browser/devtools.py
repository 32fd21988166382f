"""A page in headless Chromium, driven by the DevTools protocol over a pipe."""

from __future__ import annotations

import fcntl
import json
import os
import shutil
import subprocess
import time
from contextlib import contextmanager

import pytest

from study.reporting.output.write import BROWSERS, browser
from tests.pages import served

#: marks of tests that need a browser
IN_A_BROWSER = [
    pytest.mark.slow,
    pytest.mark.verify,
    pytest.mark.skipif(
        not any(map(shutil.which, BROWSERS)), reason="no Chromium or Chrome is installed"
    ),
]
#: pixels by which a page is wider than the screen
OVERFLOW = "document.documentElement.scrollWidth - document.documentElement.clientWidth"
Message = dict[str, object]
# Seconds that one command of the protocol may take on a busy machine.
PATIENCE = 600


class Browser:
    """One tab: commands are answered in order, events are kept."""

    def __init__(self, to_browser, from_browser):
        self._out = to_browser
        self._in = from_browser
        self._buffer = b""
        self._count = 0
        self._session = ""
        self.events: list[Message] = []

    def attach(self):
        """Open an empty tab and listen to its console, its faults and its network."""
        target = self.send("Target.createTarget", url="about:blank")["targetId"]
        made = self.send("Target.attachToTarget", targetId=target, flatten=True)
        self._session = str(made["sessionId"])
        for domain in ("Page", "Runtime", "Log", "Network"):
            self.send(f"{domain}.enable")
        return self

    def send(self, method, **parameters):
        """Result of one command."""
        self._count += 1
        message = {"id": self._count, "method": method, "params": parameters}
        if self._session:
            message["sessionId"] = self._session
        os.write(self._out, json.dumps(message).encode() + b"\0")
        while True:
            answer = self._read()
            if answer.get("id") == self._count:
                assert "error" not in answer, answer
                return answer["result"]
            self.events.append(answer)

    def _read(self):
        while b"\0" not in self._buffer:
            read = os.read(self._in, 1 << 16)
            assert read, "the browser ended"
            self._buffer += read
        first, self._buffer = self._buffer.split(b"\0", 1)
        return json.loads(first)

    def open(self, page, width, scheme):
        """Load a file or an address at a width in CSS pixels, in the light or the dark scheme."""
        url = page if isinstance(page, str) else page.resolve().as_uri()
        self.events.clear()
        self.send(
            "Emulation.setDeviceMetricsOverride",
            width=width,
            height=900,
            deviceScaleFactor=1,
            mobile=False,
        )
        feature = {"name": "prefers-color-scheme", "value": scheme}
        self.send("Emulation.setEmulatedMedia", features=[feature])
        self.send("Page.navigate", url=url)
        end = time.monotonic() + PATIENCE
        while self.ask("document.readyState") != "complete":
            assert time.monotonic() < end, f"{page} was not loaded within {PATIENCE} s"
            time.sleep(0.05)

    def ask(self, expression):
        """Value of a JavaScript expression in the page."""
        found = self.send(
            "Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=True
        )
        assert "exceptionDetails" not in found, found
        return found["result"].get("value")

    def complaints(self):
        """What the page wrote to the console, and what it could not do."""
        kinds = ("Runtime.consoleAPICalled", "Runtime.exceptionThrown", "Log.entryAdded")
        return [event for event in self.events if event.get("method") in kinds]

    def requests(self):
        """Addresses asked for, but for the page itself and what is written inside it."""
        sent = [e["params"] for e in self.events if e.get("method") == "Network.requestWillBeSent"]
        found = [str(one["request"]["url"]) for one in sent if one.get("type") != "Document"]
        return [url for url in found if not url.startswith("data:")]


@contextmanager
def running(profile):
    """Start a browser, and end it."""
    command = [browser(), "--headless", "--disable-gpu", "--no-first-run", "--disable-sync"]
    command += ["--disable-background-networking", "--disable-component-update"]
    command += ["--remote-debugging-pipe", f"--user-data-dir={profile}"]
    if hasattr(os, "geteuid") and os.geteuid() == 0:
        command.append("--no-sandbox")  # Chromium's sandbox refuses to run as root
    inlet, to_browser = os.pipe()
    from_browser, outlet = os.pipe()

    def connect():
        # Chromium reads commands from descriptor 3 and answers on descriptor 4; copies above 9
        # keep the one from being overwritten while the other is set
        copies = [fcntl.fcntl(one, fcntl.F_DUPFD, 10) for one in (inlet, outlet)]
        for copy, wanted in zip(copies, (3, 4), strict=True):
            os.dup2(copy, wanted)

    process = subprocess.Popen(
        command, preexec_fn=connect, close_fds=False, stderr=subprocess.DEVNULL
    )
    os.close(inlet)
    os.close(outlet)
    try:
        yield Browser(to_browser, from_browser).attach()
    finally:
        process.terminate()
        process.wait(PATIENCE)
        os.close(to_browser)
        os.close(from_browser)


@pytest.fixture(scope="module")
def server(home):
    with served(home) as made:
        yield made
