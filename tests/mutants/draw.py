"""Draw mutants of the core by lot, see which of them the tests notice, and show those
they do not.

    python tests/mutants/draw.py 1 300          # draw, number: goes on where it stopped, for its state is in `mutants/`
    python tests/mutants/draw.py 1 300 100      # tries again, by 100 s of tests, what `make test` did not notice

mutmut makes the mutants. Each is written into a copy of the project and tried by the
tests that reach its line, the quickest files first: by those of `make test`, and if
none fails by those that only `make check` runs. Mutants of `equivalent.toml` are left
out of the count.
"""

import ast
import contextlib
import difflib
import hashlib
import json
import multiprocessing
import os
import queue
import random
import re
import sys
import threading
import time
import tomllib
from collections import Counter
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import accumulate
from pathlib import Path

from recording import (
    HERE,
    PYTEST,
    ROOT,
    STATE,
    Reach,
    copy_project,
    environment,
    lend_cache,
    record,
)

CORE = (
    "tasks",
    "pipeline/archive",
    "pipeline/engine",
    "pipeline/graph",
    "pipeline/store",
)
AT_A_TIME = 2
#: Processor time, as recorded, of the tests of each tier that try a mutant [s].
PATIENCE = 25.0
THOROUGH = frozenset(
    tomllib.loads((ROOT / "tests" / "tiers.toml").read_text())["thorough"]
)


@dataclass(frozen=True)
class Mutant:
    """A function with one change."""

    name: str
    function: str
    path: Path
    lines: tuple[int, ...]  # if one of them is run, so is the changed statement
    code: str
    diff: str

    @property
    def line(self) -> str:
        """What the change puts in."""
        return next(
            (
                line[1:].strip()
                for line in self.diff.splitlines()
                if line.startswith("+")
            ),
            "",
        )

    @property
    def asserts_less(self) -> bool:
        """Whether it only no longer asserts that lengths are equal."""
        said = [
            re.sub(r"(, )?strict=\w+|, (?=\))", "", line[1:])
            for line in self.diff.splitlines()[1:]
        ]
        return len(said) == 2 and said[0] == said[1]


def statement_lines(node: ast.stmt, line: int) -> tuple[int, ...]:
    """Lines of the innermost statement at a line, without what it holds; of a
    function's head, those of its body.
    """
    inner = [
        each
        for each in ast.walk(node)
        if isinstance(each, ast.stmt)
        and each.lineno <= line <= (each.end_lineno or each.lineno)
    ]
    found = max(inner, key=lambda each: (each.lineno, -(each.end_lineno or 0)))
    end, body = found.end_lineno or found.lineno, getattr(found, "body", None)
    if isinstance(found, ast.FunctionDef):
        return tuple(range(found.body[0].lineno, end + 1))
    return tuple(
        range(found.lineno, max(found.lineno, body[0].lineno - 1 if body else end) + 1)
    )


def functions(
    within: str, node: ast.Module | ast.ClassDef
) -> Iterator[tuple[str, ast.FunctionDef]]:
    """Functions and methods with their full names."""
    for child in node.body:
        if isinstance(child, ast.FunctionDef):
            yield f"{within}.{child.name}", child
        elif isinstance(child, ast.ClassDef):
            yield from functions(f"{within}.{child.name}", child)


def mutants(path: Path) -> Iterator[tuple[str, Callable[[], Mutant]]]:
    """Name of every mutant of a file, and what makes it. A name holds as long as its
    function stays as it is.
    """
    from libcst import FunctionDef
    from libcst.metadata import MetadataWrapper, PositionProvider
    from mutmut.mutation.file_mutation import create_mutations, deep_replace

    source = (ROOT / path).read_text()
    lines = source.splitlines()
    module, mutations, _, _ = create_mutations(str(path), source)
    positions = MetadataWrapper(module, unsafe_skip_copy=True).resolve(PositionProvider)
    named = {
        node.lineno: (function, node)
        for function, node in functions(
            ".".join(path.with_suffix("").parts), ast.parse(source)
        )
    }
    count: Counter[str] = Counter()
    for each in mutations:
        if not isinstance(each.contained_by_top_level_function, FunctionDef):
            continue
        function, node = named[
            positions[each.contained_by_top_level_function].start.line
        ]
        count[function] += 1
        text = "\n".join(lines[node.lineno - 1 : node.end_lineno])
        name = f"{function}#{count[function]}-{hashlib.sha256(text.encode()).hexdigest()[:8]}"

        def make(each=each, name=name, function=function, node=node) -> Mutant:
            code = deep_replace(module, each.original_node, each.mutated_node).code
            diff = list(
                difflib.unified_diff(lines, code.splitlines(), lineterm="", n=0)
            )[2:]
            at = positions[each.original_node].start.line
            return Mutant(
                name, function, path, statement_lines(node, at), code, "\n".join(diff)
            )

        yield name, make


def _try(tree: Path, tests: list[str], longest: dict[str, float]) -> None:
    """Run tests in a copy of the project and in a process that has run none; its exit
    code is pytest's.
    """
    import pytest

    class Quick:
        """Each test may take a multiple of its time: what hangs is noticed."""

        @staticmethod
        def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
            for item in items:
                item.add_marker(
                    pytest.mark.timeout(30 + 5 * longest.get(item.nodeid, 0.0))
                )

    os.setsid()
    os.chdir(tree)
    os.environ.update(environment(tree), PYTHONDONTWRITEBYTECODE="1")
    sys.dont_write_bytecode = True
    sys.path[:0] = [str(tree)]
    with (
        open(tree / "said.txt", "w") as said,
        contextlib.redirect_stdout(said),
        contextlib.redirect_stderr(said),
    ):
        os.dup2(said.fileno(), 1)
        os.dup2(said.fileno(), 2)
        code = pytest.main([*PYTEST, "-x", "-rfE", *tests], plugins=[Quick()])
        said.flush()
    os._exit(int(code))


def failing(
    tree: Path, mutant: Mutant, tests: list[str], took: dict[str, float]
) -> str:
    """Try a mutant by some tests; the one that fails, or nothing."""
    original = (tree / mutant.path).read_text()
    (tree / mutant.path).write_text(mutant.code)
    process = multiprocessing.get_context("forkserver").Process(
        target=_try, args=(tree, tests, took)
    )
    try:
        process.start()
        process.join(60 + 5 * sum(took[test] for test in tests))
        by = re.search(
            r"^(?:FAILED|ERROR) (\S+)", (tree / "said.txt").read_text(), re.MULTILINE
        )
        return (
            ""
            if process.exitcode in (None, 0)
            else by[1]
            if by
            else f"exit {process.exitcode}"
        )
    finally:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, 9)
        process.join()
        (tree / mutant.path).write_text(original)


def is_thorough(test: str) -> bool:
    """Whether only `make check` runs a test."""
    return not THOROUGH.isdisjoint((test, test.split("[")[0], test.split("::")[0]))


def outcome(tree: Path, mutant: Mutant, reach: Reach, patience: float) -> str:
    """Try a mutant by the tests of each tier, and say which notices it, or that it
    survives.
    """
    reaching = reach.tests(mutant.path, mutant.lines)
    for command, thorough in (("make test", False), ("make check", True)):
        tests = [test for test in reaching if is_thorough(test) == thorough]
        times = accumulate(reach.took[test] for test in tests)
        tests = [
            test for test, until in zip(tests, times, strict=True) if until <= patience
        ]
        if tests and (by := failing(tree, mutant, tests, reach.took)):
            return f"{command}: {by}"
    return f"survives; tests that reach it take {sum(reach.took[test] for test in reaching):.0f} s"


def main(draw: int, number: int, again: float) -> int:
    STATE.mkdir(exist_ok=True)
    lend_cache()
    reach = Reach(record())
    every = [
        each
        for part in CORE
        for file in sorted((ROOT / part).rglob("*.py"))
        for each in mutants(file.relative_to(ROOT))
    ]
    # A longer draw begins with the shorter, and a change of the source leaves the
    # mutants of other functions drawn.
    every.sort(key=lambda each: random.Random(f"{draw} {each[0]}").random())
    drawn = [make() for _, make in every[:number]]
    known = tomllib.loads((HERE / "equivalent.toml").read_text())["mutant"]
    equivalent = {(each["function"], each["line"]) for each in known}
    counted = [
        each
        for each in drawn
        if not each.asserts_less and (each.function, each.line) not in equivalent
    ]
    kept = STATE / "outcomes.json"
    outcomes: dict[str, str] = json.loads(kept.read_text()) if kept.exists() else {}
    done = ("make test",) if again else ("make test", "make check", "survives")
    left = [
        each for each in counted if not outcomes.get(each.name, "").startswith(done)
    ]
    multiprocessing.get_context("forkserver").set_forkserver_preload(
        [
            line
            for line in (HERE / "preload.txt").read_text().splitlines()
            if not line.startswith("#")
        ]
    )
    lock, trees = threading.Lock(), queue.SimpleQueue[Path]()
    for slot in range(AT_A_TIME):
        trees.put(copy_project(f"copy{slot}"))

    def attempt(mutant: Mutant) -> None:
        tree, began = trees.get(), time.monotonic()
        found = outcome(tree, mutant, reach, again or PATIENCE)
        trees.put(tree)
        with lock:
            outcomes[mutant.name] = found
            kept.write_text(json.dumps(outcomes, indent=0))
            print(
                f"{len(outcomes)} {mutant.name} {time.monotonic() - began:.0f} s {found}",
                flush=True,
            )

    with ThreadPoolExecutor(AT_A_TIME) as pool:
        list(pool.map(attempt, left))
    survivors = [each for each in counted if outcomes[each.name].startswith("survives")]
    print(
        *(f"{each.name}: {outcomes[each.name]}\n{each.diff}\n" for each in survivors),
        sep="\n",
    )
    noticed = len(counted) - len(survivors)
    quickly = sum(outcomes[each.name].startswith("make test") for each in counted)
    print(
        f"draw {draw}: {noticed} of {len(counted)} mutants noticed ({noticed / len(counted):.1%}), {len(survivors)} "
        f"survive; {number - len(counted)} more cannot be told from the code; `make test` alone notices "
        f"{quickly / noticed:.1%} of those noticed"
    )
    return noticed < 0.95 * len(counted)


if __name__ == "__main__":
    sys.exit(main(int(sys.argv[1]), int(sys.argv[2]), float((*sys.argv[3:], 0)[0])))
