"""What the figures' axes hold: every curve its own numbers, in its own unit, under its own name."""

import numpy as np
import pandas as pd
import pytest
from synthetic import AGENTS, TITLES, check, evaluate, lines_of, named_lines, numbers, store, study

from atari_dqn.analysis.study import Section
from atari_dqn.report import plots, results

DQN, DOUBLE, DUELING = AGENTS
GAMES = np.arange(1, 201)
SHOWN = np.arange(100, 201)  # games that have a mean of 100


def slope(times):
    """The mean of the last hundred scores where the n-th is `times` n."""
    return times * (SHOWN - 49.5)


@pytest.fixture
def panels(tmp_path, shown):
    """The axes of the learning curves by their units: DQN from two seeds, Double DQN from one."""
    store(tmp_path, "boxing_final", DQN, 0.1 * GAMES, seed=1)
    store(tmp_path, "boxing_final", DQN, 0.3 * GAMES, seed=2)
    store(tmp_path, "boxing_final", DOUBLE, 0.5 * GAMES, seed=1)
    results.show_curves(Section("boxing_final", "full", str(tmp_path), [DQN, DOUBLE], [1, 2]))
    figure = shown.figures["fig-boxing-final-curves"]
    return {axes.get_xlabel(): axes for axes in figure.axes}


def curves(axes, agent):
    colour = plots.COLOURS[agent]
    return [
        (line.get_xdata(), line.get_ydata())
        for line in axes.get_lines()
        if len(line.get_xdata()) > 2 and line.get_color() == colour
    ]


@pytest.mark.parametrize(
    ("unit", "a_game"),
    [("games played", 1), ("million frames", 0.02), ("hours by the clock", 0.01)],
)
def test_every_seed_has_its_own_curve_against_each_unit(panels, unit, a_game):
    drawn = curves(panels[unit], DQN)
    assert len(drawn) == (3 if unit == "games played" else 2)
    for (xs, ys), times in zip(drawn[:2], (0.1, 0.3), strict=True):
        assert xs == pytest.approx(SHOWN * a_game)
        assert ys == pytest.approx(slope(times))
    (xs, ys), *_ = curves(panels[unit], DOUBLE)
    assert xs == pytest.approx(SHOWN * a_game)
    assert ys == pytest.approx(slope(0.5))


def test_the_bold_curve_is_the_mean_of_an_agents_seeds(panels):
    *_, (xs, ys) = curves(panels["games played"], DQN)
    assert xs == pytest.approx(SHOWN)
    assert ys == pytest.approx(slope(0.2))


def test_curves_are_named_after_their_agents_and_the_axis_after_its_window(panels):
    axes = panels["games played"]
    named = named_lines(axes)
    assert list(named) == ["DQN", "Double DQN"]
    assert named["Double DQN"][0][1] == pytest.approx(slope(0.5))
    assert numbers(axes.get_ylabel()) == [100]


def test_human_and_random_lines_lie_at_their_scores_and_are_named(panels):
    for axes in panels.values():
        assert [ys for _, ys in lines_of(axes, ":")] == [[12.1, 12.1], [0.1, 0.1]]
    notes = {note.get_text(): note.xy[1] for note in panels["games played"].texts}
    assert notes == {"human 12.1": 12.1, "random play 0.1": 0.1}


def test_published_scores_stand_at_their_frames_as_far_as_ours_reach(panels):
    """Ours reach four million frames; the marks are at 5, 10 and 21."""
    marks = {
        line.get_label(): (list(line.get_xdata()), list(line.get_ydata()))
        for line in panels["million frames"].get_lines()
        if line.get_label().endswith("published")
    }
    assert marks == {
        "DQN, published": ([5], [2.6]),
        "DQN, Adam, published": ([5], [24.0]),
        "Rainbow, published": ([5], [18.0]),
    }


def test_the_values_under_the_pointer_are_those_of_the_curves(tmp_path, shown, panels):
    hover = shown.hovers["fig-boxing-final-curves"]
    first, second = hover["curves"]
    assert (first["name"], second["name"]) == ("DQN", "Double DQN")
    assert first["xs"] == SHOWN.tolist()
    assert first["ys"] == pytest.approx(slope(0.2), abs=0.006)
    assert second["ys"] == pytest.approx(slope(0.5), abs=0.006)
    axes = panels["games played"]
    place = hover["axes"]
    assert (place["x_min"], place["x_max"]) == pytest.approx(axes.get_xlim(), abs=1e-3)
    assert (place["left"], place["width"]) == pytest.approx(
        (axes.get_position().x0, axes.get_position().width), abs=1e-3
    )


def test_of_seeds_that_have_come_less_far_the_mean_ends_where_one_ends(tmp_path, shown):
    store(tmp_path, "boxing_final", DQN, np.full(200, 10.0), seed=1)
    store(tmp_path, "boxing_final", DQN, np.full(150, 30.0), seed=2)
    results.show_curves(Section("boxing_final", "full", str(tmp_path), [DQN], [1, 2]))
    axes = shown.figures["fig-boxing-final-curves"].axes[0]
    one, two, mean = curves(axes, DQN)
    assert [xs[-1] for xs, _ in (one, two, mean)] == [200, 150, 150]
    assert mean[1] == pytest.approx(np.full(51, 20.0))


def test_at_another_difficulty_there_is_nothing_to_compare_with(tmp_path, shown):
    store(tmp_path, "boxing_expert", DQN, 0.1 * GAMES)
    results.show_curves(study(tmp_path)["boxing_expert"])
    for axes in shown.figures["fig-boxing-expert-curves"].axes:
        assert lines_of(axes, ":") == []
    assert "uman" not in shown.captions["fig-boxing-expert-curves"]


def test_curves_of_breakout_have_breakouts_references(tmp_path, shown):
    store(tmp_path, "breakout_final", DUELING, 0.1 * GAMES)
    results.show_curves(study(tmp_path)["breakout_final"])
    label = "fig-breakout-final-curves"
    for axes in shown.figures[label].axes:
        assert [ys[0] for _, ys in lines_of(axes, ":")] == [30.5, 1.7]
    assert numbers(shown.captions[label])[:2] == [100, 1]  # games a point; seeds an agent
    assert "Breakout" in shown.captions[label]


def test_discounts_are_each_the_curve_of_their_own_experiment(tmp_path, shown):
    slopes = {"boxing_low_gamma": 0.1, "boxing_final": 0.2, "boxing_high_gamma": 0.3}
    for experiment, times in slopes.items():
        store(tmp_path, experiment, DUELING, times * GAMES)
    store(tmp_path, "boxing_final", DQN, 9 * GAMES)  # is another agent's
    stored = study(tmp_path)
    results.show_discounts([stored[name] for name in slopes], DUELING, "fig-discounts")
    (axes,) = shown.figures["fig-discounts"].axes
    games = np.arange(33, 201)  # the first experiment's window is a 30th of its 1,000 games
    named = named_lines(axes)
    assert list(named) == ["discount 0.9", "discount 0.99", "discount 0.995"]
    for ((xs, ys),), times in zip(named.values(), slopes.values(), strict=True):
        assert xs == pytest.approx(games)
        assert ys == pytest.approx(times * (games - 16))
    assert numbers(axes.get_ylabel()) == [33]
    assert numbers(shown.captions["fig-discounts"]) == [33]
    assert "Dueling Double DQN" in shown.captions["fig-discounts"]
    assert [ys[0] for _, ys in lines_of(axes, ":")] == [12.1, 0.1]


def test_a_discount_that_is_not_trained_yet_has_no_curve(tmp_path, shown):
    for experiment in ("boxing_final", "boxing_high_gamma"):
        store(tmp_path, experiment, DUELING, 0.1 * GAMES)
    stored = study(tmp_path)
    sections = [stored[name] for name in ("boxing_low_gamma", "boxing_final", "boxing_high_gamma")]
    results.show_discounts(sections, DUELING, "fig-discounts")
    (axes,) = shown.figures["fig-discounts"].axes
    assert list(named_lines(axes)) == ["discount 0.99", "discount 0.995"]


def test_predicted_realised_and_held_out_values_are_told_apart_by_their_lines(tmp_path, shown):
    for place, agent in enumerate(AGENTS):
        run = store(tmp_path, "boxing_final", agent, np.zeros(300))
        base = 10.0 * place + np.array([1.0, 2.0, 4.0])
        check(run, np.zeros(3), predicted=base, realised=base + 0.5, held_out=base - 0.5)
    results.show_values(study(tmp_path)["boxing_final"])
    panels = shown.figures["fig-boxing-final-values"].axes
    assert [axes.get_title(loc="left") for axes in panels] == list(TITLES.values())
    for place, axes in enumerate(panels):
        base = 10.0 * place + np.array([1.0, 2.0, 4.0])
        for style, expected in (("-", base), ("--", base + 0.5), (":", base - 0.5)):
            ((xs, ys),) = lines_of(axes, style)
            assert xs == [100, 200, 300]
            assert ys == pytest.approx(expected)
        assert axes.get_xlabel() == "games played"
    caption = shown.captions["fig-boxing-final-values"]
    assert (
        caption.index("predicts") < caption.index("solid") < caption.index("return that followed")
    )
    assert caption.index("return that followed") < caption.index("dashed")
    assert "prediction lies above what followed, the network overestimates" in caption
    assert numbers(caption)[:4] == [20, 100, 20, 512]


def test_evaluation_scores_stand_beside_their_agent(tmp_path, shown):
    for agent, mean in ((DUELING, 30.0), (DQN, 10.0)):
        run = store(tmp_path, "boxing_final", agent, np.zeros(300))
        evaluate(run, score=mean)
        evaluate(run, add=True, score=-70.0, sticky_actions=0.25)
    results.show_evaluations(study(tmp_path)["boxing_final"])
    (axes,) = shown.figures["fig-boxing-final-evaluation"].axes
    assert [tick.get_text() for tick in axes.get_yticklabels()] == ["DQN", "Dueling Double DQN"]
    points = np.concatenate([dots.get_offsets() for dots in axes.collections])
    assert len(points) == 80
    for place, mean in ((0, 10.0), (1, 30.0)):
        own = points[np.round(points[:, 1]) == place]
        assert own[:, 0].mean() == pytest.approx(mean)
    assert numbers(shown.captions["fig-boxing-final-evaluation"]) == [40, 0.1]  # games; % random


def test_smoothing_never_mixes_seeds_agents_or_variations():
    rows = [
        {"variation": v, "agent": a, "seed": s, "episode": n, "score": float(v + a + s)}
        for v in (100, 200) for a in (10, 20) for s in (1, 2) for n in (1, 2, 3)
    ]  # fmt: skip
    table = pd.DataFrame(rows).sample(frac=1, random_state=0).sort_values("episode")
    smooth = plots.smoothed(table, 2)
    assert sorted(smooth.episode.unique()) == [2, 3]
    assert (smooth["mean"] == smooth.variation + smooth.agent + smooth.seed).all()
