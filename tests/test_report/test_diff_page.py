"""The page on which two archives are compared."""

import re
import shutil

import netCDF4
import numpy as np
import pytest

from conftest import STUDY, Toy
from gaitsweep.pipeline.archive import diff
from gaitsweep.pipeline.cli import commands


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    toy = Toy(tmp_path_factory.mktemp("archive"))
    toy.write(STUDY)
    toy("run", "toy.toml")
    return toy.folder / "data" / "archive" / "toy.nc"


@pytest.fixture
def copy(made, tmp_path):
    shutil.copy(made, tmp_path / "copy.nc")
    return tmp_path / "copy.nc"


def _change(path):
    """Change two numbers by known shares, and take a third away."""
    with netCDF4.Dataset(path, "a") as file:
        angle = file["stance_angle"]
        angle[3, 1, 0] *= 1 + 1e-9
        angle[7, 0, 1] *= 1 + 1e-6
        angle[9, 1, 0] = np.nan


def test_the_page_tells_where_two_archives_differ_most(made, copy, capsys):
    _change(copy)
    page = copy.with_name("page.html")

    code = commands.main(["diff", str(made), str(copy), "--page", str(page)])

    said, text = capsys.readouterr().out, page.read_text()
    assert code == 1
    for sentence in said.splitlines():
        assert sentence.replace("`", "") in text
    with netCDF4.Dataset(made) as file:
        slope = float(file["slope"][7])
        gait = str(file["gait"][1])
    row = re.search(r"<tr><td[^>]*>stance_angle.*?</tr>", text).group()
    place = re.search(r"γ = ([0-9.]+), w_t = ([0-9.]+), (\w+)", row).groups()
    assert float(place[0]) == pytest.approx(slope, rel=1e-5)
    assert place[1:] == ("0", gait)
    assert "<svg" in text


def test_numbers_differ_by_shares_of_the_larger(made, copy):
    _change(copy)

    kept = []
    diff.diff(made, copy, keep=kept.append)

    (angle,) = (one for one in kept if one.name == "stance_angle")
    found = angle.difference.values
    assert found[3, 1, 0] == pytest.approx(1e-9, rel=1e-5)
    assert found[7, 0, 1] == pytest.approx(1e-6, rel=1e-5)
    assert np.isnan(found[9, 1, 0])
    assert np.count_nonzero(found > 0) == 2


def test_the_page_prints_the_digits_that_tell_two_numbers_apart(made, copy, capsys):
    with netCDF4.Dataset(copy, "a") as file:
        before = float(file["stance_angle"][3, 1, 0])
        file["stance_angle"][3, 1, 0] = after = before * (1 + 1e-7)
    page = copy.with_name("page.html")

    commands.main(["diff", str(made), str(copy), "--page", str(page)])

    row = re.search(r"<tr><td[^>]*>stance_angle.*?</tr>", page.read_text()).group()
    printed = [float(text) for text in re.findall(r">(0\.\d+)<", row)]
    assert len(set(printed)) == 2
    for value in (before, after):
        assert min(abs(text - value) for text in printed) < 1e-8 * value


@pytest.mark.parametrize("tolerances", [[], ["--rtol", "residual=1e-12"]])
def test_sentences_and_page_measure_a_difference_alike(made, copy, capsys, tolerances):
    """A measure of rounding is compared with one, unless it has a tolerance of its
    own.
    """
    with netCDF4.Dataset(copy, "a") as file:
        before = float(file["residual"][3, 1, 0])
        file["residual"][3, 1, 0] = after = before + 1e-9
    page = copy.with_name("page.html")

    commands.main(["diff", str(made), str(copy), "--page", str(page), *tolerances])

    share = 1e-9 / after if tolerances else 1e-9
    (said,) = re.findall(r"by up to (\S+)", capsys.readouterr().out)
    assert float(said) == pytest.approx(share, rel=0.05)
    row = re.search(r"<tr><td[^>]*>residual.*?</tr>", page.read_text()).group()
    values = [float(text) for text in re.findall(r'value="([^"]+)"', row)]
    assert share == pytest.approx(values[3], rel=1e-6)


def test_an_archive_is_opened_once_for_sentences_and_page(
    made, copy, capsys, monkeypatch
):
    opened = []
    open_archive = diff.open_archive

    def counted(path):
        opened.append(path)
        return open_archive(path)

    monkeypatch.setattr(diff, "open_archive", counted)
    page = copy.with_name("page.html")

    commands.main(["diff", str(made), str(copy), "--page", str(page)])

    assert opened == [made, copy]


def test_a_page_of_archives_with_other_axes_has_what_both_can_be_compared_in(
    made, tmp_path, capsys
):
    toy = Toy(tmp_path)
    toy.write(STUDY.replace("w_t = [0.0, 0.25]", ""))
    toy("run", "toy.toml")
    other = tmp_path / "data" / "archive" / "toy.nc"
    page = tmp_path / "page.html"

    code = commands.main(["diff", str(made), str(other), "--page", str(page)])

    assert code == 1 and capsys.readouterr().err == ""
    assert "the dimension w_t is only in" in page.read_text()


def test_an_infinite_number_differs_whatever_the_tolerance(made, copy, capsys):
    with netCDF4.Dataset(copy, "a") as file:
        file["stance_angle"][3, 1, 0] = np.inf
    page = copy.with_name("page.html")
    command = ["diff", str(made), str(copy), "--page", str(page), "--rtol", "0.5"]

    code = commands.main(command)

    assert code == 1
    assert "1 of 800 differ, by up to inf" in capsys.readouterr().out
    row = re.search(r"<tr><td[^>]*>stance_angle.*?</tr>", page.read_text()).group()
    assert ">∞<" in row


def test_archives_that_agree_are_said_to_agree(made, copy, capsys):
    page = copy.with_name("page.html")

    code = commands.main(["diff", str(made), str(copy), "--page", str(page)])

    assert code == 0
    assert "They agree." in page.read_text() and "<svg" not in page.read_text()


def test_numbers_that_one_archive_lacks_come_first(made, copy, capsys):
    with netCDF4.Dataset(copy, "a") as file:
        file["stance_angle"][3, 1, 0] *= 2
        file["spectral_radius"][9, 1, 0] = np.nan
    page = copy.with_name("page.html")

    commands.main(["diff", str(made), str(copy), "--page", str(page)])

    text = page.read_text()
    rows = re.findall(r"<tr><td[^>]*>([a-z_]+)<", text)
    assert rows == ["spectral_radius", "stance_angle"]
    assert "variables have equal numbers" in text


def test_a_page_tells_within_which_tolerance_archives_agree(made, copy, capsys):
    with netCDF4.Dataset(copy, "a") as file:
        file["stance_angle"][3, 1, 0] *= 1 + 1e-9
    page = copy.with_name("page.html")
    tolerances = ["--rtol", "1e-6", "--rtol", "stance_angle=1e-8"]

    commands.main(["diff", str(made), str(copy), "--page", str(page), *tolerances])

    assert "They agree within 1e-06, stance_angle 1e-08." in page.read_text()


@pytest.mark.parametrize(
    "content",
    ["mine", '<!doctype html><meta name="generator" content="gaitsweep check">'],
)
def test_the_page_replaces_no_file_of_others(made, copy, capsys, content):
    page = copy.with_name("page.html")
    page.write_text(content)

    code = commands.main(["diff", str(made), str(copy), "--page", str(page)])

    error = capsys.readouterr().err
    assert code != 0 and error.count("\n") == 1 and "not a file of gaitsweep" in error
    assert page.read_text() == content
