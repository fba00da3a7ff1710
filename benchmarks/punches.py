"""Every punch that scores in games of Boxing with random actions: results/benchmarks/punches.csv.

Takes about a minute per thirty games. The columns are those of `atari_dqn.report.ram.Punch`.
"""

import argparse

import pandas as pd

from atari_dqn.report import ram
from atari_dqn.runs.files import project_root


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--games", type=int, default=60)
    chosen = parser.parse_args()
    punches = pd.DataFrame([punch for punch, _ in ram.scoring_punches(chosen.games)])
    punches.to_csv(project_root() / ram.STORED, index=False)
    print(ram.summary(punches).to_string(index=False))


if __name__ == "__main__":
    main()
