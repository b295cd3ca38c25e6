"""Every mark of a page, and many cells of its maps, make the gait walk that the archive
holds there.
"""

from pathlib import Path

import pytest

from browser import clicks
from gaitsweep import run
from gaitsweep.pipeline.report import pages
from gaitsweep.pipeline.report.source import read

pytestmark = pytest.mark.thorough
PAPER = Path(__file__).parents[2] / "data" / "studies" / "paper"


def wrong_marks(browser, archive):
    """Marks clicked on the open page of an archive, and what is wrong with those that
    are.
    """
    gaits, clicked, wrong = clicks.archived(archive), 0, []
    for figure in clicks.figures(browser):
        places = clicks.places(browser, figure)
        said = clicks.click(browser, figure, places)
        clicked += len(places)
        wrong += [
            (figure, one["values"], reason)
            for one in said
            if (reason := clicks.wrong(one, gaits))
        ]
    return clicked, wrong


def wrong_cells(browser, archive, figure, count):
    """Cells clicked of the maps of the open page of an archive, and what is wrong with
    those that are.
    """
    source, panels = read(archive), clicks.parts(browser, figure, "panels")
    drawn = clicks.cells(browser, figure, count)
    said, wrong = clicks.click(browser, figure, [point for *_, point in drawn]), []
    for (number, *_), one in zip(drawn, said, strict=True):
        if figure == "basin":
            reason = clicks.wrong_motion(one)
        else:
            gait = clicks.in_cell(source, panels[number], number % 3, one["values"])
            blank = one["title"] == "No gait" and not one["address"]
            if len(gait) and gait["slope"].iloc[0] > 0:
                reason = clicks.wrong(one, gait)
            else:
                reason = (
                    ""
                    if blank and (one["said"] == clicks.STILL) == bool(len(gait))
                    else f"says {one['said']!r}"
                )
        wrong += [(figure, one["values"], reason)] if reason else []
    return len(drawn), wrong


@pytest.mark.parametrize(
    ("name", "least"),
    [
        *[("branches", 60), ("ends", 100), ("curves", 200)],
        *[("driven", 100), ("torque", 20)],
    ],
)
def test_every_mark_walks_the_archived_gait(walk, walking, name, least):
    clicked, wrong = wrong_marks(walk(name, still=True), walking.parent / f"{name}.nc")
    assert clicked > least and wrong == []


def test_dots_of_orbits_over_a_push_off_walk_on(walk):
    """Each is a step, of the walker with the push-off of the dot."""
    browser = walk("pushed", still=True)
    said = clicks.click(browser, "bifurcation", clicks.places(browser, "bifurcation"))
    assert len(said) >= 40
    for one in said:
        push, angle, _ = map(float, one["values"])
        assert one["title"] == f"A motion of walker D, push_off = {push:g}"
        assert one["ringed"] and one["tip"] == one["command"]
        assert f"--set push_off={push:g}" in one["command"]
        assert float(one["facts"]["stance angle θ*"]) == pytest.approx(angle, rel=1e-5)
        assert not one["outcome"].startswith("In its first step")


@pytest.mark.parametrize(("name", "count"), [("design", 9), ("basin", 60)])
def test_cells_of_maps_walk_as_the_archive_says(walk, walking, name, count):
    clicked, wrong = wrong_cells(
        walk(name, still=True), walking.parent / f"{name}.nc", name, count
    )
    assert clicked >= count and wrong == []


#: What a map says under the pointer and where it is clicked, at places along a line: a
#: click has whole pixels.
_POINT_AND_CLICK = """
const plot = document.querySelector("#heatmap .plot"), picture = plot.querySelector("svg");
const told = () => [...plot.querySelectorAll(".tip dd")].map(dd => dd.textContent).join();
const box = plot.getBoundingClientRect(), found = [];
for (let x = 0.3; x < 0.7; x += 0.0011) {
  const where = { bubbles: true, pointerType: "mouse", clientX: box.left + x * box.width, clientY: box.top + 0.4 * box.height };
  picture.dispatchEvent(new PointerEvent("pointermove", where));
  const before = told();
  picture.dispatchEvent(new PointerEvent("pointerdown", where));
  picture.dispatchEvent(new PointerEvent("pointerup", where));
  picture.dispatchEvent(new MouseEvent("click", where));
  found.push([before, told()]);
  plot.dispatchEvent(new Event("blur"));
}
return found;"""  # noqa: E501


def test_a_click_is_on_the_cell_that_the_pointer_told(walk):
    """Of two that meet within a pixel it was the other, on dense screens."""
    told = walk("map", still=True).execute_script(_POINT_AND_CLICK)

    assert len({before for before, _ in told if before}) > 5
    assert [pair for pair in told if pair[0] != pair[1]] == []


@pytest.mark.soak
@pytest.mark.timeout(3600)
@pytest.mark.parametrize(
    "name", ["figure5", "figure6", "figure8", "figure11", "design", "basin"]
)
def test_every_mark_of_the_papers_pages_walks_the_archived_gait(opened, tmp_path, name):
    archive = tmp_path / f"{name}.nc"
    run(PAPER / f"{name}.toml", archive=archive, quiet=True)
    browser = opened(
        pages.write([archive], tmp_path / "report").parent / f"{name}.html", still=True
    )
    if name in ("design", "basin"):
        clicked, wrong = wrong_cells(
            browser, archive, name, 400 if name == "design" else 200
        )
        assert clicked >= 200
    else:
        clicked, wrong = wrong_marks(browser, archive)
        assert clicked > 150  # nodes of branches, as many as the step control needs
    assert wrong == []
