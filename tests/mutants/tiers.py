"""Choose the tests of `make test`: those that the documentation names, and others that
reach most in least time.

    python tests/mutants/tiers.py 350     # seconds of processor time they may take, as recorded

Writes `tests/tiers.toml`: the files of tests, dearest first, and the tests that only
`make check` runs. A test that is not named there, a new one say, belongs to both.
"""

import heapq
import json
import re
import sys
from collections import Counter, defaultdict

from coverage import CoverageData
from recording import ROOT, STATE, Reach, record

#: What it is worth to reach a line that no, one, two or three tests reach already:
#: another may notice what they do not.
WORTH = (1.0, 0.5, 0.25, 0.125)
QUICK = 0.1  # tests that take less are kept [s]
READING = 1.0  # those that reach no line, since they read the code, may take more [s]
DEAR = 60.0  # tests that take more are left to `make check`, whatever names them [s]
#: What the pages of capabilities and promises name: tests, and files of tests.
NAMED = re.compile(r"tests/[\w/]+\.py(?:::\w+)?")

Lines = set[tuple[str, int]]


def reached(reach: Reach) -> dict[str, Lines]:
    """Lines that each test reaches, as they were when it was recorded."""
    found: dict[str, Lines] = defaultdict(set)
    for name in sorted(set(reach.newest.values())):
        data = CoverageData(f"{STATE / name}.lines")
        data.read()
        for path in data.measured_files():
            within = path.removeprefix(f"{STATE / name}/")
            for line, contexts in data.contexts_by_lineno(path).items():
                for context in contexts:
                    test = re.sub(
                        r" \((setup|call|teardown)\)$", "", context.split("|")[0]
                    )
                    if test in reach.took and reach.newest[test.split("::")[0]] == name:
                        found[test].add((within, line))
    return found


def named(took: dict[str, float]) -> set[str]:
    """The cheapest case of each test that the documentation names for a capability or a
    promise.
    """
    text = "".join(
        (ROOT / "docs" / page).read_text() for page in ("capabilities.md", "trust.md")
    )
    cases = (
        [t for t in took if t == name or t.startswith((f"{name}[", f"{name}::"))]
        for name in NAMED.findall(text)
    )
    cheapest = {
        min(of_name, key=lambda test: took[test]) for of_name in cases if of_name
    }
    return {test for test in cheapest if took[test] < DEAR}


def choose(lines: dict[str, Lines], took: dict[str, float], seconds: float) -> set[str]:
    """Keep quick and named tests, then others by what their lines are worth per second,
    while there is time.
    """
    quick = {
        test
        for test, cost in took.items()
        if cost < (QUICK if lines[test] else READING)
    }
    kept = quick | named(took)
    seen = Counter(line for test in kept for line in lines[test])
    left = seconds - sum(took[test] for test in kept)

    def worth(test: str) -> float:
        return (
            sum(WORTH[seen[line]] for line in lines[test] if seen[line] < len(WORTH))
            / took[test]
        )

    queue = [(-worth(test), test) for test in took if test not in kept]
    heapq.heapify(queue)
    while queue:
        before, test = heapq.heappop(queue)
        if (
            now := -worth(test)
        ) > before:  # others that reach the same lines have been taken since
            heapq.heappush(queue, (now, test))
        elif now < 0 and took[test] <= left:
            kept.add(test)
            left -= took[test]
            seen.update(lines[test])
    return kept


def grouped(kept: set[str], took: dict[str, float]) -> list[str]:
    """Tests that are not kept, a function or a file as one name if none of its tests
    is.
    """
    names = []
    for test in sorted(set(took) - kept):
        for whole in (test.split("::")[0], test.split("[")[0]):
            if not any(
                other == whole or other.startswith((f"{whole}::", f"{whole}["))
                for other in kept
            ):
                test = whole
                break
        names.append(test)
    return list(dict.fromkeys(names))


def main(seconds: float) -> None:
    reach = Reach(record())
    kept = choose(reached(reach), reach.took, seconds)
    cost: Counter[str] = Counter()
    for test, took in reach.took.items():
        cost[test.split("::")[0]] += took
    lists = {
        "dearest_first": [file for file, _ in cost.most_common()],
        "thorough": grouped(kept, reach.took),
    }
    text = "# Written by `make tiers`. Tests that are `thorough` are left to `make check`.\n"
    for name, entries in lists.items():
        text += (
            f"{name} = [\n"
            + "".join(f"  {json.dumps(entry)},\n" for entry in entries)
            + "]\n"
        )
    (ROOT / "tests" / "tiers.toml").write_text(text)
    chosen = sum(reach.took[test] for test in kept)
    print(
        f"{len(kept)} of {len(reach.took)} tests, {chosen:.0f} of {sum(reach.took.values()):.0f} s"
    )


if __name__ == "__main__":
    main(float(sys.argv[1]))
