"""Shared by the Python tests: where the build is, and where the sources are.

scripts/test sets MRR_BUILD_DIR and MRR_SOURCE_DIR; without them the release build of this checkout is taken.
A program that was not built is a failure, never a skip.
"""

import os
import pathlib

import pytest


def pytest_configure(config):
    config.addinivalue_line("markers", "slow: takes more than a few seconds; left out by scripts/test --quick")


@pytest.fixture(scope="session")
def source_dir():
    return pathlib.Path(os.environ.get("MRR_SOURCE_DIR", pathlib.Path(__file__).parents[2]))


@pytest.fixture(scope="session")
def build_dir(source_dir):
    return pathlib.Path(os.environ.get("MRR_BUILD_DIR", source_dir / "build" / "release"))


@pytest.fixture(scope="session")
def program(build_dir):
    """program("cli/mrr"): path of a built program, which must exist."""

    def find(relative):
        path = build_dir / relative
        assert path.is_file(), f"{path} was not built"
        return path

    return find
