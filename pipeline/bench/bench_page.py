"""The bench's page: tables and work-precision plots in one file."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import jinja2
import matplotlib
import numpy as np

from pipeline.bench.harness import Case
from pipeline.bench.run import Found

PLOTTED = ("stride", "jacobian", "fixed point")
#: What `work` counts for each problem.
WORK = {"fixed point": "strides", "grid": "gaits a point", "branch": "nodes"}
MARKS = "os^Dv<>p*hXP"

TEMPLATE = """<!doctype html>
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
<p>All methods timed in turns in one run, one thread. Times are medians of the rounds with least and greatest,
for one answer; errors are against {{ kind }}, the largest over the largest entry. No error: the method lost the event,
or is the reference itself.{% if quick %} A quick run: fewer rounds.{% endif %}</p>
<p>The product carries {{ lanes }} strides at a time and flies over given event times, as its Newton's method does;
a peer carries one stride, finds its events, and pays for its algebra's calls from Python, some ten microseconds.
scipy's
right-hand side is compiled by {% if numba %}numba{% else %}nothing here, for numba is not installed{% endif %}.</p>
<div class="wide"><table><caption>Machine</caption><tbody>
{% for k, v in machine.items() %}<tr><th scope="row">{{ k }}</th><td>{{ v }}</td></tr>{% endfor %}</tbody></table></div>
<h2>A line of slopes</h2>
<p>A grid point holds every gait there is, with multipliers, energy and error bound.</p>
{{ table(work) }}
<h2>What a study does not want</h2>
<p>The same line for studies that want less and less. A stride carries its Jacobian; an event check samples a stride's
guards, where the atlas has not settled it for good; bytes are those of the variables wanted.</p>
{{ table(less) }}
<h2>Random walkers</h2>
<p>Walkers, slopes from 1e-12 to 0.3 and starts drawn at random, one of each a lane, and what became of them. Most
starts
lead nowhere, and most walkers drawn do not walk.</p>
{{ table(outcomes) }}
<h2>Error bounds</h2>
<p>Gaits at random slopes, their bounds beside their true errors by more digits.</p>
{{ table(bounds) }}
<h2>The Taylor step and the machine's peak</h2>
<p>Operations are estimated from the u-variables of the decomposition and the order; a step is timed through one call
from Python, so short steps are underrated.</p>
{{ table(flows) }}
{% for name, problems in families.items() %}<h2>Walker {{ name }}</h2>
{% for problem, part in problems.items() %}{% if part.plot %}<figure>{{ part.plot }}</figure>{% endif %}
<details{% if not part.plot %} open{% endif %}><summary>{{ problem }}: numbers</summary>{{ table(part.rows) }}</details>
{% endfor %}{% endfor %}
</body></html>
"""


def write(found: Found, path: Path) -> None:
    """Draw and write the page."""
    families: dict[str, dict[str, Any]] = {}
    for case in found.cases:
        part = families.setdefault(case.family, {}).setdefault(case.problem, {"cases": []})
        part["cases"].append(case)
    for name, parts in families.items():
        for problem, part in parts.items():
            part["rows"] = [_row(case) for case in part["cases"]]
            title = f"Walker {name}: one {problem.replace('j', 'J')}"
            part["plot"] = _plot(title, part["cases"]) if problem in PLOTTED else ""
    environment = jinja2.Environment(autoescape=jinja2.select_autoescape(default=True, default_for_string=True))
    from markupsafe import Markup

    for parts in families.values():
        for part in parts.values():
            part["plot"] = Markup(part["plot"])
    from pipeline.bench.problems import LANES

    text = environment.from_string(TEMPLATE).render(
        machine=found.machine,
        kind=found.kind,
        quick=found.quick,
        lanes=LANES,
        families=families,
        numba=found.machine["numba"] != "not installed",
        table=lambda rows: Markup(_table(rows)),
        work=[{"walker": k, **v} for k, v in found.work.items()],
        less=[{"walker": k, **v} for k, of in found.less.items() for v in of],
        outcomes=found.outcomes,
        bounds=found.bounds,
        flows=[{"walker": k, **v} for k, of in found.flows.items() for v in of],
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
    if case.problem in WORK:
        row[WORK[case.problem]] = "" if np.isnan(case.work) else f"{case.work:.4g}"
    return row


def _time(seconds: float) -> str:
    """A time with three digits and a unit that suits it."""
    for unit, size in (("s", 1.0), ("ms", 1e-3)):
        if seconds >= size:
            return f"{seconds / size:.3g} {unit}"
    return f"{seconds / 1e-6:.3g} µs"


def _table(rows: list[dict[str, Any]]) -> str:
    """Rows of equal keys as an HTML table; words are the bench's own."""

    def shown(x: Any) -> str:
        return x if isinstance(x, str) else f"{x:.4g}"

    head = "".join(f'<th scope="col">{k}</th>' for k in rows[0])
    body = "".join("<tr>" + "".join(f"<td>{shown(x)}</td>" for x in row.values()) + "</tr>" for row in rows)
    return f'<div class="wide"><table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table></div>'


def _plot(title: str, cases: list[Case]) -> str:
    """Time against error on logarithmic axes, one curve a method, spread as bars; SVG text."""
    matplotlib.use("Agg")
    from matplotlib.figure import Figure

    methods: dict[str, list[Case]] = {}
    for case in cases:
        if np.isfinite(case.error):
            methods.setdefault(case.method, []).append(case)
    with matplotlib.rc_context({"svg.hashsalt": title, "svg.fonttype": "none"}):
        figure = Figure(figsize=(8, 4.5), layout="constrained")
        axes = figure.add_subplot()
        for mark, (method, of) in zip(MARKS, methods.items(), strict=False):
            of = sorted(of, key=lambda c: c.error)
            # An error of nothing at all cannot be drawn on a logarithmic axis; the reference's rounding can.
            error = np.maximum([c.error for c in of], 1e-20)
            middle = np.array([np.median(c.seconds) for c in of])
            golden_ratio_order = np.abs(np.array([[min(c.seconds), max(c.seconds)] for c in of]).T - middle)
            axes.errorbar(error, middle, yerr=golden_ratio_order, marker=mark, ms=5, lw=1, capsize=2, label=method)
        axes.set(xscale="log", yscale="log", xlabel="relative error", ylabel="time of one [s]", title=title)
        axes.grid(alpha=0.3)
        axes.legend(fontsize="small", loc="center left", bbox_to_anchor=(1.0, 0.5))
        out = io.StringIO()
        figure.savefig(out, format="svg", metadata={"Date": None, "Creator": None})
    text = out.getvalue()
    label = f'<svg role="img" aria-label="{title}: time against error" '
    return text[text.index("<svg") :].replace("<svg ", label, 1)
