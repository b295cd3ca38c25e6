"""The live page: a click makes a gait walk, and one selection is shared by figures,
tables, walker and address.
"""

import itertools
import json
import re
import shlex
import time
from pathlib import Path

import numpy as np
import pytest

from gaitsweep import gaits, load
from gaitsweep.pipeline.cli import commands

pytestmark = pytest.mark.thorough

EVERY = (
    "curves",
    "branches",
    "flips",
    "map",
    "ratios",
    "cube",
    "design",
    "basin",
    "kneed-basin",
    "orbits",
    "index",
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


def part(browser, name):
    return one(browser, f"[data-part={name}]")


def ask(browser, script, *given):
    return browser.execute_script(f"return {script}", *given)


def wait(browser, script, seconds=6.0):
    """Value of a script once it is true."""
    end = time.monotonic() + seconds
    while not (value := ask(browser, script)) and time.monotonic() < end:
        time.sleep(0.05)
    return value


def data(browser, figure, name):
    """Marks or maps of a figure."""
    found = json.loads(
        ask(browser, f"document.querySelector('#{figure} script.{name}').textContent")
    )
    for part in found if name == "panels" else ():
        for side in "xy":
            part[side].setdefault("values", found[0][side].get("values"))
    return found


def click(browser, chains, figure, point):
    """Click a figure at a point of its picture."""
    plot = one(browser, f"#{figure} .plot")
    browser.execute_script("arguments[0].scrollIntoView({ block: 'start' })", plot)
    box, width = plot.rect, float(plot.get_attribute("data-width"))
    x, y = (round(v * box["width"] / width) for v in point)
    place = round(x - box["width"] / 2), round(y - box["height"] / 2)
    chains(browser).move_to_element_with_offset(plot, *place).click().perform()


def selected(browser):
    """Selection in the address: its keys and values, numbers as numbers."""
    pairs = ask(browser, "[...new URLSearchParams(location.hash.slice(1))]")
    return {key: value if key == "walker" else float(value) for key, value in pairs}


HASH = "location.hash.includes('stance_angle')"
LEG = "document.querySelector('[data-part=walk] g g path:nth-of-type(2)').getAttribute('d')"


@pytest.mark.parametrize("name", EVERY)
@pytest.mark.parametrize(("width", "scheme"), [(1280, "light"), (390, "dark")])
def test_a_page_whose_gaits_walk_opens_without_a_word_and_fits_its_width(
    walk, name, width, scheme
):
    browser = walk(name, width, scheme)
    assert ask(browser, "document.documentElement.scrollWidth") <= width
    assert [entry["message"] for entry in browser.get_log("browser")] == []


@pytest.mark.parametrize("name", ["index", "curves", "branches"])
def test_the_walker_walks_pauses_slows_and_steps(walk, name):
    browser = walk(name)
    play, step = (one(browser, f"[data-do={what}]") for what in ("play", "step"))
    still = ask(browser, LEG)
    step.click()
    stepped = ask(browser, LEG)
    assert stepped != still
    time.sleep(0.2)
    assert ask(browser, LEG) == stepped
    clock = "document.querySelector('[data-part=clock]').textContent"
    rates = []
    for pace in ("1", "10"):
        browser.execute_script(
            "arguments[0].value = arguments[1]", part(browser, "pace"), pace
        )
        play.click()
        assert play.text == "Pause" and play.get_attribute("aria-pressed") == "true"
        first = _seconds(ask(browser, clock))
        time.sleep(0.8)
        play.click()
        rates.append(_seconds(ask(browser, clock)) - first)
    assert rates[0] > 4 * rates[1] > 0
    paused = ask(browser, LEG)
    time.sleep(0.2)
    assert ask(browser, LEG) == paused


def _seconds(clock):
    """Time since the first step from `step 2, 0.31 of 0.76 s`, in units of that text."""
    step, now, whole = (float(v) for v in re.findall(r"[\d.]+", clock)[:3])
    return (step - 1) * whole + now


def test_the_units_of_a_walker_can_be_left_for_those_of_its_leg(walk):
    browser = walk("branches")
    metres = float(part(browser, "facts").text.split("step length")[1].split()[0])
    browser.execute_script("arguments[0].value = 'leg'; arguments[0].dispatchEvent(new Event('change'))",
                           part(browser, "units"))  # fmt: skip
    text = part(browser, "facts").text
    assert float(text.split("step length")[1].split()[0]) == pytest.approx(
        metres / 0.806136, rel=1e-3
    )
    assert "√(leg/g)" in text


def test_a_click_on_a_curve_makes_that_gait_walk_and_marks_it_everywhere(walk, chains):
    browser = walk("curves")
    curve = data(browser, "loglog", "marks")[1]
    row = curve["rows"][20]
    click(browser, chains, "loglog", row[:2])
    assert wait(browser, HASH)
    found = selected(browser)
    assert found["walker"] == "E" and found["slope"] == pytest.approx(row[2], rel=1e-7)
    solved = gaits(
        "E",
        row[2],
        foot_mass_ratio=found["foot_mass_ratio"],
        variables=["stance_angle"],
    ).stance_angle
    assert np.nanmin(abs(solved / found["stance_angle"] - 1)) < 1e-4
    assert str(row[2]) in part(browser, "command").text
    assert (
        f"foot_mass_ratio={found['foot_mass_ratio']}" in part(browser, "command").text
    )
    assert ask(browser, "document.querySelectorAll('.ring:not([hidden])').length") == 2
    assert (
        len(
            browser.find_elements(
                "css selector", "[data-part=circle] [data-multiplier]"
            )
        )
        == 3
    )
    assert (
        "Energy lost per step" in part(browser, "losses").text
        and "ssumption" in part(browser, "violations").text
    )
    # The radius beside it is that of the figure of multipliers at the same slope.
    shown = float(part(browser, "facts").text.split("max |λ|")[1].split()[0])
    others = [r for c in data(browser, "multipliers", "marks") if c["label"].startswith(curve["label"].split(" · ")[0])
              for r in c["rows"] if r[2] == row[2]]  # fmt: skip
    assert any(
        float(r[4].replace("−", "-")) == pytest.approx(shown, rel=1e-4) for r in others
    )
    first = ask(browser, LEG)
    time.sleep(0.3)
    assert ask(browser, LEG) != first


def test_every_point_of_a_curve_over_a_key_walks_as_the_walker_there(walk, chains):
    browser = walk("flips")
    # A gait walks before anything is asked.
    assert part(browser, "title").text.startswith("Long-step gait of walker A")
    curve, *_ = data(browser, "curves", "marks")
    for row in curve["rows"][::6]:
        click(browser, chains, "curves", row[:2])
        command = part(browser, "command").text

        assert command == row[2]
        words = shlex.split(command)
        key, value = words[words.index("--set") + 1].split("=")
        found = selected(browser)
        assert found[key] == pytest.approx(float(value), rel=1e-9)
        assert found["slope"] == pytest.approx(float(words[-1]), rel=1e-9)
        # At a flip of the walker of that detuning, and of no other, a multiplier is -1.
        radius = part(browser, "facts").text.split("max |λ|")[1].split("stable")[0]
        assert float(radius.split()[0]) == pytest.approx(1, abs=1e-4)
        ring = ask(browser, "document.querySelector('#curves .ring').style.left")
        scale = ask(browser, "document.querySelector('#curves .plot').clientWidth")
        width = one(browser, "#curves .plot").get_attribute("data-width")
        assert float(ring[:-2]) == pytest.approx(row[0] * scale / float(width), abs=1)


def test_a_selection_can_be_sent(walk, chains):
    browser = walk("branches")
    row = data(browser, "locus", "marks")[0]["rows"][30]
    click(browser, chains, "locus", row[:2])
    assert wait(browser, HASH)
    address, title = ask(browser, "location.hash"), part(browser, "facts").text
    assert walk("branches", anchor=address) is browser
    assert wait(browser, "document.querySelector('.motion.docked') !== null")
    assert part(browser, "facts").text == title


@pytest.mark.parametrize(
    "address",
    ["#walker=C&detuning=0.1&slope=0.02&stance_angle=0.9", "#walker=Z&slope=0.02&stance_angle=0.2",
     "#walker=C&detuning=0.1&slope=-1&stance_angle=0.2", "#walker=C&detuning=0.1&slope=x&stance_angle=y",
     "#slope=1e999&stance_angle=0"],
)  # fmt: skip
def test_an_address_that_names_no_gait_says_so_and_shows_another(walk, address):
    browser = walk("branches", anchor=address)
    said = wait(browser, "document.querySelector('[data-part=said]').textContent")
    assert "Shown is another gait of this page." in said
    assert "step gait of walker C" in part(browser, "title").text
    assert [entry["message"] for entry in browser.get_log("browser")] == []


@pytest.mark.parametrize(
    ("page", "address", "angle"),
    [("branches", "slope=0.02&stance_angle=0.267", 0.266759283),
     ("branches", "slope=0.02", 0.266759283),
     ("branches", "slope=0.02&stance_angle=0.2668&stance_rate=-1.12&thigh_rate=-0.735", 0.266759283)],
)  # fmt: skip
def test_an_address_typed_by_hand_is_solved_before_anything_is_said(
    walk, page, address, angle
):
    browser = walk(page, anchor=f"#walker=C&detuning=0.1&{address}")

    assert wait(browser, "location.hash.includes('stance_angle=0.266759')")

    assert selected(browser)["stance_angle"] == pytest.approx(angle, rel=1e-6)
    facts = part(browser, "facts").text
    assert "0.266759" in facts and "stable" in facts
    assert part(browser, "said").text == ""


@pytest.mark.parametrize(
    ("page", "address", "said"),
    [("ends", "walker=physical&slope=0.01", "this line has no gait: its gaits are at slopes from 0.0191"),
     ("ends", "walker=physical&slope=0.01&stance_angle=0.2", "this line has no gait"),
     ("ends", "walker=nobody&slope=0.03", "no line with walker = nobody"),
     ("ends", "walker=physical&slope=", "no valid value for slope. It may be cut off."),
     ("ends", "walker=physical&slope=0.03&stance_angle=0.2&stance_rate=-", "no valid value for stance_rate."),
     ("ends", "walker=physical&slope=-1", "Nothing drives this walker at slope −1"),
     ("branches", "walker=C&slope=0.02", "The address does not give detuning."),
     ("design", "walker=A&R=0.2&slope=0.02", "The address does not give c_t."),
     ("design", "walker=A&R=0.2&c_t=0.084&slope=0.49", "No gait was found at slope 0.49."),
     ("map", "walker=B&R=0.123&slope=0.02", "R = 0.123 is not on the map: its nearest value is 0.12.")],
)  # fmt: skip
def test_an_address_that_matches_nothing_says_what_the_page_has(
    walk, page, address, said
):
    browser = walk(page, anchor=f"#{address}")

    words = wait(browser, "document.querySelector('[data-part=said]').textContent")

    assert said in words and words.endswith("Shown is another gait of this page.")


@pytest.mark.parametrize(
    ("page", "at", "keys"),
    [("orbits", "walker=C", {}), ("basin", "walker=D", {}),
     ("design", "walker=A&R=0.2&c_t=0.12", {"R": 0.2, "c_t": 0.12})],
)  # fmt: skip
def test_an_address_of_any_slope_is_solved_where_no_branch_is_stored(
    walk, page, at, keys
):
    browser = walk(page, anchor=f"#{at}&slope=0.013")

    found = wait(browser, "location.hash.includes('stance_angle') && location.hash")

    assert part(browser, "said").text == ""
    assert "slope=0.013" in found
    long = gaits(at[7], 0.013, **keys).stance_angle.sel(gait="long")
    assert selected(browser)["stance_angle"] == pytest.approx(float(long), rel=1e-6)


def test_a_motion_that_begins_at_a_gait_stays_there(walk):
    long = gaits("D", 0.0126).sel(gait="long")
    rates = f"stance_rate={float(long.stance_rate)}&thigh_rate={float(long.thigh_rate)}"
    address = f"stance_angle={float(long.stance_angle)}&{rates}&free=1"

    browser = walk("basin", anchor=f"#walker=D&slope=0.0126&{address}")

    said = wait(browser, "document.querySelector('[data-part=outcome]').textContent")
    assert said == "It stays within 1 % of the gait."


def test_a_walker_may_be_named_as_the_page_calls_it(walk):
    browser = walk("pair", anchor="#walker=F&slope=0.01")

    assert wait(browser, "location.hash.includes('foot_mass_ratio=0.05')")

    assert part(browser, "title").text.endswith("walker F (E with ρ = 0.05)")


def test_a_row_of_a_table_walks(walk):
    browser = walk("branches")
    button = browser.find_elements("css selector", "tr[data-gait] .walk-it")[-1]
    browser.execute_script(
        "arguments[0].scrollIntoView({ block: 'center' }); arguments[0].click()", button
    )
    assert wait(browser, HASH)
    row = one(browser, "tr.chosen")
    given = dict(pair.split("=") for pair in row.get_attribute("data-gait").split("&"))
    assert selected(browser)["slope"] == pytest.approx(float(given["slope"]), rel=1e-4)
    assert selected(browser)["stance_angle"] == pytest.approx(
        float(given["stance_angle"]), rel=1e-3
    )


def test_the_end_of_a_branch_walks(walk):
    browser = walk("ends")
    rows = browser.find_elements("css selector", "tr[data-gait]")
    row = next(row for row in rows if "kneestrike and heelstrike coincide" in row.text)
    browser.execute_script("arguments[0].querySelector('.walk-it').click()", row)
    assert wait(browser, HASH)
    end = dict(pair.split("=") for pair in row.get_attribute("data-gait").split("&"))
    assert selected(browser)["slope"] == pytest.approx(float(end["slope"]), rel=1e-4)


def test_a_branch_is_slid_along_through_its_folds(walk, keys):
    browser = walk("branches", anchor="#motion")
    slide = part(browser, "slide")
    last = int(slide.get_attribute("max"))
    labels, slopes = set(), []
    for place in range(1, last, 4):
        browser.execute_script("arguments[0].value = arguments[1]; arguments[0].dispatchEvent(new Event('input'))",
                               slide, place)  # fmt: skip
        time.sleep(0.12)
        labels.add(part(browser, "title").text.split()[0])
        slopes.append(float(part(browser, "facts").text.split("slope γ")[1].split()[0]))
    turns = sum(
        (b - a) * (c - b) < 0
        for a, b, c in zip(slopes, slopes[1:], slopes[2:], strict=False)
    )
    assert labels == {"Long-step", "Short-step"}
    assert turns >= 1
    assert part(browser, "said").text == ""
    one(browser, ".motion").send_keys(keys.ARROW_LEFT)
    time.sleep(0.4)
    assert (
        float(part(browser, "facts").text.split("slope γ")[1].split()[0]) != slopes[-1]
    )


def test_a_stable_gait_recovers_from_a_push_and_a_hard_one_makes_it_fall(walk):
    browser = walk(
        "branches", anchor="#motion", still=True
    )  # what follows depends on the moment of the push
    assert "unstable" not in part(browser, "facts").text
    browser.execute_script(
        "for (let k = 0; k < 10; k++) arguments[0].click()",
        one(browser, "[data-do=step]"),
    )
    one(browser, "[data-do=push]").click()
    assert "recovers" in part(browser, "outcome").text
    one(browser, "[data-do=reset]").click()
    assert part(browser, "outcome").text == ""
    browser.execute_script("arguments[0].value = '0.3'", part(browser, "strength"))
    one(browser, "[data-do=pull]").click()
    assert (
        "fall" in part(browser, "outcome").text
        or "fell" in part(browser, "outcome").text
    )


def test_what_has_fallen_begins_again_when_it_is_pushed(walk):
    browser = walk("branches", anchor="#motion", still=True)
    browser.execute_script("arguments[0].value = '0.3'", part(browser, "strength"))
    one(browser, "[data-do=pull]").click()
    assert "fell" in part(browser, "outcome").text
    browser.execute_script(
        "for (let k = 0; k < 2000; k++) arguments[0].click()",
        one(browser, "[data-do=step]"),
    )
    browser.execute_script("arguments[0].value = '0.01'", part(browser, "strength"))
    one(browser, "[data-do=push]").click()
    assert "recovers" in part(browser, "outcome").text
    assert part(browser, "clock").text.startswith("step 1, 0.00")


def test_escape_closes_the_docked_panel_from_anywhere(walk, chains, keys):
    browser = walk("curves", still=True)
    click(
        browser, chains, "loglog", data(browser, "loglog", "marks")[0]["rows"][20][:2]
    )
    docked = "document.querySelector('.motion').classList.contains('docked')"
    assert wait(browser, docked)
    chains(browser).send_keys(keys.ESCAPE).perform()
    assert not ask(browser, docked)


def test_an_unstable_gait_is_not_said_to_recover(walk):
    address = "#walker=C&detuning=0.1&slope=0.076987184&stance_angle=0.43751088"
    browser = walk("branches", anchor=address, still=True)
    radius = float(
        wait(browser, "document.querySelector('[data-part=facts]').textContent").split(
            "max |λ|"
        )[1][:5]
    )
    assert 1 < radius < 1.01
    browser.execute_script("arguments[0].value = '0.01'", part(browser, "strength"))
    one(browser, "[data-do=push]").click()
    assert "within 1 % of this unstable gait" in part(browser, "outcome").text


def test_steps_are_counted_on_when_a_pushed_walker_is_pushed_again(walk):
    browser = walk("branches", anchor="#motion", still=True)
    clock, step = (
        "document.querySelector('[data-part=clock]').textContent",
        one(browser, "[data-do=step]"),
    )
    for pushes in range(2):
        browser.execute_script(
            "for (let k = 0; k < 50; k++) arguments[0].click()", step
        )  # two steps and a little
        before = ask(browser, clock).split(",")[0]
        assert before == f"step {2 * pushes + 3}"
        one(browser, "[data-do=push]").click()
        assert ask(browser, clock).split(",")[0] == before


def test_two_gaits_at_one_slope_are_laid_over_each_other(walk):
    browser = walk("curves", anchor="#motion")
    assert wait(
        browser, "document.querySelectorAll('[data-part=second] option').length > 1"
    )
    circles = "document.querySelectorAll('[data-part=circle] [data-multiplier]').length"
    before = ask(browser, circles)
    browser.find_elements("css selector", "[data-part=second] option")[1].click()
    assert ask(browser, circles) == 2 * before
    drawn = "[...document.querySelectorAll('[data-part=walk] g > g')].filter(g => g.style.display !== 'none').length"
    assert ask(browser, drawn) == 2


@pytest.mark.parametrize(
    ("name", "walker", "key"), [("map", "B", "R"), ("ratios", "E", "foot_mass_ratio")]
)
def test_a_cell_of_a_map_walks_as_the_solver_has_it(walk, chains, name, walker, key):
    browser = walk(name)
    maps = data(browser, "heatmap", "panels")
    assert len(json.dumps(maps)) < 25_000
    # The right map first: what is said of a cell stands to its right.
    for panel, label, share in zip(
        maps[::-1], ("Short", "Long"), (0.31, 0.62), strict=True
    ):
        left, top, right, bottom = panel["box"]
        click(
            browser,
            chains,
            "heatmap",
            (left + share * (right - left), top + 0.41 * (bottom - top)),
        )
        is_titled = f"document.querySelector('[data-part=title]').textContent.startsWith('{label}')"
        assert wait(browser, is_titled), (
            part(browser, "title").text,
            part(browser, "said").text,
        )
        found = selected(browser)
        column = round(share * (len(panel["x"]["values"]) - 1))
        assert any(
            found["slope"] == pytest.approx(v, rel=1e-7)
            for v in panel["x"]["values"][column - 1 : column + 2]
        )
        row = min(panel["y"]["values"], key=lambda value: abs(value - found[key]))
        assert found[key] == pytest.approx(row, rel=1e-9)
        gait = gaits(
            walker, found["slope"], variables=["stance_angle"], **{key: row}
        ).sel(gait=label.lower())
        assert found["stance_angle"] == pytest.approx(
            float(gait.stance_angle), rel=1e-6
        )
        assert f"--set {key}={row}" in part(browser, "command").text


def test_a_cell_of_a_design_map_walks_as_the_fastest_stable_gait(walk, chains):
    browser = walk("design")
    left, top, right, bottom = data(browser, "design", "panels")[2]["box"]
    click(
        browser,
        chains,
        "design",
        (left + 0.5 * (right - left), top + 0.5 * (bottom - top)),
    )
    assert wait(browser, HASH)
    found = selected(browser)
    wanted = gaits(
        "A",
        found["slope"],
        R=found["R"],
        c_t=found["c_t"],
        variables=["stance_angle", "spectral_radius"],
    )
    assert found["stance_angle"] == pytest.approx(
        float(wanted.stance_angle.sel(gait="long")), rel=1e-6
    )
    assert float(part(browser, "facts").text.split("max |λ|")[1].split()[0]) <= 1


def test_the_address_of_a_cell_of_a_design_map_leads_to_its_gait(walk, chains):
    browser = walk("design")
    left, top, right, bottom = data(browser, "design", "panels")[2]["box"]
    click(
        browser,
        chains,
        "design",
        (left + 0.5 * (right - left), top + 0.1 * (bottom - top)),
    )
    assert wait(browser, HASH)
    address, facts = ask(browser, "location.hash"), part(browser, "facts").text
    walk("design", anchor=address)
    assert wait(browser, "document.querySelector('.motion.docked') !== null")
    assert part(browser, "said").text == "" and part(browser, "facts").text == facts


@pytest.mark.parametrize("name", ["basin", "kneed-basin"])
def test_a_pixel_of_a_basin_walks_on_or_falls_as_the_archive_says(walk, chains, name):
    browser = walk(name)
    left, top, right, bottom = data(browser, "basin", "panels")[0]["box"]
    said = []
    for across, down in itertools.product(np.linspace(0.1, 0.9, 5), repeat=2):
        click(
            browser,
            chains,
            "basin",
            (left + across * (right - left), top + down * (bottom - top)),
        )
        time.sleep(0.15)
        archived = (
            one(browser, "#basin .tip").find_elements("css selector", "dd")[-1].text
        )
        text, falls = (
            part(browser, "outcome").text,
            archived.startswith(("fell", "foot", "knee")),
        )
        said.append(falls)
        assert (
            archived in text.replace("the ", "")
            if falls
            else "walks" in text or "recovers" in text
        ), archived
        one(browser, "[data-do=close]").click()
    assert set(said) == {True, False}


@pytest.mark.parametrize("name", ["basin", "kneed-basin"])
def test_the_pixel_chosen_of_a_basin_is_marked_where_it_was_clicked(walk, chains, name):
    browser = walk(name, 900)
    left, top, right, bottom = data(browser, "basin", "panels")[0]["box"]
    point = left + 0.4 * (right - left), top + 0.7 * (bottom - top)
    click(browser, chains, "basin", point)
    assert wait(browser, HASH)
    ring, width = (
        one(browser, "#basin .ring"),
        float(one(browser, "#basin .plot").get_attribute("data-width")),
    )
    scale = one(browser, "#basin .plot").rect["width"] / width
    found = [
        float(ring.value_of_css_property(side).removesuffix("px")) / scale
        for side in ("left", "top")
    ]
    assert found == pytest.approx(point, abs=4)


def test_a_dot_of_an_orbit_goes_on_as_it_was(walk, chains):
    browser = walk("orbits")
    rows = data(browser, "bifurcation", "marks")[0]["rows"]
    click(browser, chains, "bifurcation", rows[-3][:2])
    assert wait(browser, HASH)
    assert selected(browser)["free"] == 1
    assert (
        "still walks" in part(browser, "outcome").text
        or "recovers" in part(browser, "outcome").text
    )


def test_a_gait_of_two_steps_walks(walk, chains, capsys):
    """Its steps take turns, as those of the command do that the page shows."""
    browser = walk("two-steps")
    click(browser, chains, "linear", data(browser, "linear", "marks")[0]["rows"][2][:2])
    assert wait(browser, HASH) and selected(browser)["free"] == 1
    assert wait(browser, "document.querySelector('[data-part=outcome]').textContent")
    assert (
        "61 steps" in part(browser, "outcome").text
        or "still walks" in part(browser, "outcome").text
    )
    assert (
        commands.main([*shlex.split(part(browser, "command").text)[1:], "--json"]) == 0
    )
    angles = json.loads(capsys.readouterr().out)["stance_angle"]
    assert (
        angles[2] == pytest.approx(angles[0], rel=1e-9)
        and abs(angles[1] - angles[0]) > 0.01
    )


def test_the_command_of_a_motion_from_any_state_makes_the_same_motion(walk, capsys):
    ends = set()
    for angle, rate in ((0.3, -0.01), (0.3, -0.3), (0.22, -0.22), (0.15, -0.3)):
        browser = walk(
            "basin",
            anchor=f"#walker=D&slope=0.0126&stance_angle={angle}&stance_rate={rate}&free=1",
        )
        said = wait(
            browser, "document.querySelector('[data-part=outcome]').textContent"
        )
        program, *words = part(browser, "command").text.split()
        assert program == "gaitsweep" and commands.main([*words, "--steps", "60"]) == 0
        if fell := re.fullmatch(
            r"Step (\d+): (.*)\.", capsys.readouterr().out.splitlines()[-1]
        ):
            steps = int(fell[1])
            begins = f"After {steps} step" if steps else "In its first step"
            assert said.startswith(begins) and said.endswith(f"{fell[2]}."), (
                said,
                fell[0],
            )
        else:
            assert "60 steps" in said or "recovers" in said
        ends.add(bool(fell))
    assert ends == {True, False}


def test_a_motion_that_falls_at_once_says_so(walk):
    address = "#walker=D&slope=0.0126&stance_angle=0.3&stance_rate=-0.01&free=1"
    browser = walk("basin", anchor=address)
    assert "In its first step it fell backward." in wait(
        browser, "document.querySelector('[data-part=outcome]').textContent"
    )
    one(browser, "[data-do=play]").click()
    time.sleep(0.3)
    assert [entry["message"] for entry in browser.get_log("browser")] == []


def test_reduced_motion_is_honoured_and_keys_play_it(walk, chains, keys):
    browser = walk("curves", still=True)
    row = data(browser, "loglog", "marks")[0]["rows"][20]
    click(browser, chains, "loglog", row[:2])
    assert wait(browser, HASH)
    still = ask(browser, LEG)
    time.sleep(0.3)
    assert ask(browser, LEG) == still
    one(browser, ".motion").send_keys(" ")
    time.sleep(0.3)
    assert ask(browser, LEG) != still
    one(browser, ".motion").send_keys(keys.ESCAPE)
    assert ask(browser, "document.querySelector('.docked')") is None


def test_the_walker_is_drawn_thirty_times_a_second(walk):
    browser = walk("branches", anchor="#motion")
    one(browser, "[data-do=play]").click()
    frames = "Number(document.querySelector('.motion').dataset.frames ?? 0)"
    wait(browser, frames)
    begin, first = time.monotonic(), ask(browser, frames)
    time.sleep(2)
    assert (ask(browser, frames) - first) / (time.monotonic() - begin) >= 30


def test_a_phones_touch_selects(walk):
    browser = walk("curves", 390)
    plot = one(browser, "#loglog .plot")
    browser.execute_script("arguments[0].scrollIntoView({ block: 'start' })", plot)
    row = data(browser, "loglog", "marks")[0]["rows"][5]
    scale = plot.rect["width"] / float(plot.get_attribute("data-width"))
    corner = ask(
        browser,
        "[arguments[0].getBoundingClientRect().left, arguments[0].getBoundingClientRect().top]",
        plot,
    )
    point = {"x": corner[0] + row[0] * scale, "y": corner[1] + row[1] * scale}
    browser.execute_cdp_cmd(
        "Input.dispatchTouchEvent", {"type": "touchStart", "touchPoints": [point]}
    )
    browser.execute_cdp_cmd(
        "Input.dispatchTouchEvent", {"type": "touchEnd", "touchPoints": []}
    )
    assert wait(browser, HASH)
    assert selected(browser)["slope"] == pytest.approx(row[2], rel=1e-7)


def test_a_figure_is_zoomed_moved_and_seen_whole_again(walk, keys, chains):
    browser = walk("curves")
    plot, view = (
        one(browser, "#loglog .plot"),
        "document.querySelector('#loglog svg').getAttribute('viewBox')",
    )
    whole = ask(browser, view)
    browser.execute_script("arguments[0].scrollIntoView({ block: 'start' })", plot)
    plot.send_keys("+")
    zoomed = ask(browser, view)
    assert float(zoomed.split()[2]) == pytest.approx(float(whole.split()[2]) / 1.6)
    # Numbers stand along its edges, for its axes may be out of sight: they rise to the
    # right, and upwards.
    for side, edge in (("x", "left"), ("y", "top")):
        shown = ask(
            browser,
            f"""[...document.querySelectorAll('#loglog .numbers-on-edges span.{side}')].map(
            node => [parseFloat(node.style.{edge}), Number(node.textContent.replace('−', '-'))])""",
        )
        values = [value for _, value in sorted(shown)]
        assert len(values) > 2 and values == sorted(values, reverse=side == "y")
    chains(browser).move_to_element(plot).click_and_hold().move_by_offset(
        60, 20
    ).release().perform()
    moved = ask(browser, view)
    assert moved.split()[2] == zoomed.split()[2] and float(moved.split()[0]) < float(
        zoomed.split()[0]
    )
    assert not ask(browser, HASH)  # a drag is no click
    plot.send_keys("0")
    assert [float(v) for v in ask(browser, view).split()] == [
        float(v) for v in whole.split()
    ]


def test_keys_of_the_browser_itself_are_left_to_it(walk):
    browser = walk("curves")
    pressed = """(() => { const plot = document.querySelector('#loglog .plot'), view = () => plot.querySelector('svg').getAttribute('viewBox'), whole = view();
        const press = given => { const event = new KeyboardEvent('keydown', { bubbles: true, cancelable: true, ...given }); plot.dispatchEvent(event); return event.defaultPrevented; };
        return [press({ key: 'ArrowLeft', altKey: true }), press({ key: '+', ctrlKey: true }), view() === whole]; })()"""  # noqa: E501
    assert ask(browser, pressed) == [False, False, True]


def test_numbers_on_the_edges_of_a_narrow_figure_differ(walk):
    browser = walk("narrow")
    plot = one(browser, "#bifurcation .plot")
    for _ in range(6):
        plot.send_keys("+")
        shown = ask(browser, """[...document.querySelectorAll('#bifurcation .numbers-on-edges span.x')].map(
            node => [parseFloat(node.style.left), Number(node.textContent)])""")  # fmt: skip
        values = [value for _, value in sorted(shown)]
        # Evenly spaced on the picture, evenly spaced as numbers.
        gaps = np.diff(values)
        assert len(gaps) > 1 and gaps.min() > 0.999 * gaps.max() > 0


@pytest.mark.parametrize("ending", ["SVG", "PNG"])
def test_a_figure_is_saved_as_a_picture(walk, ending):
    browser = walk("curves", scheme="dark")
    browser.execute_script("""window.saved = null;
        HTMLAnchorElement.prototype.click = function () { window.saved = [this.download, this.href]; };""")
    button = f"[...document.querySelectorAll('#loglog .save')].find(b => b.textContent === '{ending}')"
    browser.execute_script(f"{button}.click()")
    name, address = wait(browser, "window.saved")
    assert name == f"curves-loglog.{ending.lower()}"
    if ending == "PNG":
        assert address.startswith("data:image/png;base64,") and len(address) > 20_000
    else:
        text = ask(browser, "decodeURIComponent(window.saved[1])")
        assert "var(--" not in text and "#6fb6f0" in text


def test_a_page_without_script_is_complete(opened, walking, browser):
    browser.execute_cdp_cmd("Emulation.setScriptExecutionDisabled", {"value": True})
    try:
        opened(walking / "branches.html")
        assert (
            one(browser, "#locus svg").is_displayed()
            and one(browser, "table.archive").is_displayed()
        )
        assert not one(browser, ".motion").is_displayed()
    finally:
        browser.execute_cdp_cmd(
            "Emulation.setScriptExecutionDisabled", {"value": False}
        )


def test_the_script_and_the_pages_are_small(walking):
    for path in walking.glob("*.html"):
        text = path.read_text(encoding="utf-8")
        script = text[text.rindex("<script>") : text.rindex("</script>")]
        assert len(script.encode()) <= 80_000
        assert len(text.encode()) <= (300_000 if path.name == "index.html" else 500_000)


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_no_serious_accessibility_finding_while_a_gait_walks(walk, scheme):
    axe = pytest.importorskip(
        "axe_core_python", reason="accessibility is checked with axe-core"
    )
    browser = walk(
        "branches",
        scheme=scheme,
        anchor="#walker=C&detuning=0.1&slope=0.02&stance_angle=0.27",
        still=True,
    )
    browser.execute_script(
        (Path(axe.__file__).parent / "axe.min.js").read_text(encoding="utf-8")
    )
    found = browser.execute_async_script("axe.run().then(arguments[0])")
    serious = [f"{v['id']}: {v['nodes'][0]['html'][:120]}" for v in found["violations"]
               if v["impact"] in ("serious", "critical")]  # fmt: skip
    assert serious == []


@pytest.mark.parametrize(
    ("page", "keys"),
    [("map", ["slope", "R"]), ("ratios", ["slope", "foot_mass_ratio"])],
)
def test_sliders_over_the_keys_of_a_map_lead_to_archived_gaits(walk, page, keys):
    browser = walk(page)
    labels = [
        label.text.split(" = ")[0]
        for label in browser.find_elements("css selector", "[data-part=keys] label")
    ]
    assert sorted(labels) == sorted(keys)
    for k in range(2):
        before = ask(browser, "location.hash")
        told = browser.execute_script(
            """const range = document.querySelectorAll("[data-part=keys] input")[arguments[0]];
            range.value = Number(range.value) - 2; range.dispatchEvent(new Event("input"));
            return [range.parentElement.textContent, location.hash];""", k
        )  # fmt: skip
        assert told[1] != before
        name, value = told[0].strip().split(" = ")
        at = dict(part.split("=") for part in told[1].lstrip("#").split("&"))
        assert float(at[name]) == pytest.approx(float(value), rel=1e-3)
        assert (
            "dots: θ* along"
            in browser.find_element("css selector", "[data-part=fit]").text
        )
        assert browser.find_elements(
            "css selector", "#motion .ring, .ring:not([hidden])"
        )


def test_a_slider_over_lines_of_one_key_leads_to_the_same_branch(walk):
    browser = walk("curves")
    script = """const range = document.querySelector("[data-part=keys] input"), seen = [];
        for (let i = 0; i <= Number(range.max); i++) { range.value = i; range.dispatchEvent(new Event("input"));
          seen.push([range.parentElement.textContent, document.querySelector("[data-part=title]").textContent]); }
        return seen;"""
    seen = browser.execute_script(script)
    assert [words.strip() for words, _ in seen] == [
        f"foot_mass_ratio = {value}" for value in (0.02, 0.05, 0.1)
    ]
    assert len({title.split(" gait")[0] for _, title in seen}) == 1


def test_the_gaits_along_a_key_are_dots_one_of_which_is_that_shown(walk):
    browser = walk("map")
    words = browser.find_element("css selector", "[data-part=fit]").text
    assert re.fullmatch(r"dots: θ\* along (?:slope|R)", words)
    radii = ask(
        browser,
        "[...document.querySelectorAll('[data-part=curve] circle')].map(c => c.getAttribute('r'))",
    )
    assert len(radii) in (30, 31) and radii.count("4.5") == 1


def _choose(browser, control, value):
    """Set the control of slices with a title; its other controls stay."""
    script = """const labels = [...document.querySelectorAll(".slices label")],
        label = labels.find(one => one.textContent.startsWith(arguments[0])),
        node = label.querySelector("select, input");
      node.value = node.type === "range" ? arguments[1] : [...node.options].findIndex(one => one.text === arguments[1]);
      node.dispatchEvent(new Event("input"));
      return label.textContent;"""
    return browser.execute_script(script, control, value)


def _cell(browser, place):
    """Click the cell of a slice at a place, across and up; what is said of it."""
    script = """const cells = [...document.querySelectorAll(".slices rect")],
        cell = cells.find(one => one.place?.join() === arguments[0]);
      cell.dispatchEvent(new MouseEvent("click", { bubbles: true }));
      return document.querySelector(".slices output").textContent;"""
    return browser.execute_script(script, ",".join(map(str, place)))


def _numbers(told):
    """Numbers of a sentence, by their titles."""
    pairs = (part.split(" = ") for part in told.split(", "))
    return {title: float(value.replace("−", "-")) for title, value in pairs}


@pytest.mark.parametrize("gait", ["long", "short"])
def test_slices_lead_through_the_axes_that_maps_leave_out(walk, walking, gait):
    browser = walk("cube")
    sweep = load(walking.parent / "cube.nc")
    _choose(browser, "Gait", gait)
    _choose(browser, "Quantity", "period T")
    _choose(browser, "Across", "foot mass ratio ρ")
    assert _choose(browser, "slope", 17).startswith("slope γ (rad) = 0.044")

    told = _numbers(_cell(browser, (9, 2)))

    at = sweep.sel(R=0.2, foot_mass_ratio=0.11, slope=0.044, gait=gait)
    places = {"slope γ (rad)": 0.044, "foot mass ratio ρ": 0.11, "R": 0.2}
    assert told == pytest.approx({**places, "period T": float(at.period)}, rel=1e-3)
    given = dict(
        pair.split("=") for pair in ask(browser, "location.hash")[1:].split("&")
    )
    assert (given["R"], given["foot_mass_ratio"], given["slope"]) == (
        "0.2",
        "0.11",
        "0.044",
    )
    assert float(given["stance_angle"]) == pytest.approx(
        float(at.stance_angle), rel=1e-7
    )
    assert "--set foot_mass_ratio=0.11" in part(browser, "command").text


def test_the_address_of_a_cell_of_a_slice_leads_to_its_gait(walk):
    browser = walk("cube")
    _cell(browser, (11, 1))
    address = ask(browser, "location.hash")

    again = walk("cube", anchor=address)

    assert (
        ask(again, "location.hash").split("&stance_angle")[0]
        == address.split("&stance_angle")[0]
    )
    assert part(again, "said").text == ""
    walk("cube", anchor=address.replace("R=0.2", "R=0.13"))
    assert part(browser, "said").text.startswith("R = 0.13 is not on the map")


def test_slices_are_cut_with_the_keyboard(walk, keys):
    browser = walk("cube")
    slice_ = one(browser, ".slices svg")
    before = _numbers(one(browser, ".slices output").text)

    slice_.send_keys(keys.ARROW_RIGHT)
    slice_.send_keys(keys.ARROW_UP)
    slice_.send_keys(keys.ENTER)

    after = _numbers(one(browser, ".slices output").text)
    assert after["slope γ (rad)"] > before["slope γ (rad)"]
    assert f"slope={after['slope γ (rad)']:g}" in ask(browser, "location.hash")


def test_slices_have_one_scale_of_colours_and_two_different_axes(walk):
    browser = walk("cube")
    bar = "[...document.querySelectorAll('.slices text')].slice(-3).map(one => one.textContent)"
    seen = set()
    for value in range(5):
        _choose(browser, "foot mass ratio", value)
        seen.add(tuple(ask(browser, bar)))
    assert len(seen) == 1

    _choose(browser, "Across", "R")
    chosen = "[...document.querySelectorAll('.slices select')].slice(-2).map(one => one.value)"
    assert len({*ask(browser, chosen)}) == 2
