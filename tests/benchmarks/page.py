"""The page of the bench: tables and work-precision plots in one file."""

import io
from pathlib import Path
from typing import Any

import jinja2
import matplotlib
import numpy as np
from markupsafe import Markup
from matplotlib.figure import Figure

from benchmarks.harness import Case, Measurements
from benchmarks.problems import LANES

_PLOTTED = ("stride", "jacobian", "fixed point")
#: What `work` counts in each problem.
_WORK = {"fixed point": "steps", "grid": "gaits per point", "branch": "nodes"}
_MARKS = "os^Dv<>p*hXP"

_TEMPLATE = """<!doctype html>
<html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width, initial-scale=1">
<title>Run time against error</title>
<style>
body{font:16px/1.5 system-ui,sans-serif;max-width:72rem;margin:2rem auto;padding:0 1rem;color:#1a1a1a;background:#fff}
h1,h2{line-height:1.2} figure{margin:1rem 0} svg{max-width:100%;height:auto} .wide{overflow-x:auto}
table{border-collapse:collapse;font-variant-numeric:tabular-nums;font-size:.9rem}
caption{text-align:left;padding:.3rem 0}
th,td{padding:.15rem .7rem;text-align:right;border-bottom:1px solid #ddd} th:first-child,td:first-child{text-align:left}
details{margin:.5rem 0}
</style></head><body>
<h1>Run time against error</h1>
<p>All methods are timed in turns in one run on one thread. Times are processor times of one answer: the median, the
least and the greatest of the rounds. Errors are the largest error over the largest entry, against
{{ measured.kind }}. Where no error is given, the method missed the event or is the reference itself.
{% if measured.quick %}This is a quick run, with fewer rounds.{% endif %}</p>
<p>gaitsweep integrates {{ lanes }} steps at a time over given event times, as in its Newton's method. A peer integrates
one step, locates its events, and calls its algebra from Python, which takes about ten microseconds. The right-hand side
for scipy is compiled by numba.</p>
<div class="wide"><table><caption>Computer</caption><tbody>
{% for k, v in measured.machine.items() %}<tr><th scope="row">{{ k }}</th><td>{{ v }}</td></tr>{% endfor %}
</tbody></table></div>
<h2>A line of slopes</h2>
<p>At each grid point all gaits are solved, with multipliers, energies and error bounds.</p>
{{ table(tables.counts) }}
<h2>Grids</h2>
<p>Processor time of all processes for grids of slopes and one or two keys, with multipliers, error bounds and the
archive, beyond that of a study of one point; also in Newton solves of a gait of D by scipy (to 13 digits, here).</p>
{{ table(tables.grids) }}
<h2>Lines</h2>
<p>Processor time of a line of 20 slopes, searched from nothing, with all its gaits, multipliers, error bounds and its
part of the archive; lines of one key run side by side. A peer solves the long gait alone, from its neighbour's.</p>
{{ table(tables.lines) }}
<h2>Accuracies</h2>
<p>Processor time of a gait of a long line, and of a plane of two keys, its part of the archive included, by the
accuracy that a study asks for; "best" is as good as doubles give. Where polynomials reach the accuracy no step is
integrated. Below, the curve of each walker stands beside those of the peers.</p>
{{ table(tables.accuracies) }}
<h2>Planes</h2>
<p>Processor time of walkers that differ in two keys, at one slope: of each gait that is added to a plane, with its
multipliers, error bound and part of the archive, and of making a cell, over which the gaits are predicted.</p>
{{ table(tables.planes) }}
<h2>Gaits missed</h2>
<p>Lines of random walkers as people build them, each searched besides at one random slope from thousands of other
initial guesses: gaits of that search, and those of them that the line's survey lacks.</p>
{{ table(tables.missed) }}
<h2>Work against wanted variables</h2>
<p>The same line for studies that want fewer and fewer variables. Each step includes its Jacobian; an event check
samples the guards of a step that the atlas does not already guarantee; bytes are those of the wanted variables.</p>
{{ table(tables.less) }}
<h2>Random walkers</h2>
<p>Outcomes of Newton's method for random walkers, slopes from 1e-12 to 0.3 and initial guesses. Most guesses do not
converge, and most random walkers have no gait.</p>
{{ table(tables.outcomes) }}
<h2>Error bounds</h2>
<p>Error bounds of gaits at random slopes, with their errors as computed in extended precision.</p>
{{ table(tables.bounds) }}
<p>By decade of the slope: gaits whose error exceeds the bound, and how many times the error the bound is.</p>
{{ table(tables.deception) }}
<h2>The Taylor step and peak performance</h2>
<p>Operations are estimated from the u-variables of the decomposition and the order. An integration step is timed
through one call from Python, so the rate of short steps is underestimated.</p>
{{ table(tables.flows) }}
{% for name, problems in families.items() %}<h2>Walker {{ name }}</h2>
{% for problem, part in problems.items() %}{% if part.plot %}<figure>{{ part.plot | safe }}</figure>{% endif %}
<details{% if not part.plot %} open{% endif %}><summary>{{ words(problem) }}: table</summary>
{{ table(part.rows) }}</details>
{% endfor %}{% endfor %}
</body></html>
"""


def write(measured: Measurements, path: Path) -> None:
    """Draw and write the page."""
    families: dict[str, dict[str, Any]] = {}
    for case in measured.cases:
        part = families.setdefault(case.family, {}).setdefault(
            case.problem, {"cases": []}
        )
        part["cases"].append(case)
    for name, parts in families.items():
        for problem, part in parts.items():
            part["rows"] = [_row(case) for case in part["cases"]]
            title = f"Walker {name}: one {_words(problem).replace('j', 'J')}"
            part["plot"] = _plot(title, part["cases"]) if problem in _PLOTTED else ""
        for problem in {"line", "plane"} & set(parts):
            # Beside the peers, each gait of which is solved from its neighbour's.
            peers = [
                case
                for case in parts["grid"]["cases"]
                if not case.method.startswith("ours")
            ]
            parts[problem]["plot"] = _plot(
                f"Walker {name}: one gait of a {problem}",
                parts[problem]["cases"] + peers,
            )
    environment = jinja2.Environment(autoescape=True)
    text = environment.from_string(_TEMPLATE).render(
        measured=measured,
        tables=measured.tables,
        lanes=LANES,
        families=families,
        table=lambda rows: Markup(_table(rows)),
        words=_words,
    )
    path.write_text(text, encoding="utf-8")


def _row(case: Case) -> dict[str, Any]:
    row = {
        "method": case.method,
        "tolerance": f"{case.setting:.1e}",
        "median": _time(float(np.median(case.seconds))),
        "least": _time(min(case.seconds)),
        "greatest": _time(max(case.seconds)),
        "error": "" if np.isnan(case.error) else f"{case.error:.1e}",
    }
    if case.problem in _WORK:
        row[_WORK[case.problem]] = "" if np.isnan(case.work) else f"{case.work:.4g}"
    return row


def _words(name: str) -> str:
    """A name of the bench's archive as the page shows it."""
    return (
        name.replace("stride", "step")
        .replace("flights", "integrations")
        .replace(" a ", " per ")
    )


def _time(seconds: float) -> str:
    """A time with three digits, in s, ms or µs."""
    for unit, size in (("s", 1.0), ("ms", 1e-3)):
        if seconds >= size:
            return f"{seconds / size:.3g} {unit}"
    return f"{seconds / 1e-6:.3g} µs"


def _table(rows: list[dict[str, Any]]) -> str:
    """Rows of equal keys as an HTML table; the text is the bench's own and is not
    escaped.
    """

    def shown(x: Any) -> str:
        # Counts in all their digits, so that they add up.
        return (
            x
            if isinstance(x, str)
            else f"{x:.0f}"
            if x == round(x, 0) and abs(x) < 1e9
            else f"{x:.4g}"
        )

    head = "".join(f'<th scope="col">{_words(k)}</th>' for k in rows[0])
    body = "".join(
        "<tr>" + "".join(f"<td>{shown(x)}</td>" for x in row.values()) + "</tr>"
        for row in rows
    )
    return f'<div class="wide"><table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table></div>'


def _plot(title: str, cases: list[Case]) -> str:
    """Time against error on logarithmic axes as SVG, one curve per method, with the
    range of times as bars.
    """
    methods: dict[str, list[Case]] = {}
    for case in cases:
        if np.isfinite(case.error):
            methods.setdefault(case.method, []).append(case)
    with matplotlib.rc_context({"svg.hashsalt": title, "svg.fonttype": "none"}):
        figure = Figure(figsize=(8, 4.5), layout="constrained")
        axes = figure.add_subplot()
        for mark, (method, of) in zip(_MARKS, methods.items(), strict=False):
            of = sorted(of, key=lambda c: c.error)
            # Zero cannot be drawn on a logarithmic axis; the rounding of the reference
            # can.
            error = np.maximum([c.error for c in of], 1e-20)
            middle = np.array([np.median(c.seconds) for c in of])
            spread = np.abs(
                np.array([[min(c.seconds), max(c.seconds)] for c in of]).T - middle
            )
            axes.errorbar(
                error,
                middle,
                yerr=spread,
                marker=mark,
                ms=5,
                lw=1,
                capsize=2,
                label=method,
            )
        axes.set(
            xscale="log",
            yscale="log",
            xlabel="relative error",
            ylabel="processor time of one answer [s]",
            title=title,
        )
        axes.grid(alpha=0.3)
        axes.legend(fontsize="small", loc="center left", bbox_to_anchor=(1.0, 0.5))
        out = io.StringIO()
        figure.savefig(out, format="svg", metadata={"Date": None, "Creator": None})
    text = out.getvalue()
    label = f'<svg role="img" aria-label="{title}: time against error" '
    return text[text.index("<svg") :].replace("<svg ", label, 1)
