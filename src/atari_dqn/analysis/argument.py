"""Numbers in hand-written text: each is written down with the text, and the build fails when the
stored runs say another.

    numbers = {
        "Double DQN": (summaries.score(boxing, "double_dqn"), 35.9),
        "punches per minute": (styles.punches_per_minute.mean(), 31),
    }
    argument.checked(numbers, study.held)
"""

from typing import SupportsFloat


class Moved(Exception):
    """Numbers in the text that the runs do not bear out; the message names each."""


def checked(numbers: dict[str, tuple[SupportsFloat | None, float]], held: bool = True) -> None:
    """Compares numbers that have been found with those that are written, by their names: (found,
    written).

    Raises Moved if a found number, rounded to the written one's decimals, is not the written one,
    or is not there (None or nan); unless the text is not `held` to these runs (`Study.held`).
    """
    moved = []
    for name, (found, written) in numbers.items():
        decimals = len(str(written).partition(".")[2])
        text = "–" if found is None else f"{float(found):.{decimals}f}"
        if text != f"{written:.{decimals}f}":
            moved.append(f"{name}: written {written}, found {text}")
    if moved and held:
        raise Moved(f"the runs have moved on, and this text with them: {'; '.join(moved)}")
