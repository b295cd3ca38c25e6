"""`gaitsweep schema`: JSON Schema of studies or of walker files."""

import argparse
import json

from gaitsweep.pipeline.study.schema import schema


def run(options: argparse.Namespace) -> int:
    """Print the schema."""
    print(json.dumps(schema(options.kind), indent=1))
    return 0
