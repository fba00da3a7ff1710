"""Numbers in hand-written text stand only as long as the runs bear them out."""

import numpy as np
import pytest
from synthetic import ROOT, store

from atari_dqn.analysis import argument
from atari_dqn.analysis.study import Study
from atari_dqn.analysis.summaries import Score


def test_numbers_that_read_as_they_are_written_hold():
    numbers = {
        "score": (Score(35.94, 100, 780), 35.9),
        "share": (0.4951, 0.5),
        "episodes": (780, 780),
        "below": (-12.04, -12.0),
    }
    argument.checked(numbers)


@pytest.mark.parametrize("found", [36.06, None, float("nan")])
def test_numbers_that_have_moved_or_are_not_there_fail_and_all_are_named(found):
    numbers = {"kept": (1.0, 1.0), "score": (found, 35.9), "punches": (32, 31)}
    with pytest.raises(argument.Moved) as error:
        argument.checked(numbers)
    assert "score: written 35.9, found" in str(error.value)
    assert "punches: written 31, found 32" in str(error.value)
    assert "kept" not in str(error.value)
    argument.checked(numbers, held=False)  # of other runs than the text is about


def test_the_text_is_held_to_the_projects_own_runs_all_of_them_and_none_damaged(
    tmp_path, monkeypatch
):
    (tmp_path / "pyproject.toml").touch()
    for name in ("params", "notebooks"):
        (tmp_path / name).symlink_to(ROOT / name)
    monkeypatch.chdir(tmp_path)
    results = tmp_path / "results"
    run = store(results, "boxing_final", "dqn", np.zeros(200))
    names = ["boxing_final"]
    assert Study("full", None, names).held
    assert Study("full", str(results / "notebooks" / "snapshot"), names).held, "as it is built"
    assert not Study("full", str(tmp_path / "again"), names).held
    assert not Study("quick", None, names).held
    assert not Study("full", None, names, agents=["dqn"]).held
    assert not Study("full", None, names, seeds=[1]).held
    table = run.folder / "episodes.csv"
    table.write_bytes(table.read_bytes()[:-300])
    assert not Study("full", None, names).held, "a damaged run tells less"
