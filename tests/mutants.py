"""Faults that a wrong number in the report could come from, each put into a copy of the code to see
a test fail:

    python tests/mutants.py

Prints the test that fails for each, and exits with 1 if a fault passes them all. Takes some minutes.
"""

import os
import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).parents[1]
# module, what is there, what takes its place, and the tests that should notice
FAULTS = [
    # verdicts: overestimation the other way round, one difficulty for all, above for below
    ("analysis/verdicts", "gap=values.predicted - values.realised", "gap=values.realised - values.predicted", "claims"),
    ("analysis/verdicts", "return all_of([Verdict(outcome, said, planned) for _, outcome in parts.values()])", "return Verdict(next(iter(parts.values()))[1], said, planned)", "claims"),
    ("analysis/verdicts", "own = played[played.agent == agent]\n        verdicts", "own = played\n        verdicts", "claims"),
    ("analysis/verdicts", "if low > margin:", "if high > margin:", "claims"),
    ("analysis/verdicts", "return episodes - section.milestone_window + 1, episodes", "return episodes - section.milestone_window, episodes", "claims"),
    ("analysis/verdicts", "SAME_SCORE = 5.0", "SAME_SCORE = 50.0", "claims"),
    # units
    ("report/plots", "curves.cpu_seconds / 3600", "curves.cpu_seconds / 60", "plots"),
    ("report/results", "found.seconds.max() / 3600", "found.seconds.max() / 60", "results"),
    ("report/results", 'f"{60 * knocked_out.frames.mean()', 'f"{knocked_out.frames.mean()', "results"),
    ("report/offline", "{frames / 3600 / 60:,.0f} hours", "{frames / 3600:,.0f} hours", "offline"),
    ("report/cost", "(runs.seconds / 60).round()", "(runs.seconds / 3600).round()", "cost"),
    # whose numbers, and which of them
    ("report/results", "knocked_out = games[games.knockout == 1]", "knocked_out = games[games.knockout == -1]", "results"),
    ("report/results", '"at the end": gain[-late:].mean()', '"at the end": gain[:late].mean()', "results"),
    ("report/results", "BLINDLY: _under(section, robustness.SEQUENCE)", "BLINDLY: _under(section, robustness.MIRRORED)", "results"),
    ("report/catalogue", ".score.tail(RECENT)", ".score.head(RECENT)", "catalogue"),
    ("analysis/study", "within_reach=100 * table.reach", "within_reach=100 * table.ropes", "results"),
    ("analysis/summaries", "(means.cummax() - means).max()", "(means - means.cummin()).max()", "summaries"),
    ("analysis/summaries", '"higher" if gap > 0 else "lower"', '"lower" if gap > 0 else "higher"', "summaries"),
]  # fmt: skip


def noticed(folder: Path, fault: tuple[str, str, str, str]) -> str | None:
    """The first test that fails with the fault; None if all pass."""
    module, there, instead, tests = fault
    path = folder / "src" / "atari_dqn" / f"{module}.py"
    right = path.read_text()
    if right.count(there) != 1:
        raise SystemExit(f"{module}: {there!r} is there {right.count(there)} times, not once")
    path.write_text(right.replace(there, instead))
    command = [sys.executable, "-m", "pytest", "-x", "--tb=no", f"tests/test_{tests}.py"]
    environment = {**os.environ, "PYTHONPATH": str(folder / "src")}
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True)
    path.write_text(right)
    failed = re.search(r"^FAILED \S+::(\S+)", done.stdout, re.MULTILINE)
    return failed[1] if failed else None


def main() -> None:
    missed = 0
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        for path in ROOT.glob("[!.]*"):
            if path.name in ("src", "tests"):
                shutil.copytree(path, folder / path.name)
            else:
                (folder / path.name).symlink_to(path)
        for fault in FAULTS:
            found = noticed(folder, fault)
            missed += found is None
            print(f"{fault[0]}: {fault[2]}: {found or 'no test fails'}", flush=True)
    raise SystemExit(min(missed, 1))


if __name__ == "__main__":
    main()
