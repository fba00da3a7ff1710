"""Hours, speeds and origins: units of time, whose speed it is, and what it is compared with."""

import json

import numpy as np
import pandas as pd
import pytest
from synthetic import AGENTS, SECONDS, STEPS, numbers, store, study

from atari_dqn.analysis import study as analysis
from atari_dqn.analysis.study import Section
from atari_dqn.report import cost, plots

DQN, DOUBLE, DUELING = AGENTS


def test_hours_are_of_training_by_the_clock_run_by_run(tmp_path):
    """A hundred games of a run made by hand take an hour."""
    runs = [
        store(tmp_path, "boxing_final", DQN, np.zeros(700)),
        store(tmp_path, "boxing_final", DOUBLE, np.zeros(250)),
    ]
    assert [analysis.hours(run) for run in runs] == pytest.approx([7.0, 2.5])
    (runs[0].folder / "timing.csv").unlink()
    assert analysis.hours(runs[0]) == 0


def test_memory_is_the_most_of_any_stretch_of_training(tmp_path):
    sessions = [{"peak_memory_megabytes": 900.0}, {"peak_memory_megabytes": 2100.0}, {}]
    run = store(tmp_path, "boxing_final", DQN, np.zeros(5), sessions=sessions)
    assert analysis.peak_megabytes(run) == 2100.0
    run = store(tmp_path, "boxing_final", DQN, np.zeros(5), sessions=[{}])
    assert analysis.peak_megabytes(run) == 0


def test_hours_are_summed_over_all_stored_runs(tmp_path, shown):
    sessions = [{"peak_memory_megabytes": 1500.0, "device": "cpu"}]
    store(tmp_path, "boxing_final", DQN, np.zeros(3000), sessions=sessions)
    store(tmp_path, "boxing_final", DOUBLE, np.zeros(250))
    store(tmp_path, "boxing_sensitivity", DUELING, np.zeros(100), variation="raw rewards")
    pace = [round(STEPS / SECONDS), round(STEPS / (SECONDS / 9))]  # agent steps per second
    cost.show_hours(study(tmp_path))
    assert numbers(shown.texts[-1]) == [3, 33.5, 1.5, *pace], "runs, hours, GB"
    store(tmp_path, "breakout_early", DQN, np.zeros(6999))
    cost.show_hours(study(tmp_path))
    assert numbers(shown.texts[-1]) == [4, 103.5, 1.5, *pace]
    store(tmp_path, "breakout_early", DQN, np.zeros(7000))
    cost.show_hours(study(tmp_path))
    told = [4, 103.5, 1.5, *pace, 7000, 70.0, 20.5]
    assert numbers(shown.texts[-1]) == told, "and the source report's"
    sessions = [{"processor": "any", "device": "cuda", "commit": "a" * 40}]
    store(tmp_path, "breakout_final", DQN, np.zeros(3000), sessions=sessions)
    cost.show_hours(study(tmp_path))
    assert numbers(shown.texts[-1]) == told, "a GPU's hours are not those of a core"
    assert "that saw no GPU" in shown.texts[-1]
    store(tmp_path, "breakout_early", DQN, np.zeros(7000), sessions=sessions)
    cost.show_hours(study(tmp_path))
    total, early = shown.texts[-1].split("\n\n")
    assert numbers(total)[:2] == [3, 33.5], "the early run's hours are no part of these"
    assert numbers(early) == [7000, 70.0, 20.5]
    assert "on a GPU" in early


def test_every_stored_run_has_a_row_with_its_state_games_steps_hours_and_origin(tmp_path):
    stretch = {"processor": "slow", "device": "cpu", "commit": "a" * 40}
    sessions = [stretch, stretch, {"processor": "fast", "device": "cuda", "commit": "b" * 40 + "+"}]
    store(tmp_path, "boxing_final", DOUBLE, np.zeros(3000), sessions=sessions, resumes=2)
    run = store(tmp_path, "boxing_sensitivity", DUELING, np.zeros(150), variation="raw rewards")
    first, second = analysis.run_table(study(tmp_path).runs).to_dict("records")
    assert first["hours"] == pytest.approx(30.0)
    assert second["hours"] == pytest.approx(1.5)
    said = ("experiment", "agent", "seed", "state", "games", "agent steps", "resumes", "trained on")
    assert [first[key] for key in said] == [
        *("`boxing_final`", "Double DQN", 1, "complete", "3,000", "7,500,000", 2),
        "slow, then GPU beside fast",
    ]
    assert [second[key] for key in said] == [
        *("`boxing_sensitivity`: raw rewards", "Dueling Double DQN", 1, "unfinished", "150"),
        *("375,000", 0, "a processor"),
    ]
    assert first["commits"] == "`aaaaaaaa`, `bbbbbbbb+`"
    many = [{**stretch, "commit": letter * 40} for letter in "abcda"]
    store(tmp_path, "boxing_final", DQN, np.zeros(100), sessions=many)
    said = analysis.run_table(study(tmp_path).runs)["commits"].tolist()
    assert "`aaaaaaaa`, …, `dddddddd` (4 in all)" in said
    assert second["hash"] == f"`{run.params.identity()[:8]}`"


@pytest.mark.parametrize(
    ("processor", "name"),
    [
        ("Intel(R) Xeon(R) Processor", "Xeon"),
        ("Intel(R) Xeon(R) CPU E5-2680 v4 @ 2.40GHz", "Xeon E5-2680 v4"),
        ("Intel(R) Core(TM) i7-9700K CPU @ 3.60GHz", "Core i7-9700K"),
        ("AMD EPYC", "EPYC"),
        ("AMD EPYC 7763 64-Core Processor", "EPYC 7763"),
        ("Apple M2", "Apple M2"),
        ("Processor", "Processor"),
    ],
)
def test_a_processor_is_told_by_what_tells_it_from_others(tmp_path, processor, name):
    run = store(tmp_path, "boxing_final", DQN, np.zeros(5), sessions=[{"processor": processor}])
    assert analysis.run_table([run])["trained on"].tolist() == [name]


def measured():
    """A benchmark: speeds in agent steps per second by library, agent and set-up."""
    alone, cores = "one process, 1 thread", "one process per core, 1 thread"
    threads = "one process, 2 threads"
    rows = [
        ("atari-dqn", DQN, alone, 100.0, 8),
        ("atari-dqn", DQN, cores, 180.0, 8),
        ("atari-dqn", DQN, threads, 120.0, 8),
        ("atari-dqn", DQN, threads, 110.0, 1),
        ("atari-dqn", DOUBLE, cores, 150.0, 8),
        ("SB3", DQN, cores, 50.0, 8),
        ("SB3", DQN, threads, 60.0, 8),
        ("Tianshou", DQN, cores, 45.0, 8),
        ("Tianshou", DOUBLE, cores, 40.0, 8),
    ]
    table = pd.DataFrame(
        rows, columns=["library", "agent", "setup", "steps_per_second", "environments"]
    )
    speed = table.steps_per_second
    peer = table.agent.map({DQN: 60.0, DOUBLE: 40.0})
    return table.assign(
        low=speed - 5, high=speed + 5, ratio_to_best_peer=speed / peer,
        share_of_direct_roofline=speed / 150, share_of_needed_roofline=speed / 300,
    )  # fmt: skip


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.setattr(cost, "FOLDER", str(tmp_path))
    machine = {"cores": 2, "processor": "X", "update_period": 4, "float32_gflops_per_core": 80.6}
    (tmp_path / "machine.json").write_text(json.dumps(machine))
    return tmp_path


def test_a_librarys_speed_is_that_of_its_fastest_set_up():
    best = cost.best_setups(measured())
    found = {(row.library, row.agent): row.steps_per_second for row in best.itertuples()}
    assert found == {
        ("atari-dqn", DQN): 180, ("atari-dqn", DOUBLE): 150, ("SB3", DQN): 60,
        ("Tianshou", DQN): 45, ("Tianshou", DOUBLE): 40,
    }  # fmt: skip
    assert best.steps_per_second.tolist() == [180, 150, 60, 45, 40]


def test_our_speed_is_told_with_how_many_times_the_fastest_peers_it_is(folder, shown):
    measured().to_csv(folder / "throughput.csv", index=False)
    cost.show_throughput()
    speed, cores = shown.texts
    # speed and its range, times SB3 and its range, operations,
    # limit over SB3's speed, share of it, "100%", of our own
    assert numbers(speed.replace("SB3", "")) == [
        180,
        175,
        185,
        3.0,
        55,
        65,
        *(81, 2.5, 120, 100, 60),
    ]
    assert numbers(cores) == [2, 1.8, 2, 1.2], "cores, gain of processes, threads, gain of threads"
    bars = shown.figures["fig-throughput"].axes[0]
    libraries = [label.get_text() for label in bars.get_yticklabels()]
    agents = {plots.STYLES[agent].colour: agent for agent in (DQN, DOUBLE)}
    found = {
        (libraries[round(bar.get_y() + bar.get_height() / 2)], agents[bar.get_facecolor()[:3]]): (
            bar.get_width()
        )
        for bar in bars.patches
        if bar.get_width()
    }
    assert found == {
        ("atari-dqn", DQN): 180, ("atari-dqn", DOUBLE): 150, ("SB3", DQN): 60,
        ("Tianshou", DQN): 45, ("Tianshou", DOUBLE): 40,
    }  # fmt: skip
    assert bars.get_xlabel().startswith("agent steps per second")
    roofs = [line for line in bars.get_lines() if np.isfinite(line.get_xdata()).all()]
    assert [list(line.get_xdata()) for line in roofs] == [[150, 150]] * 2
    assert [line.get_color() for line in roofs] == list(agents)
    assert numbers(shown.captions["fig-throughput"])[:3] == [2, 32, 4], "cores, batch, period"


def test_a_gain_beyond_the_number_of_cores_is_owned_to_be_noise(folder, shown):
    table = measured()
    table.loc[1, ["steps_per_second", "low", "high"]] = (210.0, 190.0, 220.0)
    table.to_csv(folder / "throughput.csv", index=False)
    cost.show_throughput()
    said = numbers(shown.texts[1])
    assert said == [2, 2.1, 2, 1.2, 2, 95, 105, 2, 190, 220], "then the range of one, and of two"


def test_what_rounding_does_is_told_in_medians_and_ranges(folder, shown):
    cost.show_drift()
    assert shown.texts == [], "nothing was measured"
    columns = {"moved": [1.0, 3.0, 2.0], "native": [0.4, 0.1, 0.3], "permuted": [0.2, 0.25, 0.05]}
    pd.DataFrame({"updates": 200, **columns}).to_csv(folder / "drift.csv")
    cost.show_drift()
    middle, ranges = [2.0, 0.3, 0.2], [0.1, 0.4, 0.05, 0.25]
    assert numbers(shown.texts[-1]) == [200, *middle, 3, *ranges]


def test_the_learners_speeds_stand_under_their_names(folder, shown):
    row = {"experiment": "boxing_final", "agent": DOUBLE, "native_steps_per_second": 180.0}
    row |= {"torch_steps_per_second": 90.0, "ratio": 2.0, "low": 1.9, "high": 2.2}
    row |= {"processor": "Some Xeon", "instructions": "AVX512"}
    pd.DataFrame([{**row, "transitions": 1_000_000}]).to_csv(folder / "learners.csv")
    cost.show_learners()
    (found,) = shown.tables["tbl-learners"]
    assert (found["agent"], found["PyTorch"], found["native"]) == ("Double DQN", "90.0", "180.0")
    assert found["instructions"] == "AVX-512"
    assert "Processor: Some Xeon." in shown.captions["tbl-learners"]
    assert numbers(found["speed-up"]) == [2.0, 1.9, 2.2]
    assert numbers(shown.captions["tbl-learners"])[:2] == [1_000_000, 90]


def test_a_whole_run_is_told_from_its_empty_memory_to_its_full_one(folder, shown):
    first = {"transitions": 20_000, "steps_per_second": 200.0, "checkpoint_seconds": 1.0}
    first |= {"checkpoint_share_of_time": 0.001, "resident_megabytes": 700.0}
    last = {"transitions": 1_000_000, "steps_per_second": 180.0, "checkpoint_seconds": 6.0}
    last |= {"checkpoint_share_of_time": 0.012, "resident_megabytes": 1900.0}
    more = {"checkpoint_megabytes": 500.0, "load_seconds": 4.0, "processor": "Some Xeon"}
    pd.DataFrame([first | more, last | more]).to_csv(folder / "whole_run.csv", index=False)
    cost.show_whole_run()
    assert numbers(shown.texts[0]) == [200, 20_000, 180, 1_000_000, 6.0, 1.2, 1.9]
    assert "alone on one core (Some Xeon)" in shown.texts[0]
    for row, stored, speed, seconds, share, memory in zip(
        shown.tables["tbl-whole-run"],
        ("20,000", "1,000,000"),
        ("200.0", "180.0"),
        ("1.0", "6.0"),
        ("0.1%", "1.2%"),
        ("700.0", "1900.0"),
        strict=True,
    ):
        assert row == {
            **{"transitions": stored, "agent steps per second": speed},
            **{"checkpoint: seconds": seconds, "MB": "500.0", "share of time": share},
            **{"seconds to load": "4.0", "peak memory (MB)": memory},
        }


def test_parts_of_an_update_are_shares_of_its_time(folder, shown):
    parts = {"part": ["update", "sampling"], "milliseconds_per_update": [15.0, 5.0]}
    parts |= {"share": [0.75, 0.25], "share_of_peak": [0.5, np.nan], "processor": "Some Xeon"}
    pd.DataFrame(parts).to_csv(folder / "breakdown.csv", index=False)
    cost.show_breakdown()
    names = ["part", "milliseconds per update", "share"]
    names.append("share of peak, counted in textbook operations")
    found = [[row[name] for name in names] for row in shown.tables["tbl-breakdown"]]
    assert found == [["update", "15.00", "75%", "50%"], ["sampling", "5.00", "25%", "–"]]
    assert "Processor: Some Xeon." in shown.captions["tbl-breakdown"]


def test_the_share_of_an_experiment_is_of_all_its_runs_games(tmp_path):
    store(tmp_path, "boxing_final", DQN, np.zeros(900), seed=1)
    store(tmp_path, "boxing_final", DQN, np.zeros(300), seed=2)
    section = Section("boxing_final", "full", str(tmp_path), seeds=[1, 2])
    assert section.share == pytest.approx(1200 / (2 * 3 * 3000))


def test_the_speed_on_a_gpu_is_that_of_the_slowest_and_the_fastest_run(folder, shown):
    cost.show_gpu()
    assert not shown.texts
    machine = {"gpu": "a card", "cores": 16, "emulator_processes": 3}
    runs = [(1, DQN, 90_000, 60.0), (1, DOUBLE, 120_000, 120.0), (2, DQN, 60_000, 60.0)]
    pd.DataFrame(
        {
            "batch": batch,
            **machine,
            "experiment": "boxing_final",
            "agent": agent,
            "agent_steps": steps,
            "seconds": seconds,
            "came_home": agent != DOUBLE,
            "used": batch == 1,
        }
        for batch, agent, steps, seconds in runs
    ).to_csv(folder / "gpu.csv", index=False)
    cost.show_gpu()
    (said,) = shown.texts
    batches = [16, 2, 1, 2, 3]  # cores, batches, runs side by side, emulators
    # minutes, steps per second of a run, of a batch; how many were lost, and not used
    assert numbers(said) == [*batches, 1, 2, 1000, 1500, 1000, 2500, 1, 3, 1]
    assert "For 1 of the 3 the state was not brought back" in said
