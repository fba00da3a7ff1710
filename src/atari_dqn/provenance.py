"""Where the stored runs come from, and what they cost."""

import pandas as pd

from atari_dqn import runs
from atari_dqn.runs import Run
from atari_dqn.sections import Study


def hours(run: Run) -> float:
    """Hours by the clock, on one core, of the training behind the stored games."""
    return _last(run, "timing.csv", "seconds") / 3600


def peak_megabytes(run: Run) -> float:
    """The most memory that a process which trained the run has ever held; 0 if none noted it."""
    sessions = run.provenance()["sessions"]
    return max(session.get("peak_memory_megabytes", 0.0) for session in sessions)


def _last(run: Run, file: str, column: str) -> float:
    table = runs.read_table([run], file)
    return 0.0 if table.empty else float(table[column].iloc[-1])


def run_table(study: Study) -> pd.DataFrame:
    """A row a stored run: state, games, agent steps, hours, resumes, commits, parameters' hash."""
    rows = []
    for run in study.runs:
        state = run.state()
        if state == runs.MISSING:
            continue
        stored = run.provenance()
        last = stored["sessions"][-1]
        commits = [_short(session["commit"]) for session in stored["sessions"]]
        experiment = run.params.experiment.partition("+")[0]
        training = state in (runs.RUNNING, runs.INTERRUPTED)
        rows.append(
            {
                "experiment": f"`{experiment}`" + (f": {run.variation}" if run.variation else ""),
                "agent": runs.title(run.agent),
                "seed": run.seed,
                "state": "unfinished" if training else state,
                "games": f"{run.status()['episodes_done']:,}",
                "agent steps": f"{_last(run, 'episodes.csv', 'agent_steps'):,.0f}",
                "hours": hours(run),
                "resumes": stored["resumes"],
                "processor": last["processor"],
                "commits": ", ".join(dict.fromkeys(commits)),
                "hash": f"`{stored['identity'][:8]}`",
            }
        )
    columns = ["experiment", "agent", "seed", "state", "games", "agent steps", "hours", "resumes"]
    return pd.DataFrame(rows, columns=[*columns, "processor", "commits", "hash"])


def _short(commit: str) -> str:
    """A commit's first digits, with a + if files differed from it."""
    return f"`{commit[:8]}{'+' * commit.endswith('+')}`"
