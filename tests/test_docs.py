"""What the README and docs show is true: links, options, studies, walkers and the
output printed beside them.
"""

import contextlib
import itertools
import json
import math
import os
import pkgutil
import re
import runpy
import subprocess
import sys
import textwrap
import tomllib

import numpy as np
import pytest
from scipy.optimize import fsolve

import gaitsweep
from conftest import ROOT
from gaitsweep.pipeline.archive.citation import PAPER
from gaitsweep.pipeline.cli import commands
from gaitsweep.pipeline.report.figures import FIGURES
from gaitsweep.pipeline.study import parse
from gaitsweep.tasks.contract.registry import OPTIONS

PAGES = [
    ROOT / "README.md",
    ROOT / "CONTRIBUTING.md",
    *sorted((ROOT / "docs").glob("*.md")),
]


def blocks(page, language):
    text = (ROOT / page).read_text(encoding="utf-8")
    fenced = re.findall(r"^ *```(\w*)\n(.*?)^ *```$", text, re.S | re.M)
    return [textwrap.dedent(block) for tongue, block in fenced if tongue == language]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_every_link_leads_to_a_file(page):
    for link in re.findall(r"\]\(([^)#]+)", page.read_text(encoding="utf-8")):
        assert (page.parent / link).exists(), link


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_every_path_and_module_named_exists(page):
    prose = re.sub(
        r"^ *```.*?^ *```$", "", page.read_text(encoding="utf-8"), flags=re.S | re.M
    )
    for code in re.findall(r"`([^`\n]+)`", prose):
        path = code.partition(":")[0]
        if re.fullmatch(
            r"(pipeline|tasks|tests|docs|data)/[\w./-]*|[\w/]+\.(py|md)", path
        ):
            assert path.startswith("data/archive") or (ROOT / path).exists(), path
        elif re.fullmatch(r"(pipeline|tasks)(\.\w+)+", code):
            pkgutil.resolve_name(code)


def test_every_package_has_its_place_in_contributing():
    text = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    packages = {
        f"`{init.parent.relative_to(ROOT)}/`"
        for name in ("pipeline", "tasks")
        for init in (ROOT / name).glob("*/__init__.py")
    }
    assert len(packages) > 10
    assert not {package for package in packages if package not in text}


def test_the_paper_is_cited_alike_everywhere():
    for name in (
        "README.md",
        "CITATION.cff",
        "docs/physics.md",
        "data/reference/published.toml",
    ):
        text = (ROOT / name).read_text(encoding="utf-8")
        assert "10.1080/713603737" in text and "2000" in text, name
        assert not re.search(r"\(1999\)|[ =]1999\b", text), name
    assert all(
        words in PAPER
        for words in (
            "Garcia",
            "Chatterjee",
            "Ruina",
            "15(2), 75-99, 2000",
            "10.1080/713603737",
        )
    )


@pytest.mark.parametrize("name", ["studies", "conventions"])
def test_tables_are_those_of_the_fields_and_the_reference_gaits(name):
    page = (ROOT / "docs" / f"{name}.md").read_text(encoding="utf-8")
    filled = runpy.run_path(str(ROOT / "docs" / "tables.py"))["filled"]
    assert filled(page) == page


def test_pages_that_speak_of_lanes_say_what_one_is():
    for page in [*(ROOT / "docs").glob("*.md"), ROOT / "README.md"]:
        text = page.read_text(encoding="utf-8")
        assert not re.search(r"\blanes?\b", text) or "*lane*" in text, page.name


def test_help_of_the_tables_writes_nothing():
    page = ROOT / "docs" / "studies.md"
    written = page.stat().st_mtime_ns
    done = subprocess.run(
        [sys.executable, ROOT / "docs" / "tables.py", "--help"],
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0 and "usage: tables.py" in done.stdout
    assert page.stat().st_mtime_ns == written


def test_every_command_and_option_exists():
    subparsers = commands.parser()._subparsers._group_actions[0].choices
    helps = {name: command.format_help() for name, command in subparsers.items()}
    seen = 0
    for page in PAGES:
        inline = re.findall(
            r"(?<!`)`(gaitsweep [^`]+)`", page.read_text(encoding="utf-8")
        )
        fenced = re.findall(
            r"^(?:\$ )?(gaitsweep .*)$",
            "".join(blocks(page.relative_to(ROOT), "")),
            re.M,
        )
        for line in inline + fenced:
            words = line.split("#")[0].split()
            assert words[1].rstrip(",.;") in helps, line
            for option in (w.partition("=")[0] for w in words if w.startswith("--")):
                assert option in helps[words[1]], line
            seen += 1
    assert seen > 15


def test_the_studies_shown_can_be_run(tmp_path):
    (walker, sweep) = blocks("docs/your-own-walker.md", "toml")
    (tmp_path / "walker.toml").write_text(walker)
    (tmp_path / "mine-study.toml").write_text(sweep)
    mine = parse.read(tmp_path / "mine-study.toml")
    assert mine.checks[0]["kneed"] and mine.checks[0]["si"] and mine.points == 900
    templates = {
        path.stem: parse.read(path)
        for path in (ROOT / "data" / "studies" / "examples").glob("*.toml")
    }
    assert len(templates) > 3 and templates["toward-round-feet"].line_shape == (
        1,
        12,
        5,
    )
    (readme,) = blocks("README.md", "toml")
    assert parse.parse(tomllib.loads(readme), readme, tmp_path / "s.toml").points == 400


def test_the_walker_shown_has_an_infinite_friction_demand(tmp_path, capsys):
    (walker, _) = blocks("docs/your-own-walker.md", "toml")
    (tmp_path / "walker.toml").write_text(walker)
    solve = ["solve", "--walker", str(tmp_path / "walker.toml"), "--slope", "0.03"]
    commands.main([*solve, "--all-variables"])
    long = capsys.readouterr().out.partition("short (")[0]
    assert "contact_tension, friction" in long and re.search(
        r"friction_demand_kneestrike +inf$", long, re.M
    )
    commands.main([*solve, "--json"])
    gaits = json.loads(capsys.readouterr().out, parse_constant=pytest.fail)
    assert float(gaits[0]["friction_demand_kneestrike"]) == math.inf


def test_the_studies_of_figure_3_and_of_designs_say_what_is_true():
    (physical, straight) = (
        gaitsweep.solve(name, 0.036)["stable"].any()
        for name in ("physical", "physical-straight")
    )
    said = (ROOT / "data/studies/paper/figure3.toml").read_text()
    assert physical and not straight
    assert (
        "a stable one with free knees, and one with locked knees, which is unstable"
        in said
    )
    said = " ".join(
        (ROOT / "data/studies/paper/design.toml").read_text().replace("#", "").split()
    )
    low, high = map(
        float,
        re.search(r"no gait between slopes ([\d.]+) and ([\d.]+)\.", said).groups(),
    )
    slopes = [low - 1e-4, low + 1e-4, 0.1, high - 1e-4, high + 1e-4]
    walks = (gaitsweep.gaits("physical", slopes).status == 0).any("gait").values
    assert walks.tolist() == [True, False, False, False, True]


def test_the_readme_shows_what_the_command_prints(capsys):
    (shell,) = [b for b in blocks("README.md", "") if "$ gaitsweep solve" in b]
    command, *shown = shell[shell.index("$ gaitsweep solve") :].splitlines()
    assert commands.main(command.split()[2:]) == 0
    printed = capsys.readouterr().out.splitlines()
    shown = shown[: next(i for i, line in enumerate(shown) if line.strip() == "...")]
    assert len(shown) > 5
    for line, found in zip(shown, printed, strict=False):
        assert re.split(r"\d", line)[0].rstrip(" -") == re.split(r"\d", found)[
            0
        ].rstrip(" -")
        # The last digits are the machine's own.
        numbers = [
            [float(n) for n in re.findall(r"-?\d+\.\d+", text)]
            for text in (line, found)
        ]
        assert numbers[0] == pytest.approx(numbers[1], rel=1e-12), (line, found)


def test_guesses_lead_where_the_readme_says():
    said = " ".join((ROOT / "README.md").read_text(encoding="utf-8").split())
    guesses, long, short = map(
        int,
        re.search(
            r"of (\d+) of them .* leads (\d+) to the long gait, (\d+) to the short",
            said,
        ).groups(),
    )
    known = gaitsweep.solve("C", 0.02).set_index("gait")["stance_angle"]
    found = []
    for angle, rate in itertools.product(
        np.linspace(0.1, 0.5, 9), np.linspace(-2, -0.4, 9)
    ):
        with contextlib.suppress(gaitsweep.StudyError):  # it falls
            end, _, flag, _ = fsolve(
                lambda state: gaitsweep.step_map("C", 0.02, state).state - state,
                [angle, rate, rate],
                full_output=True,
            )
            found += [known.index[(abs(known - end[0]) < 1e-6)].tolist()] * (flag == 1)

    assert guesses == 81
    assert (found.count(["long"]), found.count(["short"]), len(found)) == (
        long,
        short,
        long + short,
    )


def test_the_python_shown_is_python():
    for page in PAGES:
        for block in blocks(page.relative_to(ROOT), "python"):
            compile(block, str(page), "exec")
    names = [
        "figure",
        "gaits",
        "load",
        "report",
        "run",
        "simulate",
        "solve",
        "step_map",
    ]
    code = f"import gaitsweep; print(*(getattr(gaitsweep, name).__name__ for name in {names}), *gaitsweep.__all__)"
    done = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", code],
        cwd=ROOT,
        capture_output=True,
        text=True,
    )
    printed = done.stdout.split()
    assert printed[: len(names)] == names and set(names) < set(printed[len(names) :])


def test_every_option_of_every_kind_is_in_the_docs_and_the_help():
    studies, shown = (
        (ROOT / "docs" / "studies.md").read_text(),
        commands.parser()._subparsers._group_actions[0],
    )
    text = shown.choices["plan"].format_help()
    of_all = set.intersection(
        *map(set, OPTIONS.values())
    )  # those are described once, before the kinds
    assert of_all == {"tuned"} and "`tuned = [" in studies.partition("## Kinds")[0]
    for kind, known in OPTIONS.items():
        table = studies.partition(f"<!-- options of {kind} -->\n")[2]
        rows = table.partition("\n\n")[0]
        for name, option in known.items():
            assert name in of_all or f"| `{name}` | " in rows, (kind, name)
            assert option.meaning in text, (kind, name)


def test_the_page_on_python_runs_from_top_to_bottom(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    names: dict = {}
    for block in blocks("docs/python.md", "python"):
        exec(block, names)
    (selection,) = re.findall(
        r"`(sweep\.stance_angle\.where[^`]+)`", (ROOT / "docs/python.md").read_text()
    )
    assert eval(selection, names).notnull().any()
    # The numbers and sizes that the page states.
    speeds = names["gaits"]("A", np.linspace(0.001, 0.06, 100)).sel(gait="long")
    assert np.interp(0.5, speeds.speed, speeds.cost_of_transport) == pytest.approx(
        0.0152, abs=5e-5
    )
    assert (
        names["grid"].period.shape == (20, 20, 20, 4)
        and (names["grid"].status.sel(gait="long") == 0).all()
    )
    assert (
        names["walk"].steps_taken == 20
        and len(names["branches"]) > 4
        and len(names["table"]) == 2
    )


def test_every_figure_is_in_the_table_of_figures():
    page = (ROOT / "docs" / "studies.md").read_text(encoding="utf-8")
    table = page.partition("## Figures\n")[2].partition("\n\n")[0]
    named = {
        name
        for line in table.splitlines()
        if line.startswith("|")
        for name in re.findall(r"`(\w+)`", line.split("|")[1])
    }
    drawn_of_themselves = {"residuals", "measured"}
    assert named == {*FIGURES} - drawn_of_themselves
