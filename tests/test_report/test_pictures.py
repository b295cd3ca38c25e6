"""The pictures of the documentation show what a report shows now."""

import importlib.util
import json
import shutil
from pathlib import Path

import pytest

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


def test_a_picture_is_old_when_what_draws_it_changes_but_not_with_its_layout(
    pictures, tmp_path
):
    for folder in ("docs", "pipeline/report"):
        shutil.copytree(ROOT / folder, tmp_path / folder)
    recorded = {name: pictures.digest(one) for name, one in pictures.PICTURES.items()}
    (tmp_path / "docs/pictures.json").write_text(json.dumps(recorded))
    cycle = tmp_path / "pipeline/report/figures/cycle.py"

    cycle.write_text(f"# A comment.\n{cycle.read_text()}")
    assert pictures.stale(tmp_path) == []

    cycle.write_text(f"{cycle.read_text()}\nANOTHER = 1\n")
    assert pictures.stale(tmp_path) == ["walker.png"]
