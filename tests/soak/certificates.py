"""Certificates of the project's statements on gaits: `python -m soak.certificates
FOLDER [NAME]…`.
"""

import json
import sys
from pathlib import Path

from joblib import Parallel, delayed

from gaitsweep.pipeline.dispatch import ask


def write(folder, only=(), jobs=2):
    """Prove statements, all unless some are named, and yield the files of their
    certificates as they are written.

    One that is not proved is an error, and its certificate stays as it was.
    """
    folder.mkdir(parents=True, exist_ok=True)
    run = Parallel(n_jobs=jobs, return_as="generator_unordered", batch_size=1)
    for certificate in run(
        delayed(ask)("certify", {"name": name})
        for name in only or ask("certificates", {})
    ):
        path = folder / f"{certificate['name']}.json"
        path.write_text(_laid_out(certificate), encoding="utf-8")
        yield path


def _laid_out(certificate):
    """A certificate with a key to a line."""
    rows = []
    for key, value in certificate.items():
        text = json.dumps(value)
        if isinstance(value, dict):
            text = (
                "{\n  "
                + ",\n  ".join(
                    f"{json.dumps(k)}: {json.dumps(v)}" for k, v in value.items()
                )
                + "\n }"
            )
        rows.append(f" {json.dumps(key)}: {text}")
    return "{\n" + ",\n".join(rows) + "\n}\n"


if __name__ == "__main__":
    for written in write(Path(sys.argv[1]), sys.argv[2:]):
        print(written, flush=True)
