"""Reference values: what the files hold, and that every way to the numbers that shares
nothing gives the same ones.
"""

import csv
import json
import random
from decimal import Decimal
from pathlib import Path

import numpy as np
import pytest

import extended
from conftest import ROOT
from exact_gaits import GAITS, REFERENCE
from gaitsweep.pipeline.study import files
from gaitsweep.tasks.ledger import write_certificates
from gaitsweep.tasks.studies import prove_gaits
from gaitsweep.tasks.studies.follow_branches import branch
from gaitsweep.tasks.studies.solve_at_slope import solve_one
from gaitsweep.tasks.studies.solve_points import atlas
from gaitsweep.tasks.walkers.resolve import resolve
from lines import some
from oracle import Oracle
from soak import reference

TEXT = (REFERENCE / "gaits.json").read_text()
KEPT = json.loads(TEXT)
ENTRIES = {entry["name"]: entry for entry in KEPT["entries"]}
NUMBERS = [*reference.UNITS, *reference.MULTIPLIERS]
SPECIAL = [entry for entry in KEPT["entries"] if entry["kind"] != "gait"]
RATES = ("stance_rate", "thigh_rate", "shank_rate")


def drawn(count, seed=0):
    gaits = [entry for entry in KEPT["entries"] if entry["kind"] == "gait"]
    return random.Random(seed).sample(gaits, count)


def walker(name, number=float):
    return (
        files.walker(f"{name}.toml", Path(), number=number)
        if name == reference.COMPASS
        else name
    )


def table(name):
    keys = KEPT["walkers"][name]
    return {**keys, "knees": keys["knees"] == "true"}


def room(entry, key):
    """How far the true number may lie from the one printed."""
    return Decimal(entry["radius"].get(key, "0"))


def multipliers(entry):
    """Of the section, largest first."""
    pairs = [
        names
        for names in zip(NUMBERS[7::2], NUMBERS[8::2], strict=True)
        if names[0] in entry
    ]
    return [complex(*(float(entry[name]) for name in names)) for names in pairs]


def test_a_hundred_entries_hold_every_walker_and_kind():
    assert len(ENTRIES) == len(KEPT["entries"]) >= 100
    assert list(ENTRIES) == [name for name, _, _ in reference.asked()]
    assert {entry["kind"] for entry in KEPT["entries"]} == {"gait", "flip", "fold"}
    walkers = {*"ABCDEF", "physical", "physical-straight", reference.COMPASS}
    assert (
        set(KEPT["walkers"])
        == {entry["walker"] for entry in KEPT["entries"]}
        == walkers
    )
    for entry in KEPT["entries"]:
        assert (entry["stable"] is None) is (entry["kind"] != "gait")
        assert len(multipliers(entry)) == (2 if entry["walker"] in "DEF" else 3)
        assert (
            table(entry["walker"])["knees"]
            is ("kneestrike_time" in entry)
            is ("kneestrike" in entry["events"])
        )


def test_every_number_is_printed_to_half_a_unit_and_no_less_than_promised():
    for entry in KEPT["entries"]:
        digits, decimals = reference.DIGITS[entry["kind"]]
        for name in [name for name in NUMBERS if name in entry]:
            value = Decimal(entry[name])
            if name not in entry["radius"]:  # exact
                assert entry[name] == (
                    "0" if name != "slope" else entry["name"].rpartition("-")[2]
                )
                continue
            unit = value.as_tuple().exponent
            assert room(entry, name) == Decimal(5).scaleb(unit - 1)
            if name.startswith("multiplier"):
                assert unit == -decimals
            else:
                assert len(value.as_tuple().digits) == (
                    reference.SLOPE_DIGITS if name == "slope" else digits
                )


def test_the_two_files_agree_and_spreadsheets_compute_nothing():
    text = (REFERENCE / "gaits.csv").read_text()
    assert text == reference.table(KEPT)
    head, *rows = csv.reader(text.splitlines())
    assert (
        len(rows) == len(ENTRIES)
        and "slope [rad]" in head
        and "stance_rate [rad/time]" in head
    )
    names = [name.partition(" [")[0] for name in head]
    for row, entry in zip(rows, KEPT["entries"], strict=True):
        found = dict(zip(names, row, strict=True))
        assert all(found[name] == entry.get(name, "") for name in NUMBERS)
        assert {key: found[key] for key in reference.KEYS} == KEPT["walkers"][
            entry["walker"]
        ]
        assert all(not cell or cell[0] not in "=+@-" or float(cell) < 0 for cell in row)


def test_both_works_are_cited_as_everywhere():
    software, paper = KEPT["about"]["bibtex"]
    citation = (ROOT / "CITATION.cff").read_text()
    assert (
        f"version: {software.partition('version = {')[2].partition('}')[0]}\n"
        in citation
    )
    doi = paper.partition("doi = {")[2].partition("}")[0]
    assert doi and f"doi: {doi}" in citation


@pytest.mark.parametrize(
    ("interval", "place", "found"),
    [
        (("0.12344", "1e-7"), -4, ("0.1234", "5e-5")),
        (
            ("0.12345", "6e-5"),
            -5,
            ("0.12", "5e-3"),
        ),  # 0.12339 to 0.12351: no third digit is that of all
        (("-1.0000", "1e-9"), -8, ("-1.00000000", "5e-9")),
        (("9.9999", "2e-4"), -2, ("10.00", "5e-3")),
        (("0", "1e-9"), -3, ("0.000", "5e-4")),
        (("0", "0"), -3, ("0", "0")),
    ],
)
def test_only_digits_common_to_a_whole_interval_are_printed(interval, place, found):
    assert reference.rounded(*interval, place) == found


def test_certificates_hold_the_same_numbers():
    kept = {
        path.stem: json.loads(path.read_text())
        for path in sorted((REFERENCE / "proofs").glob("*.json"))
    }
    compared = 0
    for entry in KEPT["entries"]:
        name = (
            entry["name"]
            if entry["kind"] == "gait"
            else f"{entry['walker']}-{entry['kind']}"
        )
        box = kept.get(name, {}).get("box", {})
        if "slope" in box and abs(
            Decimal(box["slope"][0]) - Decimal(entry["slope"])
        ) > Decimal("1e-6"):
            continue  # another fold
        for key, (middle, radius) in box.items():
            assert abs(Decimal(middle) - Decimal(entry[key])) <= Decimal(radius) + room(
                entry, key
            ), (name, key)
            compared += 1
        if box:
            assert (
                entry["gait"] == kept[name]["gait"]
                and entry["events"] == kept[name]["events"]
            )
            assert entry["stable"] == kept[name].get("stable")
    assert compared > 90


def test_equations_in_113_bits_give_the_same_digits():
    """The 25 digits of the derivation with momenta and mpmath."""
    compared = 0
    for known in GAITS:
        entry = ENTRIES.get(f"{known['walker']}-{known['gait']}-{known['slope']}")
        for key in [key for key in reference.STATE if entry and key in known]:
            value = Decimal(known[key])
            last = Decimal(2).scaleb(value.adjusted() - 24)
            assert abs(value - Decimal(entry[key])) <= room(entry, key) + last, (
                entry["name"],
                key,
            )
            compared += 1
        if entry:
            exact = [complex(*map(float, pair)) for pair in known["multipliers"]]
            assert [*multipliers(entry), 0, 0][: len(exact)] == pytest.approx(
                exact, abs=6e-10
            )
    assert compared > 80


def agrees_with_the_solver(entry):
    gaits = solve_one(
        {"walker": walker(entry["walker"]), "slope": float(entry["slope"])}
    )["gaits"]
    (found,) = [gait for gait in gaits if gait["gait"] == entry["gait"]]
    assert found["stable"] is entry["stable"]
    rate = max(abs(float(entry[name])) for name in RATES)
    for name in ("stance_angle", *RATES, "period"):
        size = rate if name in RATES else float(entry[name])
        off = abs(Decimal(float(found[name])) - Decimal(entry[name]))
        assert off <= Decimal(found["error_bound"] * size) + room(entry, name), (
            entry["name"],
            name,
        )


def test_the_solver_gives_the_same_gaits_within_its_bound():
    for entry in some(drawn(5)):
        agrees_with_the_solver(entry)


def test_the_solver_gives_all_gaits_within_its_bound():
    for entry in some(drawn(len(KEPT["entries"]) - len(SPECIAL))):
        agrees_with_the_solver(entry)


@pytest.mark.parametrize(
    "name",
    ["A", "B", "C", "D", "F", "physical", "physical-straight", reference.COMPASS],
)
def test_the_solver_gives_the_same_flips_and_folds_within_its_bound(name):
    line = {"walker": walker(name), "set": {}}
    found = branch(
        {"line": line, "slope_from": 1e-4, "slope_to": 0.3, "n": 2},
        [atlas({"line": line}, [])],
    )
    for entry in some(entry for entry in SPECIAL if entry["walker"] == name):
        kinds, slopes, bounds = (
            found[f"special_points/{key}"] for key in ("kind", "slope", "error_bound")
        )
        near = [k for k in range(len(slopes)) if str(kinds[k]) == entry["kind"]]
        k = min(near, key=lambda k: abs(slopes[k] - float(entry["slope"])))
        off = abs(Decimal(float(slopes[k])) - Decimal(entry["slope"]))
        assert off <= Decimal(float(bounds[k] * slopes[k])) + room(entry, "slope"), (
            entry["name"]
        )


@pytest.mark.parametrize(
    "name", ["C-long-0.03", "physical-long-0.03", "goswami-compass-short-0.0524"]
)
def test_rigid_bodies_repeat_the_gaits(name):
    """The second derivation, integrated by scipy's DOP853: steps of its own, strikes
    found by their signs.
    """
    entry = ENTRIES[name]
    keys = {
        key: value if isinstance(value, bool) else float(value)
        for key, value in table(entry["walker"]).items()
    }
    rates = [float(entry[key]) for key in RATES][: 3 if keys["knees"] else 2]
    step = Oracle(keys).step(
        float(entry["stance_angle"]), np.array(rates), float(entry["slope"])
    )
    assert step.theta == pytest.approx(float(entry["stance_angle"]), rel=1e-9)
    assert step.rates[: len(rates)] == pytest.approx(rates, rel=1e-9)
    assert step.period == pytest.approx(float(entry["period"]), rel=1e-9)
    if keys["knees"]:
        assert step.kneestrike_time == pytest.approx(
            float(entry["kneestrike_time"]), rel=1e-9
        )


def unknowns(entry):
    """What the equations in 113 bits take: the walker, and the names of their unknowns."""
    kneed = "kneestrike_time" in entry
    names = [
        name
        for name in reference.STATE
        if name in entry and (kneed or name != "shank_rate")
    ]
    return "D" if entry["walker"] == "D" else table(entry["walker"]), names


@pytest.mark.parametrize(
    "name",
    [
        "goswami-compass-long-0.0524",
        "physical-short-0.05",
        "B-long-0.03",
        "A-short-0.001",
    ],
)
def test_gaits_solved_anew_in_113_bits_have_the_same_digits(name):
    entry = ENTRIES[name]
    keys, names = unknowns(entry)
    w, z, _ = extended.solve(keys, entry["slope"], [entry[name] for name in names])
    for key, value in zip(names, z, strict=True):
        apart = abs(Decimal(extended.mp.nstr(value, 30)) - Decimal(entry[key]))
        assert apart <= room(entry, key) * Decimal("1.0001"), key
    found = [complex(x) for x in extended.multipliers(w, z)]
    assert [*multipliers(entry), 0, 0][: len(found)] == pytest.approx(found, abs=6e-10)


@pytest.mark.parametrize("entry", SPECIAL, ids=lambda entry: entry["name"])
def test_at_flips_and_folds_the_derivative_in_113_bits_has_its_multiplier(entry):
    keys, names = unknowns(entry)
    w = extended.Walker(keys, entry["slope"])
    z = [extended.mp.mpf(entry[name]) for name in names]
    guards, end, _ = w.stride(z)
    size = 1e-12 * max(abs(float(x)) for x in z)
    assert (
        max(abs(x) for x in guards) < size
        and max(abs(a - b) for a, b in zip(end, z, strict=False)) < size
    )
    found = [complex(x) for x in extended.multipliers(w, z)]
    assert min(abs(x - (1 if entry["kind"] == "fold" else -1)) for x in found) < 1e-10
    assert [*multipliers(entry), 0, 0][: len(found)] == pytest.approx(found, abs=1e-8)


@pytest.mark.parametrize("nudge", [0.0, 1e-8])
@pytest.mark.parametrize(
    "name",
    ["D-long-0.009", "A-short-0.01", "goswami-compass-short-0.0524", "D-flip-0.0151"],
)
def test_entries_made_anew_are_the_same_bytes(name, nudge, monkeypatch):
    """Also where the solver's last digits are others, as on another machine, and the
    proof starts elsewhere.
    """

    def solved(params):
        found = solve_one(params)
        for gait in found["gaits"]:
            gait |= {
                key: gait[key] * (1 + nudge)
                for key in reference.STATE
                if gait.get(key) is not None
            }
        return found

    monkeypatch.setattr(prove_gaits, "solve_one", solved)
    monkeypatch.setattr(write_certificates, "solve_one", solved)
    made = reference.make([name], jobs=1)
    assert (
        made["about"] == KEPT["about"]
        and made["walkers"].items() <= KEPT["walkers"].items()
    )
    assert json.dumps(made["entries"]) == json.dumps([ENTRIES[name]])


def test_the_file_is_written_as_the_command_writes_it():
    assert json.dumps(KEPT, indent=1) + "\n" == TEXT
    assert KEPT["about"] == reference.ABOUT


def test_the_keys_are_those_of_the_walkers():
    for name in KEPT["walkers"]:
        known = resolve(walker(name)).table()
        for key, value in table(name).items():
            assert float(value) == pytest.approx(float(known[key]), rel=2e-16, abs=0), (
                name,
                key,
            )
