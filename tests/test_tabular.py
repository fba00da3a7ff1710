import numpy as np
import pytest
from matplotlib.patches import Rectangle
from synthetic import named_lines, numbers

from atari_dqn.envs import AtariEnv
from atari_dqn.games import GAMES
from atari_dqn.report import tabular
from atari_dqn.report.tabular import COLUMNS, GOAL, ROWS, SHORTEST, START, Transition


def to_the_goal(cell):
    """Points of the best way from a cell, counted on the map: one for every step."""
    row, column = divmod(cell, COLUMNS)
    if cell == START:
        return SHORTEST
    return -((COLUMNS - 1 - column) + (ROWS - 1 - row))


SAFE = [cell for cell in range(ROWS * COLUMNS) if cell <= START]  # neither cliff nor goal


def test_a_step_moves_the_value_by_the_share_alpha_towards_reward_and_discounted_best_value():
    q = np.array([[1.0, 2.0], [5.0, 3.0]])
    tabular.update(q, Transition(0, 1, -1.0, 1, over=False), alpha=0.5, gamma=0.9)
    assert q.tolist() == [[1.0, 2.0 + 0.5 * (-1.0 + 0.9 * 5.0 - 2.0)], [5.0, 3.0]]


def test_what_follows_the_end_of_a_game_is_worth_nothing():
    q = np.array([[1.0, 2.0], [5.0, 3.0]])
    tabular.update(q, Transition(0, 0, -1.0, 1, over=True), alpha=1.0, gamma=0.9)
    assert q[0, 0] == -1.0


def test_updates_of_every_cell_and_action_end_at_the_lengths_of_the_shortest_ways():
    world, q = tabular.cliff(), np.zeros((ROWS * COLUMNS, 4))
    for _ in range(40):
        for cell in SAFE:
            for action in range(4):
                ((_, s_t, r_t, over),) = world.P[cell][action]
                tabular.update(q, Transition(cell, action, r_t, s_t, over), alpha=1.0, gamma=1.0)
    assert q[SAFE].max(axis=1).tolist() == [to_the_goal(cell) for cell in SAFE]


def test_it_learns_the_shortest_way_and_its_values_from_play_alone():
    q, scores = tabular.learn(lambda game: 0.1, games=500, seed=1)
    path = tabular.greedy_path(q)
    assert path == [START, *range(24, 36), GOAL]
    assert q[path[:-1]].max(axis=1) == pytest.approx([to_the_goal(c) for c in path[:-1]], abs=0.01)
    assert np.mean(scores[-100:]) > np.mean(scores[:100])
    assert max(scores) <= SHORTEST


def test_the_same_seed_learns_the_same_table():
    first, second, other = (tabular.learn(lambda game: 0.1, 30, seed)[0] for seed in (1, 1, 2))
    assert (first == second).all()
    assert (first != other).any()


def test_less_exploration_earns_more_once_the_way_is_known():
    schemes = {"always": lambda game: 0.1, "less": lambda game: 0.1 * 0.99**game}
    scores = tabular.compare(schemes, games=400, seeds=(0, 1))
    assert len(scores) == 2 * 2 * 400
    late = scores[scores.game > 300].groupby("exploration").score.mean()
    assert late["less"] > late["always"]


def test_a_path_that_misses_the_goal_is_cut():
    assert len(tabular.greedy_path(np.zeros((ROWS * COLUMNS, 4)))) == ROWS * COLUMNS


def test_the_greatest_of_noisy_estimates_is_too_great_and_a_second_set_is_right():
    table = tabular.overestimation([1, 2, 3], samples=40_000)
    believed = table.pivot(index="actions", columns="evaluated with", values="believed")
    expected = [0, 1 / np.sqrt(np.pi), 1.5 / np.sqrt(np.pi)]  # of one, two and three normals
    assert believed["the same estimates"].tolist() == pytest.approx(expected, abs=0.02)
    assert believed["a second set"].tolist() == pytest.approx([0, 0, 0], abs=0.02)


def test_the_greedy_path_is_framed_on_the_map_and_crosses_no_text():
    q, _ = tabular.learn(lambda game: 0.1, games=300, seed=1)
    figure = tabular.grid_figure(q)
    (axes,) = figure.axes
    frames = [patch for patch in axes.patches if isinstance(patch, Rectangle)]
    cells = [int(frame.get_y()) * COLUMNS + int(frame.get_x()) for frame in frames]
    assert cells == tabular.greedy_path(q)
    figure.canvas.draw()
    for text in axes.texts:
        place = text.get_window_extent()
        for frame in frames:
            box = frame.get_window_extent()
            inside = (box.min <= place.min).all() and (place.max <= box.max).all()
            assert inside or not box.overlaps(place), text.get_text()


def test_the_map_prints_every_cell():
    q, _ = tabular.learn(lambda game: 0.1, games=300, seed=1)
    texts = [text.get_text() for text in tabular.grid_figure(q).axes[0].texts]
    assert "↑\n−13.0" in texts
    assert sum("\n" in text for text in texts) == len(SAFE)


def test_the_curves_of_learning_are_means_of_twenty_games_and_of_the_seeds():
    schemes = {"always": lambda game: 0.1, "less": lambda game: 0.1 * 0.9**game}
    scores = tabular.compare(schemes, games=30, seeds=(0, 1))
    (axes,) = tabular.curves_figure(scores).axes
    named = named_lines(axes)
    *_, best = named
    assert numbers(best) == [SHORTEST]
    for name in schemes:
        points = scores[scores.exploration == name].pivot(index="game", columns="seed")
        twenty = np.lib.stride_tricks.sliding_window_view(points.score.mean(axis=1), 20)
        ((xs, ys),) = named[name]
        assert xs == list(range(20, 31))
        assert ys == pytest.approx(twenty.mean(axis=1))
    assert axes.get_xlabel() == "games"
    assert numbers(axes.get_ylabel()) == [20]


def test_overestimation_is_drawn_against_the_actions_that_either_game_has():
    table = tabular.overestimation([2, 4, 18], samples=1000)
    (axes,) = tabular.overestimation_figure(table).axes
    believed = table.pivot(index="actions", columns="evaluated with", values="believed")
    found = {name: ys for name, ((_, ys),) in named_lines(axes).items()}
    assert found == {name: pytest.approx(believed[name].tolist()) for name in believed}
    ticks = {
        label.get_text(): at
        for label, at in zip(axes.get_xticklabels(), axes.get_xticks(), strict=True)
    }
    for game in ("boxing", "breakout"):
        actions = len(AtariEnv(game).actions)
        assert ticks[f"{actions}\n{GAMES[game].title}"] == actions
    assert all(numbers(name) == [at] for name, at in ticks.items())
