"""Numbers in hand-written text stand only as long as the runs bear them out."""

import pytest

from atari_dqn.analysis import argument
from atari_dqn.analysis.summaries import Score


def test_a_number_that_still_holds_reads_as_it_is_written():
    numbers = {
        "score": (Score(35.94, 100, 780), 35.9),
        "share": (0.4951, 0.5),
        "episodes": (780, 780),
        "below": (-12.04, -12.0),
    }
    expected = {"score": "35.9", "share": "0.5", "episodes": "780", "below": "-12.0"}
    assert argument.checked("full", numbers) == expected


def test_numbers_that_have_moved_or_are_not_there_fail_and_all_are_named():
    numbers = {"kept": (1.0, 1.0), "score": (36.06, 35.9), "punches": (None, 31)}
    with pytest.raises(argument.Moved) as error:
        argument.checked("full", numbers)
    assert "score: written 35.9, found 36.1" in str(error.value)
    assert "punches: written 31, found –" in str(error.value)
    assert "kept" not in str(error.value)


def test_the_small_profiles_have_other_numbers_and_no_text_about_them():
    assert argument.checked("smoke", {"score": (2.22, 35.9)}) == {"score": "2.2"}


def test_a_number_that_a_damaged_run_cannot_tell_stands_and_any_other_must_hold():
    numbers = {"gone": (None, 31), "of nothing": (float("nan"), 7.1), "kept": (1.0, 1.0)}
    with pytest.raises(argument.Moved, match=r"gone.*of nothing"):
        argument.checked("full", numbers)
    assert argument.checked("full", numbers, {"a run": "is damaged"})["kept"] == "1.0"
    with pytest.raises(argument.Moved, match="moved on, and this text with them: kept: written"):
        argument.checked("full", numbers | {"kept": (1.2, 1.0)}, {"a run": "is damaged"})
