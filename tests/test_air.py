"""What `make lint` refuses of code that is too dense: `.ci/air.py`."""

import importlib.util
from pathlib import Path

import pytest

SCRIPT = Path(__file__).resolve().parents[1] / ".ci" / "air.py"
DENSE = "\n".join(
    f"a{k}, b{k}, c{k} = d[{k}], e(f, g, h), i * j + k ** l" for k in range(40)
)
LARGE = "def f():\n" + "".join(f"    x = y + {k}\n" for k in range(100))
AIRY = '"""A docstring of many words does not count."""\n' + "\n".join(
    f"a{k} = {k}" for k in range(40)
)


@pytest.fixture
def air(tmp_path, monkeypatch):
    spec = importlib.util.spec_from_file_location("air", SCRIPT)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    (tmp_path / "tasks").mkdir()
    (tmp_path / "air.toml").write_text("")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(module, "ALLOWED", tmp_path / "air.toml")
    return module


@pytest.mark.parametrize(
    ("source", "said"),
    [
        (DENSE, "tasks/a.py: 27 tokens a line, at most 11\n"),
        (LARGE, "tasks/a.py::f: 800 syntax nodes, at most 300\n"),
    ],
)
def test_what_is_too_dense_or_too_large_is_refused(air, capsys, source, said):
    Path("tasks/a.py").write_text(source)

    code = air.main([])

    assert code == 1
    assert capsys.readouterr().out.endswith(said)


def test_code_with_air_passes(air):
    Path("tasks/a.py").write_text(AIRY)

    assert air.main([]) == 0


def test_what_is_recorded_may_stay_but_not_grow(air):
    Path("tasks/a.py").write_text(LARGE)
    assert air.main(["--record"]) == 0
    assert air.main([]) == 0

    Path("tasks/a.py").write_text(LARGE + "    x = y\n")

    assert air.main([]) == 1
