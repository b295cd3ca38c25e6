"""The pages in Firefox and WebKit: they open, fit their width, and every mark walks the
archived gait.
"""

import time

import pytest

from browser.engines import Firefox, webkit
from browser.test_clicks import wrong_cells, wrong_marks
from browser.test_walking import LEG

pytestmark = [pytest.mark.soak, pytest.mark.timeout(1800)]


@pytest.fixture(scope="module", params=[Firefox, webkit])
def engine(request, tmp_path_factory):
    with request.param(tmp_path_factory.mktemp("engine")) as engine:
        yield engine


@pytest.fixture
def opened(engine):
    """Open a page of a folder in a window of some width."""

    def go(folder, name, width=1280):
        engine.set_window_size(width, 900)
        engine.get("about:blank")
        engine.get((folder / f"{name}.html").as_uri())
        return engine

    return go


def test_every_page_opens_and_fits_its_width(opened, engine, report, walking):
    pages = [
        (folder, page.stem)
        for folder in (report, walking)
        for page in sorted(folder.glob("*.html"))
    ]
    assert len(pages) > 15
    for width in (1280, 500):  # the windows of neither get narrower
        for folder, name in pages:
            inner, whole = opened(folder, name, width).execute_script(
                "return [innerWidth, document.documentElement.scrollWidth]"
            )
            assert whole <= inner <= width, (name, width)
    assert not isinstance(engine, Firefox) or engine.complaints() == []


def test_firefox_tells_what_goes_wrong(opened, engine, walking):
    if not isinstance(engine, Firefox):
        pytest.skip("WebKit has no log")
    opened(walking, "curves").execute_script(
        "console.error('as planned'); setTimeout(() => nothing(), 0)"
    )
    time.sleep(0.5)
    said = "\n".join(engine.complaints())
    assert "as planned" in said and "nothing is not defined" in said


@pytest.mark.parametrize(
    ("name", "least"), [("branches", 60), ("ends", 100), ("curves", 200)]
)
def test_every_mark_walks_the_archived_gait(opened, walking, name, least):
    clicked, wrong = wrong_marks(opened(walking, name), walking.parent / f"{name}.nc")
    assert clicked > least and wrong == []


@pytest.mark.parametrize(("name", "count"), [("design", 9), ("basin", 60)])
def test_cells_of_maps_walk_as_the_archive_says(opened, walking, name, count):
    clicked, wrong = wrong_cells(
        opened(walking, name), walking.parent / f"{name}.nc", name, count
    )
    assert clicked >= count and wrong == []


def test_the_walker_moves_within_a_moment_of_the_click(opened, walking):
    browser = opened(walking, "curves")
    still = browser.execute_script(
        f"document.querySelector('[data-do=play]').click(); return {LEG}"
    )
    begin = time.monotonic()
    while browser.execute_script(f"return {LEG}") == still:
        assert time.monotonic() < begin + 0.6
        time.sleep(0.02)


def test_small_pictures_keep_their_shape(opened, walking):
    shapes = opened(walking, "index").execute_script(
        "return [...document.querySelectorAll('.thumb svg')].map(svg => svg.getBoundingClientRect())"
        ".map(box => box.width / box.height)"
    )
    assert len(shapes) > 5 and shapes == pytest.approx([4 / 3] * len(shapes), rel=0.02)
