"""The pictures of the documentation show what a report shows now."""

import importlib.util
import json
import shutil
from pathlib import Path
from xml.etree import ElementTree

import pytest

from gaitsweep.pipeline.report.figures import FIGURES

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def pictures():
    """The module that takes them."""
    spec = importlib.util.spec_from_file_location("pictures", ROOT / "docs/pictures.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_no_picture_is_older_than_what_it_shows(pictures):
    assert pictures.stale() == [], "`make docs` takes them anew"


def test_every_picture_of_the_docs_is_taken(pictures):
    shown = {path.name for path in (ROOT / "docs").glob("*.png")}
    assert shown == {*pictures.PICTURES}


def test_every_figure_that_a_study_may_want_has_a_small_picture(pictures):
    drawn_of_themselves = {"residuals", "measured"}
    files = {*(ROOT / "docs/figures").iterdir()}

    assert {path.stem for path in files} == {*FIGURES} - drawn_of_themselves
    assert files == {ROOT / "docs" / name for name in pictures.THUMBNAILS}
    assert max(path.stat().st_size for path in files) <= 30_000
    for path in files:
        root = ElementTree.parse(path).getroot()
        assert root.tag == "{http://www.w3.org/2000/svg}svg"
        assert "var(" not in path.read_text(encoding="utf-8")


def test_a_picture_is_old_when_what_draws_it_changes_but_not_with_its_layout(
    pictures, tmp_path
):
    for folder in ("docs", "pipeline/report"):
        shutil.copytree(ROOT / folder, tmp_path / folder)
    every = pictures.PICTURES | pictures.THUMBNAILS
    recorded = {name: pictures.digest(one) for name, one in every.items()}
    (tmp_path / "docs/pictures.json").write_text(json.dumps(recorded))
    cycle = tmp_path / "pipeline/report/figures/cycle.py"

    cycle.write_text(f"# A comment.\n{cycle.read_text()}")
    assert pictures.stale(tmp_path) == []

    cycle.write_text(f"{cycle.read_text()}\nANOTHER = 1\n")
    assert pictures.stale(tmp_path) == ["walker.png", "figures/angles.svg"]
