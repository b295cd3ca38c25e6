"""Pictures of the documentation, taken of the pages of a report when what they show has
changed. `make docs` runs it; a test fails where a picture is older than what it shows.
"""

import ast
import base64
import hashlib
import json
import shutil
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent

#: What each picture showed when it was taken.
RECORD = ROOT / "docs" / "pictures.json"

_REPORT = Path("pipeline/report")
_EVERY = ("sketch", "style", "degrees")


@dataclass(frozen=True)
class Picture:
    """A part of a page: of a study, the element, or the whole window; the width [px] at
    which it is seen, what is done before, and the files that decide how it looks.
    """

    study: str
    element: str
    width: int
    shows: tuple[str, ...]
    before: str = ""


def _figures(*names: str) -> tuple[str, ...]:
    """Files of the modules of figures."""
    return tuple(f"figures/{name}.py" for name in (*names, *_EVERY))


PICTURES = {
    "live.png": Picture(
        "figure6",
        "",
        1280,
        (
            *_figures("branch_curves", "landmarks", "stability"),
            "scripts/stage.js",
            "scripts/walker.js",
            "templates/parts.html",
            "templates/report.css",
            "templates/study.html",
        ),
        "location.hash = 'walker=physical&slope=0.036'; document.querySelector('figure').scrollIntoView()",
    ),
    "parameters.png": Picture(
        "figure9", "#parameters .picture", 960, _figures("parameters", "body")
    ),
    "walker.png": Picture(
        "figure3", "#angles .picture", 960, _figures("cycle", "body")
    ),
    "design.png": Picture(
        "design", "#design .picture", 960, _figures("design_maps", "maps")
    ),
}


def digest(picture: Picture, root: Path = ROOT) -> str:
    """Hash of the code that draws a picture, whatever its layout, and of the texts that
    it shows.
    """
    whole = hashlib.sha256()
    for name in picture.shows:
        text = (root / _REPORT / name).read_text(encoding="utf-8")
        if name.endswith(".py"):
            text = ast.dump(ast.parse(text))
        whole.update(text.encode())
    return whole.hexdigest()[:16]


def stale(root: Path = ROOT) -> list[str]:
    """Names of pictures that are older than what they show."""
    recorded = json.loads((root / "docs" / RECORD.name).read_text(encoding="utf-8"))
    return [
        name
        for name, picture in PICTURES.items()
        if recorded.get(name) != digest(picture, root)
    ]


def main() -> None:
    """Take the pictures that are older than what they show."""
    names = stale()
    if not names:
        return
    if shutil.which("chromium") is None or shutil.which("chromedriver") is None:
        print(f"Chromium is missing, so these pictures stay old: {', '.join(names)}")
        return
    pages = _pages({PICTURES[name].study for name in names})
    recorded = json.loads(RECORD.read_text(encoding="utf-8"))
    for name in names:
        picture = PICTURES[name]
        (ROOT / "docs" / name).write_bytes(_taken(pages, picture))
        recorded[name] = digest(picture)
    RECORD.write_text(json.dumps(recorded, indent=2, sort_keys=True) + "\n")


def _pages(studies: set[str]) -> Path:
    """The folder of the pages of some studies of the paper, run first where they are
    not.
    """
    from gaitsweep import report, run

    archives = [ROOT / "data" / "archive" / f"{name}.nc" for name in sorted(studies)]
    for archive in archives:
        run(f"paper/{archive.stem}", archive=archive, quiet=True)
    folder = ROOT / "build" / "pictures"
    report(archives, folder)
    return folder


def _taken(pages: Path, picture: Picture) -> bytes:
    """A picture of a page, as PNG."""
    from selenium import webdriver

    options = webdriver.ChromeOptions()
    options.binary_location = str(shutil.which("chromium"))
    for flag in ("headless", "no-sandbox", "disable-gpu", "hide-scrollbars"):
        options.add_argument(f"--{flag}")
    service = webdriver.ChromeService(str(shutil.which("chromedriver")))
    browser = webdriver.Chrome(options=options, service=service)
    try:
        size = {"width": picture.width, "height": 900, "deviceScaleFactor": 1}
        _do(browser, "Emulation.setDeviceMetricsOverride", {**size, "mobile": False})
        still = [{"name": "prefers-reduced-motion", "value": "reduce"}]
        _do(browser, "Emulation.setEmulatedMedia", {"features": still})
        browser.get((pages / f"{picture.study}.html").as_uri())
        browser.execute_script(picture.before)
        time.sleep(1)
        how = {"format": "png", "captureBeyondViewport": bool(picture.element)}
        if picture.element:
            how["clip"] = _place(browser, picture.element)
        return base64.b64decode(_do(browser, "Page.captureScreenshot", how)["data"])
    finally:
        browser.quit()


def _do(browser: Any, command: str, how: dict[str, Any]) -> Any:
    """A command of Chromium's own protocol."""
    return browser.execute_cdp_cmd(command, how)


def _place(browser: Any, element: str) -> dict[str, float]:
    """Where an element stands on its page."""
    script = """const box = document.querySelector(arguments[0]).getBoundingClientRect();
        return { x: box.x + scrollX, y: box.y + scrollY, width: box.width, height: box.height, scale: 1 };"""
    return dict(browser.execute_script(script, element))


if __name__ == "__main__":
    sys.exit(main())
