"""Numbers in hand-written text: each is written down with the text, and the build fails when the
stored runs say another.

    numbers = argument.checked(
        profile,
        {
            "double_score": (summaries.score(boxing, "double_dqn"), 35.9),
            "punches per minute": (styles.punches_per_minute.mean(), 31),
        },
    )
    outputs.show_text(f"Double DQN scores {numbers['double_score']} points ...")
"""

from collections.abc import Collection
from math import isnan
from typing import SupportsFloat


class Moved(Exception):
    """Numbers in the text that the runs do not bear out; the message names each."""


def checked(
    profile: str,
    numbers: dict[str, tuple[SupportsFloat | None, float]],
    damaged: Collection[str] = (),
) -> dict[str, str]:
    """{name: text} of {name: (found, written)}, as the found ones read with the written ones'
    decimals.

    Raises Moved if a found number, so rounded, is not the written one, or is not there yet (None or
    nan). The text is about the full runs: in the small profiles any number passes. So does one that
    is not there while runs are `damaged`: the text stays what they said when they were whole.
    """
    moved, texts = [], {}
    for name, (found, written) in numbers.items():
        decimals = len(str(written).partition(".")[2])
        absent = found is None or isnan(float(found))
        texts[name] = "–" if found is None else f"{float(found):.{decimals}f}"
        if absent and damaged:
            continue
        if texts[name] != f"{written:.{decimals}f}":
            moved.append(f"{name}: written {written}, found {texts[name]}")
    if moved and profile == "full":
        raise Moved(f"the runs have moved on, and this text with them: {'; '.join(moved)}")
    return texts
