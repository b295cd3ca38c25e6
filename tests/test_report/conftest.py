from pathlib import Path

import pytest

from gaitsweep.pipeline.report import pages
from test_report import synthetic


@pytest.fixture(scope="session")
def archives(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """One archive of each kind."""
    return synthetic.everything(tmp_path_factory.mktemp("archive"))


@pytest.fixture(scope="session")
def report(archives: list[Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a report of them all."""
    return pages.write(archives, tmp_path_factory.mktemp("reports")).parent
