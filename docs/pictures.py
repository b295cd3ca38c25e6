"""Pictures of the documentation, taken of the pages of a report, and small ones of every
figure, drawn as the index of a report has them, when what they show has changed.
`make docs` runs it; a test fails where a picture is older than what it shows.
"""

import ast
import base64
import hashlib
import json
import re
import shutil
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from inspect import cleandoc
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


@dataclass(frozen=True)
class Thumbnail:
    """A figure of a study, small, and the files that decide how it looks."""

    study: str
    shows: tuple[str, ...]


def _thumbnails(study: str, module: str, *names: str) -> dict[str, Thumbnail]:
    """The figures of a study that a module draws, by the names of their files."""
    shows = (*_figures(module), "figures/svg.py")
    return {f"figures/{name}.svg": Thumbnail(study, shows) for name in names}


#: Studies that no other has the data of, or only with more dots than a small picture
#: shows.
STUDIES = {
    "ranked-keys": """
        walker = "C"
        axes.slope = [0.02]
        want = { variables = ["sensitivities"], figures = ["sensitivities"] }
        """,
    "a-few-orbits": """
        kind = "orbit"
        walker = "D"
        axes.slope = { from = 0.0145, to = 0.0195, n = 101 }
        want.figures = ["bifurcation"]
        options = { starts = 1, transient = 400, steps = 176, shown = 40 }
        """,
}

#: One for each name that a study's `figures` may list.
THUMBNAILS = {
    **_thumbnails("paper/figure11", "families", "linear", "loglog", "multipliers"),
    **_thumbnails("paper/figure11", "families", "heelstrike", "losses", "power"),
    **_thumbnails("paper/figure10", "laws", "exponents"),
    **_thumbnails("paper/transition", "laws", "transition_ladder"),
    **_thumbnails("paper/figure3", "cycle", "angles"),
    **_thumbnails("paper/figure9", "body", "walker", "conditions"),
    **_thumbnails("paper/figure9", "parameters", "parameters"),
    **_thumbnails("paper/figure6", "branch_curves", "locus"),
    **_thumbnails("a-few-orbits", "bifurcation", "bifurcation", "lyapunov"),
    **_thumbnails("paper/cascade-kneed", "searches", "cascade"),
    **_thumbnails("paper/census", "searches", "census"),
    **_thumbnails("paper/basin", "maps", "basin"),
    **_thumbnails("examples/mass-on-level-ground", "maps", "heatmap"),
    **_thumbnails("paper/touching-branches", "curves", "curves"),
    **_thumbnails("paper/design", "design_maps", "design"),
    **_thumbnails("examples/level-ground", "over_key", "over_key"),
    **_thumbnails("examples/pushing-off", "sought", "sought"),
    **_thumbnails("examples/fastest-walker", "optima", "optimum"),
    **_thumbnails("ranked-keys", "ranking", "sensitivities"),
}

#: Width at which a thumbnail is seen [px].
_SMALL = 150


def digest(picture: Picture | Thumbnail, root: Path = ROOT) -> str:
    """Hash of the code that draws a picture, whatever its layout, and of the texts that
    it shows.
    """
    whole = hashlib.sha256()
    for name in picture.shows:
        text = (root / _REPORT / name).read_text(encoding="utf-8")
        whole.update((_syntax(text) if name.endswith(".py") else text).encode())
    return whole.hexdigest()[:16]


@cache
def _syntax(code: str) -> str:
    """Code without its layout."""
    return ast.dump(ast.parse(code))


def stale(root: Path = ROOT) -> list[str]:
    """Names of pictures that are older than what they show."""
    recorded = json.loads((root / "docs" / RECORD.name).read_text(encoding="utf-8"))
    every: dict[str, Picture | Thumbnail] = {**PICTURES, **THUMBNAILS}
    return [
        name
        for name, picture in every.items()
        if recorded.get(name) != digest(picture, root)
    ]


def main() -> None:
    """Take the pictures that are older than what they show."""
    names = stale()
    draw([name for name in names if name in THUMBNAILS])
    take([name for name in names if name in PICTURES])


def draw(names: list[str]) -> None:
    """Draw some thumbnails."""
    from gaitsweep.pipeline.report import figures, source

    sources = {
        study: source.read(archive)
        for study, archive in _archives({THUMBNAILS[name].study for name in names})
    }
    for name in names:
        path = ROOT / "docs" / name
        drawing = figures.draw(sources[THUMBNAILS[name].study], path.stem, path.stem)
        text = _alone(drawing.small, drawing.width, drawing.height)
        path.parent.mkdir(exist_ok=True)
        path.write_text(text, encoding="utf-8")
    _record({name: digest(THUMBNAILS[name]) for name in names})


def _alone(svg: str, width: float, height: float) -> str:
    """A picture of a page as a file of its own, in the colours of a light page, on its
    ground.
    """
    from gaitsweep.pipeline.report.figures.style import PAPER, VARIABLES

    for colour, name in VARIABLES.items():
        svg = svg.replace(f"var(--{name})", colour)
    # The letters of paths need no blanks.
    svg = re.sub(
        r'(?<= d=")[^"]*',
        lambda path: re.sub(r" *([A-Za-z]) *", r"\1", path[0]),
        svg,
    )
    size = f'width="{_SMALL}" height="{round(_SMALL * height / width)}"'
    head = f'<svg xmlns="http://www.w3.org/2000/svg" {size} \\1>'
    head += f'<rect width="100%" height="100%" fill="{PAPER}"/>'
    # Lines as thick as on a page.
    head += "<style>path { vector-effect: non-scaling-stroke }</style>"
    return re.sub(r'^<svg (viewBox="[^"]*")[^>]*>', head, svg) + "\n"


def take(names: list[str]) -> None:
    """Take some pictures of pages, where there is a browser."""
    if not names:
        return
    if shutil.which("chromium") is None or shutil.which("chromedriver") is None:
        print(f"Chromium is missing, so these pictures stay old: {', '.join(names)}")
        return
    pages = _pages({PICTURES[name].study for name in names})
    for name in names:
        (ROOT / "docs" / name).write_bytes(_taken(pages, PICTURES[name]))
    _record({name: digest(PICTURES[name]) for name in names})


def _record(digests: dict[str, str]) -> None:
    """Keep what some pictures showed when they were taken."""
    recorded = json.loads(RECORD.read_text(encoding="utf-8")) | digests
    RECORD.write_text(json.dumps(recorded, indent=2, sort_keys=True) + "\n")


def _pages(studies: set[str]) -> Path:
    """The folder of the pages of some studies of the paper."""
    from gaitsweep import report

    folder = ROOT / "build" / "pictures"
    archives = _archives({f"paper/{study}" for study in studies})
    report([archive for _, archive in archives], folder)
    return folder


def _archives(studies: set[str]) -> Iterator[tuple[str, Path]]:
    """Some studies with their archives, run first where they are not."""
    from gaitsweep import run

    for study in sorted(studies):
        folder, _, name = study.rpartition("/")
        place = "data/archive" if folder == "paper" else "build/pictures/archive"
        archive = ROOT / place / f"{name}.nc"
        archive.parent.mkdir(parents=True, exist_ok=True)
        file: str | Path = study
        if study in STUDIES:
            file = archive.with_suffix(".toml")
            file.write_text(f'name = "{study}"\n{cleandoc(STUDIES[study])}\n')
        run(file, archive=archive, quiet=True)
        yield study, archive


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
