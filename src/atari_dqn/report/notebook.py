"""What the notebooks share: their parameters, and the state of the runs that they show."""

import ast
from pathlib import Path
from typing import Any

from IPython.core.getipython import get_ipython

from atari_dqn import params
from atari_dqn.analysis.study import Section
from atari_dqn.params import ParameterError, Parameters
from atari_dqn.report.outputs import show_text
from atari_dqn.runs import plan, scheduler
from atari_dqn.runs.files import RunError, project_root, results_folder
from atari_dqn.runs.run import COMPLETE, STALE, Run

OWN = ("agent", "seed", "results_dir")  # parameters of experiment.ipynb that are none of training


def injected() -> dict[str, Any]:
    """The names that the notebook's parameter cells assign, with their values now.

    The notebook's own cell begins with the line "# Parameters: defaults", the one that papermill
    adds below it with "# Parameters".
    """
    shell = get_ipython()
    assert shell is not None, "notebook.injected() is for notebooks"
    names: set[str] = set()
    for source in shell.user_ns["In"]:
        first, _, _ = source.partition("\n")
        if first.startswith("# Parameters: defaults"):
            names.clear()  # run again, perhaps edited: what was there before does not count
        elif first.strip() != "# Parameters":
            continue
        names |= {
            node.id
            for node in ast.walk(ast.parse(source))
            if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store)
        }
    return {name: shell.user_ns[name] for name in names}


def run_from_notebook(values: dict[str, Any]) -> Run:
    """The run that experiment.ipynb's parameters describe.

    `agent`, `seed` and `results_dir` are the notebook's own; everything else must be a training
    parameter, and None leaves one as the experiment's file has it. Raises ParameterError, also for
    an experiment of several variations.
    """
    known = {*Parameters.model_fields, *OWN, "base"}
    for name in values:
        if name not in known:
            why = params.hint(name, known)
            raise ParameterError(f"unknown parameter {params.shown(name)}; {why}")
    values = {name: value for name, value in values.items() if value is not None}
    agent, seed, results = (values.pop(name, None) for name in OWN)
    resolved = params.resolve(values, project_root() / "params")
    if resolved.variations:
        raise ParameterError(
            f"experiment: {resolved.experiment!r} is not allowed: it has variations, which are "
            "several runs; `python -m atari_dqn train` with its file trains them"
        )
    agent = resolved.agents[0] if agent is None else agent
    seed = resolved.seeds[0] if seed is None else seed
    return Run(params.pick(resolved, agent, seed), results_folder(resolved.profile, results))


def train(section: Section) -> None:
    """Trains what is missing of a section's runs. Raises RunError if a run fails."""
    if failures := scheduler.train_all(section.runs):
        raise RunError("; ".join(failures))


def show_badge(section: Section) -> None:
    """Says which runs are missing or partial, their share done, and how to finish them."""
    states = {run.name: run.state() for run in section.runs if run.name not in section.damaged}
    complete, name = list(states.values()).count(COMPLETE), section.params.experiment
    profile = "" if section.params.profile == "full" else f" --profile {section.params.profile}"
    command = f"`python -m atari_dqn experiments run {name}{profile}`"
    count = len(section.runs)
    games = f"{count} run{'s' * (count > 1)} of {section.params.episodes:,} games"
    if section.episodes.empty and section.damaged:
        text = f"**Nothing to show** of {games}."
    elif section.episodes.empty:
        text = f"**Not started**: {games}. To train them: {command}"
    else:
        share = "less than 1%" if section.share < 0.01 else f"{section.share:.0%}"
        planned = len(section.runs) * section.params.episodes
        text = f"**{complete} of {len(section.runs)} runs complete**{profile and ' (small runs)'}: "
        text += f"{len(section.episodes):,} of {planned:,} games played ({share})."
        if complete < len(section.runs):
            text += f" To finish them: {command}"
    for run in section.runs:
        if said := section.damaged.get(run.name):
            text += f"\n\n{run.name} is damaged and not shown: {as_code(said, run.results)}"
        elif states[run.name] == STALE:
            text += f"\n\n{run.name} is stale ({'; '.join(run.changes())}) and not shown."
    kind = ".badge" if complete == len(section.runs) else ".badge .partial"
    show_text(f"::: {{{kind}}}\n{text}\n:::")


def show_damaged(profile: str, results: Path | str | None) -> None:
    """Names the stored runs that cannot be read, if there are any."""
    folder = results_folder(profile, results)
    if damaged := plan.damaged(profile, [], folder):
        lines = [f"- {as_code(said, folder)}" for said in damaged]
        show_text("\n".join(["Left out, since it cannot be read:\n", *lines]))


def as_code(said: str, results: Path) -> str:
    """An error about something in a folder of results, as Markdown that means nothing else,
    wherever the folder is."""
    return f"`{said.replace(f'{results}/', 'results/').replace('`', chr(39))}`"
