import shutil
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from gaitsweep import run
from gaitsweep.pipeline.report import pages
from test_report import synthetic

#: Studies whose pages have gaits that walk: curves, branches through folds, maps,
#: orbits and a basin.
STUDIES = {
    "curves": 'walker = "E"\n[axes]\nfoot_mass_ratio = [0.1, 0.05, 0.02]\n'
    'slope = { from = 1e-3, to = 0.1, n = 40, spacing = "log" }\n'
    '[want]\nvariables = ["stance_angle", "period", "multipliers"]\nfigures = ["loglog", "multipliers"]\n',
    "pair": 'walker = "E"\n[axes]\nfoot_mass_ratio = [0.1, 0.05]\n'
    'slope = { from = 1e-6, to = 0.1, n = 40, spacing = "log" }\n'
    '[want]\nvariables = ["stance_angle", "multipliers"]\nfits = ["transition"]\nfigures = ["loglog"]\n',
    "branches": 'kind = "branch"\nwalker = "C"\n[axes]\ndetuning = [0.1]\nslope = { from = 1e-3, to = 0.1, n = 60 }\n'
    '[want]\nfigures = ["locus"]\n',
    "flips": 'kind = "curve"\nwalker = "A"\n[axes]\ndetuning = [0.5]\nslope = [1e-3, 0.2]\n'
    '[want]\nfigures = ["curves"]\n[options]\nkey = "detuning"\nfrom = 0.48\nto = 0.56\nkinds = ["flip"]\n',
    "ends": 'kind = "branch"\nwalker = "physical"\n[axes]\nslope = { from = 0.015, to = 0.06, n = 60 }\n'
    '[want]\nfigures = ["locus"]\n',
    "map": 'walker = "B"\n[axes]\nR = { from = 0.1, to = 0.4, n = 31 }\nslope = { from = 0.005, to = 0.05, n = 30 }\n'
    '[want]\nvariables = ["stance_angle", "speed", "multipliers"]\nfigures = ["heatmap"]\n',
    "ratios": 'walker = "E"\n[axes]\nfoot_mass_ratio = [0.02, 0.05, 0.08, 0.11, 0.14]\n'
    "slope = { from = 0.004, to = 0.06, n = 29 }\n"
    '[want]\nvariables = ["stance_angle", "speed", "multipliers"]\nfigures = ["heatmap"]\n',
    "cube": 'walker = "E"\n[axes]\nR = [0.0, 0.1, 0.2, 0.25]\nfoot_mass_ratio = { from = 0.02, to = 0.13, n = 12 }\n'
    "slope = { from = 0.01, to = 0.06, n = 26 }\n"
    '[want]\nvariables = ["stance_angle", "speed", "period", "multipliers"]\nfigures = ["heatmap"]\n',
    "design": 'kind = "design"\nwalker = "A"\n[axes]\nR = [0.15, 0.2, 0.3]\nc_t = [0.07, 0.084, 0.12]\n'
    'slope = [1e-5, 0.2]\n[want]\nfigures = ["design"]\n',
    "basin": 'kind = "basin"\nwalker = "D"\n[axes]\nslope = [0.0126]\n[want]\nfigures = ["basin"]\n'
    "[options]\nsize = 60\nstance_angle = [0.1, 0.35]\nstance_rate = [-0.35, -0.1]\n",
    "kneed-basin": 'kind = "basin"\nwalker = "C"\n[axes]\nslope = [0.06]\n[want]\nfigures = ["basin"]\n'
    "[options]\nsize = 40\n",
    "driven": 'kind = "branch"\nwalker = ["C", "E"]\n[axes]\nslope = [0.0, -0.002]\n'
    'push_off = { from = 0.02, to = 0.3, n = 30 }\n[want]\nfigures = ["locus"]\n',
    "torque": 'kind = "branch"\n[walker]\nbase = "B"\nhip_stiffness = 0.05\nhip_torque = 0.01\n[axes]\nslope = [0.0]\n'
    'hip_torque = { from = 1e-3, to = 0.03, n = 30 }\n[want]\nfigures = ["locus"]\n',
    "pushed": 'kind = "orbit"\nwalker = "D"\n[axes]\nslope = [0.0]\npush_off = { from = 0.13, to = 0.15, n = 5 }\n'
    '[want]\nfigures = ["bifurcation"]\n[options]\nstarts = 1\ntransient = 60\nsteps = 24\nshown = 8\n',
    "narrow": 'kind = "orbit"\nwalker = "D"\n[axes]\nslope = { from = 0.01815, to = 0.01816, n = 5 }\n'
    '[want]\nfigures = ["bifurcation"]\n[options]\nstarts = 1\ntransient = 60\nsteps = 24\nshown = 8\n',
    "two-steps": 'walker = "D"\n[axes]\nslope = { from = 0.0155, to = 0.0165, n = 5 }\n'
    '[want]\nvariables = ["stance_angle"]\nfigures = ["linear"]\n[options]\nsteps = 2\n',
    "orbits": 'kind = "orbit"\nwalker = "C"\n[axes]\nslope = { from = 0.07, to = 0.09, n = 21 }\n'
    '[want]\nfigures = ["bifurcation"]\n[options]\nstarts = 1\ntransient = 60\nsteps = 40\nshown = 8\n',
}


@pytest.fixture(scope="session")
def report(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a report of one archive of each kind."""
    archives = synthetic.everything(tmp_path_factory.mktemp("archive"))
    return pages.write(archives, tmp_path_factory.mktemp("reports")).parent


@pytest.fixture(scope="session")
def archives_bundled(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The bundle of a report, alone in a folder."""
    archives = synthetic.everything(tmp_path_factory.mktemp("archive"))
    index = pages.write(archives, tmp_path_factory.mktemp("reports"), bundle=True)
    return index.with_name("bundle.html").rename(
        tmp_path_factory.mktemp("alone") / "bundle.html"
    )


@pytest.fixture(scope="session")
def walking(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a report of computed archives, whose gaits walk."""
    folder = tmp_path_factory.mktemp("walking")
    for name, text in STUDIES.items():
        run(f'name = "{name}"\n{text}', archive=folder / f"{name}.nc", quiet=True)
    return pages.write(
        [folder / f"{name}.nc" for name in STUDIES], folder / "reports"
    ).parent


@pytest.fixture(scope="session")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[object]:
    """A headless Chromium with a profile of its own, talking to nobody."""
    webdriver = pytest.importorskip(
        "selenium.webdriver", reason="the browser tests need selenium"
    )
    chromium, driver = shutil.which("chromium"), shutil.which("chromedriver")
    if chromium is None or driver is None:
        pytest.skip(
            "the browser tests need Debian's chromium and chromium-driver (.ci/run installs them)"
        )
    options = webdriver.ChromeOptions()
    options.binary_location = chromium
    profile = tmp_path_factory.mktemp("profile")
    for flag in ("headless", "no-sandbox", "disable-gpu", "no-first-run", "disable-background-networking",
                 "disable-component-update", "disable-sync", f"user-data-dir={profile}"):  # fmt: skip
        options.add_argument(f"--{flag}")
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    found = webdriver.Chrome(options=options, service=webdriver.ChromeService(driver))
    yield found
    found.quit()


@pytest.fixture
def opened(browser):
    """Open a file at a width, in a colour scheme, with or without motion."""

    def go(
        path: Path,
        width: int = 1280,
        scheme: str = "light",
        anchor: str = "",
        still: bool = False,
    ):
        media = {
            "prefers-color-scheme": scheme,
            "prefers-reduced-motion": "reduce" if still else "no-preference",
        }
        features = [{"name": name, "value": value} for name, value in media.items()]
        browser.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": features})
        size = {
            "width": width,
            "height": 900,
            "deviceScaleFactor": 1,
            "mobile": width < 500,
        }
        browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
        browser.get("about:blank")
        browser.get(path.as_uri() + anchor)
        loaded = (
            "return location.protocol === 'file:' && document.readyState === 'complete'"
        )
        deadline = time.monotonic() + 30
        while (
            not browser.execute_script(loaded) and time.monotonic() < deadline
        ):  # on a busy machine
            time.sleep(0.05)
        return browser

    return go


@pytest.fixture
def visit(opened, report):
    """Open a page of the report of one archive of each kind."""
    return lambda name, *where, **how: opened(report / f"{name}.html", *where, **how)


@pytest.fixture
def walk(opened, walking):
    """Open a page whose gaits walk."""
    return lambda name, *where, **how: opened(walking / f"{name}.html", *where, **how)
