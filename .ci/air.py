"""How much a reader must hold at once: tokens, tokens a line of code, blank lines and large functions, by folder.

python .ci/air.py            print the figures; exit 1 if a file or a function is beyond its limit
python .ci/air.py --record   write what is beyond the limits today into .ci/air.toml, where it may only shrink
"""

import ast
import io
import sys
import tokenize
import tomllib
from collections import Counter
from pathlib import Path

FOLDERS = ("tasks", "pipeline", "gaitsweep", "tests", ".ci")
#: Tokens a line of code, of files with at least `SMALL` lines, and syntax nodes of a function.
MOST_TOKENS, MOST_NODES, SMALL = 11.0, 300, 30
ALLOWED = Path(__file__).with_name("air.toml")
_SILENT = {
    tokenize.COMMENT,
    tokenize.NL,
    tokenize.NEWLINE,
    tokenize.INDENT,
    tokenize.DEDENT,
    tokenize.ENDMARKER,
}
_FUNCTIONS = (ast.FunctionDef, ast.AsyncFunctionDef)


def docstring_lines(tree: ast.Module) -> set[int]:
    """Numbers of the lines that docstrings take."""
    lines: set[int] = set()
    for node in ast.walk(tree):
        if not isinstance(node, (ast.Module, ast.ClassDef, *_FUNCTIONS)):
            continue
        first = node.body[0] if node.body else None
        if isinstance(first, ast.Expr) and isinstance(first.value, ast.Constant):
            lines.update(range(first.lineno, (first.end_lineno or first.lineno) + 1))
    return lines


def nodes_of(function: ast.AST) -> int:
    """Syntax nodes of a function without its docstring and the functions in it."""
    count, left = 0, list(function.body)  # type: ignore[attr-defined]
    while left:
        node = left.pop()
        if isinstance(node, _FUNCTIONS):
            continue
        count += 1
        left.extend(ast.iter_child_nodes(node))
    return count


def code_of(source: str, hidden: set[int]) -> tuple[int, set[int]]:
    """Number of tokens outside docstrings and comments, and the lines that they take."""
    lines: set[int] = set()
    count = 0
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        if token.type not in _SILENT and token.start[0] not in hidden:
            count += 1
            lines.update(range(token.start[0], token.end[0] + 1))
    return count, lines


def measure(path: Path) -> tuple[Counter[str], dict[str, int]]:
    """Counts of a file, and the syntax nodes of its functions, the largest of a name."""
    source = path.read_text(encoding="utf-8")
    tree = ast.parse(source)
    hidden = docstring_lines(tree)
    tokens, code = code_of(source, hidden)

    functions = [node for node in ast.walk(tree) if isinstance(node, _FUNCTIONS)]
    inside: set[int] = set()
    nodes: dict[str, int] = {}
    large = 0
    for function in functions:
        inside.update(range(function.lineno, (function.end_lineno or 0) + 1))
        name, size = f"{path}::{function.name}", nodes_of(function)
        nodes[name] = max(size, nodes.get(name, 0))
        large += size > MOST_NODES

    text = source.splitlines()
    counts = Counter(
        tokens=tokens,
        code=len(code),
        inside=len(inside & code),
        blank=sum(not text[number - 1].strip() for number in inside - hidden),
        functions=len(functions),
        large=large,
    )
    return counts, nodes


def describe(name: str, counts: Counter[str]) -> str:
    """A line of the table."""
    density = counts["tokens"] / max(counts["code"], 1)
    blank = 100 * counts["blank"] / max(counts["inside"], 1)
    return (
        f"{name:22s} tokens {counts['tokens']:7d}  a line {density:5.1f}  blank {blank:4.1f} of 100"
        f"  functions {counts['functions']:5d}, large {counts['large']:3d}"
    )


def beyond_limits(
    files: dict[str, Counter[str]], nodes: dict[str, int]
) -> dict[str, float]:
    """Files and functions beyond the limits, with their tokens a line and their nodes."""
    found: dict[str, float] = {}
    for name, counts in files.items():
        density = round(counts["tokens"] / max(counts["code"], 1), 1)
        if counts["code"] >= SMALL and density > MOST_TOKENS:
            found[name] = density
    found.update({name: count for name, count in nodes.items() if count > MOST_NODES})
    return found


def measure_all() -> tuple[dict[str, Counter[str]], dict[str, float]]:
    """Counts by folder, and what is beyond the limits."""
    folders: dict[str, Counter[str]] = {}
    files: dict[str, Counter[str]] = {}
    nodes: dict[str, int] = {}
    for folder in FOLDERS:
        for path in sorted(Path(folder).rglob("*.py")):
            counts, functions = measure(path)
            files[str(path)] = counts
            nodes.update(functions)
            inner = f"{folder}/{path.parts[1] if len(path.parts) > 2 else '(modules)'}"
            for name in (inner, folder):
                folders.setdefault(name, Counter()).update(counts)
    return folders, beyond_limits(files, nodes)


def record(found: dict[str, float]) -> None:
    """Write what is beyond the limits."""
    head = """# Written by `python .ci/air.py --record`: tokens a line of files and syntax nodes of functions
# that are beyond the limits. A value may shrink; new ones are refused.
"""
    rows = [f'"{name}" = {value}\n' for name, value in sorted(found.items())]
    ALLOWED.write_text(head + "".join(rows), encoding="utf-8")


def refused(found: dict[str, float]) -> list[str]:
    """What is beyond its limit and not recorded, or beyond what was recorded."""
    allowed = tomllib.loads(ALLOWED.read_text(encoding="utf-8"))
    lines = []
    for name, value in found.items():
        unit, limit = "tokens a line", MOST_TOKENS
        if "::" in name:
            unit, limit = "syntax nodes", MOST_NODES
        limit = allowed.get(name, limit)
        if value > limit:
            lines.append(f"{name}: {value:g} {unit}, at most {limit:g}")
    return lines


def main(words: list[str]) -> int:
    """Print the figures and what is refused, or record what is beyond the limits."""
    folders, found = measure_all()
    for name, counts in folders.items():
        print(describe(name, counts))
    if "--record" in words:
        record(found)

    lines = refused(found)
    print(*lines, sep="\n", end="\n" * bool(lines))
    return 1 if lines else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
