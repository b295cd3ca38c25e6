"""Draw mutants of the core by lot, see which of them the tests notice, and show those they do not.

    python tests/mutants/draw.py 1 300          # draw, number: goes on where it stopped, for its state is in `mutants/`
    python tests/mutants/draw.py 1 300 again    # tries survivors and timeouts once more

Mutants of `equivalent.toml` are left out of the count.
"""

import os
import random
import shutil
import sqlite3
import sys
import tomllib
from pathlib import Path

from mutmut import __main__ as mutmut
from mutmut.mutation.diff_apply import get_diff_for_mutant
from mutmut.state import state
from mutmut.stats import status_by_exit_code
from mutmut.utils.format_utils import mangled_name_from_mutant_name
from mutmut.workers.isolation import get_mutant_runner

HERE = Path(__file__).parent
AT_A_TIME = 2
#: Tests of what runs in processes of its own, where no call is recorded.
BESIDE = {
    "pipeline.archive": ("archive", "cf", "isolation"),
    "pipeline.execution": ("run", "scheduler", "isolation", "kills"),
    "pipeline.store": ("journal", "archive", "isolation"),
}
#: How a mutant can end that has been noticed. A loop without end fails its test in time; what takes longer than all
#: tests together may do so because the machine is busy.
NOTICED = ("killed", "segfault", "suspicious")
#: Exit code of a mutant with which the tests cannot even be imported.
_NO_IMPORT = 255


def lend_cache() -> None:
    """Give the mutants a copy of the compiled flows, so theirs do not fill the user's."""
    own = Path(os.environ.get("GAITSWEEP_CACHE") or Path(os.environ.get("XDG_CACHE_HOME") or "~/.cache", "gaitsweep"))
    lent = Path("mutants/cache").absolute()
    shutil.rmtree(lent, ignore_errors=True)
    lent.mkdir(parents=True)
    source = own.expanduser() / "cache.db"
    if source.exists():
        with sqlite3.connect(source) as old, sqlite3.connect(lent / "cache.db") as new:
            old.backup(new)
    os.environ["GAITSWEEP_CACHE"] = str(lent)


def prepare() -> list[str]:
    """Write the mutants, record which tests reach which function, and return the mutants' names."""
    mutmut.set_mutant_under_test("mutant_generation")
    mutmut.copy_src_dir()
    mutmut.copy_also_copy_files()
    mutmut.setup_source_paths()
    mutmut.create_mutants(AT_A_TIME)
    mutmut.collect_or_load_stats(get_mutant_runner(AT_A_TIME), apply_config_invalidation=True)
    # Tests of a file share what one of them has solved: what one reaches, all may notice.
    of_file: dict[str, set[str]] = {}
    for test in state().duration_by_test:
        of_file.setdefault(test.split("::")[0], set()).add(test)
    for function, tests in state().tests_by_mangled_function_name.items():
        for file in {test.split("::")[0] for test in tests}:
            state().tests_by_mangled_function_name[function] |= of_file[file]
    names = sorted(name for _, name, _ in mutmut.collect_source_file_mutation_data(mutant_names=())[0])
    for name in names:
        for file in BESIDE.get(".".join(name.split(".")[:2]), ()):
            function = mangled_name_from_mutant_name(name)
            state().tests_by_mangled_function_name[function] |= of_file[f"tests/test_pipeline/test_{file}.py"]
    mutmut.save_stats()
    return names


def results(names: list[str]) -> dict[str, tuple[str, Path]]:
    """Status and file of each mutant."""
    found = mutmut.collect_source_file_mutation_data(mutant_names=())[0]
    wanted = set(names)
    return {
        name: ("killed" if code == _NO_IMPORT else status_by_exit_code[code], data.path)
        for data, name, code in found
        if name in wanted
    }


def argued() -> set[tuple[str, str]]:
    """Functions and lines of mutants that change nothing."""
    known = tomllib.loads((HERE / "equivalent.toml").read_text())["mutant"]
    return {(each["function"], each["line"]) for each in known}


def main(draw: int, number: int, again: bool) -> int:
    Path("mutants").mkdir(exist_ok=True)
    lend_cache()
    names = prepare()
    # A longer draw begins with the shorter, and a change of the source leaves the mutants of other functions drawn.
    names.sort(key=lambda name: random.Random(f"{draw} {name}").random())
    drawn = names[:number]
    wanted = ("not checked", "survived", "no tests", "timeout") if again else ("not checked",)
    left = [name for name, (status, _) in results(drawn).items() if status in wanted]
    if left:
        mutmut._run(left, AT_A_TIME)
    equivalent, noticed, survivors = argued(), 0, []
    for name, (status, path) in sorted(results(drawn).items()):
        diff = get_diff_for_mutant(name, path=path)
        function = name.rpartition("__mutmut_")[0]
        if status in NOTICED:
            noticed += 1
        elif not any((function, line[1:].strip()) in equivalent for line in diff.splitlines() if line.startswith("+")):
            survivors.append(f"{name}: {status}\n{diff}\n")
    print("\n".join(survivors))
    counted = noticed + len(survivors)
    print(
        f"draw {draw}: {noticed} of {counted} mutants noticed ({noticed / counted:.1%}), {len(survivors)} survive; "
        f"{len(drawn) - counted} more cannot be told from the code"
    )
    return noticed < 0.9 * counted


if __name__ == "__main__":
    sys.exit(main(int(sys.argv[1]), int(sys.argv[2]), "again" in sys.argv[3:]))
