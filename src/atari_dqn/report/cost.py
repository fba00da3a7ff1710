"""Speed and cost: the stored benchmark beside the peers, and the hours that the runs took."""

import json

import pandas as pd
import seaborn as sns
from matplotlib import pyplot as plt
from matplotlib.patheffects import withStroke

from atari_dqn import params
from atari_dqn.analysis.study import TITLES, Study, data, hours, on_gpu, peak_megabytes
from atari_dqn.report import plots
from atari_dqn.report.outputs import (
    show_absent,
    show_figure,
    show_placeholders,
    show_table,
    show_text,
)
from atari_dqn.runs.files import project_root

OURS = "atari-dqn"
FOLDER = "results/benchmarks"


def best_setups(measured: pd.DataFrame) -> pd.DataFrame:
    """Of the rows of `throughput.csv`, each library's fastest for each agent, fastest first."""
    best = measured.loc[measured.groupby(["library", "agent"]).steps_per_second.idxmax()]
    return best.sort_values("steps_per_second", ascending=False)


def draw_throughput(best: pd.DataFrame) -> plt.Figure:
    """Bars of agent steps per second, and the roofline of direct convolutions for each agent."""
    figure, axes = plt.subplots(figsize=(plots.WIDTH, 2.6))
    colours = {params.title(agent): plots.STYLES[agent].colour for agent in best.agent.unique()}
    shown = best.assign(agent=best.agent.map(lambda agent: params.title(agent)))
    shared = {"x": "steps_per_second", "y": "library", "hue": "agent", "palette": colours}
    sns.barplot(shown, **shared, saturation=1, ax=axes)
    for bars in axes.containers:
        axes.bar_label(bars, fmt="%.0f", padding=3, fontsize="small")
    ours = best[best.library == OURS].set_index("agent")
    for agent, roof in (ours.steps_per_second / ours.share_of_direct_roofline).items():
        look = plots.STYLES[agent]
        casing = [withStroke(linewidth=3, foreground="white")]  # across bars of its own colour
        axes.axvline(roof, color=look.colour, ls=look.line, lw=1.2, path_effects=casing)
        axes.annotate(
            "textbook limit", (roof, 0.02), xycoords=("data", "axes fraction"), xytext=(-2, 0),
            textcoords="offset points", rotation=90, ha="right", fontsize="x-small", color="0.35",
        )  # fmt: skip
    axes.set(xlabel="agent steps per second, whole machine, best set-up", ylabel="")
    axes.legend(title=None, loc="lower left", bbox_to_anchor=(0, 1), ncols=2)
    return figure


def show_throughput() -> None:
    """Training speed beside the peers', each in its best set-up."""
    folder = project_root() / FOLDER
    if not (folder / "throughput.csv").exists():
        show_absent("fig-throughput", "The benchmark has not been run: `make bench` does.")
        return
    measured = pd.read_csv(folder / "throughput.csv")
    machine = json.loads((folder / "machine.json").read_text())
    best = best_setups(measured)
    show_figure(
        draw_throughput(best),
        label="fig-throughput",
        caption=f"Training speed on {machine['cores']} cores of an {machine['processor']}: Boxing, "
        f"batch 32, one update every {machine['update_period']} agent steps, everything included. "
        "Each library in its best set-up; `results/benchmarks/throughput.csv` lists all of them. "
        "Vertical lines: the limit of the textbook method (direct convolutions). "
        "The peers are Tianshou [@weng2022] and Stable-Baselines3 [@raffin2021], which has no "
        "Double DQN. @tbl-learners compares our own two learners.",
        alt="Bars of agent steps per second for this project and its peers.",
        data=f"{FOLDER}/throughput.csv",
    )
    ours = best[(best.library == OURS) & (best.agent == "dqn")].iloc[0]
    peer = best[(best.library != OURS) & (best.agent == "dqn")].iloc[0]
    show_text(
        f"With DQN this project makes {ours.steps_per_second:.0f} agent steps per second on the "
        f"whole machine ({_rounds(ours)}; @fig-throughput), {ours.ratio_to_best_peer:.2f} times "
        f"{peer.library} "
        f"({_rounds(peer)}), the faster of two well-known libraries, in its best set-up. "
        "The *limit* of a method is the speed that a program would have if it did nothing but "
        "emulate the games and do the method's arithmetic at the processor's highest speed "
        f"({machine['float32_gflops_per_core']:.0f} billion operations per second and core). The "
        "textbook method, which computes each convolution as it is defined, cannot pass "
        f"{1 / peer.share_of_direct_roofline:.2f} times {peer.library}; ours reaches "
        f"{ours.share_of_direct_roofline:.0%} of that limit. More than 100% is possible because "
        "it uses a method with fewer multiplications. Measured against the limit for its own, "
        f"smaller number of multiplications, it reaches {ours.share_of_needed_roofline:.0%}; the "
        "rest goes to the transforms, Adam's memory traffic and the replay memory (@tbl-breakdown)."
    )
    show_text(_gain_of_cores(measured[measured.library == OURS], machine["cores"]))


def _rounds(measured: pd.Series) -> str:
    return f"rounds from {measured.low:.0f} to {measured.high:.0f}"


def _gain_of_cores(ours: pd.DataFrame, cores: int) -> str:
    """What the other cores bring, as processes and as threads: DQN, against a process on one."""
    alone = ours[(ours.agent == "dqn") & (ours.setup == "one process, 1 thread")].iloc[0]
    same = ours[(ours.agent == "dqn") & (ours.environments == alone.environments)]
    gains = same.set_index("setup").steps_per_second / alone.steps_per_second
    if cores == 1:
        return "The machine has one core only."
    both = same.set_index("setup").loc["one process per core, 1 thread"]
    processes = gains[both.name]
    text = (
        f"On its {cores} cores, one process per core makes {processes:.2f} times the agent steps "
        f"of one process on one core, and one process of {cores} threads "
        f"{gains[f'one process, {cores} threads']:.2f} times: hence one run per core."
    )
    if processes > cores:
        text += (
            f" (A factor above {cores} is impossible: between rounds the one process varied from "
            f"{alone.low:.0f} to {alone.high:.0f} agent steps per second, and the {cores} from "
            f"{both.low:.0f} to {both.high:.0f}.)"
        )
    return text


def show_gpu() -> None:
    """The speed of runs that were trained for a while on a GPU."""
    path = project_root() / FOLDER / "gpu.csv"
    if not path.exists():
        return
    runs = pd.read_csv(path)  # as of their last games there
    runs["speed"] = runs.agent_steps / runs.seconds
    batches = runs.groupby("batch")
    together, machine = batches.speed.sum(), runs.iloc[0]
    lost, unused = int((~runs.came_home).sum()), int((runs.came_home & ~runs.used).sum())
    show_text(
        f"On an {machine.gpu}, with {machine.cores} processor cores, {batches.ngroups} batches of "
        f"{_range(batches.size())} runs were trained side by side, with "
        f"{_range(runs.emulator_processes)} emulator processes each, for "
        f"{_range((runs.seconds / 60).round())} minutes. They made "
        f"{_range(runs.speed)} agent steps per second each, {_range(together)} together. What was "
        "left of a run was done on one processor core (@tbl-provenance), with the images of its "
        "replay memory played again from the records of its games."
        + (
            f" For {lost} of the {len(runs)} the state was not brought back, and they were resumed "
            "from an earlier checkpoint."
            if lost
            else ""
        )
        + (
            f" The state of {unused} that came back is not used: its run begins again."
            * bool(unused)
        )
    )


def _range(values: pd.Series) -> str:
    """From the lowest to the highest, or the one that there is."""
    ends = dict.fromkeys(f"{value:,.0f}" for value in (min(values), max(values)))
    return " to ".join(ends)


def show_learners() -> None:
    """The native learner beside PyTorch's in the whole training loop."""
    label, path = "tbl-learners", project_root() / FOLDER / "learners.csv"
    if not path.exists():
        show_absent(label, "`python benchmarks/learners.py` has not been run.")
        return
    measured = pd.read_csv(path)
    shown = pd.DataFrame(
        {
            "run": [TITLES[name] for name in measured.experiment],
            "agent": measured.agent.map(lambda agent: params.title(agent)),
            "instructions": measured.instructions.replace("AVX512", "AVX-512"),
            "PyTorch": measured.torch_steps_per_second,
            "native": measured.native_steps_per_second,
            "speed-up": [
                f"{row.ratio:.2f} ({row.low:.2f} to {row.high:.2f})"
                for row in measured.itertuples()
            ],
        }
    )
    show_table(
        shown,
        label=label,
        caption="Agent steps per second of processor time with either learner, everything included "
        f"and {measured.transitions.min():,} transitions stored: the same loop in turns, and how "
        "many times as fast the native one is (90% interval of the median). Rows with AVX2 on "
        "a processor that has AVX-512 too are for comparison. Processor: "
        f"{', '.join(measured.processor.unique())}.",
        decimals=1,
    )


def show_drift() -> None:
    """How far rounding takes the learners apart, beside what it does to PyTorch's alone."""
    path = project_root() / FOLDER / "drift.csv"
    if not path.exists():
        return
    measured = pd.read_csv(path)
    middle = measured[["moved", "native", "permuted"]].median()
    show_text(
        f"Rounding alone takes two learners apart, since each update starts from what the last one "
        f"left. Given the same batches for {measured.updates.max()} updates from the last weights "
        f"of finished runs, PyTorch's weights move by {middle.moved:.2f}, the native learner's end "
        f"{middle.native:.2f} from them, and those of PyTorch itself with the transitions of each "
        f"batch in another order {middle.permuted:.2f} (medians of {len(measured)}, over which the "
        f"latter two run from {measured.native.min():.2f} to {measured.native.max():.2f} and from "
        f"{measured.permuted.min():.2f} to {measured.permuted.max():.2f}; Euclidean distances)."
    )


def show_breakdown() -> None:
    """Where the time of an update goes."""
    path = project_root() / FOLDER / "breakdown.csv"
    if not path.exists():
        show_absent("tbl-breakdown", "`python benchmarks/breakdown.py` has not been run.")
        return
    table = pd.read_csv(path)
    table["share"] = table.share.map("{:.0%}".format)
    table["share_of_peak"] = table.share_of_peak.map("{:.0%}".format).replace("nan%", "–")
    show_table(
        table.drop(columns="processor")
        .rename(columns=lambda name: name.replace("_", " "))
        .rename(columns={"share of peak": "share of peak, counted in textbook operations"}),
        label="tbl-breakdown",
        caption="Where the time of an update and its four agent steps goes: one process, one "
        "thread. How near the processor's highest speed the arithmetic comes is counted in the "
        "operations of direct convolutions, of which the code needs fewer, so that "
        f"it may pass 100%. Processor: {table.processor[0]}.",
    )


def show_whole_run() -> None:
    """What a whole training process does and needs, as its replay memory fills."""
    label = "tbl-whole-run"
    path = project_root() / FOLDER / "whole_run.csv"
    if not path.exists():
        show_placeholders(label)
        return
    measured = pd.read_csv(path)
    first, last = measured.iloc[0], measured.iloc[-1]
    show_text(
        f"A training process of Double DQN in Boxing, alone on one core ({first.processor}), makes "
        f"{first.steps_per_second:.0f} agent steps per second with {first.transitions:,.0f} stored "
        f"transitions and {last.steps_per_second:.0f} with {last.transitions:,.0f}. With these, "
        f"writing a checkpoint takes {last.checkpoint_seconds:.1f} seconds, "
        f"{last.checkpoint_share_of_time:.1%} of the run's time, and the process holds "
        f"{last.resident_megabytes / 1000:.1f} GB at its peak."
    )
    shown = pd.DataFrame(
        {
            "transitions": measured.transitions.map("{:,}".format),
            "agent steps per second": measured.steps_per_second,
            "checkpoint: seconds": measured.checkpoint_seconds,
            "MB": measured.checkpoint_megabytes,
            "share of time": measured.checkpoint_share_of_time.map("{:.1%}".format),
            "seconds to load": measured.load_seconds,
            "peak memory (MB)": measured.resident_megabytes,
        }
    )
    show_table(
        shown,
        label=label,
        caption="A training process of `boxing_final` by the size of its replay memory, filled "
        "with random play; one measurement each.",
        decimals=1,
    )


def show_hours(study: Study) -> None:
    """Hours by the clock so far, one core each, and beside the source report's early run."""
    every = study.stored
    stored = [run for run in every if not on_gpu(run)]
    spent = sum(hours(run) for run in stored)
    early = study["breakout_early"]
    text = f"The {len(stored)} stored runs {'that saw no GPU ' * (every != stored)}took "
    text += f"{spent:,.1f} wall-clock hours, one core each, sometimes with other load"
    if peak := max((peak_megabytes(run) for run in stored), default=0):
        text += f", and used up to {peak / 1000:.1f} GB of memory"
    text += "."
    last = [
        section.episodes.groupby(["variation", "agent", "seed"]).tail(1)
        for section in study.sections.values()
        if not section.episodes.empty and not section.on_gpu
    ]
    if last:
        total = pd.concat(last)[["agent_steps", "seconds", "cpu_seconds"]].sum()
        text += (
            f" On average they made {total.agent_steps / total.seconds:.0f} agent steps per second "
            f"of the clock and {total.agent_steps / total.cpu_seconds:.0f} per second of processor "
            "time. (@tbl-learners counts the training loop alone, without greedy games and "
            "checkpoints.)"
        )
    theirs = data("source_report")
    if early.complete and early.params.profile == "full":
        ours = early.episodes.seconds.max() / 3600
        where = " on a GPU, shared with other runs" if early.on_gpu else ""
        text += (
            f"\n\nThe {early.params.episodes:,} games of the early Breakout run took {ours:.1f} "
            f"hours{where}; the source report's took over {theirs['early_breakout_hours']} on a "
            "laptop. The two cannot be compared: machines, updates per step and games' lengths "
            "differ."
        )
    show_text(text)
