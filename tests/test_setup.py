"""`make setup` takes packages from where pip would, and tells nobody the passwords that
lie in the addresses.
"""

import json
import os
import shutil
import subprocess
import sys

import pytest

from conftest import ROOT

PASSWORD = """s3cret'$(touch told)"`touch told`;&\\%40"""
SETTINGS = f"""[global]
index-url = https://me:{PASSWORD}@packages.example/simple
extra-index-url =
    https://more.example/simple
    https://you:{PASSWORD}@most.example/simple
trusted-host = packages.example more.example:8443
find-links = /srv/wheels https://links.example/wheels
proxy = http://one:{PASSWORD}@proxy.example:3128
cert = /etc/nowhere.pem

[install]
cert = /etc/own certificates.pem
"""
BASE = sys._base_executable  # which has pip
#: Python in a shell: of what `make setup` asks, it does not install, and puts a uv
#: there that notes its environment.
PYTHON = f"""#!/bin/sh
case "$1 $2" in
  "-m venv") mkdir -p .venv/bin && printf '#!/bin/sh\\nexec {sys.executable} ../uv.py "$@"\\n' >.venv/bin/uv
             chmod +x .venv/bin/uv;;
  "-m pip") test "$3" != config || exec {BASE} "$@";;
  "-c "*) ;;
  *) exec {BASE} "$@";;
esac
"""
UV = """import json, os, sys
with open("../uv.jsonl", "a") as file:
    print(json.dumps({"words": sys.argv[1:], "environment": dict(os.environ)}), file=file)
"""


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A copy of what `make setup` reads, and pip's settings with it."""
    for name in list(os.environ):
        if name.startswith(("PIP_", "UV_", "SSL_")) or name.lower().endswith("_proxy"):
            monkeypatch.delenv(name)
    (tmp_path / "pip.conf").write_text(SETTINGS)
    monkeypatch.setenv("PIP_CONFIG_FILE", str(tmp_path / "pip.conf"))
    (tmp_path / "python").write_text(PYTHON)
    (tmp_path / "python").chmod(0o755)
    (tmp_path / "uv.py").write_text(UV)

    made = tmp_path / "project"
    (made / ".ci").mkdir(parents=True)
    for name in (
        "Makefile",
        "pyproject.toml",
        "requirements.lock",
        ".ci/with_settings_of_pip.py",
    ):
        shutil.copy(ROOT / name, made / name)
    return made


def make(folder, *words):
    command = ["make", f"PYTHON={folder.parent / 'python'}", *words]
    return subprocess.run(
        command, cwd=folder, capture_output=True, text=True, check=True
    )


def calls(folder):
    return [
        json.loads(line)
        for line in (folder.parent / "uv.jsonl").read_text().splitlines()
    ]


def test_settings_of_pip_reach_uv(folder):
    make(folder, "setup")

    called = calls(folder)[0]
    assert (
        called["words"][:2] == ["pip", "install"]
        and "--require-hashes" in called["words"]
    )
    expected = {
        "UV_DEFAULT_INDEX": f"https://me:{PASSWORD}@packages.example/simple",
        "UV_INDEX": f"https://more.example/simple https://you:{PASSWORD}@most.example/simple",
        "UV_INSECURE_HOST": "packages.example more.example:8443",
        "UV_FIND_LINKS": "/srv/wheels,https://links.example/wheels",
        "HTTPS_PROXY": f"http://one:{PASSWORD}@proxy.example:3128",
        "SSL_CERT_FILE": "/etc/own certificates.pem",
    }
    assert {name: called["environment"].get(name) for name in expected} == expected


@pytest.mark.parametrize(
    "words", [["setup"], ["-n", "setup"], ["-n", "lock"], ["--debug=b", "setup"]]
)
def test_no_password_is_printed_or_executed(folder, words):
    done = make(folder, *words)

    assert "s3cret" not in done.stdout + done.stderr and "uv pip" in done.stdout
    assert not list(folder.rglob("told"))
    if "-n" not in words:
        assert not [
            word
            for called in calls(folder)
            for word in called["words"]
            if "s3cret" in word
        ]


def test_settings_in_the_environment_win_and_those_of_uv_are_kept(folder, monkeypatch):
    monkeypatch.setenv("PIP_CERT", "/etc/mine.pem")
    monkeypatch.setenv("UV_INDEX", "https://own.example/simple")

    make(folder, "setup")

    environment = calls(folder)[0]["environment"]
    assert environment["SSL_CERT_FILE"] == "/etc/mine.pem"
    assert environment["UV_INDEX"] == "https://own.example/simple"
