"""Shared by all tests: small parameters, and state kept out of the project's folders."""

import os
import shutil
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")  # results depend on it, and tests run in parallel

import pytest
import torch

from atari_dqn import native
from atari_dqn.params import Parameters

SMALL = {
    "experiment": "small",
    "profile": "smoke",
    "agents": ["double_dqn"],
    "episodes": 3,
    "max_game_frames": 120,
    "environments": 2,
    "replay_capacity": 400,
    "learning_starts": 20,
    "batch_size": 4,
    "target_update_period": 7,
    "evaluation_games": 2,
}

LONGEST = (
    *("test_report.py", "test_scheduler.py", "test_runs.py", "test_native.py", "test_lab.py"),
    *("test_benchmarks.py", "test_claims.py", "test_restore.py", "test_training.py"),
    *("test_video.py", "test_records.py", "test_agents.py", "test_faults.py", "test_wiring.py"),
)


MEMORY, ROOM = Path("/dev/shm"), 4 << 30  # bytes: twice what the tests have there at once


def pytest_configure():
    """Folders of tests lie in memory where there is room, and programs may be run from there: they
    write gigabytes, much of it so that it is on the disk before they go on."""
    runs = MEMORY.is_dir() and not os.statvfs(MEMORY).f_flag & os.ST_NOEXEC
    if runs and shutil.disk_usage(MEMORY).free > ROOM:
        os.environ.setdefault("PYTEST_DEBUG_TEMPROOT", str(MEMORY))


def pytest_collection_modifyitems(config, items):
    """The longest files first: begun last, one would keep a core busy while the other idles. And
    tests that need the native learner only where it can be had; if it only fails to compile, they
    fail."""
    items.sort(key=lambda item: item.path.name not in LONGEST)
    try:
        native.load()
    except native.Unavailable as error:
        if "cannot compile" in str(error):
            return
        config.addinivalue_line("filterwarnings", "ignore:PyTorch learns:UserWarning")
        skipped = pytest.mark.skip(reason=f"the native learner cannot be had: {error}")
        for item in items:
            if item.get_closest_marker("native"):
                item.add_marker(skipped)


@pytest.fixture(autouse=True)
def _isolated(tmp_path, monkeypatch):
    monkeypatch.setenv("ATARI_DQN_STATE", str(tmp_path / "state"))
    torch.set_num_threads(1)


@pytest.fixture
def small():
    """Makes parameters of a run that takes a second or two; keywords change them."""
    return lambda **changes: Parameters.model_validate({**SMALL, **changes})


@pytest.fixture
def shown(monkeypatch):
    """A `synthetic.Shown` of whatever is displayed in the course of the test."""
    from synthetic import Shown  # here: most tests need no drawing

    from atari_dqn.report import outputs

    found = Shown()
    monkeypatch.setattr(outputs, "display", found.display)
    return found
