import re
import time

import pytest

PAGES = ("index", "ledger", "transition", "tuned-walkers", "detuning", "cascade", "design")


@pytest.fixture
def keys():
    return pytest.importorskip("selenium.webdriver.common.keys", reason="the browser tests need selenium").Keys


@pytest.fixture
def chains():
    return pytest.importorskip("selenium.webdriver", reason="the browser tests need selenium").ActionChains


def one(browser, selector):
    return browser.find_element("css selector", selector)


def ask(browser, script):
    return browser.execute_script(f"return {script}")


@pytest.mark.parametrize("name", PAGES)
@pytest.mark.parametrize(("width", "scheme"), [(1280, "light"), (390, "dark")])
def test_a_page_opens_without_a_word_in_the_console_and_fits_its_width(visit, name, width, scheme):
    browser = visit(name, width, scheme)
    assert ask(browser, "document.documentElement.scrollWidth") <= width
    assert [entry["message"] for entry in browser.get_log("browser")] == []


def test_every_link_of_the_index_leads_to_a_page(visit):
    browser = visit("index")
    links = {a.get_attribute("href") for a in browser.find_elements("css selector", "a[href]")}
    assert len(links) > 6
    for link in links:
        browser.get(link)
        assert one(browser, "h1").text
        anchor = link.partition("#")[2]
        assert not anchor or ask(browser, f"document.getElementById({anchor!r}) !== null")


def test_text_and_figures_follow_the_colour_scheme(visit):
    ink = "getComputedStyle(document.querySelector('.plot svg text')).fill"
    ground = "getComputedStyle(document.body).backgroundColor"
    seen = {scheme: [_lightness(ask(visit("transition", scheme=scheme), what)) for what in (ink, ground)]
            for scheme in ("light", "dark")}  # fmt: skip
    assert seen["light"][0] < 60
    assert seen["light"][1] > 240
    assert seen["dark"][0] > 200
    assert seen["dark"][1] < 40


def _lightness(colour: str) -> float:
    return sum(map(int, re.findall(r"\d+", colour)[:3])) / 3


@pytest.mark.parametrize("name", ["index", "transition", "detuning"])
def test_the_walker_walks_pauses_slows_and_steps(visit, name):
    browser = visit(name)
    play, slow, step = (one(browser, f"[data-do={what}]") for what in ("play", "slow", "step"))
    path = "document.querySelector('.walk path:nth-of-type(4)').getAttribute('d')"
    still = ask(browser, path)
    step.click()
    stepped = ask(browser, path)
    assert stepped != still
    time.sleep(0.2)
    assert ask(browser, path) == stepped
    play.click()
    time.sleep(0.3)
    assert ask(browser, path) != stepped
    assert play.text == "Pause"
    slow.click()
    assert slow.get_attribute("aria-pressed") == "true"
    play.click()
    paused = ask(browser, path)
    time.sleep(0.2)
    assert ask(browser, path) == paused


def test_another_gait_can_be_chosen(visit):
    browser = visit("transition")
    colour = "document.querySelector('.walk path:nth-of-type(4)').getAttribute('stroke')"
    assert ask(browser, colour) == "var(--long)"
    one(browser, ".motion select").send_keys("s")
    one(browser, ".motion option:nth-child(2)").click()
    assert ask(browser, colour) == "var(--short)"
    assert "--slope 0.009" in one(browser, ".motion .command").text


@pytest.mark.parametrize(
    ("name", "figure"),
    [("transition", "loglog"), ("transition", "angles"), ("detuning", "locus"), ("cascade", "bifurcation"),
     ("design", "heatmap")],
)  # fmt: skip
def test_a_point_under_the_pointer_says_its_values_and_command(visit, chains, name, figure):
    browser = visit(name, anchor=f"#{figure}")
    plot = one(browser, f"#{figure} .plot")
    x, y = ask(browser, _place(figure))
    box = plot.rect
    chains(browser).move_to_element_with_offset(plot, int(x - box["width"] / 2), int(y - box["height"] / 2)).perform()
    tip = one(browser, f"#{figure} .tip")
    assert tip.is_displayed()
    assert tip.find_elements("css selector", "dd")[0].text
    command = tip.find_element("css selector", "code").text
    assert re.fullmatch(r"gaitsweep solve --walker \w+( --set \S+)* --slope [\d.e-]+", command)
    chains(browser).click().perform()
    assert "pinned" in tip.get_attribute("class")


def _place(figure: str) -> str:
    """Where a mark in the middle of a figure's first curve is, in pixels from the plot's corner."""
    return f"""(() => {{
        const plot = document.querySelector('#{figure} .plot'), scale = plot.clientWidth / plot.dataset.width;
        const rows = JSON.parse(plot.querySelector('script').textContent)[0].rows;
        return rows[rows.length >> 1].slice(0, 2).map(v => v * scale);
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


@pytest.mark.parametrize("name", ["index", "transition"])
def test_a_page_prints(visit, name):
    sheet = visit(name).execute_cdp_cmd("Page.printToPDF", {"printBackground": True})
    assert len(sheet["data"]) > 20_000


def test_small_text_of_figures_stays_legible_on_a_phone(visit):
    browser = visit("transition", 390)
    size = """Math.min(...[...document.querySelectorAll('.plot')].map(plot =>
        parseFloat(getComputedStyle(plot.querySelector('text')).fontSize) * plot.clientWidth / plot.dataset.width))"""
    assert ask(browser, size) > 9
