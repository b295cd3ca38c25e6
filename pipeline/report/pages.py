"""From archives to pages: an index, a page for each study, the ledger of claims, and the data of every figure."""

import base64
import contextlib
import fcntl
import gc
import hashlib
import multiprocessing
import os
import pickle
import re
import threading
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from functools import cache
from multiprocessing import connection
from pathlib import Path
from typing import Any

import jinja2
import pandas as pd

from gaitsweep.pipeline import paths
from gaitsweep.pipeline.archive.citation import PAPER
from gaitsweep.pipeline.archive.read import blamed_if_damaged
from gaitsweep.pipeline.report import entry, html_tables, ledger, results
from gaitsweep.pipeline.report.figures import FIGURES, draw, starts
from gaitsweep.pipeline.report.figures.svg import Drawing
from gaitsweep.pipeline.report.source import Source, read
from gaitsweep.pipeline.report.words import grouped, plain

_TEMPLATES, _SCRIPTS = Path(__file__).parent / "templates", Path(__file__).parent / "scripts"

#: Modules of the script, each of which may call those before it.
_MODULES = ("flight", "gaits", "address", "stage", "walker", "figures", "tables")

#: How every page begins, whatever its title.
_PAGE = rb"(?s)<!doctype html>.*img-src data:; script-src 'sha256-"

#: Suffix of drafts, by which a report finds those of a killed one; random, so that no other file has it.
_DRAFT = "0f880eeb4f27a9a9d8dbbd8e0c329cc6"

#: Names of pages that belong to no study.
_RESERVED = ("index", "ledger")

#: Entries of the run's record that a page shows; the record also names the computer, which a page does not.
_RUN = {name: name for name in ("began", "jobs", "cluster", "version", "points", "failed", "exit_code", "account")}
_RUN |= {"seconds": "finished after (s)"}

#: Processes that make pages; a large archive takes each of them a GiB.
_MAX_PROCESSES = 4

#: Size limit of all thumbnails on the index [byte].
_MAX_THUMBNAIL_BYTES = 235_000


@dataclass(frozen=True)
class Page:
    """One study as its page shows it.

    `undrawn` names the figures that the archive holds no data for; `lines` are those whose gaits its script can start,
    `states` those states that its marks start from, once each; `absent` lists the points without a converged gait,
    `listed` those in the CSV file; `tables` are those of results, by their place on the page; `files` are the texts of
    its data files, by file name.
    """

    slug: str
    source: Source
    drawings: list[Drawing]
    undrawn: list[str]
    lines: list[dict[str, Any]]
    states: list[list[float]]
    absent: pd.DataFrame
    listed: pd.DataFrame
    tables: dict[str, Any]
    files: dict[str, str]


def write(
    archives: Iterable[Path], out: Path, only: bool = False, tell: Callable[[int], object] = lambda made: None
) -> Path:
    """Write the report of some archives into a folder: their pages, and the index and ledger of all pages there.

    Parameters
    ----------
    archives : iterable of Path
        Archives written by `gaitsweep run`; nothing else is read but the `NAME.run.json` next to each.
    out : Path
        Folder of the pages, created if missing. A page and its data files are named after the study; a study
        reported again replaces them.
    only : bool
        Delete the other pages of earlier reports.
    tell : callable
        Told the number of pages made, after each.

    Returns
    -------
    Path
        The file of the index.

    Raises
    ------
    ArchiveError
        If a file is not an archive of gaitsweep.
    OSError
        If the folder cannot be written.
    """
    sources = [read(Path(archive)) for archive in archives]
    out = Path(out)
    out.mkdir(parents=True, exist_ok=True)
    pages = _in_processes(sources, _slugs(sources), tell)
    with _locked(out):
        _combine(_environment(), out, pages, only)
    return out / "index.html"


def _make(source: Source, slug: str) -> tuple[str, dict[str, str]]:
    """Text of the page of a study, and its data files by their names."""
    with blamed_if_damaged(source.path):
        page = _page(source, slug)
        return _study(_environment(), page), page.files


def _in_processes(
    sources: list[Source], slugs: list[str], tell: Callable[[int], object]
) -> dict[str, tuple[str, dict[str, str]]]:
    """What `_make` gives for each source, by slug; pages depend on no other, so every core makes some.

    Processes are forked one for each few pages and only write to a pipe: what one does not deliver, for lack of memory
    or in error, is made here, where the error is raised.
    """
    made: dict[str, tuple[str, dict[str, str]]] = {}
    workers = min(_MAX_PROCESSES, len(os.sched_getaffinity(0)), len(sources))
    if workers > 1 and threading.active_count() == 1:  # a fork keeps the locks that other threads hold
        _environment()
        size = -(-len(sources) // (3 * workers))
        parts = [list(zip(sources, slugs, strict=True))[k : k + size] for k in range(0, len(sources), size)]
        with contextlib.suppress(OSError):  # no room for another process
            for slug, page in _forked(parts, workers):
                made[slug] = page
                tell(len(made))
    for source, slug in zip(sources, slugs, strict=True):
        if slug not in made:
            made[slug] = _make(source, slug)
            tell(len(made))
    return {slug: made[slug] for slug in slugs}


def _forked(parts: list[list[tuple[Source, str]]], workers: int) -> Iterator[tuple[str, tuple[str, dict[str, str]]]]:
    """Yield pages, with their slugs, as processes make them, each one part of the pages."""
    fork = multiprocessing.get_context("fork")
    running: dict[Any, multiprocessing.process.BaseProcess] = {}
    waiting = parts[::-1]
    try:
        while waiting or running:
            while waiting and len(running) < workers:
                receiver, sender = fork.Pipe(duplex=False)
                process = fork.Process(target=_deliver, args=(waiting.pop(), sender, [*running, receiver]), daemon=True)
                process.start()
                sender.close()
                running[receiver] = process
            ready: list[Any] = connection.wait(list(running))
            for end in ready:
                try:
                    yield end.recv()
                except (EOFError, pickle.UnpicklingError):
                    running.pop(end).join()
                    end.close()
    finally:
        for end, maker in running.items():
            maker.terminate()
            maker.join()
            end.close()


def _deliver(
    part: list[tuple[Source, str]], sender: connection.Connection, receivers: list[connection.Connection]
) -> None:
    """Make some pages in a process of their own, and send each; on an error it ends without a word.

    The ends at which its parent receives are closed here, so that it does not wait for one that was killed.
    """
    gc.freeze()  # collections would copy the memory that processes share
    try:
        for receiver in receivers:
            receiver.close()
        for source, slug in part:
            sender.send((slug, _make(source, slug)))
    finally:
        os._exit(0)


@contextlib.contextmanager
def _locked(out: Path) -> Iterator[None]:
    """Hold the folder while its pages are combined: of two reports into it, one waits for the other.

    Drafts there are left from a report that was killed, and are removed.
    """
    folder = os.open(out, os.O_RDONLY)
    try:
        with contextlib.suppress(OSError):  # a file system without locks
            fcntl.flock(folder, fcntl.LOCK_EX)
            for draft in out.glob(f".*.{_DRAFT}"):
                draft.unlink()
        yield
    finally:
        os.close(folder)


def _combine(
    environment: jinja2.Environment, out: Path, pages: dict[str, tuple[str, dict[str, str]]], only: bool
) -> None:
    """Write pages and their data, and the index and ledger of all pages in the folder."""
    texts = {f"{slug}.html": text for slug, (text, _) in pages.items()}
    previous, current = entry.read_all(out), {name: entry.read(text) for name, text in texts.items()}
    keep = {name: record for name, record in previous.items() if name not in texts and not only} | current
    entries = sorted((record for record in keep.values() if record), key=lambda record: record.order)
    _check_own(out, pages, {name for record in previous.values() for name in record.files})
    for slug, (page, files) in pages.items():
        for name, text in files.items():
            _publish(out / name, text)
        _publish(out / f"{slug}.html", page)
    wanted = {*keep, *(name for record in entries for name in record.files)}
    for record in previous.values():
        entry.remove(out, record, wanted)
    claims = ledger.families(entries)
    common = {"entries": entries, "ledger": claims, "tally": ledger.tally(claims), "signs": ledger.sign}
    _publish(out / "ledger.html", environment.get_template("ledger.html").render(**common))
    if claims:
        _publish(out / "ledger.csv", _csv(ledger.table(claims)))
    else:
        (out / "ledger.csv").unlink(missing_ok=True)
    lines = next((record.lines for record in entries if record.lines), [])
    index = environment.get_template("index.html")
    _publish(out / "index.html", index.render(**common, thumbnails=_thumbnails(entries), lines=lines))


def _check_own(out: Path, pages: dict[str, tuple[str, dict[str, str]]], listed: set[str]) -> None:
    """Refuse to write over what no report has made: pages are known by their beginning, data by a page or heading."""
    for name in (*pages, *_RESERVED):
        paths.check_own(out / f"{name}.html", _PAGE)
    if not (out / "ledger.html").exists():
        paths.check_own(out / "ledger.csv", rb"(?!)")
    for _, files in pages.values():
        for name in files.keys() - listed:
            paths.check_own(out / name, re.escape(files[name].partition("\n")[0].encode()))


def _study(environment: jinja2.Environment, page: Page) -> str:
    """Render the page of one study, which depends on no other."""
    source = page.source
    record = _entry(page)
    return environment.get_template("study.html").render(
        page=page,
        entry=vars(record),
        claims=[(row["id"], verdict := str(row.get("verdict", "")), ledger.sign(verdict)) for row in record.claims],
        **page.tables,
        sentence=html_tables.outcome_sentence(source),
        outcomes=html_tables.outcomes(source, page.absent),
        failures=html_tables.failures(page.absent),
        failed_tasks=html_tables.failed_tasks(source),
        walkers=html_tables.walkers(source),
        run=html_tables.pairs({_RUN[k]: v for k, v in source.run.items() if k in _RUN}),
        origin=_origin(source),
        provenance=html_tables.pairs(_rest(source)),
    )


def _entry(page: Page) -> entry.Entry:
    """The record for the index and the ledger."""
    source = page.source
    return entry.Entry(
        slug=page.slug,
        study=source.slug,
        name=source.name,
        title=source.title,
        about=source.about,
        whole=source.whole,
        statuses=html_tables.statuses(source),
        figures=[drawing.name for drawing in page.drawings],
        claims=html_tables.claims(source),
        files=list(page.files),
        thumbnail=page.drawings[0].small if page.drawings else "",
        lines=starts.brief(page.lines),
    )


def _page(source: Source, slug: str) -> Page:
    added = {"fits/scaling": "residuals", "overlay": "measured"}
    wanted = dict.fromkeys([*source.figures, *(name for table, name in added.items() if table in source.tables)])
    drawings: list[Drawing] = []
    for name in wanted:
        drawing = draw(source, name, slug, small=not drawings)  # the index shows the first
        drawings += [drawing] if drawing else []
    tables: dict[str, Any] = {
        "landmarks": html_tables.landmarks(source),
        "residuals": html_tables.residuals(source),
        "fits": html_tables.fits(source),
        "special": html_tables.special_points(source),
        "results": results.tables(source),
    }
    absent = html_tables.points(source)
    listed = html_tables.listed(absent)
    frames = {drawing.name: drawing.data for drawing in drawings}
    every = [*tables["fits"], *tables["results"], tables["residuals"], tables["special"]]
    frames |= {f"table-{table.name}": table.frame for table in every if table and table.name}
    frames |= {"absent": listed} if len(absent) else {}
    known: dict[bytes, list[str]] = {}  # a column may be in several tables
    files = {f"{slug}-{name}.csv": _csv(frame, known) for name, frame in frames.items()}
    undrawn = [name for name in source.figures if name not in [drawing.name for drawing in drawings]]
    states = _share_states(drawings)
    return Page(slug, source, drawings, undrawn, starts.lines(source), states, absent, listed, tables, files)


def _share_states(drawings: list[Drawing]) -> list[list[float]]:
    """Every state once that marks of some figures start from; the marks are left with their places."""
    places: dict[tuple[float, ...], int] = {}
    for target in (target for drawing in drawings for target in drawing.targets if "starts" in target):
        target["starts"] = [places.setdefault(tuple(start), len(places)) for start in target["starts"]]
    return [list(state) for state in places]


def _slugs(sources: list[Source]) -> list[str]:
    """A file name for each study, all different."""
    taken: list[str] = []
    for source in sources:
        slug, k = source.slug, 1
        while slug in taken or slug.lower() in _RESERVED:
            k += 1
            slug = f"{source.slug}-{k}"
        taken.append(slug)
    return taken


def _origin(source: Source) -> str:
    """Where the archive comes from, in one line."""
    record, packages = source.provenance, source.provenance.get("packages", {})
    version = packages.get("gaitsweep", "") if isinstance(packages, dict) else ""
    parts = [f"gaitsweep {version}".strip()]
    parts += [f"{word} {str(record[word.lower()])[:12]}" for word in ("commit", "Python") if record.get(word.lower())]
    return ", ".join([*parts, *_times(source.run)])


def _times(run: dict[str, Any]) -> list[str]:
    """Processor time of a study, and time from the start of its command, which may run other studies, to its end."""
    account, seconds = run.get("account"), run.get("seconds")
    own = account.get("workers_cpu") if isinstance(account, dict) else None
    parts = [f"{own:.3g} s of processor time of its workers"] if isinstance(own, float) else []
    jobs = run.get("jobs", "?")
    workers = f"{jobs} worker{'' if jobs == 1 else 's'}"
    parts += [f"finished {seconds:.3g} s after its command began, with {workers}"] if isinstance(seconds, float) else []
    return parts


def _rest(source: Source) -> dict[str, Any]:
    """Provenance without the parts that the page shows elsewhere."""
    return {key: value for key, value in source.provenance.items() if key not in ("study", "walkers", "varied")}


def _thumbnails(entries: list[entry.Entry]) -> dict[str, str]:
    """The first figures of the studies, the smallest first, up to the size limit of the index."""
    room, thumbnails = _MAX_THUMBNAIL_BYTES, {}
    for record in sorted((record for record in entries if record.thumbnail), key=lambda record: len(record.thumbnail)):
        room -= len(record.thumbnail)
        if room > 0:
            thumbnails[record.slug] = record.thumbnail
    return thumbnails


@cache
def _environment() -> jinja2.Environment:
    """Templates that escape everything; a page runs no script but the report's own.

    Notes
    -----
    An archive may come from anyone. Text is escaped, the text of figures by matplotlib; data is JSON that cannot close
    its element; and the page's content security policy names the one script by its hash.
    """
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(_TEMPLATES),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=jinja2.StrictUndefined,
    )
    environment.policies["json.dumps_kwargs"] = {"ensure_ascii": False, "sort_keys": True, "separators": (",", ":")}
    script = _script()
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    environment.globals.update(
        style=(_TEMPLATES / "report.css").read_text(encoding="utf-8"),
        script=script,
        digest=digest,
        known=list(FIGURES),
        paper=PAPER,
    )
    environment.filters.update(plain=plain, grouped=grouped)
    return environment


def _script() -> str:
    """The one script of a page, its modules in their order, without comments, needless spaces and ends of lines."""
    text = "\n".join((_SCRIPTS / f"{name}.js").read_text(encoding="utf-8") for name in _MODULES)
    text = re.sub(r"^\s*(//[^\n]*|/\*\*.*?\*/)\n", "", text, flags=re.M | re.S)
    text = "\n".join(_tightened(line.strip()) for line in text.splitlines())
    text = re.sub(r"(?<=[;{,])\n", "", text)  # a line that ends so goes on
    return f'"use strict";\n(() => {{\n{text.strip()}\n}})();'


def _tightened(line: str) -> str:
    """A line of script without the spaces beside its signs, except within quotes; nested templates are left."""
    if "'" in line or line.count("`") not in (0, 2):
        return line
    parts = re.split(r'("(?:[^"\\]|\\.)*"|`[^`]*`)', line)
    return "".join(
        p if p[:1] in ('"', "`") else re.sub(r" ?([=<>?:,;{}()&|*/]) ?| ([+-]) (?![+-])", r"\1\2", p) for p in parts
    )


def _csv(frame: pd.DataFrame, known: dict[bytes, list[str]] | None = None) -> str:
    """A frame as CSV; `known` keeps the entries of columns of numbers, which other frames may have too."""
    columns = [_entries(column, {} if known is None else known) for _, column in frame.items()]
    return "".join(",".join(row) + "\n" for row in [map(_field, frame.columns), *zip(*columns, strict=True)])


def _entries(column: pd.Series, known: dict[bytes, list[str]]) -> list[str]:
    """What a column has in a CSV file: nothing where its number or word is missing.

    Words that a spreadsheet would evaluate as a formula are quoted.
    """
    if column.dtype.kind in "iuf":
        key = column.dtype.str.encode() + column.to_numpy().tobytes()
        if key not in known:
            known[key] = ["" if x != x else repr(x) for x in column.tolist()]
        return known[key]
    words = ["" if no else str(word) for word, no in zip(column, column.isna(), strict=True)]
    return [_field(f"'{word}" if word[:1] in ("=", "+", "-", "@") else word) for word in words]


def _field(word: str) -> str:
    """A word in a CSV file, within quotes if it holds a sign of the format."""
    return '"' + word.replace('"', '""') + '"' if re.search('[,"\n\r]', word) else word


def _publish(path: Path, text: str) -> None:
    """Replace a file at once: a reader sees the old text or the new."""
    draft = paths.of(path, _DRAFT)
    try:
        draft.write_text(text, encoding="utf-8")
        os.replace(draft, path)
    except OSError as error:
        error.filename = str(path)  # not the draft, unknown to the reader
        raise
    finally:
        with contextlib.suppress(OSError):
            draft.unlink()
