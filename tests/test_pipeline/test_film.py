"""Films and strips of gaits, and of what falls."""

import numpy as np
import pytest
from matplotlib.figure import Figure
from PIL import Image

from gaitsweep import gaits, simulate
from gaitsweep.pipeline import paths
from gaitsweep.pipeline.cli import commands
from gaitsweep.pipeline.report.figures import film
from gaitsweep.pipeline.report.figures.body import Body

GAIT = ["--walker", "physical", "--slope", "0.036"]


def _run(*words):
    return commands.main(["film", *map(str, words)])


@pytest.mark.parametrize("ending", ["webp", "png", "gif"])
def test_a_film_lasts_as_long_as_its_steps(tmp_path, ending):
    assert _run(tmp_path / f"a.{ending}", *GAIT, "--steps", "1", "--slow", "1") == 0
    with Image.open(tmp_path / f"a.{ending}") as picture:
        frames = [np.asarray(picture.convert("RGB"), int)]
        for k in range(1, picture.n_frames):
            picture.seek(k)
            frames.append(np.asarray(picture.convert("RGB"), int))
    assert len(frames) == 20  # 0.757 s, 25 a second
    dark = [
        (frame.max(axis=2) < 100).sum() for frame in frames
    ]  # the thin leg is drawn in each
    blue = [(frame[..., 2] - frame[..., 0] > 80).sum() for frame in frames]
    assert (
        min(blue) > 300
        and min(dark) > 100
        and np.abs(frames[0] - frames[10]).mean() > 1
    )


def test_poses_join_from_step_to_step_and_advance_by_the_step_length():
    found = gaits("physical", 0.036).isel(gait=0)
    state = [
        float(found[name]) for name in ("stance_angle", "stance_rate", "thigh_rate")
    ]
    motion, body = (
        simulate("physical", 0.036, state, 3, motion=True),
        Body.of(found.attrs),
    )
    period, angle = float(found["period"]), state[0]
    at = np.array(
        [0.0, period * (1 - 1e-9), period * (1 + 1e-9), 2 * period * (1 + 1e-9)]
    )
    first, before, after, second = film.poses(motion, body, at)
    length = 2 * (body.length * np.sin(angle) + body.radius * angle)
    assert after.hip == pytest.approx(before.hip, abs=1e-6) and (
        before.step,
        after.step,
    ) == (0, 1)
    assert after.foot - first.foot == pytest.approx(length, rel=1e-6)
    assert second.hip - first.hip == pytest.approx(2 * length, rel=1e-6)
    assert after.stance == pytest.approx(
        before.thigh, abs=1e-6
    )  # the legs change places


def test_the_leg_that_stands_first_is_heavy_in_every_step():
    found = gaits("D", 0.009).sel(gait="long")
    drawn, body = [], Body.of(found.attrs)
    for step, stance in ((0, 0.2), (1, 0.2)):
        axes = film.stage(Figure(), body, 0.0, (-1, 1), (-1, 1))
        film.draw(
            axes,
            body,
            film.Pose(complex(body.hip(stance)), 0.0, stance, -stance, -stance, step),
            0.0,
        )
        heavy = max(axes.lines, key=lambda line: line.get_linewidth())
        drawn.append(heavy.get_xdata()[-1] < heavy.get_xdata()[0])
    # Seen from the hip the first leg stands to the right; a step later it is the one
    # that swings, to the left.
    assert drawn == [False, True]


def test_a_film_of_a_fall_ends_on_the_ground_and_says_so(tmp_path, capsys):
    push = [
        "--walker",
        "D",
        "--slope",
        "0.009",
        "--push",
        "0.6",
        "--steps",
        "6",
        "--slow",
        "0.5",
    ]
    assert _run(tmp_path / "fall.gif", *push) == 0
    assert "fell forward" in capsys.readouterr().err
    with Image.open(tmp_path / "fall.gif") as picture:
        assert picture.n_frames > 10
    heights = [pose.hip.imag for pose in _fallen()]
    assert heights[-1] <= 0 < heights[-2] and len(heights) < 500


def _fallen():
    found = gaits("D", 0.009).sel(gait="long")
    state = [
        float(found[name]) for name in ("stance_angle", "stance_rate", "thigh_rate")
    ]
    motion = simulate(
        "D", 0.009, state, 6, motion=True, pushes={0: [0.6 * state[1]] * 2}
    )
    return film.poses(
        motion, Body.of(found.attrs), np.linspace(0, film.lengths(motion).sum(), 500)
    )


def test_a_strip_is_a_picture_that_is_the_same_each_time(tmp_path):
    for name in ("a.svg", "b.svg"):
        assert _run(tmp_path / name, *GAIT, "--strip") == 0
    text = (tmp_path / "a.svg").read_text()
    assert text == (tmp_path / "b.svg").read_text() and text.count("<path") > 20


@pytest.mark.parametrize(
    ("words", "code", "said"),
    [
        (["x.mp4", *GAIT], 2, "must end in .webp, .png, .gif; got 'x.mp4'"),
        (["x.webp", *GAIT, "--strip"], 2, "must end in .svg, .pdf, .png"),
        (
            ["x.webp", "--walker", "physical", "--slope", "0.001"],
            1,
            "No long gait: none below 0.0191229 rad.",
        ),
        (
            ["x.webp", "--walker", "physical", "--slope", "2"],
            2,
            "degrees? 2 degrees are 0.0349066 rad.",
        ),
        (
            ["x.webp", *GAIT, "--gait", "short"],
            1,
            "No short gait: none between 0.0223799 and 0.036387 rad.",
        ),
        (
            ["x.webp", *GAIT, "--steps", "51"],
            2,
            "`--steps` must lie in [1, 50]; got 51.",
        ),
        (
            ["x.webp", *GAIT, "--push", "nan"],
            2,
            "`--push` must lie in [-10, 10]; got nan.",
        ),
        (
            ["x.webp", *GAIT, "--slow", "90"],
            2,
            "more than 1,000: show fewer steps, or faster.",
        ),
        (["no/x.webp", *GAIT, "--steps", "1"], 2, "cannot be written"),
    ],
)
def test_what_cannot_be_filmed_is_said_in_a_line_and_leaves_no_file(
    tmp_path, monkeypatch, capsys, words, code, said
):
    monkeypatch.chdir(tmp_path)
    assert _run(*words) == code
    error = capsys.readouterr().err
    assert said in error and error.count("\n") == 1
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    "words",
    [
        ["a.webp"],
        ["a.svg", "--strip"],
        pytest.param(["a.gif"], marks=pytest.mark.thorough),
        pytest.param(["a.png"], marks=pytest.mark.thorough),
        pytest.param(["a.png", "--strip"], marks=pytest.mark.thorough),
        pytest.param(["a.pdf", "--strip"], marks=pytest.mark.thorough),
    ],
)
def test_a_film_replaces_nothing_but_an_earlier_one(tmp_path, capsys, words):
    path = tmp_path / words[0]
    arguments = [path, *words[1:], *GAIT, "--steps", "1", "--slow", "0.3"]
    assert _run(*arguments) == 0
    paths.check_own(path, b"", film.MARK.encode())  # it may be made anew

    if path.suffix in (".webp", ".gif", ".png"):
        Image.new("RGB", (640, 320)).save(path)
    else:
        Figure().savefig(path)
    foreign = path.read_bytes()

    assert _run(*arguments) == 2
    assert path.read_bytes() == foreign
    said = f"gaitsweep: {path} is not a file of gaitsweep; move it away.\n"
    assert capsys.readouterr().err == said
