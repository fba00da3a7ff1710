import errno
import gc
import json
import subprocess
import sys
import tracemalloc

import numpy as np
import pytest

from atari_dqn.runs import checkpoints
from atari_dqn.runs.checkpoints import CheckpointError

STATE = {
    "number": 3,
    "nothing": float("inf"),
    "big": 2**127 + 1,
    "nested": {"array": np.arange(12.0).reshape(3, 4).T, "scalar": np.array(7.0, np.float32)},
    "bytes": b"\x00\x01",
    "list": [{"bytes": b"abc"}, {"bytes": b""}],
    "chunks": [b"one", b"", b"three"],
}


def test_what_is_saved_comes_back(tmp_path):
    checkpoints.save(tmp_path, STATE)
    loaded = checkpoints.load(tmp_path)
    assert loaded["big"] == STATE["big"]
    assert loaded["nothing"] == STATE["nothing"]
    assert loaded["bytes"] == b"\x00\x01"
    assert loaded["list"] == STATE["list"]
    assert loaded["chunks"] == STATE["chunks"]
    np.testing.assert_array_equal(loaded["nested"]["array"], STATE["nested"]["array"])
    assert loaded["nested"]["scalar"].shape == ()


def test_nothing_of_a_checkpoint_waits_for_the_garbage_collector(tmp_path):
    state = {"weights": np.ones(1_000_000), "images": [bytes(1_000_000)]}
    checkpoints.save(tmp_path, state)  # what is imported and made once is not counted below
    gc.disable()
    tracemalloc.start()
    try:
        checkpoints.save(tmp_path, state)
        assert tracemalloc.get_traced_memory()[0] < 1e6
        loaded = checkpoints.load(tmp_path)
        assert tracemalloc.get_traced_memory()[0] > 8e6
        del loaded
        assert tracemalloc.get_traced_memory()[0] < 1e6
    finally:
        tracemalloc.stop()
        gc.enable()


def test_no_checkpoint_is_none(tmp_path):
    assert checkpoints.load(tmp_path / "nowhere") is None


def test_the_newest_two_are_kept_and_the_newest_is_loaded(tmp_path):
    for number in (1, 20, 300):
        checkpoints.save(tmp_path, {"number": number})
    assert [path.name for path in sorted(tmp_path.iterdir())] == [
        "checkpoint-000002",
        "checkpoint-000003",
    ]
    assert checkpoints.load(tmp_path)["number"] == 300


def damage_by_truncation(folder):
    path = folder / "chunks.bin"
    path.write_bytes(path.read_bytes()[:-1])


def damage_by_a_flipped_bit(folder):
    path = folder / "arrays.safetensors"
    data = bytearray(path.read_bytes())
    data[-1] ^= 1
    path.write_bytes(data)


def damage_by_a_missing_file(folder):
    (folder / "state.json").unlink()


def damage_by_a_torn_manifest(folder):
    (folder / "manifest.json").write_text('{"state.json": ')


def damage_by_an_empty_manifest(folder):
    (folder / "manifest.json").write_text("{}")


@pytest.mark.parametrize(
    "damage",
    [
        damage_by_truncation,
        damage_by_a_flipped_bit,
        damage_by_a_missing_file,
        damage_by_a_torn_manifest,
        damage_by_an_empty_manifest,
    ],
)
def test_a_damaged_checkpoint_is_passed_over_with_a_warning(tmp_path, damage):
    for number in (1, 2):
        checkpoints.save(tmp_path, {**STATE, "number": number})
    damage(tmp_path / "checkpoint-000002")
    with pytest.warns(UserWarning, match="checkpoint-000002 is damaged"):
        assert checkpoints.load(tmp_path)["number"] == 1
    damage(tmp_path / "checkpoint-000001")
    with (
        pytest.warns(UserWarning, match="damaged"),
        pytest.raises(CheckpointError, match="every checkpoint in"),
    ):
        checkpoints.load(tmp_path)


def test_a_checkpoint_that_cannot_be_read_now_is_not_taken_for_damaged(tmp_path, monkeypatch):
    def too_many_open_files(path):
        raise OSError(errno.EMFILE, "Too many open files")

    checkpoints.save(tmp_path, {"number": 1})
    with monkeypatch.context() as patch:
        patch.setattr(checkpoints, "_digest", too_many_open_files)
        with pytest.raises(CheckpointError, match="checkpoint-000001: Too many open files"):
            checkpoints.load(tmp_path)
    assert checkpoints.load(tmp_path)["number"] == 1


def test_a_damaged_checkpoint_does_not_count_as_one_of_the_two_kept(tmp_path):
    for number in (1, 2):
        checkpoints.save(tmp_path, {**STATE, "number": number})
    damage_by_truncation(tmp_path / "checkpoint-000002")
    with pytest.warns(UserWarning, match="damaged"):
        checkpoints.load(tmp_path)
    checkpoints.save(tmp_path, {**STATE, "number": 3})
    assert [path.name for path in sorted(tmp_path.glob("checkpoint-*"))] == [
        "checkpoint-000001",
        "checkpoint-000002",
    ]


def test_an_unfinished_write_is_never_seen_and_is_cleared_away(tmp_path):
    checkpoints.save(tmp_path, {"number": 1})
    (tmp_path / "tmp-000002").mkdir()
    (tmp_path / "tmp-000002" / "state.json").write_text("{}")
    assert checkpoints.load(tmp_path)["number"] == 1
    checkpoints.save(tmp_path, {"number": 2})
    assert checkpoints.load(tmp_path)["number"] == 2
    assert not list(tmp_path.glob("tmp-*"))


FULL_DISK = """
import resource, signal, sys
from pathlib import Path
import numpy as np
from atari_dqn.runs import checkpoints
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, 100_000))
state = {"array": np.zeros(int(sys.argv[2])), "chunks": [bytes(int(sys.argv[3]))]}
try:
    checkpoints.save(Path(sys.argv[1]), state)
except checkpoints.CheckpointError as error:
    print(error)
"""


@pytest.mark.parametrize("sizes", [("100000", "1"), ("1", "1000000")], ids=["arrays", "chunks"])
def test_no_room_is_a_clear_error_and_the_last_checkpoint_stays(tmp_path, sizes):
    """The limit on a file's size is met in the middle of a write, as a full disk's end is."""
    checkpoints.save(tmp_path, {"number": 1})
    result = subprocess.run(
        [sys.executable, "-c", FULL_DISK, str(tmp_path), *sizes], capture_output=True, text=True
    )
    assert result.stdout.startswith("cannot write the checkpoint"), result.stderr
    assert "File too large" in result.stdout
    assert [path.name for path in tmp_path.iterdir()] == ["checkpoint-000001"]
    assert checkpoints.load(tmp_path)["number"] == 1


def test_no_permission_is_a_clear_error(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(CheckpointError, match="cannot write to"):
        checkpoints.save(tmp_path / "file" / "state", {"number": 1})


def test_nothing_in_a_checkpoint_is_a_pickle(tmp_path):
    checkpoints.save(tmp_path, STATE)
    folder = tmp_path / "checkpoint-000001"
    assert {path.suffix for path in folder.iterdir()} == {".json", ".safetensors", ".bin"}
    json.loads((folder / "state.json").read_text())
