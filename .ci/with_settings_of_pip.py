"""Run a command of uv where pip would look: `python .ci/with_settings_of_pip.py uv pip
install …`.

Indexes, proxies and certificates that pip is set to use, in its files or in the
environment, reach uv in its environment. They may hold passwords: no list of processes
shows them there, and nothing prints them.
"""

import ast
import os
import subprocess
import sys

#: What uv calls each setting of pip; the latter three it shares with other programs.
_NAMES = {
    "index-url": ["UV_DEFAULT_INDEX"],
    "extra-index-url": ["UV_INDEX"],
    "find-links": ["UV_FIND_LINKS"],
    "trusted-host": ["UV_INSECURE_HOST"],
    "cert": ["SSL_CERT_FILE"],
    "client-cert": ["SSL_CLIENT_CERT"],
    "proxy": ["HTTP_PROXY", "HTTPS_PROXY"],
}
#: Sections of pip's files and its environment, as `pip install` reads them: the last
#: wins.
_SECTIONS = ["global", "install", ":env:"]


def settings() -> dict[str, str]:
    """Settings of pip by their names."""
    listed = subprocess.run(
        [sys.executable, "-m", "pip", "config", "list"],
        capture_output=True,
        text=True,
        check=True,
    )
    found: dict[str, dict[str, str]] = {section: {} for section in _SECTIONS}
    for line in listed.stdout.splitlines():
        name, _, value = line.partition("=")
        section, _, key = name.rpartition(".")
        if section in found and key in _NAMES:
            found[section][key] = str(ast.literal_eval(value))
    return {
        key: value for section in _SECTIONS for key, value in found[section].items()
    }


def environment() -> dict[str, str]:
    """The environment of uv: what is set there for uv itself stays as it is."""
    asked = settings()
    if "find-links" in asked:
        asked["find-links"] = ",".join(asked["find-links"].split())
    if "extra-index-url" in asked:
        asked["extra-index-url"] = " ".join(asked["extra-index-url"].split())
    named = {name: value for key, value in asked.items() for name in _NAMES[key]}
    own = {name: value for name, value in os.environ.items() if name.startswith("UV_")}
    return {**os.environ, **named, **own}


if __name__ == "__main__":
    os.execvpe(sys.argv[1], sys.argv[1:], environment())
