"""What public names owe their readers: a sentence, and of arrays their names, shapes
and units.
"""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parent.parent
FILES = [
    file
    for name in ("tasks", "pipeline")
    for file in sorted((ROOT / name).rglob("*.py"))
]
#: Where users enter: what notebooks call, and the tasks.
FACE = sorted(
    [*(ROOT / "pipeline" / "api").glob("*.py"), *(ROOT / "tasks").glob("*.py")]
)


def functions(tree: ast.Module) -> Iterator[tuple[str, ast.FunctionDef]]:
    """Public functions of a module and public methods of its public classes, with their
    names.
    """
    for node in tree.body:
        if isinstance(node, ast.FunctionDef) and not node.name.startswith("_"):
            yield node.name, node
        if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
            for method in node.body:
                if isinstance(method, ast.FunctionDef) and not method.name.startswith(
                    "_"
                ):
                    yield f"{node.name}.{method.name}", method


def speaks_of_arrays(annotation: ast.expr | None) -> bool:
    return annotation is not None and bool(
        re.search(r"ndarray|Arrays", ast.unparse(annotation))
    )


def attributes(text: str) -> set[str]:
    """Names under `Attributes`."""
    section = re.search(r"^Attributes\n-+\n(.*?)(?=^\S+\n-{3,}$|\Z)", text, re.S | re.M)
    heads = re.findall(r"^(\w[\w, ]*?) ?:", section[1], re.M) if section else []
    return {name.strip() for head in heads for name in head.split(",")}


def misnamed(file: Path) -> Iterator[str]:
    """Names under `Attributes` of dataclasses that have no such attribute, and public
    fields that are not under it, where there is one.
    """
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        is_data = isinstance(node, ast.ClassDef) and any(
            "dataclass" in ast.unparse(decorator) for decorator in node.decorator_list
        )
        told = attributes(ast.get_docstring(node) or "") if is_data else set()
        if not told:
            continue

        fields = {s.target.id for s in node.body if isinstance(s, ast.AnnAssign)}
        assigned = {
            part.attr
            for part in ast.walk(node)
            if isinstance(part, ast.Attribute) and isinstance(part.ctx, ast.Store)
        }
        public = {name for name in fields if not name.startswith("_")}
        for name in sorted((told - fields - assigned) | (public - told)):
            yield f"{file.relative_to(ROOT)}: {node.name}: {name}"


def missing(file: Path) -> Iterator[str]:
    """Public functions whose arrays are not named under `Parameters` or `Returns`."""
    for name, node in functions(ast.parse(file.read_text(encoding="utf-8"))):
        text = ast.get_docstring(node) or ""
        if re.search(
            r"as `\w+\.\w+`|as `\w+` (takes|does)", text
        ):  # a method that overrides another, or its like
            continue
        taken = [
            a
            for a in (*node.args.args, *node.args.kwonlyargs)
            if speaks_of_arrays(a.annotation)
        ]
        simple = any(
            isinstance(d, ast.Name) and "property" in d.id for d in node.decorator_list
        )
        if taken and "Parameters\n" not in text:
            yield f"{file.relative_to(ROOT)}: {name}: Parameters"
        if (
            speaks_of_arrays(node.returns)
            and not simple
            and not re.search(r"Returns\n|Yields\n", text)
        ):
            yield f"{file.relative_to(ROOT)}: {name}: Returns"


def private(file: Path, words: dict[Path, set[str]]) -> Iterator[str]:
    """Public functions of a module that no other file speaks of."""
    for node in ast.parse(file.read_text(encoding="utf-8")).body:
        # Claims are entered into the ledger by their decorator; a class may be known by
        # what functions return.
        public = (
            isinstance(node, ast.FunctionDef)
            and not node.name.startswith("_")
            and not node.decorator_list
        )
        if public and not any(
            node.name in said for other, said in words.items() if other != file
        ):
            yield f"{file.relative_to(ROOT)}: {node.name}"
