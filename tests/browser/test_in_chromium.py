import re
import time
from pathlib import Path

import numpy as np
import pytest

from gaitsweep.pipeline.report import pages
from test_report.shape import POINT, write

PAGES = (
    "index",
    "ledger",
    "transition",
    "tuned-walkers",
    "detuning",
    "cascade",
    "design",
)


@pytest.fixture
def keys():
    return pytest.importorskip(
        "selenium.webdriver.common.keys", reason="the browser tests need selenium"
    ).Keys


@pytest.fixture
def chains():
    return pytest.importorskip(
        "selenium.webdriver", reason="the browser tests need selenium"
    ).ActionChains


def one(browser, selector):
    return browser.find_element("css selector", selector)


def ask(browser, script):
    return browser.execute_script(f"return {script}")


@pytest.mark.parametrize("name", PAGES)
@pytest.mark.parametrize(("width", "scheme"), [(1280, "light"), (390, "dark")])
def test_a_page_opens_without_a_word_in_the_console_and_fits_its_width(
    visit, name, width, scheme
):
    browser = visit(name, width, scheme)
    assert ask(browser, "document.documentElement.scrollWidth") <= width
    assert [entry["message"] for entry in browser.get_log("browser")] == []


#: How far the buttons of figures reach over what stands above these [px], where they
#: show without a pointer.
OVERLAPS = """Array.from(document.querySelectorAll(".plot .tools"), tools => {
  const above = tools.closest("figure").previousElementSibling;
  return above ? above.getBoundingClientRect().bottom - tools.getBoundingClientRect().top : 0;
})"""


@pytest.mark.parametrize("width", [390, 1000])
def test_buttons_of_figures_lie_over_no_words_where_they_always_show(visit, width):
    browser = visit("design", width)
    assert ask(browser, "matchMedia('(hover: none)').matches")

    overlaps = ask(browser, OVERLAPS)

    assert overlaps
    assert max(overlaps) <= 0


def test_every_link_of_the_index_leads_to_a_page(visit):
    browser = visit("index")
    links = {
        a.get_attribute("href")
        for a in browser.find_elements("css selector", "a[href]")
    }
    assert len(links) > 6
    for link in links:
        browser.get(link)
        assert one(browser, "h1").text
        anchor = link.partition("#")[2]
        assert not anchor or ask(
            browser, f"document.getElementById({anchor!r}) !== null"
        )


def test_text_and_figures_follow_the_colour_scheme(visit):
    ink = "getComputedStyle(document.querySelector('.plot svg text')).fill"
    # What is painted behind a figure: the first that is not transparent.
    ground = """(() => {
      for (let node = document.querySelector(".plot svg"); node; node = node.parentElement) {
        const { backgroundColor } = getComputedStyle(node);
        if (!backgroundColor.endsWith(", 0)")) return backgroundColor;
      } })()"""
    seen = {scheme: [_lightness(ask(visit("transition", scheme=scheme), what)) for what in (ink, ground)]
            for scheme in ("light", "dark")}  # fmt: skip
    assert seen["light"][0] < 60
    assert seen["light"][1] > 240
    assert seen["dark"][0] > 200
    assert seen["dark"][1] < 40


def _lightness(colour: str) -> float:
    return sum(map(int, re.findall(r"\d+", colour)[:3])) / 3


@pytest.mark.parametrize(
    ("name", "figure"),
    [("transition", "loglog"), ("transition", "angles"), ("detuning", "locus"), ("cascade", "bifurcation"),
     ("design", "heatmap")],
)  # fmt: skip
def test_a_point_under_the_pointer_says_its_values_and_command(
    visit, chains, name, figure
):
    browser = visit(name, anchor=f"#{figure}")
    plot = one(browser, f"#{figure} .plot")
    x, y = ask(browser, _place(figure))
    box = plot.rect
    chains(browser).move_to_element_with_offset(
        plot, int(x - box["width"] / 2), int(y - box["height"] / 2)
    ).perform()
    tip = one(browser, f"#{figure} .tip")
    assert tip.is_displayed()
    assert tip.find_elements("css selector", "dd")[0].text
    command = tip.find_element("css selector", "code").text
    assert re.fullmatch(
        r"gaitsweep solve --walker \w+( --set \S+)* --slope [\d.e-]+", command
    )
    chains(browser).click().perform()
    assert "pinned" in tip.get_attribute("class")


def _place(figure: str) -> str:
    """Where a mark in the middle of a figure's first curve or map is, in pixels from
    the plot's corner.
    """
    return f"""(() => {{
        const plot = document.querySelector('#{figure} .plot'), scale = plot.clientWidth / plot.dataset.width;
        const [first] = JSON.parse(plot.querySelector('script').textContent), rows = first.rows, box = first.box;
        const inside = () => [0.8 * box[0] + 0.2 * box[2], 0.2 * box[1] + 0.8 * box[3]];
        const place = rows ? rows[rows.length >> 1].slice(0, 2) : inside();
        return place.map(v => v * scale);
    }})()"""


def test_points_are_reached_with_the_keyboard(visit, keys):
    browser = visit("transition")
    plot = one(browser, "#loglog .plot")
    plot.send_keys(keys.ARROW_RIGHT)
    first = one(browser, "#loglog .tip").text
    plot.send_keys(keys.ARROW_RIGHT)
    second = one(browser, "#loglog .tip").text
    plot.send_keys(keys.ARROW_DOWN)
    assert len({first, second, one(browser, "#loglog .tip").text}) == 3
    plot.send_keys(keys.ESCAPE)
    assert not one(browser, "#loglog .tip").is_displayed()


def test_the_first_tab_offers_to_skip_to_the_content(visit, keys):
    browser = visit("transition")
    one(browser, "body").send_keys(keys.TAB)
    assert ask(browser, "document.activeElement.textContent") == "Skip to the content"


def test_the_last_words_of_a_printed_page_stay_with_what_is_before(visit):
    browser = visit("transition")
    browser.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": "print"})
    style = "getComputedStyle(document.querySelector('main > footer'))"
    kept = browser.execute_script(f"return {style}.breakBefore")
    browser.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": ""})
    assert kept == "avoid"


@pytest.mark.parametrize("name", ["index", "transition"])
def test_a_page_prints(visit, name):
    sheet = visit(name).execute_cdp_cmd("Page.printToPDF", {"printBackground": True})
    assert len(sheet["data"]) > 20_000


def test_small_text_of_figures_stays_legible_on_a_phone(visit):
    browser = visit("transition", 390)
    least = """[...document.querySelectorAll('.plot')].flatMap(plot => [...plot.querySelectorAll('svg text')]
        .filter(text => parseFloat(text.style.fontSize) ARG)
        .map(text => parseFloat(getComputedStyle(text).fontSize) * plot.clientWidth / plot.dataset.width))"""
    # Larger letters would collide in a figure that fits the screen, as all do; so would
    # notes on curves and degrees, if they were as large as titles and numbers.
    large, small = (least.replace("ARG", which) for which in (">= 9", "< 9"))
    assert ask(browser, f"Math.min(...{large})") > 8
    assert ask(browser, f"Math.min(...{small})") > 6.5


@pytest.mark.parametrize("name", PAGES)
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_no_serious_accessibility_finding(visit, name, scheme):
    axe = pytest.importorskip(
        "axe_core_python", reason="accessibility is checked with axe-core"
    )
    browser = visit(name, scheme=scheme)
    browser.execute_script(
        (Path(axe.__file__).parent / "axe.min.js").read_text(encoding="utf-8")
    )
    found = browser.execute_async_script("axe.run().then(arguments[0])")
    serious = [f"{v['id']}: {v['nodes'][0]['html'][:120]}" for v in found["violations"]
               if v["impact"] in ("serious", "critical")]  # fmt: skip
    assert serious == []


def test_a_page_paints_within_a_second(visit, report):
    name = max(PAGES, key=lambda page: (report / f"{page}.html").stat().st_size)

    # Whatever else runs beside the browser can only slow it: the quickest visit counts.
    quickest = min(_first_paint(visit(name)) for _ in range(3))

    assert 0 < quickest < 1000


def _first_paint(browser):
    paint = "performance.getEntriesByName('first-contentful-paint')[0]?.startTime ?? 0"
    for _ in range(20):
        if ask(browser, paint):
            break
        time.sleep(0.1)
    return ask(browser, paint)


def test_claims_are_filtered_by_words_and_verdict(visit):
    browser = visit("ledger")
    shown = "[...document.querySelectorAll('.claim')].filter(claim => !claim.hidden).map(claim => claim.id)"
    assert set(ask(browser, shown)) == {"E2", "E3", "E4", "Z5"}
    one(browser, ".filter [name=words]").send_keys("cube root")
    assert ask(browser, shown) == ["E2"]
    one(browser, ".filter [name=words]").clear()
    browser.execute_script(
        "document.querySelector('.filter').dispatchEvent(new Event('input'))"
    )
    one(browser, ".filter option:last-child").click()
    assert set(ask(browser, shown)) == {"E4", "Z5"}
    assert "2 of 4" in one(browser, ".filter [role=status]").text


def test_a_link_leads_to_a_claim_that_the_filter_hides(visit):
    browser = visit("ledger")
    one(browser, ".filter [name=words]").send_keys("cube root")
    browser.execute_script("location.hash = '#Z5'")
    assert one(browser, "#Z5").is_displayed() and one(browser, "#E4").is_displayed()


def test_the_filter_of_claims_holds_on_the_way_back(visit):
    browser = visit("ledger")
    shown = "[...document.querySelectorAll('.claim')].filter(claim => !claim.hidden).map(claim => claim.id)"
    one(browser, ".filter [name=words]").send_keys("cube root")
    one(browser, "header.top a.brand").click()
    browser.back()
    words = ask(browser, "document.querySelector('.filter [name=words]').value")
    assert ask(browser, shown) == (["E2"] if words else ["E2", "E3", "E4", "Z5"])


def test_a_claim_has_an_address(visit):
    browser = visit("ledger", anchor="#E4")
    assert one(browser, ".claim:target h3").text.startswith("E4")


def test_a_table_is_sorted_by_a_click_on_its_heading(visit):
    browser = visit("transition")
    table = "document.querySelectorAll('table.archive')[0]"
    column = f"[...{table}.tBodies[0].rows].map(row => Number(row.cells[4].querySelector('data').value))"
    before = ask(browser, column)
    button = browser.execute_script(
        f"return {table}.tHead.rows[0].cells[4].querySelector('button')"
    )
    button.click()
    assert ask(browser, column) == sorted(before) != before
    button.click()
    assert ask(browser, column) == sorted(before, reverse=True)


def test_a_line_is_highlighted_and_hidden_from_the_legend(visit, chains):
    browser = visit("tuned-walkers")
    lit = "[...document.querySelectorAll('#loglog svg .on')].map(part => part.dataset.line)"
    shown = "[...document.querySelectorAll('#loglog svg [data-line]')].filter(part => part.style.display !== 'none')"
    every = set(ask(browser, f"{shown}.map(part => part.dataset.line)"))
    button = one(browser, "#loglog .legend button:nth-child(2)")
    browser.execute_script("arguments[0].scrollIntoView({ block: 'center' })", button)
    chains(browser).move_to_element(button).perform()
    assert set(ask(browser, lit)) == {"1"}
    assert one(browser, "#loglog .plot").get_attribute("class") == "plot lit"
    button.click()
    assert button.get_attribute("aria-pressed") == "false"
    assert set(ask(browser, f"{shown}.map(part => part.dataset.line)")) == every - {"1"}
    button.click()
    assert set(ask(browser, f"{shown}.map(part => part.dataset.line)")) == every
    chains(browser).move_to_element(one(browser, "h1")).perform()
    assert one(browser, "#loglog .plot").get_attribute("class") == "plot"


def test_a_line_hidden_in_one_figure_is_hidden_in_all_of_the_page(visit):
    browser = visit("tuned-walkers")
    legends = ask(
        browser,
        """[...document.querySelectorAll(".plot")].filter(plot => plot.querySelector(".legend"))
        .map(plot => plot.closest("section").id)""",
    )
    assert len(legends) > 1
    name = one(browser, f"#{legends[0]} .legend button:nth-child(2)").text
    state = """[...document.querySelectorAll(".legend button")].filter(one => one.textContent === arguments[0])
        .map(one => one.getAttribute("aria-pressed"))"""
    browser.execute_script("document.querySelectorAll('.legend button')[1].click()")
    assert {*browser.execute_script(f"return {state}", name)} == {"false"}
    hidden = """[...document.querySelectorAll("svg [data-line]")].filter(one => one.style.display === "none")
        .map(one => one.closest("section").id)"""
    assert {*ask(browser, hidden)} == {*legends}


def test_a_box_zooms_and_keeps_axes_and_titles_and_a_double_click_resets(visit, chains):
    browser = visit("transition", anchor="#loglog")
    plot = one(browser, "#loglog .picture svg")
    view = "document.querySelector('#loglog svg').getAttribute('viewBox').split(' ').map(Number)"
    whole = ask(browser, view)
    drag = chains(browser).move_to_element_with_offset(plot, -60, -60).click_and_hold()
    drag.move_by_offset(40, 30).move_by_offset(60, 40).perform()
    assert one(browser, "#loglog .box").is_displayed()
    chains(browser).release().perform()
    assert ask(browser, view)[2] < 0.5 * whole[2]
    titles = [
        b.text
        for b in browser.find_elements("css selector", "#loglog .numbers-on-edges b")
    ]
    assert titles == ["slope γ (rad)", "stance angle θ* (rad)"]
    assert (
        len(browser.find_elements("css selector", "#loglog .numbers-on-edges span")) > 3
    )
    chains(browser).double_click(plot).perform()
    assert ask(browser, view) == whole


def test_a_double_click_shows_a_line_alone_and_again_all_of_them(visit, chains):
    browser = visit("tuned-walkers", anchor="#loglog")
    pressed = "[...document.querySelectorAll('#loglog .legend button')].map(b => b.getAttribute('aria-pressed'))"
    button = one(browser, "#loglog .legend button:nth-child(2)")
    browser.execute_script("arguments[0].scrollIntoView({ block: 'center' })", button)
    chains(browser).double_click(button).perform()
    shown = ask(browser, pressed)
    assert shown[1] == "true" and set(shown[:1] + shown[2:]) == {"false"}
    chains(browser).double_click(button).perform()
    assert set(ask(browser, pressed)) == {"true"}


def test_a_table_shows_six_columns_and_digits_and_all_on_request(visit):
    browser = visit("transition", anchor="#fits")
    seen = """[...document.querySelectorAll('#fits table')].map(table =>
        [...table.tHead.rows[0].cells].filter(cell => getComputedStyle(cell).display !== 'none').length)"""
    before, digits = (
        ask(browser, seen),
        "document.querySelector('#fits td.num data').textContent.length",
    )
    assert max(before) == 6
    one(browser, "#fits .scroll + .save").click()
    assert ask(browser, seen)[0] > 6
    cells = "[...document.querySelectorAll('#fits table:first-of-type data')]"
    long = f"Math.max(...{cells}.map(d => d.textContent.length))"
    assert ask(browser, long) > 12
    one(browser, "#fits .scroll + .save").click()
    assert ask(browser, seen) == before and ask(browser, digits) < 12


def test_a_button_copies_the_command(visit):
    browser = visit("transition", anchor="#reproduce")
    button = one(browser, "#reproduce .copy")
    browser.execute_script("arguments[0].scrollIntoView({ block: 'center' })", button)
    button.click()
    assert button.text in ("Copied", "Selected")
    assert ask(browser, "getSelection().toString()").startswith(
        "gaitsweep run transition.toml"
    )


def test_claims_are_folded_on_a_phone_and_open_at_their_address(visit):
    browser = visit("ledger", 390)
    shown = "[...document.querySelectorAll('.claim')].filter(c => c.querySelector('.how').offsetParent).map(c => c.id)"
    assert ask(browser, shown) == []
    one(browser, "#E2 .unfold").click()
    assert ask(browser, shown) == ["E2"]
    assert ask(visit("ledger", 390, anchor="#E4"), shown) == ["E4"]
    assert len(ask(visit("ledger"), shown)) == 4


def test_beside_a_page_stand_the_others(visit):
    browser = visit("transition")
    links = browser.find_elements("css selector", "header.top nav a")
    assert all(link.is_displayed() for link in links) and len(links) == 7
    wide = ask(browser, "document.querySelector('main').getBoundingClientRect().right")
    assert wide == ask(browser, "document.documentElement.clientWidth")
    narrow = visit("transition", 390).find_elements("css selector", "header.top nav a")
    assert sum(link.is_displayed() for link in narrow) == 2


def test_all_pages_are_in_one_file(opened, archives_bundled):
    browser = opened(archives_bundled)
    assert one(browser, "h1").text == "Gait sweeps of passive dynamic walkers"
    browser.get(one(browser, ".cards a").get_attribute("href"))
    assert "?" in browser.current_url and one(browser, "svg .axis, .plot svg")
    browser.get(f"{archives_bundled.as_uri()}?ledger#E4")
    assert one(browser, ".claim:target h3").text.startswith("E4")
    link = one(browser, "#E4 .how a").get_attribute("href")
    browser.get(link)
    assert one(browser, f"#{link.partition('#')[2]} .plot").is_displayed()
    assert (
        ask(browser, "document.querySelectorAll('.plot .tools').length") > 0
    )  # the page's own script ran
    assert [entry["message"] for entry in browser.get_log("browser")] == []


def test_the_search_of_the_index_leads_to_findings_and_claims(opened, report):
    browser = opened(report / "index.html")
    script = """const box = document.querySelector('.search input');
        box.value = arguments[0]; box.dispatchEvent(new Event('input', { bubbles: true }));
        return [...document.querySelectorAll('#found li:not([hidden]) a')].map(a => a.getAttribute('href'));"""

    assert "ledger.html#E4" in browser.execute_script(script, "E4")
    assert "design.html#design" in browser.execute_script(script, "smallest slope")
    assert browser.execute_script(script, "no such word") == []
    assert browser.execute_script(script, "") == []


@pytest.mark.parametrize("page", ["transition", "detuning"])
def test_figures_fit_a_phone(opened, report, page):
    """Those with long words keep their size, and are moved sideways in their frames."""
    browser = opened(report / f"{page}.html", 390)
    ends = (
        "[...document.querySelectorAll('{}')].map(p => p.getBoundingClientRect().right)"
    )

    plots = ask(browser, ends.format(".plot:not(.wide)"))
    frames = ask(browser, ends.format(".frame"))

    assert plots and max(plots) <= 390
    assert max(frames) <= 390
    scrolled = "[...document.querySelectorAll('.frame:has(> .wide)')].map(f => getComputedStyle(f).overflowX)"
    assert set(ask(browser, scrolled)) <= {"auto"}
    assert ask(browser, "document.documentElement.scrollWidth") <= 390


@pytest.mark.thorough
def test_the_cells_of_figure_10_stand_below_each_other_on_a_phone(opened, tmp_path):
    columns = ["short-step scaling", "long-step scaling", "faster gait", "chaos"]
    cells = {
        "walker": np.repeat(["A", "B"], len(columns)),
        "column": columns * 2,
        "slopes": ["vanishing"] * 8,
        "printed": ["P ∝ v⁴, θ* ∝ γ¹ᐟ³"] * 8,
        "computed": ["P ∝ v^4.012, θ* ∝ γ^0.3294"] * 8,
        "verdict": ["reproduced"] * 8,
    }
    study = 'name = "f"\nwalker = ["A", "B"]\n[axes]\nslope = [0.01]\n'
    tables = {"figure10_cells": cells}
    archive = write(tmp_path / "f.nc", study, {}, {}, {"A": POINT, "B": POINT}, tables)
    page = pages.write([archive], tmp_path / "out")

    places = """[...document.querySelectorAll('td.lines')]
        .map(cell => cell.getBoundingClientRect())"""
    narrow = ask(opened(page, 390), f"{places}.map(b => [b.top, b.right])")
    heads = ask(
        opened(page, 390),
        """[...document.querySelectorAll('td.lines')]
        .map(cell => cell.dataset.of)""",
    )
    wide = ask(opened(page, 1280), f"{places}.map(b => b.top)")

    assert len(narrow) == 8
    assert len({top for top, _ in narrow}) == 8
    assert max(right for _, right in narrow) <= 390
    assert heads == columns * 2
    assert len(set(wide)) == 2


@pytest.mark.parametrize("page", ["transition", "detuning"])
def test_words_of_a_figure_and_its_legend_fit_a_phone(opened, report, page):
    browser = opened(report / f"{page}.html", 390)
    words = (
        "[...document.querySelectorAll('.plot:not(.wide) svg text, .plot p.told span')]"
    )
    shown = f"{words}.map(t => t.getBoundingClientRect()).filter(b => b.width)"
    assert ask(browser, f"{shown}.filter(b => b.left < 0 || b.right > 390).length") == 0
    # Below the figure, not in it; on a wide page the other way round.
    heights = "['svg .told', 'p.told'].map(s => document.querySelector(s).getBoundingClientRect().height > 0)"
    assert ask(browser, heights) == [False, True]
    assert ask(opened(report / f"{page}.html", 1280), heights) == [True, False]


def test_on_paper_a_figure_stands_with_its_heading_and_provenance_is_left_out(
    opened, report
):
    browser = opened(report / "transition.html")
    browser.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": "print"})
    script = """return [...document.querySelectorAll('section[aria-labelledby]')].map(s =>
        [getComputedStyle(s).display, s.querySelector('h2') !== null && s.querySelector('.plot') !== null])"""

    sections = browser.execute_script(script)

    assert sections and all(one == ["inline-block", True] for one in sections)
    shown = "return getComputedStyle(document.querySelector('#provenance')).display"
    assert browser.execute_script(shown) == "none"
    browser.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": ""})
