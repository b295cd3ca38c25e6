"""The site of the documentation: it builds without a warning, opens from disk, and
names tests and names that exist.
"""

import re
import shutil
import subprocess
import sys
import tomllib

import pytest

import gaitsweep
from conftest import ROOT
from test_report.reading import Page


def test_every_capability_names_a_test_that_exists_and_is_in_make_test():
    """The ledger alone, which takes minutes, is left to `make check`, as are pages
    whose gaits walk in a browser.
    """
    rows = re.findall(
        r"^\| (.+) \| (.+) \| `(.+)::(.+)` \|$",
        (ROOT / "docs/capabilities.md").read_text(),
        re.M,
    )
    assert len(rows) > 40 and len({capability for capability, *_ in rows}) == len(rows)
    named = {name for *_, file, test in rows for name in (file, f"{file}::{test}")}
    left = named.intersection(
        tomllib.loads((ROOT / "tests/tiers.toml").read_text())["thorough"]
    )
    assert left <= {"tests/test_tasks/test_whole_ledger.py"}
    for _, status, file, test in rows:
        assert re.match(r"full|partial: ", status)
        assert re.search(rf"^def {test}\(", (ROOT / file).read_text(), re.M), test


def test_the_reference_holds_all_that_is_exported():
    page = (ROOT / "docs" / "reference.rst").read_text()
    assert set(re.findall(r"^\.\. auto\w+:: (\w+)$", page, re.M)) == {
        *gaitsweep.__all__
    } - {"__version__"}


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    folder = tmp_path_factory.mktemp("site")
    options = [
        "-q",
        "-j",
        "2",
        "-W",
        "--keep-going",
        "-c",
        "docs",
        "-d",
        folder / "doctrees",
    ]
    command = [sys.executable, "-m", "sphinx", *options, ".", folder / "pages"]
    done = subprocess.run(
        command, cwd=ROOT, capture_output=True, text=True, timeout=280
    )
    assert done.returncode == 0 and not done.stderr, done.stderr
    return folder / "pages"


def test_every_link_and_anchor_of_the_site_resolves_on_disk(site):
    pages = {path: Page(path) for path in site.rglob("*.html")}
    assert {"index.html", "reference.html", "tutorial.html", "tolerance.html"} <= {
        path.name for path in pages
    }
    for path, page in pages.items():
        loaded = [about.get("src") or about["href"] for tag, about in page.elements if tag in ("img", "link", "script")
                  and about.keys() & {"src", "href"}]  # fmt: skip
        assert not [link for link in loaded if re.match(r"https?:|//", link)], path
        for link in filter(
            lambda link: not re.match(r"https?:|data:", link),
            page.all("href") + page.all("src"),
        ):
            file, _, anchor = link.partition("#")
            leads_to = (
                (path.parent / file.partition("?")[0]).resolve() if file else path
            )
            assert leads_to.is_file(), (path, link)
            assert not anchor or anchor in pages[leads_to].all("id"), (path, link)


def test_the_site_shows_what_scripts_print_and_draw(site):
    for script in [
        ROOT / "docs" / "tutorial.py",
        *(ROOT / "docs" / "gallery").glob("*.py"),
    ]:
        page = Page(site / script.relative_to(ROOT).with_suffix(".html"))
        assert any("printed" in classes for classes in page.all("class")), script
        (alt,) = [about["alt"] for tag, about in page.elements if tag == "img"]
        assert len(alt) > 20, script


def test_the_site_is_searched_from_disk(site, tmp_path):
    if not (chromium := shutil.which("chromium")):
        pytest.skip("needs Debian's chromium (.ci/run installs it)")
    flags = [
        "headless",
        "no-sandbox",
        "disable-gpu",
        f"user-data-dir={tmp_path}",
        "virtual-time-budget=20000",
    ]
    address = f"{(site / 'search.html').as_uri()}?q=kneestrike"
    command = [chromium, *(f"--{flag}" for flag in flags), "--dump-dom", address]
    found = subprocess.run(command, capture_output=True, text=True, timeout=120).stdout
    assert "docs/physics.html" in found.partition('id="search-results"')[2]
