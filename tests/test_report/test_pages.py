import json
import os
import re
import signal
import subprocess
import sys
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from unittest.mock import Mock

import netCDF4
import numpy as np
import pandas as pd
import pytest

from gaitsweep.pipeline import paths
from gaitsweep.pipeline.archive import read as archive_reader
from gaitsweep.pipeline.archive.citation import PAPER
from gaitsweep.pipeline.errors import ArchiveError
from gaitsweep.pipeline.outcomes import count
from gaitsweep.pipeline.report import entry, folder, html_tables, ledger, pages, source
from gaitsweep.pipeline.report.figures.style import NARROW_SMALL_WORDS, NARROW_WORDS
from gaitsweep.pipeline.report.source import read
from gaitsweep.pipeline.report.time_to_go import TimeToGo, work
from gaitsweep.pipeline.report.words import plain, typeset
from gaitsweep.pipeline.statuses import STATUS_NAMES
from processes import on_a_terminal
from test_report import synthetic
from test_report.reading import Page, numbers_in
from test_report.shape import GAITS, KNEED, POINT, write, write_record

ROOT = Path(__file__).parents[2]
INDEX_BYTES, PAGE_BYTES = 300_000, 500_000


def test_there_is_a_page_for_each_study_an_index_and_a_ledger(report):
    names = {path.stem for path in report.glob("*.html")}
    assert names == {
        "index",
        "ledger",
        "transition",
        "tuned-walkers",
        "detuning",
        "cascade",
        "design",
    }


def test_words_of_narrow_pages_have_the_sizes_that_figures_are_laid_out_for():
    style = pages._style()

    assert f"--narrow-words: {NARROW_WORDS}px" in style
    assert f"--narrow-small-words: {NARROW_SMALL_WORDS}px" in style
    narrow = style.partition("(max-width: 27rem)")[2].partition("\n")[0]
    assert set(re.findall(r"font-size: ([^ ;]+)", narrow)) == {
        "var(--narrow-words)",
        "var(--narrow-small-words)",
    }


def test_every_link_resolves(report):
    pages = {path.name: Page(path) for path in report.glob("*.html")}
    for name, found in pages.items():
        for link in found.all("href"):
            file, _, anchor = link.partition("#")
            if link.startswith("data:") or (
                file == "" and re.fullmatch(r"m\w+|image\w+", anchor)
            ):
                continue
            assert (report / (file or name)).is_file(), f"{name}: {link}"
            if anchor:
                assert anchor in pages[file or name].all("id"), f"{name}: {link}"


def test_pages_hold_to_their_budgets_and_name_no_outside_address(report):
    for path in report.glob("*.html"):
        text = path.read_text()
        assert len(text.encode()) < (
            INDEX_BYTES if path.name == "index.html" else PAGE_BYTES
        )
        assert not re.search(r"https?:|//[a-z0-9-]+\.[a-z]|@import|url\((?!#)", text), (
            path.name
        )


@pytest.mark.parametrize(
    ("line", "option"),
    [("", " --accuracy 1.23456789e-06"), ("accuracy = 1.23456789e-6\n", "")],
)
def test_the_commands_of_a_page_make_its_archive(tmp_path, line, option):
    """One that was run to an accuracy and has another name than its study since."""
    text = f'name = "sweep"\n{line}walker = "D"\n[axes]\nslope = [0.01]\n'
    path = write(
        tmp_path / "moved.nc",
        text,
        {"stance_angle": ("slope", [0.2])},
        {"slope": [0.01]},
        {"D": POINT},
    )
    with netCDF4.Dataset(path, "a") as file:
        file.accuracy = 1.23456789e-6
    pages.write([path], tmp_path)
    commands = f"gaitsweep run sweep.toml{option}\ngaitsweep report data/archive/sweep.nc</code>"
    assert commands in (tmp_path / "sweep.html").read_text()


def test_an_index_of_many_studies_and_a_map_of_ninety_thousand_points_stay_small(
    tmp_path,
):
    small, big = synthetic.tuned(tmp_path), synthetic.design(tmp_path, 300)
    index = pages.write([*[small] * 6, big], tmp_path / "out")
    assert index.stat().st_size < INDEX_BYTES
    assert (tmp_path / "out" / "tuned-walkers-6.html").is_file()
    assert (tmp_path / "out" / "design.html").stat().st_size < PAGE_BYTES


def test_a_line_of_many_slopes_is_thinned(tmp_path):
    archive = synthetic.transition(tmp_path, slopes=50_000)
    pages.write([archive], tmp_path / "out")
    assert (tmp_path / "out" / "transition.html").stat().st_size < PAGE_BYTES
    assert len(pd.read_csv(tmp_path / "out" / "csv" / "transition-loglog.csv")) < 5000


def test_every_number_of_a_table_is_in_an_archive(report, archives):
    known = np.array(sorted(set().union(*(numbers_in(path) for path in archives))))
    parameters = {
        float(v) for w in (POINT, KNEED) for v in w.values() if isinstance(v, float)
    } | {0.0, 0.5, 0.2}
    count = 0
    for path in report.glob("*.html"):
        for number in Page(path).numbers:
            assert number in known or number in parameters, f"{path.name}: {number}"
            count += 1
    assert count > 200


def test_every_figure_has_its_data_beside_it(report, archives):
    known = set().union(*(numbers_in(path) for path in archives))
    linked = [
        link
        for path in report.glob("*.html")
        for link in Page(path).all("href")
        if link.endswith(".csv")
    ]
    assert len(linked) > 12
    for link in linked:
        assert len(pd.read_csv(report / link)), link
    drawn = pd.read_csv(report / "csv" / "transition-loglog.csv", dtype=str)
    assert set(drawn["stance_angle (rad)"].astype(float)) <= known
    assert set(drawn["gait"]) == {"long", "short"}


def test_every_value_under_the_pointer_is_in_an_archive(report, archives):
    known = {plain(number, 7) for path in archives for number in numbers_in(path)} | {
        "yes",
        "no",
        "–",
    }
    derived = (
        "residual (%)",
        "time",
        "claim",
        "verdict",
    )  # a ratio of archived numbers; the second step's times
    count = 0
    for path in report.glob("*.html"):
        for series in re.findall(
            r'<script type="application/json" class="marks">(.*?)</script>',
            path.read_text(),
        ):
            for one in json.loads(series):
                kept = [
                    k
                    for k, name in enumerate(one["names"])
                    if name not in (*derived, "outcome", "kind")
                ]
                for row in one["rows"]:
                    values = [row[3 + k] for k in kept]
                    assert (
                        one["label"].endswith(("thigh", "shank", "hip"))
                        or set(values) <= known
                    ), (path.name, one)
                    count += len(values)
    assert count > 1000


def test_tables_of_results_are_on_the_page_of_their_study(tmp_path):
    figure10 = {
        "walker": ["D", "C"],
        "description": ["simplest", "kneed"],
        "zero_slope_capable": [1, 1],
        "short_angle_vanishing": [0.3331, 0.9993],
        "faster_larger": ["short", "long"],
    }
    tables = {
        "figure10": figure10,
        "figure9": {"walker": ["D", "C"], "l_t": [0.5, 0.35]},
        "accumulation": {"family": ["1"], "slope": [0.0190401]},
        "limits": {"slope": np.linspace(0.01, 0.02, 30), "cause": ["no more"] * 30},
    }
    text = '# Section 7: doublings\n# and falls.\nname = "figure7-more"\nwalker = ["D", "C"]'
    status = {"status": ((), np.int8(0)), "reason": ((), np.int16(0))}
    pages.write(
        [write(tmp_path / "a.nc", text, status, {}, {"D": POINT, "C": KNEED}, tables)],
        tmp_path,
    )
    found, source = (
        Page(tmp_path / "figure7-more.html"),
        (tmp_path / "figure7-more.html").read_text(),
    )
    assert (
        "Figure 7 more".lower() in found.text.lower()
        and "Section 7: doublings and falls." in found.text
    )
    assert {0.3331, 0.9993, 0.35, 0.0190401} <= set(found.numbers)
    for words in (
        "short step, p of θ* ∝ γᵖ: γ vanishing",
        "faster step: γ larger",
        "Accumulation points of the period doublings",
    ):
        assert words in found.text
    assert "<summary>limits</summary>" in source and found.text.count("no more") == 30
    assert ">l_t<" in source and "Solver: 1 of 1 curve complete" in found.text
    assert "Section 7: doublings and falls." in Page(tmp_path / "index.html").text


def test_the_walkers_table_is_whole_and_tells_what_varies(tmp_path):
    names = [f"walker-{i}" for i in range(11)]
    text = f'name = "s"\nwalker = {json.dumps(names)}\n[axes]\nslope = [0.01]\nR = [0.15, 0.3]\nm_h = [2.5]\n'
    status = {"status": ((), np.int8(0)), "reason": ((), np.int16(0))}
    coords = {
        "R": np.array([0.15, 0.3]),
        "m_h": np.array([2.5]),
        "detuning": np.array([0.0, 0.1, 0.2, 0.3, 1.0]),
    }
    varied = {"R": "R", "m_h": "m_h", "w_t": "detuning", "r_t": "detuning"}
    made = write(
        tmp_path / "s.nc",
        text,
        status,
        coords,
        dict.fromkeys(names, KNEED),
        varied=varied,
    )
    table = html_tables.walkers(read(made))
    assert table.heads == ["key", "meaning", *names]
    rows = {row[0].text: {cell.text for cell in row[2:]} for row in table.rows}
    assert (
        rows["R"] == {"0.15, 0.3"}
        and rows["m_h"] == {"2.5"}
        and rows["c_t"] == {"0.084"}
    )
    assert rows["w_t"] == rows["r_t"] == {"by detuning"} and rows["detuning"] == {
        "0 … 1 (5 values)"
    }
    pages.write([made], tmp_path)
    assert all(name in Page(tmp_path / "s.html").text for name in names)


def test_the_walkers_table_says_what_each_key_means(report, archives):
    for archive in archives:
        table = html_tables.walkers(read(archive))
        meanings = {row[0].text: row[1].text for row in table.rows}
        assert meanings["w_t"] == "mass behind the thigh" and meanings["knees"] == ""


def test_numbered_figures_come_first_and_in_order(tmp_path):
    def study(name, angle=True):
        grid = (
            {"stance_angle": (("slope", "gait"), np.full((2, 1), 0.2))} if angle else {}
        )
        text = f'name = "{name}"\nwalker = "D"\n[want]\nfigures = ["linear"]'
        coords = {"slope": [0.01, 0.02], "gait": np.array(["long"], object)}
        return write(tmp_path / f"{name}.nc", text, grid, coords, {"D": POINT})

    pages.write(
        [study("bowl"), study("figure11"), study("ledger-x", False), study("figure3")],
        tmp_path,
    )
    text = Page(tmp_path / "index.html").text
    places = [
        text.index(word) for word in ("figure 3", "figure 11", "bowl", "ledger x")
    ]
    assert places == sorted(places)


@pytest.mark.parametrize(
    ("walker", "command"),
    [
        ('{ base = "E", R = 0.2 }', "gaitsweep solve --walker E --set R=0.2"),
        ('{ base = "C", knees = false }', "gaitsweep solve --walker s.toml"),
        ("{ l_t = 0.5 }", "gaitsweep solve --walker s.toml"),
        ('"mine.toml"', "gaitsweep solve --walker mine.toml"),
    ],
)
def test_the_command_under_the_pointer_can_be_typed(tmp_path, walker, command):
    status = {"status": ((), np.int8(0)), "reason": ((), np.int16(0))}
    archive = write(
        tmp_path / "s.nc", f'name = "s"\nwalker = {walker}', status, {}, {"w": POINT}
    )
    assert read(archive).command({"walker": "w"}) == command


def test_the_same_archives_give_the_same_bytes(report, archives, tmp_path):
    assert _files(pages.write(archives, tmp_path).parent) == _files(report)


@pytest.mark.parametrize("trouble", ["none", "killed"])
def test_pages_made_in_one_process_or_several_have_the_same_bytes(
    report, archives, tmp_path, monkeypatch, trouble
):
    """Processes that are killed are done without; every page made is told."""
    told = []
    if trouble == "killed":
        monkeypatch.setattr(pages, "_delivered", _die)

    pages.write(archives, tmp_path, tell=lambda *said: told.append(said))

    made, left = zip(*told, strict=True)
    assert made == (*range(len(archives) + 1),)
    assert np.isnan(left[0]) and min(left[1:-1]) > 0 and left[-1] == 0
    assert _files(tmp_path) == _files(report)


def test_processes_that_make_pages_do_not_load_dask(monkeypatch):
    seen = []
    monkeypatch.delitem(sys.modules, "dask.array", raising=False)
    monkeypatch.setattr(
        pages, "_timed", lambda *_: seen.append(sys.modules["dask.array"])
    )

    pages._delivered(Mock(), "a")

    assert seen == [None]
    assert "dask.array" not in sys.modules


def _die(*_):
    os.kill(os.getpid(), signal.SIGKILL)


def _folders(folder):
    """Folders in which there are files, but for what runs keep."""
    found = {path.parent for path in folder.rglob("*") if path.is_file()}
    return found - {folder / ".gaitsweep"}


def _files(folder):
    """Every file of a report, by its place."""
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in folder.rglob("*")
        if path.is_file()
    }


#: `gaitsweep` with little more memory than its modules take: to import them without it
#: may never end.
_LITTLE_MEMORY = """
import re, resource, sys
import gaitsweep.pipeline.report.pages
from gaitsweep.pipeline.cli import commands
from gaitsweep.pipeline.cli import report as report_command
used = int(re.search(r"VmData:\\s+(\\d+)", open("/proc/self/status").read())[1]) << 10
resource.setrlimit(resource.RLIMIT_DATA, (used + (8 << 20),) * 2)
sys.exit(commands.main(sys.argv[1:]))
"""


def _command(archives, folder, program=("-m", "gaitsweep"), **environment):
    """What `gaitsweep report` returns and prints to standard error, in a process of its
    own.
    """
    done = subprocess.run(
        [sys.executable, "-P", *program, "report", *map(str, archives), "-o", str(folder / "out")],
        cwd=folder, env={**os.environ, "PYTHONPATH": str(ROOT), **environment},
        capture_output=True, text=True, timeout=100,
    )  # fmt: skip
    return done.returncode, done.stderr


def test_a_report_depends_on_no_setting_of_the_reader(report, archives, tmp_path):
    """Matplotlib reads its own settings while it is imported, and like NumPy a date."""
    (tmp_path / "matplotlibrc").write_bytes(bytes(range(128, 256)))
    settings = {
        "MPLBACKEND": "nonsense",
        "MATPLOTLIBRC": str(tmp_path / "matplotlibrc"),
        "SOURCE_DATE_EPOCH": "x",
    }
    assert _command(archives, tmp_path, **settings) == (0, "")
    assert _files(tmp_path / "out") == _files(report)


def test_a_report_without_the_memory_for_it_says_so_in_a_line(archives, tmp_path):
    """Its processes, too, have none: it waited for them without end."""
    code, said = _command(archives, tmp_path, ["-c", _LITTLE_MEMORY])
    assert code
    if (
        code != -signal.SIGABRT
    ):  # by which the netCDF library ends where it gets no memory
        # Python may complain before of objects that it could not free, and lack the
        # memory to end its line.
        assert "gaitsweep: " in said.splitlines()[-1] and "Internal error" not in said


@pytest.mark.parametrize("step", ["opened", "read"])
def test_an_archive_that_is_read_without_memory_is_not_damaged(
    archives, monkeypatch, step
):
    """The netCDF library speaks of an HDF error, whatever the cause."""
    failure = Mock(side_effect=RuntimeError("NetCDF: HDF error"))
    monkeypatch.setattr(archive_reader, "_LITTLE_MEMORY", 1 << 50)
    if step == "opened":
        monkeypatch.setattr(
            archive_reader, "open_netcdf", lambda *_: Mock(__enter__=failure)
        )
    with pytest.raises(MemoryError), archive_reader.open_archive(archives[0]):
        failure()


def test_the_pages_of_a_long_report_are_counted_on_a_terminal(archives, tmp_path):
    arguments = ["report", *map(str, archives), "-o", str(tmp_path)]

    code, said = on_a_terminal(arguments, tmp_path)

    assert code == 0
    assert re.search(rf"[1-9]\d*/{len(archives)} pages \[[^]]* to go\]", said)


def test_the_time_to_go_of_a_report_is_that_of_the_work_that_is_left():
    works = {"large": 6.0, "small": 1.0, "other": 1.0, "last": 2.0}
    to_go = TimeToGo(works, processes=2)
    assert np.isnan(to_go.seconds)

    to_go.count("large", 12.0)
    to_go.count("small", 2.0)

    assert to_go.seconds == pytest.approx(2.0 * (1.0 + 2.0) / 2)


def test_pages_of_more_figures_or_more_numbers_are_more_work(archives):
    given = read(archives[0])
    numbers = pd.DataFrame(np.zeros((1000, 1600)))
    names = [*given.figures, "linear", "loglog"]

    larger = replace(given, tables={**given.tables, "more": numbers})
    longer = replace(given, study={**given.study, "want": {"figures": names}})

    assert work(larger) == pytest.approx(work(given) + 2.0)
    assert work(longer) == pytest.approx(work(given) + 2.0)


def test_what_reads_archives_first_leaves_time_for_something_else(archives):
    seen = []

    archive_reader.probe(archives, meanwhile=lambda: seen.append(_children()))

    assert len(seen) == 1 and seen[0] > _children()


def _children():
    """How many processes this one has."""
    listed = Path(f"/proc/self/task/{os.getpid()}/children").read_text()
    return len(listed.split())


def test_drafts_of_a_report_that_was_killed_are_removed_by_the_next(
    archives, tmp_path, monkeypatch
):
    """And no file of somebody else, as the draft of an archive in the same folder."""
    gone = [
        paths.of(tmp_path / name, folder._DRAFT) for name in ("x.html", "csv/x.csv")
    ]
    others = [
        paths.of(tmp_path / "x.nc", "0" * 32),
        tmp_path / ".x.html.5",
        tmp_path / f"x.html.{folder._DRAFT}",
    ]
    (tmp_path / "csv").mkdir()
    for file in (*gone, *others):
        file.write_text("")
    monkeypatch.setattr(
        os,
        "replace",
        Mock(side_effect=PermissionError(13, "Permission denied", "draft")),
    )
    with pytest.raises(PermissionError) as refused:
        pages.write(archives[:1], tmp_path)
    assert (
        refused.value.filename.startswith(str(tmp_path / ""))
        and ".csv" in refused.value.filename
    )
    assert set(tmp_path.iterdir()) == {*others, tmp_path / "csv"} and not list(
        (tmp_path / "csv").iterdir()
    )


def test_a_report_adds_to_the_pages_already_there(report, archives, tmp_path):
    """One archive after the other, in any order, gives what all of them give at once."""
    for archive in reversed(archives):
        index = pages.write([archive], tmp_path).parent / "index.html"
    assert _files(tmp_path) == _files(report)
    pages.write([], tmp_path)
    assert index.read_bytes() == (report / "index.html").read_bytes()


def _small(folder, name, figures=("linear",)):
    grid = {"stance_angle": (("slope", "gait"), np.full((2, 1), 0.2))}
    text = f'name = "{name}"\nwalker = "D"\n[want]\nfigures = {json.dumps(figures)}'
    coords = {"slope": [0.01, 0.02], "gait": np.array(["long"], object)}
    claims = {
        "id": [f"D{len(name)}"],
        "printed": ["1"],
        "verdict": ["reproduced"],
        "figure": [f"{name}/linear"],
    }
    return write(
        folder / f"{name}.nc", text, grid, coords, {"D": POINT}, {"claims": claims}
    )


def test_only_leaves_nothing_else_of_a_report_and_all_that_is_none(tmp_path):
    (tmp_path / "bench.html").write_text("<p>Not of a report.</p>")
    (tmp_path / "one-notes.csv").write_text("mine")
    for name in ("one", "three"):
        pages.write([_small(tmp_path, name)], tmp_path)
    ledger = Page(tmp_path / "ledger.html")
    assert {"D3", "D5"} <= set(ledger.all("id")) and "one.html#linear" in ledger.all(
        "href"
    )
    pages.write([tmp_path / "three.nc"], tmp_path, only=True)
    assert {name for name in _files(tmp_path) if not name.endswith(".nc")} == {
        "index.html",
        "ledger.html",
        "csv/ledger.csv",
        "three.html",
        "csv/three-linear.csv",
        "bench.html",
        "one-notes.csv",
    }
    assert "D3" not in Page(tmp_path / "ledger.html").all("id")
    assert "one.html" not in Page(tmp_path / "index.html").all("href")


def test_a_page_written_again_leaves_no_data_of_the_old_one(tmp_path):
    pages.write([_small(tmp_path, "s", ("loglog",))], tmp_path)
    assert (tmp_path / "csv" / "s-loglog.csv").is_file()
    pages.write([_small(tmp_path, "s")], tmp_path)
    assert (
        not (tmp_path / "csv" / "s-loglog.csv").exists()
        and (tmp_path / "csv" / "s-linear.csv").is_file()
    )
    # A card, beside the page, and among what a search finds.
    index = (tmp_path / "index.html").read_text()
    assert index.count('<a href="s.html">') == 3


def test_figures_with_the_same_data_share_a_file(tmp_path):
    pages.write([_small(tmp_path, "s", ("linear", "loglog"))], tmp_path)
    assert [path.name for path in (tmp_path / "csv").glob("s-*")] == ["s-linear.csv"]
    assert Page(tmp_path / "s.html").all("href").count("csv/s-linear.csv") == 2


def test_a_page_that_lies_about_itself_takes_nothing_away(tmp_path):
    (tmp_path / "precious.csv").write_text("mine")
    pages.write([_small(tmp_path, "s")], tmp_path)
    text = (tmp_path / "s.html").read_text()
    lie = text.replace(
        '"files":["csv/s-linear.csv"]', '"files":["precious.csv","../s.nc"]'
    )
    assert lie != text
    (tmp_path / "s.html").write_text(lie)
    (tmp_path / "torn.html").write_text(text.replace('"slug":"s"', '"slug":3'))
    pages.write([_small(tmp_path, "t")], tmp_path / ".", only=True)
    assert (tmp_path / "precious.csv").is_file() and (tmp_path / "torn.html").is_file()
    assert not (tmp_path / "s.html").exists()


def test_an_entry_is_read_from_the_head_of_a_page_and_from_nothing_else(report):
    page = (report / "transition.html").read_text()
    (found,) = entry.read(page)
    assert found.slug == "transition" and found.thumbnail.startswith("<svg")
    head, _, rest = page.partition("</head>")
    for other in (
        "",
        rest,
        head.replace('id="entry"', 'id="exit"'),
        head.replace('"slug"', '"slag"'),
    ):
        assert entry.read(other) == []
    assert entry.read('<script id="entry">' + "[" * 100_000 + "</script>") == []


def test_every_page_names_the_paper(report):
    for path in report.glob("*.html"):
        assert PAPER in " ".join(Page(path).text.split()), path.name


def test_figures_have_alt_text_and_follow_the_pages_colours(report):
    for path in report.glob("*.html"):
        pictures = [
            about
            for tag, about in Page(path).elements
            if about.get("class") == "picture"
        ]
        assert all(
            about.get("role") == "img" and len(about["aria-label"]) > 30
            for about in pictures
        )
        drawn = "".join(re.findall(r"<svg viewBox.*?</svg>", path.read_text(), re.S))
        fixed = set(re.findall(r"(?:stroke|fill): (#[0-9a-f]{6})", drawn))
        assert fixed <= {
            "#ffffff",
            "#101418",
            "#3c8fd6",
            "#e0691f",
            "#8d9399",
            "#8fa3b8",
            "#b59a85",
            "#6c8f6c",
        }, path.name


def test_an_archive_cannot_put_anything_into_a_page(tmp_path):
    bad = "<script>alert(1)</script><img src=x onerror=alert(2)>\"' $x^{ =HYPERLINK(1)"
    slope = np.array([0.01, 0.02])
    dims = ("walker", "slope", "gait")
    angle = np.full((2, 2, 2), 0.2) * np.array([1, 1.1])
    study = {"name": "../../" + bad, "walker": [bad, "]]></svg>" + bad]}
    text = (
        f"name = {json.dumps(study['name'])}\nwalker = {json.dumps(study['walker'])}\n[axes]\nslope = [0.01]\n"
        f"[want]\nfigures = ['loglog', 'walker', {json.dumps(bad)}]\n"
    )
    grid = {"stance_angle": (dims, angle), "status": (dims, np.full(angle.shape, 2, "i1")),
            "reason": (dims, np.full(angle.shape, 2, "i2"))}  # fmt: skip
    claims = {
        k: ["=1+1 " + bad]
        for k in ("id", "printed", "source", "computed", "verdict", "figure", "command")
    }
    trace = synthetic.simplest_trace(bad, {})
    coords = {
        "walker": np.array(study["walker"], object),
        "slope": slope,
        "gait": np.array(["long", bad], object),
    }
    tables = {"claims": claims, "trace": trace}
    archive = write(
        tmp_path / "bad.nc",
        text,
        grid,
        coords,
        {bad: POINT, "b": KNEED},
        tables,
        {bad: bad},
    )
    out = pages.write([archive], tmp_path / "out").parent
    assert _folders(tmp_path) == {tmp_path, out, out / "csv"}
    for path in out.glob("*.html"):
        found = Page(path)
        allowed = [
            about.get("type") for tag, about in found.elements if tag == "script"
        ]
        assert allowed.count(None) == 1
        assert set(allowed) <= {None, "application/json"}
        assert not [tag for tag, _ in found.elements if tag == "img"]
        assert not [
            a for _, about in found.elements for a in about if a.startswith("on")
        ]
        assert not [
            link for link in found.all("href") if link.lower().startswith("javascript")
        ]
    for path in out.glob("csv/*.csv"):
        assert not re.search(r"(^|,)\"?[=@]", path.read_text(), re.M), path.name


def test_a_page_names_what_the_archive_lacks(report):
    assert "there is no figure of that name" in Page(report / "cascade.html").text


def test_failed_points_are_listed_with_their_reason(report):
    text = Page(report / "transition.html").text
    assert "The worker died by signal 11." in text
    absent = pd.read_csv(report / "csv" / "transition-absent.csv")
    assert set(absent["status"]) == {"no_gait", "not_converged", "worker_died"}


def test_a_page_tells_the_run_time_and_not_the_machine(report):
    text = Page(report / "transition.html").text
    assert "0.25 s CPU, 2 workers" in text and "secret-host" not in text
    assert "secret-host" not in text


def test_the_csv_file_of_a_large_study_has_the_failures_first_and_is_counted(tmp_path):
    n, dims = 21_000, ("slope", "gait")
    status = np.ones((n, 1), "i1")
    text = 'name = "large"\nwalker = "E"\n[axes]\nslope = { from = 0.01, to = 0.02, n = 21_000 }'
    coords = {"slope": np.linspace(0.01, 0.02, n), "gait": np.array(["long"], object)}
    for failed, note in (
        (100, "40 more are in the CSV file."),
        (n, "19940 more are in the CSV file. 1000 others"),
    ):
        status[n - failed :] = 2
        grid = {"status": (dims, status), "reason": (dims, status.astype("i2"))}
        pages.write(
            [write(tmp_path / "large.nc", text, grid, coords, {"E": POINT})], tmp_path
        )
        listed = pd.read_csv(tmp_path / "csv" / "large-absent.csv")
        assert (
            len(listed) == 20_000
            and (listed["status"][:failed] == "not_converged").all()
        )
        page = Page(tmp_path / "large.html").text
        assert note in page and "lists 20\u202f000 of the 21\u202f000 points" in page


def test_data_of_more_rows_than_a_spreadsheet_reads_well_is_left_to_the_archive(
    tmp_path, monkeypatch
):
    monkeypatch.setattr(html_tables, "MAX_LISTED", 1)
    pages.write([_small(tmp_path, "long")], tmp_path / "out")
    assert not (tmp_path / "out" / "csv" / "long-linear.csv").exists()
    assert "Its 2 rows are in the archive." in Page(tmp_path / "out" / "long.html").text


def test_each_point_may_have_its_own_reason(archives):
    n = 40_000
    words = np.array([f"Reason {i}." for i in range(n)], object)
    reasons = html_tables._decode(np.arange(n), words)
    assert (reasons == words).all()
    whole = read(archives[0])
    absent = pd.DataFrame({"status": pd.Categorical(["raised"] * n), "reason": reasons})
    table = html_tables.outcomes(whole, absent)
    assert 100 < len(table.rows) < 1000
    named = sum(row[0].text == "raised" for row in table.rows)
    assert table.note == f"{n - named} more reasons are in the archive."


def test_an_archive_of_another_ending_has_the_record_beside_it_and_not_that_of_its_stem(
    tmp_path,
):
    archive = write(tmp_path / "a.v2", 'name = "a"', {}, {}, {})
    for name, jobs in (("a.nc", 1), ("a.v2", 2)):
        write_record(tmp_path / name, {"jobs": jobs})
    assert read(archive).run == {"jobs": 2}


def test_the_ledger_links_each_claim_to_its_figure(report):
    ledger = Page(report / "ledger.html")
    assert {"E2", "E3", "E4", "Z5"} <= set(ledger.all("id"))
    assert "transition.html#transition_ladder" in ledger.all("href")
    assert "2 not reproduced" in ledger.text


def test_a_study_without_points_or_run_record_still_has_a_page(tmp_path):
    archive = write(
        tmp_path / "a.nc",
        'name = "a"',
        {"status": ((), np.int8(0)), "reason": ((), np.int16(0))},
        {},
        {},
    )
    assert pages.write([archive], tmp_path).is_file()
    assert "Solver: 1 of 1 curve complete" in Page(tmp_path / "a.html").text


def test_no_archive_gives_an_index_that_says_so(tmp_path):
    assert "No archives were given." in Page(pages.write([], tmp_path)).text


@pytest.mark.parametrize("content", [b"", b"not netCDF", None])
def test_a_foreign_file_is_named(tmp_path, content):
    path = tmp_path / "foreign.nc"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(ArchiveError, match=r"foreign\.nc"):
        pages.write([path], tmp_path / "out")


def test_the_report_loads_neither_the_tasks_nor_the_plan():
    program = "import gaitsweep.pipeline.report.pages, sys; "
    program += (
        "print([m for m in sys.modules if 'gaitsweep.tasks' in m or m == 'heyoka']"
    )
    program += " + [m for m in sys.modules if m in ('gaitsweep.pipeline.graph', 'gaitsweep.pipeline.engine')])"
    root = Path(__file__).parents[2]
    done = subprocess.run(
        [sys.executable, "-c", program],
        capture_output=True,
        text=True,
        cwd=root,
        check=True,
    )
    assert done.stdout.strip() == "[]"


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_colours_have_enough_contrast(scheme):
    style = (Path(pages.__file__).parent / "templates" / "report.css").read_text()
    blocks = re.findall(r":root \{(.*?)\}", style, re.S)
    values = dict(re.findall(r"--([\w]+): (#[0-9a-f]{6})", blocks[0]))
    if scheme == "dark":
        values |= dict(re.findall(r"--([\w]+): (#[0-9a-f]{6})", blocks[1]))
    for ground in ("paper", "wash"):
        for words in ("ink", "muted", "link", "bad", *(f"line{k}" for k in range(11))):
            assert _contrast(values[words], values[ground]) >= 4.5, (words, ground)


def test_the_ground_of_pages_is_that_of_figures_which_follow_the_colour_scheme():
    """A reader's own pictures alone, which are images, stand on white."""
    style = (Path(pages.__file__).parent / "templates" / "report.css").read_text()

    white = re.findall(r"([^{}]+)\{[^{}]*background: #fff\b", style)

    assert [selector.strip() for selector in white] == ["img.picture"]


def _contrast(one: str, other: str) -> float:
    """Contrast ratio of two colours (WCAG 2.1)."""

    def luminance(colour: str) -> float:
        parts = [int(colour[i : i + 2], 16) / 255 for i in (1, 3, 5)]
        linear = [
            c / 12.92 if c <= 0.03928 else ((c + 0.055) / 1.055) ** 2.4 for c in parts
        ]
        return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]

    high, low = sorted((luminance(one), luminance(other)), reverse=True)
    return (high + 0.05) / (low + 0.05)


def test_a_large_grid_is_thinned_and_every_outcome_is_counted(tmp_path, monkeypatch):
    archive = synthetic.transition(tmp_path, slopes=3000)
    whole = source.read(archive)
    monkeypatch.setattr(source, "MAX_POINTS", 1000)
    part = source.read(archive)
    assert part.grid.sizes["slope"] * part.grid.sizes["gait"] <= 1000 * 2
    assert np.isin(part.grid.slope, whole.grid.slope).all()
    assert html_tables.statuses(part) == html_tables.statuses(whole)
    assert html_tables.points(part).equals(html_tables.points(whole))


def test_an_absent_number_stands_where_numbers_stand(tmp_path):
    tables = {"limits": {"family": ["1", "–"], "ratio": [np.nan, 4.66]}}
    text = 'name = "gap"\nkind = "cascade"\nwalker = "E"'
    status = {"status": ((), np.int8(0)), "reason": ((), np.int16(0))}
    pages.write(
        [write(tmp_path / "gap.nc", text, status, {}, {"E": POINT}, tables)], tmp_path
    )
    html = (tmp_path / "gap.html").read_text(encoding="utf-8")
    assert (
        '<th scope="col" class="num">ratio' in html and '<td class="num">–</td>' in html
    )
    assert '<th scope="col" class="">family' in html and '<td class="">–</td>' in html


def test_the_slopes_of_converged_gaits_are_those_where_gaits_converged(tmp_path):
    slope = np.array([0.01, 0.02, 0.03, 0.04])
    status = np.array([[[1, 1], [0, 1], [0, 0], [1, 1]]] * 2, "i1")
    dims = ("R", "slope", "gait")
    grid = {
        "stance_angle": (dims, np.where(status, np.nan, 0.1)),
        "status": (dims, status),
        "reason": (dims, status),
    }
    text = 'name = "s"\nwalker = "B"\n[axes]\nslope = [0.01]\n'
    source = read(
        write(
            tmp_path / "s.nc",
            text,
            grid,
            {"R": [0.1, 0.2], "slope": slope, "gait": GAITS},
            {"B": POINT},
        )
    )
    table = html_tables.outcomes(source, html_tables.points(source))
    assert [cell.text for cell in table.rows[0]] == [
        "converged",
        "",
        "6",
        "0.02",
        "0.03",
    ]
    assert [cell.text for cell in table.rows[1]][2:] == ["10", "0.01", "0.04"]


def test_points_are_counted_as_by_the_run(archives):
    counted = 0
    for grid in (source.read(path) for path in archives):
        if "gait" in grid.outcomes.dims and "status" in grid.outcomes:
            status = grid.outcomes["status"].transpose(..., "gait").values
            rows = Counter(map(tuple, status.reshape(-1, status.shape[-1]).tolist()))
            assert {name: n for name, n, _ in html_tables.statuses(grid)} == dict(
                count(rows, STATUS_NAMES)
            )
            assert sum(rows.values()) == np.prod(
                [grid.grid.sizes[axis] for axis in grid.axes]
            )
            counted += len(html_tables.statuses(grid))
    assert counted > 4


def test_one_two_and_more_points_are_spoken_of_in_english(tmp_path):
    for n, words in (
        (1, "Solver: 1 of 1 point complete"),
        (3, "Solver: 3 of 3 points complete"),
    ):
        slopes, dims = np.linspace(0.01, 0.02, n), ("slope", "gait")
        grid = {"status": (dims, np.stack([np.zeros(n, "i1"), np.ones(n, "i1")], -1))}
        coords = {"slope": slopes, "gait": np.array(["long", "short"], object)}
        text = f'name = "few"\nwalker = "E"\n[axes]\nslope = {slopes.tolist()}'
        few = read(write(tmp_path / f"few{n}.nc", text, grid, coords, {"E": POINT}))
        assert html_tables.outcome_sentence(few) == words


def test_tables_name_the_walker_of_a_file_as_the_page_does(tmp_path):
    text = 'name = "own"\nwalker = "mine.toml"\n[axes]\nm_h = [4.0]\nslope = [0.01]\n[want]\nfigures = ["angles"]'
    trace = {
        "time": [0.0, 1.0],
        "theta_st": [0.2, -0.2],
        "theta_th": [-0.2, 0.2],
        "slope": [0.01] * 2,
    }
    tables = {
        "trace": {
            "walker": ["walker"] * 2,
            "m_h": [4.0] * 2,
            "gait": ["long"] * 2,
            **trace,
        }
    }
    pages.write(
        [write(tmp_path / "own.nc", text, {}, {}, {"mine.toml": POINT}, tables)],
        tmp_path,
    )
    assert (
        "the long gait of walker mine.toml, m_h = 4 at"
        in Page(tmp_path / "own.html").text
    )


def test_a_table_shows_codes_as_words_and_units_as_in_print():
    frame = pd.DataFrame(
        {"smallest_at": ["end_zero_step"], "walker": ["my_walker"], "speed": [0.5]}
    )
    frame.attrs["units"] = {"speed": "m s-1"}
    table = html_tables.named("design", frame)
    assert [cell.text for cell in table.rows[0]] == [
        "end: steps vanish",
        "my_walker",
        "0.5",
    ]
    assert table.heads[2] == "speed (m s⁻¹)"


def test_a_claim_is_shown_with_its_words_a_picture_and_a_command(report):
    text = (report / "ledger.html").read_text()
    claim = text[text.index('id="E4"') : text.index('id="Z5"')]
    assert "approximately as observed" in claim and "figure 5" in claim
    assert "printed 2.828, computed 3.69, from 3.1 to 3.9 by rounding" in claim
    assert (
        "<code>gaitsweep run transition.toml</code>" in claim and 'href="#E4"' in claim
    )
    assert (
        "<svg" not in text[text.index('id="Z5"') : text.index("</main>")]
    )  # nothing is printed for it
    table = pd.read_csv(report / "csv" / "ledger.csv")
    assert list(table["id"]) == ["E2", "E3", "E4", "Z5"]
    assert table["printed"][2] == 2.828 and table["interval_high"][2] == 3.9


def test_failures_are_named_at_the_top_of_the_index(report):
    text = (report / "index.html").read_text()
    assert text.index("ledger.html#Z5") < text.index('id="studies"')
    assert text.index("ledger.html#E4") < text.index('id="studies"')


def test_a_bar_holds_all_its_numbers_in_proportion():
    row = {"value": 0.0191, "printed_value": 0.020, "printed_half_unit": 5e-4, "interval_low": 0.018,
           "interval_high": 0.0203}  # fmt: skip
    bar = ledger._bar(row)
    places = [
        bar[name]
        for name in ("low", "value", "printed_from", "printed", "high", "printed_to")
    ]
    assert places == sorted(places) and places[0] > 0 and places[-1] < 100
    assert (bar["value"] - bar["low"]) / (bar["high"] - bar["low"]) == pytest.approx(
        0.0011 / 0.0023, rel=1e-3
    )
    # 8 % of the span is left free on either side.
    assert (places[0], places[-1]) == pytest.approx(
        (100 * 0.08 / 1.16, 100 * 1.08 / 1.16), abs=0.02
    )
    assert ledger._bar({"value": 1.0}) is None
    # Equal numbers are drawn in one place, however many digits they differ in.
    close = ledger._bar(
        {"value": 4.00001, "printed_value": 4.0, "printed_half_unit": 0.0}
    )
    assert abs(close["value"] - close["printed"]) < 0.1


def test_verdicts_have_signs():
    assert [ledger.sign(v) for v in ("proved", "reproduced", "consistent within rounding", "approximate")] == [
        "proved", "yes", "within", "open"]  # fmt: skip
    assert ledger.sign("not_reproduced") == ledger.sign("not a verdict") == "no"


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("slope^(1/3) at slopes 1e-8 to 0.2", "slope¹ᐟ³ at slopes 10⁻⁸ to 0.2"),
        ("x'/y' -> 0, P ~ v^4, 7.4e-06", "ẋ/ẏ → 0, P ∝ v⁴, 7.4 × 10⁻⁶"),
        (
            "passes -1 at 0.015 +- 1.01e-15 (0.018-0.0203)",
            "passes −1 at 0.015 ± 1.01 × 10⁻¹⁵ (0.018–0.0203)",
        ),
        (
            "v^3.95, physical-straight, zero-slope",
            "v^3.95, physical-straight, zero-slope",
        ),
    ],
)
def test_signs_are_typeset(text, shown):
    assert typeset(text) == shown


def test_a_failure_over_a_damaged_archive_names_the_damage_and_any_other_is_a_bug(
    tmp_path, monkeypatch
):
    path = _small(tmp_path, "s")

    def stumble(*_):
        raise IndexError("out of bounds")

    monkeypatch.setattr(pages, "_study_page", stumble)
    # It is laid out for the pages only.
    with pytest.raises(
        ArchiveError, match=r"s\.nc is damaged: The attribute `title` is missing\."
    ):
        pages.write([path], tmp_path / "out")
    monkeypatch.setattr(
        "gaitsweep.pipeline.archive.structure.misfits", lambda file: iter(())
    )
    with netCDF4.Dataset(path, "a") as file:
        sums = {"stance_angle": archive_reader._checksum(file["stance_angle"])}
        file.checksums = json.dumps(sums)
    with pytest.raises(IndexError):
        pages.write([path], tmp_path / "out")
    with netCDF4.Dataset(path, "a") as file:
        file["stance_angle"][0] = 3.0
    with pytest.raises(
        ArchiveError,
        match=r"s\.nc is damaged: `stance_angle` is not as it was written\.",
    ):
        pages.write([path], tmp_path / "out")


def test_an_archive_damaged_inside_is_answered_in_one_line(tmp_path):
    path = synthetic.tuned(tmp_path)
    whole = path.read_bytes()
    values = np.geomspace(
        1e-5, 0.06, 70
    ).tobytes()  # the slopes, as they lie in the file
    start = whole.index(values)
    path.write_bytes(whole[: start + 200])
    with pytest.raises(ArchiveError) as caught:
        pages.write([path], tmp_path / "out")
    assert "\n" not in str(caught.value) and str(path) in str(caught.value)


def test_two_reports_at_once_into_one_folder_give_the_index_of_both(tmp_path):
    names = [f"study{k}" for k in range(6)]
    archives = [_small(tmp_path, name) for name in names]
    with ThreadPoolExecutor(3) as pool:
        list(
            pool.map(
                lambda path: _report_in_another_process(path, tmp_path / "out"),
                archives,
            )
        )
    links = Page(tmp_path / "out" / "index.html").all("href")
    assert {f"{name}.html" for name in names} <= set(links)


def _report_in_another_process(path, out):
    code = "import sys; from pathlib import Path; from gaitsweep.pipeline.report import pages\n"
    code += "pages.write(*map(eval, sys.argv[1:]))"
    subprocess.run(
        [sys.executable, "-c", code, f"[Path({str(path)!r})]", f"Path({str(out)!r})"],
        check=True,
    )


def test_a_study_without_any_gait_has_a_page_that_says_so(tmp_path):
    dims, nothing = ("slope", "gait"), np.full((3, 2), np.nan)
    figures = [
        "linear",
        "loglog",
        "multipliers",
        "power",
        "losses",
        "heelstrike",
        "angles",
        "claims",
        "heatmap",
    ]
    text = f'name = "none"\nwalker = "E"\n[axes]\nslope = [0.01, 0.02, 0.03]\n[want]\nfigures = {json.dumps(figures)}'
    names = ("stance_angle", "spectral_radius", "speed", "power", "loss_normal", "loss_tangential", "loss_kneestrike",
             "heelstrike_rate_ratio")  # fmt: skip
    grid = dict.fromkeys(names, (dims, nothing))
    grid |= {
        "status": (dims, np.ones((3, 2), "i1")),
        "reason": (dims, np.ones((3, 2), "i2")),
    }
    coords = {"slope": [0.01, 0.02, 0.03], "gait": np.array(["long", "short"], object)}
    pages.write(
        [write(tmp_path / "none.nc", text, grid, coords, {"E": POINT})], tmp_path
    )
    text = Page(tmp_path / "none.html").text
    reasons = re.findall("figure “(.*)”, but the archive has no (.*)[.]", text)
    assert [name for name, _ in reasons] == [
        name
        for name in figures
        if name != "claims"  # which the ledger shows
    ]
    over_axes = "quantity of gaits over two axes of several values"
    assert dict(reasons)["heatmap"] == over_axes
    assert "Solver: 3 no gait" in text


def test_names_in_other_scripts_are_shown_as_they_are(tmp_path):
    name = "ходок 歩行 مشّاء"
    dims = ("walker", "slope", "gait")
    text = f'name = "w"\nwalker = ["{name}", "b"]\n[axes]\nslope = [0.01]\n[want]\nfigures = ["loglog", "walker"]'
    coords = {
        "walker": np.array([name, "b"], object),
        "slope": [0.01, 0.02],
        "gait": np.array(["long"], object),
    }
    grid = {"stance_angle": (dims, np.array([[[0.1], [0.2]], [[0.15], [0.25]]]))}
    pages.write(
        [write(tmp_path / "w.nc", text, grid, coords, {name: POINT, "b": POINT})],
        tmp_path,
    )
    assert name in Page(tmp_path / "w.html").text
    assert name in (tmp_path / "csv" / "w-loglog.csv").read_text(encoding="utf-8")


def test_no_page_has_an_identifier_twice(report):
    for path in report.glob("*.html"):
        found = re.findall(r'\sid="([^"]+)"', path.read_text())
        assert len(found) == len(set(found)), (
            path.name,
            sorted(i for i in found if found.count(i) > 1),
        )
