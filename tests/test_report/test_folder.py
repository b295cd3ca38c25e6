"""What pages of a folder say of each other: findings, verdicts, sections, neighbours;
and many of them at once.
"""

import json
import re

import numpy as np
import pytest

from gaitsweep.pipeline.report import entry, folder, pages, paper
from test_report.reading import Page
from test_report.shape import POINT, write

FIGURE5 = 'name = "figure5"\nwalker = "E"\n[axes]\nslope = [0.01, 0.02]\n[want]\nfigures = ["loglog"]'
LEDGER = 'name = "behind"\nwalker = "E"\n[axes]\nslope = [0.01]\n[want]\nclaims = ["E4"]\nfigures = ["claims"]'
GRID = {"stance_angle": (("slope", "gait"), np.full((2, 1), 0.2))}
COORDS = {"slope": [0.01, 0.02], "gait": np.array(["long"], object)}


def _claims(verdict="approximate", **more):
    row = {"id": "E4", "printed": "a ratio of 2.83", "printed_value": 2.83, "printed_half_unit": 0.005, "value": 3.3477,
           "interval_low": np.nan, "interval_high": np.nan, "verdict": verdict, "source": "section 6.3",
           "computed": "3.348", "figure": "transition/transition_ladder", "command": "gaitsweep claims E4"}  # fmt: skip
    return {name: [value] for name, value in {**row, **more}.items()}


def _figure5(tmp_path, text=FIGURE5):
    return write(tmp_path / "figure5.nc", text, GRID, COORDS, {"E": POINT})


def _behind(tmp_path, **claims):
    return write(
        tmp_path / "behind.nc",
        LEDGER,
        GRID,
        COORDS,
        {"E": POINT},
        {"claims": _claims(**claims)},
    )


def _finding(tmp_path):
    text = (tmp_path / "out" / "figure5.html").read_text()
    return re.search(r"<!--finding:loglog-->(.*?)<!--/-->", text, re.S)[1]


def test_figure_5_says_what_became_of_the_papers_ratio_and_leads_to_the_verdict_and_back(
    tmp_path,
):
    pages.write([_figure5(tmp_path), _behind(tmp_path)], tmp_path / "out")
    told = _finding(tmp_path)
    assert "very close to 2.83" in told and "comes out as 3.35" in told
    assert 'class="chip open" href="ledger.html#E4">E4 approximate<' in told
    assert "figure5.html#loglog" in Page(tmp_path / "out" / "ledger.html").all("href")
    page = (tmp_path / "out" / "figure5.html").read_text()
    assert "<h1>Figure 5. The scaling transition" in page
    assert page.index("comes out as 3.35") < page.index('class="plot"')


@pytest.mark.parametrize(
    "claims", [None, {"verdict": "reproduced"}, {"value": np.nan, "id": "E5"}]
)
def test_a_finding_stands_only_with_its_numbers_and_its_verdict(tmp_path, claims):
    more = [] if claims is None else [_behind(tmp_path, **claims)]
    pages.write([_figure5(tmp_path), *more], tmp_path / "out")
    assert "2.83" not in _finding(tmp_path)


def test_claims_that_come_later_reach_the_pages_already_there(tmp_path):
    pages.write([_figure5(tmp_path)], tmp_path / "out")
    assert "3.35" not in _finding(tmp_path)
    pages.write([_behind(tmp_path)], tmp_path / "out")
    assert "3.35" in _finding(tmp_path)
    pages.write([_behind(tmp_path, value=3.0)], tmp_path / "out")
    assert "3.35" not in _finding(tmp_path) and "as 3," in _finding(tmp_path)


def test_another_study_of_a_name_of_the_paper_has_not_its_words(tmp_path):
    pages.write(
        [_figure5(tmp_path, FIGURE5.replace('"E"', '"D"')), _behind(tmp_path)],
        tmp_path / "out",
    )
    page = Page(tmp_path / "out" / "figure5.html")
    assert "scaling transition" not in page.text and "E4" not in _finding(tmp_path)


def test_a_study_that_only_feeds_the_ledger_has_no_page_and_stays_in_the_ledger(
    tmp_path,
):
    pages.write([_figure5(tmp_path), _behind(tmp_path)], tmp_path / "out")
    for archives in ([], [_figure5(tmp_path)]):
        pages.write(archives, tmp_path / "out")
        assert not (tmp_path / "out" / "behind.html").exists()
        ledger = Page(tmp_path / "out" / "ledger.html")
        assert "E4" in ledger.all("id") and 'claims = ["E4"]' in ledger.text
    assert "behind" not in (tmp_path / "out" / "index.html").read_text()
    pages.write([_figure5(tmp_path)], tmp_path / "out", only=True)
    assert not (tmp_path / "out" / "ledger.html").exists()
    assert "ledger.html" not in Page(tmp_path / "out" / "figure5.html").all("href")


def test_the_index_has_sections_a_summary_and_what_is_not_shown(tmp_path):
    own = write(
        tmp_path / "own.nc",
        FIGURE5.replace("figure5", "own"),
        GRID,
        COORDS,
        {"E": POINT},
    )
    basin = 'name = "basin"\nkind = "basin"\nwalker = "D"'
    beyond = write(tmp_path / "basin.nc", basin, {}, {}, {"D": POINT})
    pages.write([own, beyond, _figure5(tmp_path), _behind(tmp_path)], tmp_path / "out")
    text = (tmp_path / "out" / "index.html").read_text()
    text = text[text.index('<div id="studies">') :]
    heads = (
        "The paper's figures",
        "figure5.html",
        "Beyond the paper",
        "basin.html",
        "Other studies",
        "own.html",
    )
    heads = [
        head.replace("'", "&#39;") if head in paper.PAPER["sections"].values() else head
        for head in heads
    ]
    places = [
        text.index(head) if head in text else text.index(head.replace("&#39;", "'"))
        for head in heads
    ]
    assert places == sorted(places)
    assert "three measured points" in text and "E4" not in text
    told = Page(tmp_path / "out" / "index.html").text
    assert "transition slopes of E and F in the ratio 2.83: 3.35" in " ".join(
        told.split()
    )
    pages.write([own], tmp_path / "out", only=True)
    text = (tmp_path / "out" / "index.html").read_text()
    assert "Not shown here" not in text and "<h2>Studies</h2>" in text


def test_the_words_of_the_paper_name_figures_and_claims_that_exist():
    from gaitsweep.pipeline.report.figures import FIGURES

    root = pages.Path(__file__).parents[2]
    known = {
        row["id"]
        for row in json.loads((root / "data" / "reference" / "ledger.json").read_text())
    }
    studies = {name: told for name, told in paper.PAPER.items() if "walkers" in told}
    assert set(paper.PAPER) - set(studies) == {"sections", "absent", "claims"}
    for name, told in studies.items():
        text = (root / "data" / "studies" / "paper" / f"{name}.toml").read_text()
        assert told["section"] in paper.PAPER["sections"]
        for figure, words in told.items():
            if isinstance(words, dict):
                assert figure in FIGURES and f'"{figure}"' in text, (name, figure)
                assert set(words.get("claims", [])) | set(words.get("if", {})) <= known
                named = re.findall(
                    r"\{(\w+?)(?:_printed|_low|_high)?(?::\d)?\}",
                    words.get("finding", ""),
                )
                assert set(named) <= known, (name, figure)
    assert set(paper.PAPER["claims"]) <= known


def test_neighbours_lead_to_each_other(report):
    links = {path.name: path.read_text() for path in report.glob("*.html")}
    forward = {
        name: found[1]
        for name, text in links.items()
        if (found := re.search(r'rel="next" href="([^"]+)"', text))
    }
    back = {
        name: found[1]
        for name, text in links.items()
        if (found := re.search(r'rel="prev" href="([^"]+)"', text))
    }
    assert (
        len(forward) == len(links) - 3
        and {after: name for name, after in forward.items()} == back
    )
    for name, text in links.items():
        assert text.count('aria-current="page"') == (
            name not in ("index.html", "ledger.html")
        )


def test_a_bundle_holds_all_pages_and_is_kept_up_to_date(tmp_path):
    out = tmp_path / "out"
    pages.write([_figure5(tmp_path)], out)
    assert not (out / "bundle.html").exists()
    pages.write([_behind(tmp_path)], out, bundle=True)

    def texts():
        page = (out / "bundle.html").read_text()
        return json.loads(re.search(r'id="bundle">(.*?)</script>', page)[1])["texts"]

    assert (
        set(texts()) == {"index", "ledger", "figure5"}
        and "as 3.35" in texts()["figure5"]
    )
    assert (
        'href="?ledger#E4"' in texts()["figure5"]
        and "ledger.html" not in texts()["figure5"]
    )
    pages.write([_behind(tmp_path, value=3.0)], out)
    assert "as 3," in texts()["figure5"]
    (out / "bundle.html").write_text("mine")
    with pytest.raises(pages.folder.paths.ArchiveError):
        pages.write([], out)


def test_heads_and_cells_that_are_formulas_are_text():
    frame = pages.pd.DataFrame(
        {"=cmd|' /C calc'!A0": ["@x", "-1+1"], "slope": [-0.1, 0.2]}
    )
    assert (
        folder.csv_text(frame, {"slope": "rad"})
        == "'=cmd|' /C calc'!A0,slope (rad)\n'@x,-0.1\n'-1+1,0.2\n"
    )


def test_words_of_a_csv_file_that_hold_its_signs_are_quoted_and_missing_ones_are_empty():
    words = ["u,v", 'q"', "a\rb", "c\nd", None]
    frame = pages.pd.DataFrame(
        {"word": words, "number": [1e-6, float("nan"), 0.1 + 0.2, 3.0, -0.0]}
    )
    rows = [
        '"u,v",1e-06',
        '"q""",',
        '"a\nb",0.30000000000000004',
        '"c\nd",3.0',
        ",-0.0",
    ]
    assert folder.csv_text(frame) == "\n".join(["word,number", *rows, ""])


def test_a_thousand_archives_make_a_small_index_and_pages_that_list_their_neighbours(
    tmp_path,
):
    picture = "<svg>" + "x" * 500 + "</svg>"
    record = entry.Entry(
        "s0",
        "s0",
        "s0",
        "s0",
        "About. " * 30,
        "point",
        "",
        99,
        [],
        [],
        [],
        [],
        picture,
        [],
        "",
    )
    report = folder._Report(pages._environment(), [
        pages.replace(record, slug=f"s{k}", name=f"s{k}", title=f"Study {k}") for k in range(1000)
    ])  # fmt: skip
    index = report.page("index")
    assert len(index.encode()) < 260_000 and 0 < index.count(picture) < 100
    near = report._part("pages", "", report.shown[500])
    assert near.count("<a ") == 41 and 'href="s500.html" aria-current' in near
