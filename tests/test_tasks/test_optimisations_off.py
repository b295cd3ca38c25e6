"""The same gaits with each optimisation off: equal bits where they are promised,
elsewhere within both bounds.
"""

import functools
import os
import pickle
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from gaitsweep.tasks.branches import atlas as atlases
from gaitsweep.tasks.branches.branch import Branch
from gaitsweep.tasks.branches.lockstep import side_by_side
from gaitsweep.tasks.contract.accuracy import OF_INTEGRATION, is_interpolated
from gaitsweep.tasks.contract.registry import GAITS
from gaitsweep.tasks.gaits import search
from gaitsweep.tasks.gaits.polish import UNKNOWN
from gaitsweep.tasks.mechanics import kernel
from gaitsweep.tasks.step import problem, step_map
from gaitsweep.tasks.studies import solve_guesses, solve_planes, solve_points
from lines import WANT

ROOT = Path(__file__).parent.parent.parent
SLOPES = np.geomspace(1.1e-3, 0.14, 8)
SMOOTH = tuple(name for name in WANT if name not in OF_INTEGRATION)
RATES = ("stance_rate", "thigh_rate", "shank_rate")
#: Walkers and a key of each with its range.
FAMILIES = {
    "A": ("detuning", 0.1, 1.2),
    "E": ("foot_mass_ratio", 0.05, 0.4),
    "C": ("detuning", 0.1, 0.4),
}
FAMILIES |= {"physical": ("m_h", 0.1, 1.0)}
#: The same as a plane whose gaits patches give, with the slope.
PLANES = {
    "A": (0.2, 0.4, 0.02),
    "E": (0.1, 0.2, 0.011),
    "C": (0.1, 0.2, 0.03),
    "physical": (0.1, 0.3, 0.03),
}


def members(name):
    key, low, high = FAMILIES[name]
    return [
        {"walker": name, "set": {key: float(value)}}
        for value in np.linspace(low, high, 3)
    ]


def lines(name, block=3, **options):
    """Gaits of the lines of a family, a dict of arrays for each; so many lines side by
    side.
    """
    asked = {"slope": SLOPES, "want": WANT, "gaits": GAITS, **options}
    every = members(name)
    blocks = [
        solve_points.lines({"lines": every[k : k + block], **asked}, [])
        for k in range(0, len(every), block)
    ]
    return [found for each in blocks for _, found in each]


def long_lines(name, want=WANT, coarse=False, **options):
    """The same, each line from its own atlas, as lines of many slopes have it."""
    asked = {"slope": SLOPES, "want": want, "gaits": GAITS, **options}
    atlas_of = functools.partial(solve_points.atlas, inputs=[])
    return [
        solve_points.points(
            {"line": line, **asked}, [atlas_of({"line": line, "coarse": coarse})]
        )
        for line in members(name)
    ]


def to_accuracy(name, accuracy):
    """Gaits of polynomials along the lines."""
    assert is_interpolated(SMOOTH, accuracy)
    return long_lines(name, SMOOTH, True, accuracy=accuracy, interpolated=True)


def plane(name, by="patches", accuracy=0.0):
    """Gaits of some lines of a plane."""
    low, high, slope = PLANES[name]
    key, *_ = FAMILIES[name]
    every = [
        {"walker": name, "set": {key: float(v)}}
        for v in np.linspace(low, high, 7)[1:-1]
    ]
    asked = {
        "lines": every,
        "slope": np.array([slope]),
        "want": SMOOTH,
        "accuracy": accuracy,
    }
    if by == "lines":
        return [found for _, found in solve_points.lines(asked, [])]
    asked["plane"] = {
        "keys": [key],
        "low": [low],
        "high": [high],
        "log": [False],
        "lines": 70,
    }
    window = {"slope_from": slope, "slope_to": slope, "slopes": 1}
    ((_, found),) = solve_planes.lines(
        asked, [solve_planes.charts(asked | window | {"line": every[0]}, [])]
    )
    assert int(found["reason"].max()) < 6, "a line was surveyed"
    return [{key: found[key][[i]] for key in SMOOTH} for i in range(len(every))]


def elsewhere(name, folder, **environment):
    """Gaits of the lines, computed by another process."""
    kept = folder / "gaits"
    path = os.pathsep.join(
        [
            *environment.pop("PYTHONPATH", "").split(os.pathsep),
            str(ROOT),
            str(ROOT / "tests"),
        ]
    )
    environment = {**os.environ, **environment, "PYTHONPATH": path.strip(os.pathsep)}
    subprocess.run(
        [sys.executable, __file__, name, str(kept)],
        env=environment,
        check=True,
        timeout=280,
    )
    version, found = pickle.loads(kept.read_bytes())
    return version, found


def equal(one, other):
    """The same bits of whatever both have."""
    for a, b in zip(one, other, strict=True):
        names = a.keys() & b.keys() - {"reasons"}
        assert len(names) > 1
        for name in names:
            np.testing.assert_array_equal(a[name], b[name], err_msg=name)


def within_bounds(one, other):
    """The same gaits, with the same labels and stability, no farther apart than both
    bounds.
    """
    for a, b in zip(one, other, strict=True):
        solved, others = (np.isin(each["status"], (0, 9)) for each in (a, b))
        np.testing.assert_array_equal(solved, others)
        bound = (a["error_bound"] + b["error_bound"])[solved]
        fastest = np.max([np.abs(a[name]) for name in RATES], axis=0)
        for name in ("stance_angle", "period", *RATES):
            size = (fastest if name in RATES else np.abs(a[name]))[solved]
            assert (np.abs(a[name] - b[name])[solved] <= bound * size).all(), name
        assert len(bound) and (bound < 1e-3).all()
        np.testing.assert_array_equal(
            *(each["spectral_radius"][solved] < 1 for each in (a, b))
        )


def one_procedure_at_a_time(monkeypatch):
    def alone(problem, lines, procedures):
        return [
            side_by_side(problem, [i], [each])[0]
            for i, each in zip(lines, procedures, strict=True)
        ]

    monkeypatch.setattr(atlases, "side_by_side", alone)


def few_points_at_a_time(monkeypatch):
    monkeypatch.setattr(solve_guesses, "_BLOCK", 3)


def own_samples(monkeypatch):
    """Steps verified by their own samples, whatever is known of their segments."""
    known = Branch.known_guesses

    def unknown(self, Z, segment, slope):
        guesses = known(self, Z, segment, slope)
        guesses.leg_passes[:] = UNKNOWN
        return guesses

    monkeypatch.setattr(Branch, "known_guesses", unknown)


def compiled_anew(monkeypatch):
    monkeypatch.setattr(kernel, "FLOWS", {})
    monkeypatch.setattr(
        problem, "stride_map", functools.cache(step_map.stride_map.__wrapped__)
    )


def exact_search(monkeypatch):
    """Guesses integrated exactly, none given up early and none merged."""
    compiled_anew(monkeypatch)
    monkeypatch.setattr(kernel, "_COARSE", kernel._FINE)
    monkeypatch.setattr(search, "_MERGE_CELL", 1e-9)
    monkeypatch.setattr(search, "_MAX_STEP_BY_ITERATION", {1: (np.inf,), 2: (np.inf,)})


def registers(lanes):
    """Code for registers of fewer lanes: four as AVX2 has them, one as if there were
    none.
    """

    def patch(monkeypatch):
        compiled_anew(monkeypatch)
        for module in (kernel, step_map):
            monkeypatch.setattr(module, "LANES", lanes)

    return patch


#: What is off: how it is switched off, what is computed then, and what holds. The
#: reference is `lines`.
OFF = {
    "lines side by side": (None, functools.partial(lines, block=1), equal),
    "procedures side by side": (one_procedure_at_a_time, lines, equal),
    "points side by side": (few_points_at_a_time, lines, equal),
    "all variables but one": (
        None,
        functools.partial(lines, want=("stance_angle",)),
        equal,
    ),
    "steps known from their segments": (own_samples, lines, within_bounds),
    "coarse search": (exact_search, lines, within_bounds),
    "coarse atlas": (None, long_lines, within_bounds),
    "registers of eight lanes": (registers(4), lines, within_bounds),
    "registers": (registers(1), lines, within_bounds),
    "digits, at an accuracy of 1e-4": (
        None,
        functools.partial(to_accuracy, accuracy=1e-4),
        within_bounds,
    ),
    "digits, at an accuracy of 1e-10": (
        None,
        functools.partial(to_accuracy, accuracy=1e-10),
        within_bounds,
    ),
}
WALKERS = [
    "E",
    *(pytest.param(name, marks=pytest.mark.soak) for name in FAMILIES if name != "E"),
]


@functools.cache
def reference(name):
    return lines(name)


@pytest.mark.parametrize("name", WALKERS)
@pytest.mark.parametrize("off", OFF)
def test_gaits_are_the_same_without(off, name, monkeypatch):
    expected = reference(name)
    patch, compute, holds = OFF[off]
    if patch:
        patch(monkeypatch)
    holds(expected, compute(name))


@pytest.mark.parametrize("name", WALKERS)
@pytest.mark.parametrize("accuracy", [0.0, 1e-6])
def test_gaits_of_a_plane_are_the_same_without_patches(name, accuracy):
    within_bounds(plane(name, accuracy=accuracy), plane(name, by="lines"))


@pytest.mark.parametrize("name", WALKERS)
def test_gaits_are_the_same_without_avx512_in_numpy(name, tmp_path):
    found = np.show_config(mode="dicts")["SIMD Extensions"]["found"]
    wide = " ".join(each for each in found if "512" in each or each == "X86_V4")
    _, other = elsewhere(
        name, tmp_path, NPY_DISABLE_CPU_FEATURES=wide, OPENBLAS_CORETYPE="Haswell"
    )
    within_bounds(reference(name), other)


@pytest.mark.soak
@pytest.mark.parametrize("name", FAMILIES)
def test_gaits_are_the_same_with_the_earliest_numpy(name, tmp_path):
    install = [
        sys.executable,
        "-m",
        "pip",
        "install",
        "--quiet",
        "--no-deps",
        "--target",
        str(tmp_path / "numpy"),
    ]
    if subprocess.run([*install, "numpy==2.2.0"]).returncode:
        pytest.skip("numpy 2.2.0 cannot be had")
    version, other = elsewhere(name, tmp_path, PYTHONPATH=str(tmp_path / "numpy"))
    assert version == "2.2.0"
    within_bounds(reference(name), other)


if __name__ == "__main__":
    Path(sys.argv[2]).write_bytes(pickle.dumps((np.__version__, lines(sys.argv[1]))))
