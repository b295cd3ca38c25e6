"""Figures of a reader's own on a page."""

import pytest
from matplotlib.figure import Figure

import gaitsweep
from gaitsweep.pipeline.errors import StudyError


@pytest.fixture
def transition(archives):
    return next(path for path in archives if path.stem == "transition")


def _figure(points):
    figure = Figure()
    figure.add_subplot().plot(range(points), "." if points > 1000 else "-")
    return figure


def test_a_figure_of_the_readers_own_stands_on_the_page(transition, tmp_path):
    extra = [
        ("Our machine <2>", _figure(3), "Measured & drawn."),
        ("Many points", _figure(20_000), ""),
    ]

    page = gaitsweep.report(transition, tmp_path, extra=extra)

    text = page.read_text()
    assert '<a href="#extra-1">Our machine &lt;2&gt;</a>' in text
    assert "<p>Measured &amp; drawn.</p>" in text
    assert text.count('src="data:image/svg+xml;base64,') == 1
    # In lines it would be larger than the page may be.
    assert text.count('src="data:image/png;base64,') == 1
    assert page.stat().st_size < 500_000


def test_equal_figures_give_equal_bytes_and_none_gives_the_page_as_it_was(
    transition, tmp_path
):
    folders = [tmp_path / name for name in ("once", "again", "without")]
    extra = [[("Ours", _figure(3), "")], [("Ours", _figure(3), "")], []]

    once, again, without = (
        gaitsweep.report(transition, folder, extra=each).read_bytes()
        for folder, each in zip(folders, extra, strict=True)
    )

    assert once == again and b"extra-1" not in without


@pytest.mark.parametrize(
    ("extra", "said"),
    [
        ([("Ours", Figure())], "`extra` 1 must be (title, figure, caption); got"),
        ([("Ours", "fig.png", "")], "`extra` 1 must be with a figure of matplotlib"),
        ([(1, Figure(), "")], "`extra` 1 must be with a title and a caption in words"),
    ],
)
def test_what_is_no_figure_is_refused_in_a_line(transition, tmp_path, extra, said):
    with pytest.raises(StudyError) as refused:
        gaitsweep.report(transition, tmp_path, extra=extra)

    assert str(refused.value).startswith(said)
    assert not [*tmp_path.iterdir()]


def test_figures_for_several_pages_are_refused(archives, tmp_path):
    with pytest.raises(StudyError, match="the page of one archive; got 5 archives"):
        gaitsweep.report(archives, tmp_path, extra=[("Ours", Figure(), "")])
