"""The JSON Schema of studies and walkers agrees with what checks them, and editors find
it.
"""

import copy
import json
import math
import random
import re
import tomllib
from collections import Counter

import pytest

import gaitsweep
from conftest import ROOT
from gaitsweep import GaitsweepError, StudyError
from gaitsweep.pipeline.cli import commands
from gaitsweep.pipeline.dispatch import ask
from gaitsweep.pipeline.study import files, parse
from gaitsweep.tasks.contract.registry import OPTIONS
from gaitsweep.tasks.contract.variables import admit

STUDIES = sorted(ROOT.glob("data/studies/*/*.toml"))
WALKERS = sorted(ROOT.glob("data/walkers/*.toml"))
SCHEMAS = {
    kind: json.loads(json.dumps(gaitsweep.schema(kind))) for kind in ("study", "walker")
}
TYPES = {
    "object": dict,
    "array": list,
    "string": str,
    "boolean": bool,
    "number": (int, float),
    "integer": (int, float),
}
#: Keywords that say nothing of whether a value is valid.
SILENT = {"$schema", "title", "description", "default", "then"}


def is_type(value, name):
    whole = name != "integer" or (isinstance(value, int | float) and value % 1 == 0)
    return (
        isinstance(value, TYPES[name])
        and isinstance(value, bool) == (name == "boolean")
        and whole
    )


def is_same(a, b):
    return a == b and isinstance(a, bool) == isinstance(b, bool)


def is_number(value):
    return isinstance(value, int | float) and not isinstance(value, bool)


#: Whether a value is valid by one keyword of a schema, as JSON Schema's draft 2020-12
#: defines it.
KEYWORDS = {
    "type": lambda v, name, _: is_type(v, name),
    "enum": lambda v, names, _: any(is_same(v, name) for name in names),
    "const": lambda v, other, _: is_same(v, other),
    "not": lambda v, inner, _: not is_valid(v, inner),
    "anyOf": lambda v, every, _: any(is_valid(v, inner) for inner in every),
    "allOf": lambda v, every, _: all(is_valid(v, inner) for inner in every),
    "if": lambda v, inner, whole: not is_valid(v, inner) or is_valid(v, whole["then"]),
    "minimum": lambda v, bound, _: not is_number(v) or not v < bound,
    "maximum": lambda v, bound, _: not is_number(v) or not v > bound,
    "exclusiveMinimum": lambda v, bound, _: not is_number(v) or not v <= bound,
    "exclusiveMaximum": lambda v, bound, _: not is_number(v) or not v >= bound,
    "pattern": lambda v, pattern, _: (
        not isinstance(v, str) or bool(re.search(pattern, v))
    ),
    "minLength": lambda v, n, _: not isinstance(v, str) or len(v) >= n,
    "minItems": lambda v, n, _: not isinstance(v, list) or len(v) >= n,
    "minProperties": lambda v, n, _: not isinstance(v, dict) or len(v) >= n,
    "maxProperties": lambda v, n, _: not isinstance(v, dict) or len(v) <= n,
    "maxItems": lambda v, n, _: not isinstance(v, list) or len(v) <= n,
    "items": lambda v, inner, _: (
        not isinstance(v, list) or all(is_valid(each, inner) for each in v)
    ),
    "uniqueItems": lambda v, _, __: (
        not isinstance(v, list) or not any(is_same(a, b) for a, b in pairs(v))
    ),
    "required": lambda v, names, _: (
        not isinstance(v, dict) or all(name in v for name in names)
    ),
    "properties": lambda v, keys, _: (
        not isinstance(v, dict) or all(is_valid(v[k], keys[k]) for k in keys if k in v)
    ),
    "additionalProperties": lambda v, is_open, whole: (
        is_open or not isinstance(v, dict) or v.keys() <= whole["properties"].keys()
    ),
}


def pairs(values):
    return ((a, b) for k, a in enumerate(values) for b in values[:k])


def is_valid(value, schema):
    """Whether a value is valid; a keyword that this does not know is an error."""
    if isinstance(schema, bool):
        return schema
    return all(
        KEYWORDS[key](value, given, schema)
        for key, given in schema.items()
        if key not in SILENT
    )


def check(kind, table, folder):
    """Check a study or a walker as the commands do."""
    if kind == "study":
        parse.parse(table, "", folder / "s.toml")
    elif not isinstance(table.get("walker"), dict):
        raise StudyError("There is no [walker] table.")  # as of a file
    else:
        ask("check_walker", {"walker": files.walker(table["walker"], folder)})


def read(file):
    return tomllib.loads(file.read_text(encoding="utf-8"))


#: What no file in data/ has, every option of every kind among it.
_E, _WINDOW = {"name": "s", "walker": "E"}, {"slope": [0.01, 0.02]}
_LINK = {"knees": False, "l": 1.0, "m": 1.0, "c": 0.4, "r": 0.1, "w": 0.0}
MORE = [
    {
        **_E,
        "walker": ["E"],
        "accuracy": 1e-3,
        "gaits": ["long", "short"],
        "axes": {"slope": {"from": 0.01, "to": 0.7, "n": 1}, "g": [1, 2]},
        "limits": {"seconds": 3, "memory": 1 << 27},
        "options": {"violation_limits": {"scuff": 0.1, "friction": 2}, "tuned": []},
    },
    {
        **_E,
        "walker": {
            "base": "E",
            "toward": {**_LINK, "units": "1", "name": "other"},
            "detuning": 0.1,
        },
        "axes": _WINDOW,
        "want": {
            "variables": ["period", "energy"],
            "fits": [],
            "figures": [],
            "claims": ["E2"],
        },
        "limits": {"memory": "1.5 GiB"},
    },
    {
        **_E,
        "walker": "A",
        "axes": {**_WINDOW, "w_t": [0.0, -0.01]},
        "options": {"tuned": ["c_t"], "steps": 2},
    },
    {
        **_E,
        "walker": _LINK,
        "axes": {**_WINDOW, "l": [1.0, 1.1], "R": {"from": 0, "to": 0.3, "n": 3}},
    },
    {
        **_E,
        "axes": {
            **_WINDOW,
            "detuning": {"from": 0, "to": 1, "n": 3, "toward": {"base": "E", "R": 0.3}},
        },
    },
    {
        **_E,
        "kind": "branch",
        "axes": {"slope": {"from": 0.01, "to": 0.02, "adaptive": 1e-3}},
        "options": {
            "steps": 1,
            "sensitivities": True,
            "onsets": ["friction"],
            "violation_limits": {"friction": 0.3},
        },
    },
    {
        **_E,
        "kind": "orbit",
        "axes": _WINDOW,
        "options": {
            "gait": "short",
            "starts": 3,
            "spread": -0.1,
            "transient": 9,
            "steps": 9,
            "shown": 2,
        },
    },
    {
        **_E,
        "kind": "cascade",
        "axes": _WINDOW,
        "options": {"periods": 8, "families": [1, 3], "starts": 9, "steps": 0},
        "want": {"claims": ["K2"], "figures": ["cascade"]},
    },
    {
        **_E,
        "kind": "basin",
        "axes": _WINDOW,
        "options": {
            "size": 9,
            "steps": 9,
            "stance_angle": [0.1, 0.2],
            "stance_rate": [-0.2, -0.1],
        },
    },
    {
        **_E,
        "kind": "curve",
        "axes": _WINDOW,
        "options": {
            "key": "R",
            "from": 0.0,
            "to": 0.2,
            "kinds": ["fold"],
            "levels": {"speed": 0.4},
            "onsets": ["friction"],
            "violation_limits": {"friction": 0.3},
        },
        "want": {"figures": ["curves"]},
    },
    {
        **_E,
        "kind": "optimum",
        "axes": _WINDOW,
        "options": {
            "minimise": "cost_of_transport",
            "free": {"R": [0.0, 0.2], "m_h": [0, 0.1]},
            "stable": False,
            "within": {"speed": [0.1, 0.1]},
            "without": ["friction"],
            "tradeoff": {"period": [2.0, 3.0]},
            "starts": 4,
        },
        "want": {"figures": ["optimum"]},
    },
    {
        **_E,
        "kind": "optimum",
        "axes": _WINDOW,
        "options": {
            "maximise": "slope",
            "free": {"R": [0.0, 0.2]},
            "violation_limits": {"friction": 0.5},
        },
    },
    {
        **_E,
        "kind": "curve",
        "axes": {"slope": [0.01]},
        "options": {"plane": {"R": [0.0, 0.2], "m_h": [0.1, 0.2]}},
    },
    {
        **_E,
        "at": {"speed": [0.1, 0.2], "vary": "slope", "between": [0.001, 0.1]},
        "axes": {"R": [0.0, 0.2]},
    },
    {
        **_E,
        "at": {"vary": "R"},
        "axes": {"speed": {"from": 0.1, "to": 0.2, "n": 3}, "slope": [0.01]},
    },
    {
        **_E,
        "kind": "design",
        "axes": {**_WINDOW, "m_h": [0, 0.1]},
        "options": {"at_slope": 0.01, "at_speed": 0.1, "ground": 0.05},
    },
    {
        **_E,
        "kind": "census",
        "axes": _WINDOW,
        "options": {"starts": 30, "tuned": ["m_t"]},
    },
]
BASES = [
    *(("study", read(file), file.parent) for file in STUDIES),
    *(("walker", read(file), file.parent) for file in WALKERS),
    *(("study", table, ROOT) for table in MORE),
    *(
        ("walker", {"walker": walker}, ROOT)
        for walker in (_LINK, {"base": "D", "m_t": math.inf, "tuned": []})
    ),
]


def test_what_the_checker_accepts_of_every_kind_of_study_and_walker_is_valid():
    for kind, table, folder in BASES:
        check(kind, table, folder)
        assert is_valid(table, SCHEMAS[kind]), table
    used = {
        (table.get("kind", "grid"), name)
        for _, table, _ in BASES
        for name in table.get("options", {})
    }
    assert used >= {
        (kind, name)
        for kind, known in OPTIONS.items()
        for name in known.keys() - {"tuned"}
    }


def nodes(value):
    """Every table and list within a value, itself included."""
    inner = (
        value.values()
        if isinstance(value, dict)
        else value
        if isinstance(value, list)
        else ()
    )
    return (
        [value, *(node for each in inner for node in nodes(each))]
        if isinstance(value, dict | list)
        else []
    )


def pool():
    """What mutations put in: keys, words and bounds of the schemas, numbers, and values
    of the files.
    """
    parts = [part for part in nodes([*SCHEMAS.values()]) if isinstance(part, dict)]
    keys = sorted({key for part in parts for key in part.get("properties", {})})
    words = sorted({word for part in parts for word in part.get("enum", ())})
    bounds = sorted(
        {value for part in parts for key, value in part.items() if key.endswith("imum")}
    )
    beside = [math.nextafter(b, side) for b in bounds for side in (-math.inf, math.inf)]
    sizes = [sign * 10.0**k for k in range(-20, 3) for sign in (1, -1)]
    hostile = [
        math.nan,
        math.inf,
        10**400,
        True,
        False,
        "",
        "x.toml",
        "2 GiB",
        "{",
        [],
        {},
        [0.1, 0.1],
        *range(-1, 9),
    ]
    written = [
        each
        for _, table, _ in BASES
        for part in nodes(table)
        for each in (part.values() if isinstance(part, dict) else part)
    ]
    return keys, [words, keys, bounds, beside, sizes, hostile, written]


KEYS, VALUES = pool()


def another(dice, old=None):
    """A value in place of another, mostly of its type."""
    alike = (
        [v for values in VALUES for v in values if type(v) is type(old)]
        if dice.random() < 0.7
        else []
    )
    return copy.deepcopy(dice.choice(alike or dice.choice(VALUES)))


def mutated(dice, table):
    """A study or walker with some keys or values changed."""
    table = copy.deepcopy(table)
    for _ in range(dice.choice([1, 1, 1, 2, 3])):
        node, how = dice.choice(nodes(table)), dice.random()
        if not node or how < 0.2:
            node.append(another(dice)) if isinstance(node, list) else node.update(
                {dice.choice(KEYS): another(dice)}
            )
            continue
        at = dice.choice(range(len(node)) if isinstance(node, list) else [*node])
        if how < 0.4:
            del node[at]
        else:
            node[at] = another(dice, node[at])
    return table


def test_whatever_the_schema_refuses_of_thousands_of_mutants_the_checker_refuses():
    dice, found = random.Random(7), Counter()
    for _ in range(3000):
        kind, base, folder = dice.choice(BASES)
        table = mutated(dice, base)
        try:
            check(kind, table, folder)
            is_accepted = True
        except GaitsweepError:
            is_accepted = False
        by_schema = is_valid(table, SCHEMAS[kind])
        assert by_schema or not is_accepted, table
        found[is_accepted, by_schema] += 1
    # Mutants of all sorts; and the schema notices most of what is wrong.
    assert (
        found[True, True] > 500 and found[False, False] > 3 * found[False, True] > 0
    ), found


def test_what_is_wrong_for_one_kind_of_study_only_is_refused_there():
    study = {"name": "s", "walker": "E", "axes": {"slope": [0.01, 0.02]}}
    window = {"from": 0.01, "to": 0.02}
    changes = {
        "figures": lambda kind: {"want": {"figures": ["locus"]}},
        "options": lambda kind: {"options": {"families": [1]}},
        "accuracy": lambda kind: {"accuracy": 1e-3},
        "adaptive": lambda kind: {"axes": {"slope": {**window, "adaptive": 1e-3}}},
    }
    right = {
        "figures": "branch",
        "options": "cascade",
        "accuracy": "grid",
        "adaptive": "branch",
    }
    for change, changed in changes.items():
        for kind in OPTIONS:
            table = {**study, "kind": kind, **changed(kind)}
            assert is_valid(table, SCHEMAS["study"]) == (kind == right[change]), (
                change,
                kind,
            )
    assert not is_valid(
        {**study, "axes": {"slope": {**window, "to": 0.5, "n": 2}}}, SCHEMAS["study"]
    )
    assert is_valid(
        {**study, "axes": {"slope": {**window, "to": 0.5, "n": 1}}}, SCHEMAS["study"]
    )  # 0.01 alone
    assert not is_valid(
        {**study, "accuracy": 0.1}, SCHEMAS["study"]
    )  # also where no kind is named


def test_templates_lead_editors_to_the_schema(capsys):
    for kind in ([], ["study"], ["walker"]):
        assert commands.main(["schema", *kind]) == 0
        assert json.loads(capsys.readouterr().out) == SCHEMAS["".join(kind) or "study"]
    templates = ROOT / "data" / "studies" / "examples"
    kept = json.loads((templates / "study.schema.json").read_text())
    assert kept == SCHEMAS["study"], (
        "gaitsweep schema > data/studies/examples/study.schema.json"
    )
    for file in templates.glob("*.toml"):
        about, rest = file.read_text().split("\n\n", 1)
        # An editor reads it among the first comments, a page only the first lines of
        # these.
        assert (
            about.startswith("# ")
            and ":schema" not in about
            and rest.startswith("#:schema study.schema.json\n")
        )


def test_schemas_are_the_same_once_derivatives_were_asked_for():
    before = gaitsweep.schema("study")
    admit(["period_by_key"])
    assert gaitsweep.schema("study") == before


def test_every_key_is_described():
    for kind, table in (
        ("study", SCHEMAS["study"]),
        ("walker", SCHEMAS["walker"]["properties"]["walker"]),
    ):
        assert all(
            len(each.get("description", "")) > 8
            for each in table["properties"].values()
        ), kind
    with pytest.raises(
        StudyError, match='`kind` must be "study" or "walker"; got \'stdy\''
    ):
        gaitsweep.schema("stdy")
