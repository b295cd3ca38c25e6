"""A script in percent format as Markdown, with what its cells print and draw: `python
docs/percent.py SCRIPT.py`.
"""

import base64
import contextlib
import io
import re
import sys
from pathlib import Path

import matplotlib.pyplot as plt


def executed(script):
    plt.switch_backend("agg")
    names = {"__name__": "__main__"}
    marks = re.split(
        r"^# %%(.*)\n", Path(script).read_text(encoding="utf-8"), flags=re.M
    )
    for kind, cell in zip(marks[1::2], marks[2::2], strict=True):
        if "markdown" in kind:
            yield re.sub(r"^# ?", "", cell, flags=re.M)
            continue
        yield f"```python\n{cell.strip()}\n```"
        with contextlib.redirect_stdout(io.StringIO()) as printed:
            exec(compile(cell, script, "exec"), names)
        if printed.getvalue():
            yield f"```{{code-block}} text\n:class: printed\n\n{printed.getvalue().rstrip()}\n```"
        yield from map(drawn, map(plt.figure, plt.get_fignums()))
        plt.close("all")


def drawn(figure):
    picture = io.BytesIO()
    figure.savefig(picture, dpi=150)
    alt = [
        a.get_title()
        or " against ".join(filter(None, (a.get_ylabel(), a.get_xlabel())))
        for a in figure.axes
    ]
    data = base64.b64encode(picture.getvalue()).decode()
    return f"```{{image}} data:image/png;base64,{data}\n:alt: {'; '.join(alt)}\n```"


if __name__ == "__main__":  # worker processes import this file too
    print("\n\n".join(executed(sys.argv[1])))
