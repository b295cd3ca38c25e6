"""Firefox and WebKit, driven as far as the tests of pages need: open a file, run a
script, and hear what goes wrong.
"""

import contextlib
import json
import os
import shutil
import socket
import subprocess
import time
import warnings
from pathlib import Path

import pytest

#: Nothing leaves this computer; what pages say goes to the log.
_PREFERENCES = {
    "marionette.port": 0,
    "devtools.console.stdout.content": True,
    "network.proxy.type": 1,
    **{f"network.proxy.{kind}": "127.0.0.1" for kind in ("http", "ssl")},
    **{f"network.proxy.{kind}_port": 9 for kind in ("http", "ssl")},
}
_MINI_BROWSERS = "webkit2gtk-4.*/MiniBrowser"


class Firefox:
    """A headless Firefox, spoken to by its own protocol, Marionette; Debian has no
    driver for it.
    """

    def __init__(self, folder: Path):
        program = shutil.which("firefox-esr") or shutil.which("firefox")
        if program is None:
            pytest.skip("needs Debian's firefox-esr")
        lines = (
            f"user_pref({json.dumps(key)}, {json.dumps(value)});\n"
            for key, value in _PREFERENCES.items()
        )
        (folder / "user.js").write_text("".join(lines))
        self._log, port = folder / "log", folder / "MarionetteActivePort"
        command = [
            program,
            "--headless",
            "--marionette",
            "--no-remote",
            "--profile",
            str(folder),
        ]
        with self._log.open("w") as log:
            self._process = subprocess.Popen(
                command, stdout=log, stderr=subprocess.STDOUT
            )
        end = time.monotonic() + 60
        while not (port.exists() and port.read_text()) and time.monotonic() < end:
            time.sleep(0.1)
        self._socket = socket.create_connection(("127.0.0.1", int(port.read_text())))
        self._stream = self._socket.makefile("rb")
        self._receive()
        self._ask("WebDriver:NewSession")

    def _receive(self):
        size = b""
        while (character := self._stream.read(1)) != b":":
            size += character
        return json.loads(self._stream.read(int(size)))

    def _ask(self, name, **given):
        text = json.dumps([0, 1, name, given]).encode()
        self._socket.sendall(b"%d:%s" % (len(text), text))
        _, _, error, value = self._receive()
        assert not error, error
        return value

    def set_window_size(self, width, height):
        self._ask("WebDriver:SetWindowRect", width=width, height=height)

    def get(self, address):
        self._ask("WebDriver:Navigate", url=address)

    def execute_script(self, script, *given):
        return self._ask("WebDriver:ExecuteScript", script=script, args=list(given))[
            "value"
        ]

    def complaints(self):
        """What pages wrote to the console, errors of their scripts included."""
        lines = self._log.read_text(errors="replace").splitlines()
        said = [
            line
            for line in lines
            if line.startswith("console.") or ("file://" in line and "rror" in line)
        ]
        return [
            line for line in said if "RSLoader" not in line
        ]  # its own, that it reaches nobody

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self._ask("Marionette:Quit")
        self._stream.close()
        self._socket.close()
        self._process.wait(60)


@contextlib.contextmanager
def webkit(folder: Path):
    """WebKit's smallest browser, on a screen that nobody sees."""
    webdriver = pytest.importorskip(
        "selenium.webdriver", reason="the browser tests need selenium"
    )
    browsers = [
        path
        for place in ("/usr/lib", "/usr/libexec")
        for path in Path(place).glob(f"**/{_MINI_BROWSERS}")
    ]
    driver, screen = shutil.which("WebKitWebDriver"), shutil.which("Xvfb")
    if not (browsers and driver and screen):
        pytest.skip("needs Debian's webkit2gtk-driver and xvfb")
    arguments = ["-displayfd", "1", "-screen", "0", "1400x1000x24", "-nolisten", "tcp"]
    shown = subprocess.Popen(
        [screen, *arguments],
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
    )
    options = webdriver.WebKitGTKOptions()
    options.binary_location = str(browsers[0])
    options.add_argument("--automation")
    where = {
        **os.environ,
        "DISPLAY": f":{shown.stdout.readline().strip()}",
        "XDG_DATA_HOME": str(folder),
    }
    try:
        with warnings.catch_warnings():  # selenium's own
            warnings.simplefilter("ignore", DeprecationWarning)
            browser = webdriver.WebKitGTK(
                options=options, service=webdriver.WebKitGTKService(driver, env=where)
            )
        yield browser
        browser.quit()
    finally:
        shown.terminate()
        shown.communicate(timeout=30)
