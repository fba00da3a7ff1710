"""The tables that the report's sections share follow from the stored runs."""

import shutil

import numpy as np
import pandas as pd
import pytest
from synthetic import (
    AGENTS,
    check,
    evaluate,
    facts,
    numbers,
    record,
    store,
    study,
    style,
    window,
    windows,
)

from atari_dqn import params
from atari_dqn.analysis import summaries
from atari_dqn.analysis.study import TITLES, Section
from atari_dqn.envs import EpisodeRecord
from atari_dqn.report import notebook, outputs, plots, results
from atari_dqn.runs import plan, recorder, records, robustness, styles
from atari_dqn.runs.files import project_root

DQN, DOUBLE, DUELING = AGENTS
FAR = 5000.0  # points, of a game that must not count


def test_missing_numbers_of_any_kind_are_dashes_and_numbers_stand_to_the_right(monkeypatch):
    said = []
    monkeypatch.setattr(outputs, "show_text", said.append)
    table = pd.DataFrame({"agent": ["DQN", None], "score": [1.25, np.nan], "games": [3, pd.NA]})
    outputs.show_table(table.astype({"games": "Int64"}), "tbl-any", "A caption.", decimals=1)
    rows = [[cell.strip() for cell in line.split("|")[1:-1]] for line in said[0].splitlines()[:4]]
    assert rows[2:] == [["DQN", "1.2", "3"], ["–", "–", "–"]]
    assert [cell.endswith(":") for cell in rows[1]] == [False, True, True]


def test_scores_at_marks_are_ours_by_agent_and_seed_beside_the_source_reports(tmp_path, shown):
    means = {(1, 500): 10, (501, 1000): 20, (1001, 1500): 30}
    store(tmp_path, "boxing_final", DOUBLE, windows(means, FAR))
    store(tmp_path, "boxing_final", DQN, windows({(501, 1000): -3}, FAR), seed=2)
    results.show_milestones(Section("boxing_final", "full", str(tmp_path), [DQN, DOUBLE], [1, 2]))
    rows = shown.tables["tbl-boxing-final-milestones"]
    marks = ["500", "1000", "1500", "2000", "2500", "3000"]
    found = [(row["agent"], row["whose"], [row[mark] for mark in marks]) for row in rows]
    assert found == [
        ("DQN", "ours, seed 2", ["5000.00", "-3.00", *"––––"]),
        ("DQN", "source report", ["10.61", "51.62", "69.93", "81.78", "82.75", "85.61"]),
        ("Double DQN", "ours, seed 1", ["10.00", "20.00", "30.00", *"–––"]),
        ("Double DQN", "source report", ["28.99", "80.19", "89.72", "90.79", "92.11", "92.62"]),
        (
            "Dueling Double DQN",
            "source report",
            ["36.27", "72.43", "83.42", "88.13", "88.34", "89.79"],
        ),
    ]
    caption = shown.captions["tbl-boxing-final-milestones"]
    assert caption.startswith("Boxing, final settings: mean raw score of the last 500 games")
    assert "Human 12.1, random play 0.1" in caption


def test_marks_of_a_shorter_experiment_are_sixths_of_its_games(tmp_path, shown):
    sixths = {
        (2, 167): 1,
        (168, 333): 2,
        (335, 500): 3,
        (502, 667): 4,
        (668, 833): 5,
        (835, 1000): 6,
    }
    store(tmp_path, "boxing_low_gamma", DUELING, windows(sixths, FAR, after=0))
    results.show_milestones(study(tmp_path)["boxing_low_gamma"])
    (row,) = shown.tables["tbl-boxing-low-gamma-milestones"]
    assert list(row) == ["agent", "whose", "167", "333", "500", "667", "833", "1000"]
    assert list(row.values())[2:] == ["1.00", "2.00", "3.00", "4.00", "5.00", "6.00"]
    assert "of the last 166 games" in shown.captions["tbl-boxing-low-gamma-milestones"]


KNOCKED = [1] * 10 + [-1] * 20 + [0] * 10  # of 40 games, a quarter by knock-out, half knocked out


def test_an_evaluation_has_a_row_per_condition_and_one_of_random_play(tmp_path, shown):
    for agent, mean, won in ((DQN, 10.0, 0.25), (DOUBLE, -30.0, 0.5)):
        run = store(tmp_path, "boxing_final", agent, np.zeros(700))
        wins = np.arange(40) < 40 * won
        evaluate(run, trained=600, score=mean, won=wins, knockout=KNOCKED)
        for otherwise in ({"difficulty": 2}, {"sticky_actions": 0.25}, {"trained": 500}):
            how = {"trained": 600, **otherwise}
            evaluate(run, add=True, **how, score=-90.0, knockout=1, games=30)
    for trained in (500, 600):  # games of random moves, the same whichever model stood by
        evaluate(run, add=True, trained=trained, epsilon=1.0, score=0.5, won=False, games=20)
    results.show_conditions(study(tmp_path)["boxing_final"])
    rows = shown.tables["tbl-boxing-final-evaluation"]
    columns = ("agent", "difficulty", "sticky", "games", "mean score", "won", "by knock-out")
    others = [("0", "0.25", "30", "-90.0", "0%", "100%"), ("2", "0", "30", "-90.0", "0%", "100%")]
    assert [tuple(row[name] for name in columns) for row in rows] == [
        ("DQN", "0", "0", "40", "10.0", "25%", "25%"),
        *[("DQN", *other) for other in others],
        ("Double DQN", "0", "0", "40", "-30.0", "50%", "25%"),
        *[("Double DQN", *other) for other in others],
        ("random play", "0", "0", "20", "0.5", "0%", "0%"),
    ]
    assert not {"seed", "training games"} & {*rows[0]}, "they are alike in all rows"
    for row in rows:
        low, high = numbers(row["95% interval"])
        # of 40 values evenly spread over two points
        assert high - low == pytest.approx(
            2 * 1.96 * 2 / 12**0.5 / int(row["games"]) ** 0.5, abs=0.13
        )
        assert (low + high) / 2 == pytest.approx(float(row["mean score"]), abs=0.11)
    caption = shown.captions["tbl-boxing-final-evaluation"]
    assert numbers(caption)[:3] == [600, 0, 0], "games of training, difficulty and stickiness"
    assert "with sticky actions and for random play, each game does" in caption


def test_games_played_with_more_exploration_alone_are_no_evaluation(tmp_path, shown):
    evaluate(store(tmp_path, "boxing_final", DQN, np.zeros(700)), trained=600, epsilon=0.05)
    results.show_conditions(study(tmp_path)["boxing_final"])
    assert not shown.tables


def test_models_of_different_games_are_told_apart_and_the_caption_is_of_the_rows(tmp_path, shown):
    for agent, trained in ((DQN, 500), (DOUBLE, 600)):
        evaluate(store(tmp_path, "boxing_final", agent, np.zeros(700)), trained=trained)
    results.show_conditions(study(tmp_path)["boxing_final"])
    rows = shown.tables["tbl-boxing-final-evaluation"]
    assert [row["training games"] for row in rows] == ["500", "600"]
    caption = shown.captions["tbl-boxing-final-evaluation"]
    assert "after 500 and 600 games of training" in caption
    assert "sticky actions of 0. Each opening" in caption
    assert "each game does" not in caption


def test_the_scores_of_both_games_stand_in_one_table(tmp_path, shown):
    results.show_scores(study(tmp_path))
    assert not shown.tables
    run = store(tmp_path, "boxing_final", DQN, np.full(3000, 50.0))
    evaluate(run, score=40.0)
    results.show_scores(study(tmp_path))
    rows = shown.tables["tbl-scores"]
    assert [row["game"] for row in rows] == ["Boxing", "", "", "Breakout", "", ""]
    assert list(rows[0].values())[1:] == ["DQN", "2,501 to 3,000", "50.0", "85.6", "40.0"]
    assert set(list(rows[3].values())[2:]) == {"–"}
    assert numbers(shown.captions["tbl-scores"])[1:3] == [12.1, 30.5]


def test_games_of_breakout_are_not_won_by_knock_out(tmp_path, shown):
    run = store(tmp_path, "breakout_final", DQN, np.zeros(700))
    evaluate(run, score=30.0)
    results.show_conditions(study(tmp_path)["breakout_final"])
    (row,) = shown.tables["tbl-breakout-final-evaluation"]
    assert row["mean score"] == "30.0"
    assert not {"won", "by knock-out", "seconds to knock-out"} & set(row)


def test_conditions_are_rows_of_their_own(tmp_path, shown):
    run = store(tmp_path, "boxing_expert", DQN, np.zeros(1000))
    evaluate(run, score=50.0)
    frames = [3000, 4200] * 5 + [7200] * 30  # of which the first ten are knock-outs
    evaluate(run, add=True, score=40.0, difficulty=1, knockout=KNOCKED, games=40, frames=frames)
    evaluate(run, add=True, score=30.0, sticky_actions=0.25, won=False, games=10)
    results.show_conditions(study(tmp_path)["boxing_expert"])
    rows = shown.tables["tbl-boxing-expert-evaluation"]
    columns = ("difficulty", "sticky", "mean score", "won", "by knock-out", "seconds to knock-out")
    assert [tuple(row[name] for name in columns) for row in rows] == [
        ("1", "0", "40.0", "100%", "25%", "60"),
        ("3", "0", "50.0", "100%", "0%", "–"),
        ("3", "0.25", "30.0", "0%", "0%", "–"),
    ]
    assert numbers(shown.captions["tbl-boxing-expert-evaluation"])[1:3] == [3, 0], "as trained"


def test_a_sweep_has_a_row_a_variation_beside_the_same_games_of_the_unchanged_set_up(
    tmp_path, shown
):
    last = {(485, 500): 8.0}  # of 500 games, the mean is over a thirtieth
    store(tmp_path, "boxing_final", DUELING, windows(last, FAR))
    store(tmp_path, "boxing_final", DQN, np.full(500, FAR))
    sweep, changes = "boxing_sensitivity", {"learning rate x 4": 3.0, "raw rewards": -5.0}
    for label, mean in changes.items():
        scores = window(485, 500, mean, FAR, after=0)
        run = store(tmp_path, sweep, DUELING, scores, variation=label)
        evaluate(run, score=mean + 10)
        evaluate(run, add=True, score=99, difficulty=1)
    store(tmp_path, sweep, DUELING, window(185, 200, 1.0, FAR, after=0), variation="batch size x 2")
    stored = study(tmp_path)
    results.show_variations(stored[sweep], stored["boxing_final"], DUELING)
    rows = shown.tables["tbl-boxing-sensitivity"]
    mean = "mean of the last 16 games"
    found = [
        (row["variation"], row["games"], row["hours"], row[mean], row["evaluation"]) for row in rows
    ]
    assert found == [
        ("unchanged", "500", "5.0", "8.0", "–"),
        ("learning rate × 4", "500", "5.0", "3.0", "13.0"),
        ("batch size × 2", "200", "2.0", "1.0", "–"),
        ("raw rewards", "500", "5.0", "-5.0", "5.0"),
    ]
    _, *changed = found
    figure = shown.figures["fig-boxing-sensitivity-curves"]
    panels = [one for one in figure.axes if one.lines]
    assert [axes.get_title(loc="left") for axes in panels] == [name for name, *_ in changed]
    assert figure.get_supxlabel() == "training games"
    assert numbers(figure.get_supylabel()) == [16]
    (legend,) = figure.legends
    names = [text.get_text() for text in legend.get_texts()]
    looks = dict(zip(names, (line.get_color() for line in legend.get_lines()), strict=True))
    for axes, (_, games, _, mean, _) in zip(panels, changed, strict=True):
        unchanged, change = axes.get_lines()
        ends = [line.get_ydata()[-1] for line in (unchanged, change)]
        assert ends == pytest.approx([8.0, float(mean)]), "of means, not of single games"
        drawn = {"unchanged": unchanged.get_color(), "with the change": change.get_color()}
        assert looks == drawn
        assert unchanged.get_color() == plots.STYLES[DUELING].colour != change.get_color()
        assert unchanged.get_linewidth() > change.get_linewidth()
        assert [line.get_xdata()[-1] for line in (unchanged, change)] == [500, int(games)]
    assert numbers(shown.captions["fig-boxing-sensitivity-curves"])[0] == 16


def test_any_game_of_the_emulator_goes_from_its_file_to_a_curve(tmp_path, monkeypatch, small):
    (tmp_path / "pyproject.toml").touch()
    (tmp_path / "params").mkdir()
    pong = small(experiment="pong", profile="full", game="pong", agents=["dqn"])
    (tmp_path / "params" / "pong.yaml").write_text(params.text(pong))
    shutil.copytree(project_root() / "notebooks" / "data", tmp_path / "notebooks" / "data")
    monkeypatch.chdir(tmp_path)
    (run,), _ = plan.planned("full", ["pong"], None)
    recorder.train(run)
    figures = {}
    monkeypatch.setattr(
        results, "show_figure", lambda figure, label, caption, **_: figures.update({label: caption})
    )
    results.show_curves(Section("pong", "full"))
    assert figures["fig-pong-curves"].startswith("Pong, `pong`: raw score while training")


def test_transfer_is_measured_over_the_episodes_that_both_runs_have(tmp_path, shown):
    scratch = store(tmp_path, "boxing_final", DQN, np.full(1200, 10.0))
    moved = store(tmp_path, "boxing_transfer", DQN, np.full(900, 15.0))
    for run, score in ((scratch, 2.0), (moved, 12.0)):
        checks = run.status()["episodes_done"] // 100
        check(run, np.array([*[score] * 5, *[99.0 * score] * (checks - 5)]))
    last = {(685, 850): 20.0}
    store(tmp_path, "boxing_final", DOUBLE, windows({(1, 500): 7.0, **last}, 0.0))
    last = {(685, 850): -4.0}
    store(tmp_path, "boxing_transfer", DOUBLE, windows({(1, 500): 4.0, **last}, 0.0, after=0))
    store(tmp_path, "boxing_final", DUELING, np.zeros(900))
    store(tmp_path, "boxing_transfer", DUELING, np.zeros(499))
    stored = study(tmp_path)
    results.show_transfer(stored["boxing_transfer"], stored["boxing_final"])
    first, second = shown.tables["tbl-transfer"]
    area = f"{5 / 110:.2f}"
    early = {"early": "5.00", "early, greedy": "10.00"}
    rest = {"area ratio": area, "at the end": "5.00"}
    assert first == {"agent": "DQN", "games": "900", **early, **rest}
    area = f"{(-24 * 166 - 3 * 500) / (850 * 100 + 20 * 166 + 7 * 500):.2f}"
    early = {"early": "-3.00", "early, greedy": "–"}
    rest = {"area ratio": area, "at the end": "-24.00"}
    assert second == {"agent": "Double DQN", "games": "850", **early, **rest}
    # of which episodes, as in the claim; greedy ones per check; of which last ones; the lowest
    assert numbers(shown.captions["tbl-transfer"]) == [500, 20, 166, -100]


def test_seeds_weigh_alike_in_what_transfer_is_worth(tmp_path, shown):
    for seed, mean in ((1, 10.0), (2, 30.0)):
        store(tmp_path, "boxing_final", DQN, np.full(700, 0.0), seed=seed)
        store(tmp_path, "boxing_transfer", DQN, np.full(550 + 50 * seed, mean), seed=seed)
    pair = [
        Section(name, "full", str(tmp_path), [DQN], [1, 2])
        for name in ("boxing_transfer", "boxing_final")
    ]
    results.show_transfer(*pair)
    (row,) = shown.tables["tbl-transfer"]
    assert (row["games"], row["area ratio"], row["at the end"]) == ("600", "0.20", "20.00")


def test_play_styles_are_rows_of_the_same_training_the_lowest_discount_first(tmp_path, shown):
    final = store(tmp_path, "boxing_final", DUELING, np.zeros(1200))
    own = np.r_[np.full(5, 10.0), np.full(4, 30.0), FAR, 50.0, 50.0]  # the tenth check is its alone
    style(final, own, conceded=20.0, reach=0.25)
    style(store(tmp_path, "boxing_final", DQN, np.zeros(1200)), np.full(12, FAR))  # another agent's
    stored = study(tmp_path)
    played = [stored["boxing_final"], stored["boxing_low_gamma"]]
    results.show_playstyle(played, "tbl-playstyle")
    assert "tbl-playstyle" not in shown.tables, "one discount is no comparison"
    assert "#tbl-playstyle .absent" in shown.texts[-1]
    low = store(tmp_path, "boxing_low_gamma", DUELING, np.zeros(900))
    style(low, np.full(9, -5.0), scored=30.0, conceded=60.0, punches=50, distance=25.0)
    stored = study(tmp_path)
    results.show_playstyle([stored["boxing_final"], stored["boxing_low_gamma"]], "tbl-playstyle")
    rows = shown.tables["tbl-playstyle"]
    found = [(row.pop("training games"), row.pop("discount"), row.pop("score")) for row in rows]
    assert found == [
        ("1 to 500", "0.9", "-5.0"),
        ("1 to 500", "0.99", "10.0"),
        ("501 to 900", "0.9", "-5.0"),
        ("501 to 900", "0.99", "30.0"),
        ("1,001 to 1,200", "0.99", "50.0"),
    ]
    counts = ("points scored", "points conceded", "punches thrown")  # per minute, of two
    reckless = dict(zip(counts, ("15.0", "30.0", "25.0"), strict=True))
    reckless |= {"distance": "25.0", "within reach": "50%"}
    careful = dict(zip(counts, ("15.0", "10.0", "30.0"), strict=True))
    careful |= {"distance": "40.0", "within reach": "25%"}
    assert rows == [reckless, careful, reckless, careful, careful]
    caption = shown.captions["tbl-playstyle"]
    assert "Dueling Double DQN boxes" in caption
    assert "per minute" in caption
    assert numbers(caption) == [20, 100], "greedy games of a check, and games between two"


def test_the_styles_along_training_have_a_panel_per_measure_and_a_line_per_agent(tmp_path, shown):
    for agent, base in ((DOUBLE, 1.0), (DQN, 2.0)):
        run = store(tmp_path, "boxing_final", agent, np.zeros(300))
        curve = base * np.array([1.0, 2.0, 3.0])
        how = {"distance": 10 * curve, "reach": curve / 10, "punches": curve.astype(int)}
        how |= {"blows": 10, "doubles": curve.astype(int), "scored": 33.3 * curve}
        how |= {"ropes": curve / 20, "rival_ropes": curve / 50}
        style(run, np.zeros(3), **how, conceded=2 * curve)
    results.show_learning_style(study(tmp_path)["boxing_final"])
    figure = shown.figures["fig-boxing-final-style"]
    panels = figure.axes
    (legend,) = figure.legends
    names = [text.get_text() for text in legend.get_texts()]
    looks = dict(zip(names, (line.get_color() for line in legend.get_lines()), strict=True))
    expected = {"DQN": plots.STYLES[DQN].colour, "Double DQN": plots.STYLES[DOUBLE].colour}
    assert looks == expected
    assert {axes.get_xlabel() for axes in panels[-2:]} == {"training games"}
    # an episode lasts two minutes
    factors = (10, 10, 0.5, None, None, 33.3 / 2, 1, 10, None, None, 5, 2)
    for axes, factor in zip(panels, factors, strict=True):
        if factor is None:
            continue
        lines = {line.get_label(): line.get_xydata() for line in axes.get_lines()}
        assert list(lines) == ["DQN", "Double DQN"]
        assert {line.get_label(): line.get_color() for line in axes.get_lines()} == expected
        for name, base in (("DQN", 2.0), ("Double DQN", 1.0)):
            assert lines[name][:, 0].tolist() == [100, 200, 300]
            assert lines[name][:, 1] == pytest.approx(factor * base * np.array([1.0, 2.0, 3.0]))
    titles = [axes.get_title(loc="left") for axes in panels]
    words = ("distance", "reach", "thrown", "landed", "per punch", "scored", "conceded")
    words += ("two points", "won by knock-out", "seconds to a knock-out")
    words += ("agent at the ropes", "rival at the ropes")
    assert all(word in title for word, title in zip(words, titles, strict=True))
    landed, per_punch, knock_outs = (panels[n].get_lines()[0].get_ydata() for n in (3, 4, 8))
    assert landed == pytest.approx([5] * 3)
    assert per_punch == pytest.approx([33.3] * 3)
    assert knock_outs.tolist() == [0, 100, 100], "66.6 points are none, 133.2 are more than one"
    assert "#tbl-boxing-final-style .absent" in shown.texts[-1], "three checks are too few"
    assert numbers(shown.captions["fig-boxing-final-style"]) == [20, 100], "greedy, training games"


def test_a_game_of_four_openings_shows_the_range_of_their_means_in_place_of_an_interval(
    tmp_path, shown
):
    run = store(tmp_path, "breakout_late", DQN, np.zeros(3000))
    evaluate(run, games=100)
    evaluate(run, games=100, add=True, sticky_actions=0.25)
    section = study(tmp_path)["breakout_late"]
    results.show_conditions(section)
    ranges, intervals = (
        row["95% interval, or range"] for row in shown.tables["tbl-breakout-late-evaluation"]
    )
    usual = section.final_evaluations.query("sticky_actions == 0")
    means = usual.groupby("opening").score.mean()
    assert len(means) == 4
    assert ranges == f"range {means.min():.1f} to {means.max():.1f}"
    low, high = numbers(intervals)
    assert low < 20 < high
    caption = shown.captions["tbl-breakout-late-evaluation"]
    assert (
        "A range is that of the openings' means; with sticky actions, it is a 95% interval over "
        "games. Nothing follows for other seeds."
    ) in caption


def test_the_time_to_a_knock_out_is_the_mean_of_the_games_that_end_so(tmp_path, monkeypatch):
    run = store(tmp_path, "boxing_final", DQN, np.zeros(1000))
    monkeypatch.setattr(params, "VALUE_GAMES", 3)
    style(run, np.zeros(10), greedy=3)
    table = pd.read_csv(run.styles)
    late = table.index[-3:]  # the last check: two knock-outs, and a long game without
    table.loc[late, ["scored", "frames"]] = [[100, 1200], [101, 2400], [99, 7141]]
    table.loc[late[0] - 3, ["scored", "frames"]] = [100, 3600]  # one in the check before
    table.to_csv(run.styles, index=False)
    section = study(tmp_path)["boxing_final"]
    of_check = section.styles.groupby("episode").to_knock_out.mean()
    assert of_check.dropna().to_dict() == {900: 60, 1000: 30}
    (change,) = (
        summaries.style_changes(section).query("measure == 'to_knock_out'").to_dict("records")
    )
    assert np.isnan(change["first"])
    assert change["last"] == 40, "of three knock-outs, whatever check they are of"


def test_an_interval_of_a_change_ends_where_the_measure_does(tmp_path):
    run = store(tmp_path, "boxing_final", DQN, np.zeros(1000))
    knocked = [0, 1, 0, 0, 0] + [1] * 5
    style(run, np.zeros(10), scored=100.0 * np.array(knocked), distance=[9.0, *[0.0] * 9])
    changes = summaries.style_changes(study(tmp_path)["boxing_final"]).set_index("measure")
    row = changes.loc["knock_outs", ["first", "last", "high"]]
    assert row.tolist() == [20, 100, 80], "Welch's interval would go on to 136"
    row = changes.loc["distance", ["first", "last", "low"]]
    assert row.tolist() == [1.8, 0, -1.8], "and this one to -6.8"


def test_the_style_map_goes_from_the_first_checks_to_the_last(tmp_path, shown):
    run = store(tmp_path, "boxing_final", DQN, np.zeros(1000))
    style(run, np.zeros(10), distance=30.0 + np.arange(10), conceded=[80.0] * 5 + [20.0] * 5)
    results.show_style_map(study(tmp_path)["boxing_final"])
    (axes,) = shown.figures["fig-boxing-final-style-map"].axes
    way, start, end = (line.get_xydata() for line in axes.get_lines())
    assert way[[0, -1]].tolist() == [[32, 40], [37, 10]], "means of five checks, of two minutes"
    assert len(way) == 6
    assert [start.tolist(), end.tolist()] == [[[32, 40]], [[37, 10]]]
    hollow, filled = (line.get_markerfacecolor() for line in axes.get_lines()[1:])
    assert (hollow, filled) == ("white", axes.get_lines()[0].get_color())
    assert "distance" in axes.get_xlabel()
    assert "conceded" in axes.get_ylabel()
    few = store(tmp_path / "few", "boxing_final", DQN, np.zeros(900))
    style(few, np.zeros(9))
    results.show_style_map(study(tmp_path / "few")["boxing_final"])
    assert "#fig-boxing-final-style-map .absent" in shown.texts[-1], "the ends would overlap"


def test_the_map_of_discounts_has_a_way_for_each_over_as_many_games(tmp_path, shown):
    for name, checks, distance in (("boxing_low_gamma", 10, 40.0), ("boxing_final", 12, 30.0)):
        run = store(tmp_path, name, DUELING, np.zeros(100 * checks))
        style(run, np.zeros(checks), distance=distance + np.arange(checks), conceded=20.0)
    style(store(tmp_path, "boxing_high_gamma", DUELING, np.zeros(900)), np.zeros(9))
    names = ("boxing_low_gamma", "boxing_final", "boxing_high_gamma")
    results.show_discount_map([study(tmp_path)[name] for name in names], label="fig-map")
    (axes,) = shown.figures["fig-map"].axes
    ways = {line.get_label(): line.get_xydata() for line in axes.get_lines()[::3]}
    assert list(ways) == ["discount 0.9", "discount 0.99"], "nine checks are too few"
    assert ways["discount 0.9"][[0, -1]].tolist() == [[42, 10], [47, 10]]
    assert ways["discount 0.99"][[0, -1]].tolist() == [[32, 10], [37, 10]], "not to its own end"
    assert numbers(shown.captions["fig-map"]) == [1000, 5]
    results.show_discount_map([study(tmp_path)[names[0]]], label="fig-one")
    assert "#fig-one .absent" in shown.texts[-1]


def test_maps_of_the_ring_are_of_the_first_check_and_of_the_last(tmp_path, shown, monkeypatch):
    store(tmp_path, "boxing_final", DQN, np.zeros(300))
    asked = []

    def stays(run, episode):
        asked.append((run.agent, episode))
        both = np.zeros((2, 20, 22))  # a cell each: the rival's is right of the agent's and above
        both[0, 3, 9], both[1, 12, 2] = 1, 1
        return both

    monkeypatch.setattr(styles, "checks", lambda run: [100, 200, 300])
    monkeypatch.setattr(styles, "stays", stays)
    found = results.show_places(study(tmp_path)["boxing_final"])
    assert {agent: list(checks) for agent, checks in found.items()} == {DQN: [100, 300]}
    assert asked == [(DQN, 100), (DQN, 300)]
    panels = shown.figures["fig-boxing-final-places"].axes
    titles = [axes.get_title() for axes in panels]
    words = ("agent, 100", "rival, 100", "agent, 300", "rival, 300")
    assert all(word in title for word, title in zip(words, titles, strict=True))
    for axes, (x, y) in zip(panels, [(3, 9), (12, 2)] * 2, strict=True):
        (mesh,) = axes.collections
        row, column = np.unravel_index(mesh.get_array().argmax(), (22, 20))
        assert (column, row) == (x, y)
        assert axes.yaxis_inverted()
    caption = shown.captions["fig-boxing-final-places"]
    assert "the stronger the colour, the longer" in caption, "dark pages turn light and dark round"
    assert numbers(caption)[-1] == panels[0].collections[0].norm.gamma == 0.4
    assert "not proportional" in caption


def test_balls_of_breakout_are_told_by_their_speed_and_by_where_they_are_lost(tmp_path, shown):
    run = store(tmp_path, "breakout_late", DQN, np.zeros(300))
    speeds = ("slow", "medium", "fast")
    counts = {f"returned_{speed}": 9 - 3 * index for index, speed in enumerate(speeds)}  # 9, 6, 3
    counts |= {"lost_slow": 1, "lost_medium": [2, 2, 0], "lost_fast": [1, 9, 1]}
    counts |= {"lost_left": [1, 0, 3], "lost_middle": [2, 4, 1], "lost_right": [1, 0, 0]}
    style(run, np.zeros(3), **counts, tunnel=[0, 1, 1], above=[0.0, 12.0, 30.0])
    results.show_learning_style(study(tmp_path)["breakout_late"])
    panels = shown.figures["fig-breakout-late-style"].axes
    expected = {
        "slow balls": [90, 90, 90],
        "faster balls": [75, 75, 100],
        "fastest balls": [75, 25, 75],
        "at the sides": [50, 0, 75],
        "tunnel": [0, 100, 100],
        "above the wall": [0, 12, 30],
    }
    for axes, (words, values) in zip(panels, expected.items(), strict=True):
        assert words in axes.get_title(loc="left")
        assert axes.get_lines()[0].get_xydata().T.tolist() == [[100, 200, 300], values]
    assert "Breakout" in shown.captions["fig-breakout-late-style"]


def test_shares_of_balls_are_of_all_balls_of_a_check_and_of_all_checks(tmp_path, monkeypatch):
    """Ten checks of two games; a game in which many balls come back counts by its balls."""
    run = store(tmp_path, "breakout_late", DQN, np.zeros(1000))
    monkeypatch.setattr(params, "VALUE_GAMES", 2)
    style(run, np.zeros(10), greedy=2)
    table = pd.read_csv(run.styles)
    late = table.episode > 500
    for name, early, played in (("returned_slow", 1, (0, 8)), ("lost_slow", 3, (1, 1))):
        table[name] = early
        table.loc[late, name] = np.tile(played, 5)
    table.loc[table.episode == 1000, ["returned_slow", "lost_slow"]] = [[30, 0], [30, 0]]
    table.to_csv(run.styles, index=False)
    section = study(tmp_path)["breakout_late"]
    checks = section.styles.groupby("episode").slow.mean()
    assert checks.tolist() == [25.0] * 5 + [80.0] * 4 + [100.0]
    row = summaries.style_changes(section).set_index("measure").loc["slow"]
    assert row["first"] == 25
    assert row["last"] == pytest.approx(100 * (4 * 8 + 60) / (4 * 10 + 60))


def test_checks_without_a_measure_do_not_hide_a_change_that_is_clear(tmp_path, shown):
    """A step after check 15 of 30; in four checks of each ten no ball is fast."""
    run = store(tmp_path, "breakout_late", DQN, np.zeros(3000))
    there = np.tile([1, 0, 1, 0, 1, 0, 1, 0, 1, 1], 3)
    returned = there * np.r_[np.tile([10, 11], 8)[:15], np.tile([60, 61], 8)[:15]]
    style(run, np.zeros(30), returned_fast=returned, lost_fast=there * 100 - returned)
    section = study(tmp_path)["breakout_late"]
    row = summaries.style_changes(section).set_index("measure").loc["fast"]
    assert 45 < row.low < row.high < 55
    assert 1400 <= row.half_way <= 1700
    results.show_learning_style(section)
    rows = {row["measure"]: row for row in shown.tables["tbl-breakout-late-style"]}
    assert "no clear change" in rows["games with a tunnel (%)"]["DQN"]


def test_a_share_of_one_check_alone_is_no_beginning(tmp_path, shown):
    run = store(tmp_path, "breakout_late", DQN, np.zeros(1000))
    balls = np.r_[0, 0, 1, 0, 0, np.full(5, 9)]
    style(run, np.zeros(10), returned_fast=balls, lost_fast=balls)
    results.show_learning_style(study(tmp_path)["breakout_late"])
    rows = {row.pop("measure"): row for row in shown.tables["tbl-breakout-late-style"]}
    assert rows["fastest balls returned (%)"] == {"DQN": "– → 50.0"}
    assert "A dash" in shown.captions["tbl-breakout-late-style"]


def test_a_row_of_styles_has_the_same_decimals_throughout_and_no_minus_zero(tmp_path, shown):
    for agent, distance in ((DQN, [27.94] * 5 + [27.0] * 5), (DOUBLE, [3.3] * 5 + [100.4] * 5)):
        run = store(tmp_path, "boxing_final", agent, np.zeros(1000))
        how = {"distance": np.array(distance), "ropes": 0.0, "rival_ropes": 0.0, "scored": 55.0}
        style(run, np.zeros(10), **how, punches=[100] * 5 + [120] * 5)
    results.show_learning_style(study(tmp_path)["boxing_final"])
    rows = {row.pop("measure"): row for row in shown.tables["tbl-boxing-final-style"]}
    row = rows["distance of the boxers (pixels)"]
    assert {name: cell.partition(" (")[0] for name, cell in row.items()} == {
        "DQN": "28 → 27",
        "Double DQN": "3 → 100",
    }
    assert rows["points scored per punch"]["DQN"].startswith("0.55 → 0.46 (-0.09 to -0.09;")
    assert rows["punches thrown per minute"]["DQN"].startswith("50.0 → 60.0 (+10.0 to +10.0;")
    (cell,) = set(rows["agent at the ropes (% of the time)"].values())
    assert cell == "0 → 0 (0 to 0; no clear change)"


def test_a_game_without_a_ball_of_some_speed_says_nothing_of_it(tmp_path, monkeypatch):
    run = store(tmp_path, "breakout_late", DQN, np.zeros(200))
    monkeypatch.setattr(params, "VALUE_GAMES", 1)
    style(run, np.zeros(2), returned_fast=0, lost_fast=[0, 2], greedy=1)
    styles = study(tmp_path)["breakout_late"].styles
    assert styles.fast.isna().tolist() == [True, False]
    assert styles.fast[1] == 0


def test_a_change_of_style_is_told_with_the_games_after_which_half_of_it_is_done(tmp_path, shown):
    run = store(tmp_path, "boxing_final", DQN, np.zeros(2000))
    rise = np.repeat([1.0, 2.0], [8, 12]) + np.tile([-0.05, 0.05, 0, -0.05, 0.05], 4)
    flat = np.tile([4.0, 6.0], 10)
    how = {"scored": 40.0 * rise, "reach": 0.4 * rise, "distance": 10 * flat}
    how["punches"] = (20 * rise).round().astype(int)
    style(run, np.zeros(20), **how, conceded=2 * flat)
    section = study(tmp_path)["boxing_final"]
    results.show_learning_style(section)
    rows = {row.pop("measure"): row for row in shown.tables["tbl-boxing-final-style"]}
    # five checks of 1 (8 there are) and five of 2, smoothed over five: 1.6 at the 9th
    told = {measure: row["DQN"] for measure, row in rows.items()}
    assert told["punches thrown per minute"].startswith("10.0 → 20.0 (")
    assert told["punches thrown per minute"].endswith("; half after 900 games)")
    assert told["time within reach (%)"].startswith("40.0 → 80.0 (")
    assert told["points scored per punch"] == "2.0 → 2.0 (0.0 to 0.0; no clear change)"
    assert told["distance of the boxers (pixels)"].endswith("; no clear change)")
    low, high = numbers(told["points conceded per minute"])[2:]
    assert low < 0 < high
    low, high, games = numbers(told["points scored per minute"])[2:]
    assert 0 < low < 20 < high, "from 20 to 40"
    assert games == 900
    assert numbers(shown.captions["tbl-boxing-final-style"]) == [5, 95], "checks at either end"


def test_what_there_was_nothing_of_at_first_has_no_change(tmp_path, shown):
    run = store(tmp_path, "breakout_late", DQN, np.zeros(2000))
    fast = np.repeat([0, 5], 10)
    style(run, np.zeros(20), returned_fast=fast, lost_fast=fast, tunnel=np.repeat([0, 1], 10))
    results.show_learning_style(study(tmp_path)["breakout_late"])
    rows = {row.pop("measure"): row for row in shown.tables["tbl-breakout-late-style"]}
    fastest, tunnels = rows["fastest balls returned (%)"], rows["games with a tunnel (%)"]
    assert fastest == {"DQN": "– → 50.0"}
    assert tunnels["DQN"].startswith("0 → 100 (+100 to +100; half after")


def test_an_empty_place_gives_a_reason_where_no_badge_does(tmp_path, shown):
    store(tmp_path, "boxing_final", DQN, np.zeros(2999))
    stored = study(tmp_path)
    results.show_values(stored["boxing_final"])
    results.show_discounts([stored["boxing_final"]], DUELING, "fig-discounts")
    reasons = [text.splitlines()[1] for text in shown.texts]
    assert [text.split("{#")[1].split(" ")[0] for text in shown.texts] == [
        "fig-boxing-final-values",
        "fig-discounts",
    ]
    assert all(len(reason) > 20 for reason in reasons)


def test_a_badge_tells_what_is_complete_the_share_played_and_what_is_planned(tmp_path, shown):
    store(tmp_path, "boxing_final", DQN, np.zeros(3000))
    store(tmp_path, "boxing_final", DOUBLE, np.zeros(1500))
    stored = study(tmp_path)
    notebook.show_badge(stored["boxing_final"])
    assert numbers(shown.texts[-1])[:5] == [1, 3, 4500, 9000, 50]
    assert ".partial" in shown.texts[-1]
    assert stored["boxing_final"].counted().startswith("1 run per agent, so no statement")
    notebook.show_badge(stored["boxing_low_gamma"])
    assert "Not started" in shown.texts[-1]
    assert numbers(shown.texts[-1])[:2] == [1, 1000]
    store(tmp_path, "boxing_low_gamma", DUELING, np.zeros(1000))
    notebook.show_badge(study(tmp_path)["boxing_low_gamma"])
    assert numbers(shown.texts[-1])[:5] == [1, 1, 1000, 1000, 100]
    assert ".partial" not in shown.texts[-1]


def test_a_finished_agents_score_stands_beside_those_under_conditions_it_has_never_met(
    tmp_path, shown
):
    for agent, less, idle in ((DQN, 0.0, (1, 1, 2, 1, 1)), (DOUBLE, 50.0, (1, 2, 3, 3))):
        run = store(tmp_path, "boxing_final", agent, np.full(3000, 5.0))
        evaluate(run, score=80.0 - less)
        evaluate(run, add=True, score=60.0 - less, sticky_actions=0.25)
        evaluate(run, add=True, score=FAR, difficulty=1)
        rows = [
            *(("sequence", 29, 10.0 - less), ("mirrored", 100, 30.0 - less)),
            *(("field", 100, 35.0 - less), ("bar_gone", 100, 45.0 - less)),
            ("scoreboard", 99, FAR),  # a game less than there are
        ]
        run.robustness.parent.mkdir(parents=True, exist_ok=True)
        table = {"length": 9, "trained_games": 3000}
        pd.DataFrame(
            {"condition": name, "game": game, "score": mean + game % 3 - 1, **table}
            for name, games, mean in rows
            for game in range(games)
        ).to_csv(run.robustness, index=False)
        games = [
            ({"kind": "training", "episode": number}, EpisodeRecord(moment, bytes(3), None))
            for number, moment in enumerate(idle, 1)
        ]
        record(run, *games)
    results.show_robustness(study(tmp_path)["boxing_final"])
    table = shown.tables["tbl-boxing-final-robustness"]
    found = [(row["agent"], row["condition"], row["games"], row["mean score"]) for row in table]
    assert found == [
        ("DQN", "as trained", "40", "80.0"),
        ("DQN", "sticky actions, 0.25", "40", "60.0"),
        ("DQN", "left and right exchanged", "100", "30.0"),
        ("DQN", "in the field alone", "100", "35.0"),
        ("DQN", "black bar painted over", "100", "45.0"),
        ("DQN", "the best game's moves, blindly", "29", "10.0"),
        ("Double DQN", "as trained", "40", "30.0"),
        ("Double DQN", "sticky actions, 0.25", "40", "10.0"),
        ("Double DQN", "left and right exchanged", "100", "-20.0"),
        ("Double DQN", "in the field alone", "100", "-15.0"),
        ("Double DQN", "black bar painted over", "100", "-5.0"),
        ("Double DQN", "the best game's moves, blindly", "29", "-40.0"),
    ]
    for row in table:
        low, high = numbers(row["95% interval"])
        assert (low + high) / 2 == pytest.approx(float(row["mean score"]), abs=0.11)
        if row["games"] == "40":  # evenly spread over two points
            assert high - low == pytest.approx(2 * 1.96 * 2 / 12**0.5 / 40**0.5, abs=0.12)
        if "blindly" in row["condition"]:  # as many of each of three scores, one point apart
            assert high - low == pytest.approx(2 * 1.96 * (2 / 3 / 29) ** 0.5, abs=0.12)
    said = [80, "DQN", 50, "Double DQN"]  # four of five begin alike, and two of four
    assert facts(shown.texts[-1]) == [500, 100, *said]


def test_views_are_of_one_moment_each_exchanged_elsewhere_over_the_scores_there(tmp_path, shown):
    run = store(tmp_path, "boxing_final", DQN, np.full(3000, 5.0))
    results.show_views(study(tmp_path)["boxing_final"])
    assert not shown.figures
    evaluate(run, 1, score=80.0)
    heading = {"kind": "evaluation", "trained_games": 3000, "difficulty": 0, "sticky_actions": 0.0}
    heading |= {"epsilon": 0.001, "seed": 1, "game": 0}
    run.robustness.parent.mkdir(parents=True)
    means = {"mirrored": -10.0, "field": 20.0, "bar_moved": 30.0, "bar_gone": 40.0}
    pd.DataFrame(
        {"condition": name, "game": game, "score": mean, "length": 9, "trained_games": 3000}
        for name, mean in means.items()
        for game in range(100)
    ).to_csv(run.robustness, index=False)
    played = EpisodeRecord(3, bytes([9] * 4), None)  # four steps, the first of which is made
    record(run, (heading, played))
    results.show_views(study(tmp_path)["boxing_final"])
    panels = shown.figures["fig-boxing-final-views"].axes
    said = [axes.get_xlabel() for axes in panels]
    assert [numbers(text)[0] for text in said] == [pytest.approx(80, abs=1), -10, 20, 30, 40]
    plain, whole, field, moved, gone = (axes.images[0].get_array() for axes in panels)
    game, _ = records.begin(run.params, played)
    np.testing.assert_array_equal(plain, game.step(9)[0])
    np.testing.assert_array_equal(whole, plain[:, ::-1])
    np.testing.assert_array_equal(field[10:70, 14:70], whole[10:70, 14:70])
    np.testing.assert_array_equal(moved[:, 79:], whole[:, 79:])
    assert (gone[:, [0, -1]] > 0).all()


def test_repeated_openings_count_idle_frames_and_no_more_than_the_games_and_steps_asked_for(
    tmp_path,
):
    run = store(tmp_path, "boxing_final", DQN, np.full(6, 5.0))
    openings = [(1, [1, 2, 3]), (9, [4, 4, 4]), (1, [1, 2, 9]), (2, [1, 2, 3]), (1, [1, 2])]
    games = [
        ({"kind": "training", "episode": number}, EpisodeRecord(idle, bytes(actions), None))
        for number, (idle, actions) in enumerate(openings, 1)
    ]
    (run.folder / records.FILE).write_bytes(records.encode(games))
    assert robustness.repeated_openings(run, 5, 2) == 3 / 5
    assert robustness.repeated_openings(run, 5, 3) == 0
    assert robustness.repeated_openings(run, 4, 2) == 2 / 4


def test_from_three_seeds_on_a_caption_claims_no_less_than_the_runs_allow(tmp_path):
    for seed in (1, 2, 3):
        store(tmp_path, "boxing_final", DQN, np.zeros(300), seed=seed)
    for seeds, expected in (([1, 2], "2 runs per agent, so no"), ([1, 2, 3], "3 runs per agent")):
        section = Section("boxing_final", "full", str(tmp_path), [DQN], seeds)
        assert section.counted().startswith(expected)
        assert ("no statement" in section.counted()) == (len(seeds) < 3)


def test_every_experiment_of_the_report_has_a_title_for_people(tmp_path):
    for name, section in study(tmp_path).sections.items():
        assert "_" not in section.title, name
        assert section.title.startswith(section.facts.title)


def test_an_experiment_stands_beside_the_same_games_of_another(tmp_path, shown):
    store(tmp_path, "boxing_expert", DQN, np.repeat([5.0, 30.0, 70.0], [50, 450, 500]))
    store(tmp_path, "boxing_final", DQN, np.repeat([1.0, 8.0, 40.0, 90.0], [50, 450, 500, 2000]))
    store(tmp_path, "boxing_final", DOUBLE, np.full(400, 3.0))  # not in the other
    stored = study(tmp_path)
    results.show_beside(stored["boxing_expert"], stored["boxing_final"])
    games = ("1 to 50", "51 to 500", "501 to 1,000")
    rows = shown.tables["tbl-boxing-expert-beside"]
    found = [(row["agent"], row["runs"], *(row[part] for part in games)) for row in rows]
    titles = [TITLES["boxing_expert"], TITLES["boxing_final"]]
    assert found == [
        ("DQN", titles[0], "5.0", "30.0", "70.0"),
        ("DQN", titles[1], "1.0", "8.0", "40.0"),
        ("Double DQN", titles[1], "3.0", "–", "–"),
    ]


def test_endings_are_shown_for_each_milestone_with_the_games_that_they_are_of(tmp_path, shown):
    results.show_endings(study(tmp_path)["boxing_final"])
    assert not shown.tables
    run = store(tmp_path, "boxing_final", DQN, np.repeat([60.0, -30.0, 80.0], [400, 100, 500]))
    frames = np.repeat([3600, 7200, 1800], [400, 100, 500])  # of a game; 3,600 are a minute
    table = pd.read_csv(run.folder / "episodes.csv").assign(frames=np.cumsum(frames), length=450)
    table.to_csv(run.folder / "episodes.csv", index=False)
    results.show_endings(study(tmp_path)["boxing_final"])
    rows = shown.tables["tbl-boxing-final-endings"]
    # of the first 500 games 400 take a minute, and 100 two; of the next all take half a minute
    assert rows == [
        {"agent": "DQN", "measure": "won by knock-out, %", "500": "80", "1000": "100"},
        {"agent": "DQN", "measure": "seconds per game", "500": "72", "1000": "30"},
        {"agent": "DQN", "measure": "net points per minute", "500": "35", "1000": "160"},
    ]
    assert numbers(shown.captions["tbl-boxing-final-endings"]) == [500]
