"""The states that are shown as alike are those nearest in the last hidden layer."""

import re

import numpy as np
import pytest
import torch
from synthetic import store, study

from atari_dqn.agents import AGENTS
from atari_dqn.envs import EpisodeRecord, make_env
from atari_dqn.games import GAMES
from atari_dqn.networks import DuelingNetwork, NatureNetwork
from atari_dqn.report import neighbours
from atari_dqn.report.saliency import observation_at
from atari_dqn.runs import models, records
from atari_dqn.runs.dataset import trajectory


def test_the_last_layers_make_the_values_of_the_features():
    rng = np.random.default_rng(0)
    observations = rng.integers(0, 255, (300, 84, 84, 4)).astype(np.uint8)  # more than a batch
    for kind in (NatureNetwork, DuelingNetwork):
        torch.manual_seed(1)
        network = kind(4, 6).requires_grad_(False)
        found = torch.from_numpy(neighbours.features(network, observations))
        if kind is NatureNetwork:
            values = network.output(found)
        else:
            advantages = network.advantage_output(found[:, 512:])
            values = network.value_output(found[:, :512]) + advantages
            values -= advantages.mean(dim=1, keepdim=True)
        expected = network(torch.from_numpy(observations))
        torch.testing.assert_close(values, expected, atol=1e-6, rtol=1e-4)


def length(difference):
    return float(sum(float(each) ** 2 for each in difference) ** 0.5)


def test_the_nearest_are_those_that_a_search_of_every_state_finds():
    rng = np.random.default_rng(0)
    games = [rng.normal(size=(count, 5)).astype(np.float32) for count in (7, 4, 9)]
    state = rng.normal(size=5).astype(np.float32)
    expected = sorted(
        min((length(each - state), game, place) for place, each in enumerate(states))
        for game, states in enumerate(games)
    )
    found = neighbours.nearest(state, games)
    assert [each[:2] for each in found] == [(game, place) for _, game, place in expected]
    assert [each[2] for each in found] == pytest.approx([each[0] for each in expected], rel=1e-6)


def test_the_mean_distance_is_that_of_pairs_from_different_games():
    rng = np.random.default_rng(1)
    games = [rng.normal(size=(count, 3)).astype(np.float32) for count in (30, 2, 5)]
    pairs = [
        length(one - other)
        for number, game in enumerate(games)
        for later in games[number + 1 :]
        for one in game
        for other in later
    ]
    assert neighbours.mean_distance(games) == pytest.approx(np.mean(pairs), rel=1e-6)


def test_of_every_other_opening_the_first_game_is_searched():
    facts = GAMES["boxing"]
    idle = (3, 7, 3, 9, 7, 3)
    games = {number: EpisodeRecord(frames, b"\0", None) for number, frames in enumerate(idle)}
    assert neighbours._of_other_openings(facts, games) == [1, 3]


@pytest.fixture
def evaluated(tmp_path):
    """Stores a run with an untrained model and short evaluation games of random moves, one for each
    of the given numbers of idle frames; returns the run, the model and the records."""

    def stored(*idle):
        run = store(tmp_path, "boxing_final", "dqn", [1.0])
        torch.manual_seed(0)
        actions = len(make_env(run.params).actions)
        network = AGENTS["dqn"].network(run.params.frame_stack, actions)
        (run.folder / "model.safetensors").write_bytes(
            models.model_bytes(network.state_dict(), games=1)
        )
        rng = np.random.default_rng(2)
        heading = {"kind": "evaluation", "trained_games": 1, "difficulty": 0, "seed": 1}
        heading |= {"sticky_actions": 0.0, "epsilon": run.params.evaluation_epsilon}
        found = [
            EpisodeRecord(frames, moves.astype("u1").tobytes(), None)
            for number, frames in enumerate(idle)
            for moves in [rng.integers(actions, size=30 + number)]
        ]
        games = [({**heading, "game": number}, record) for number, record in enumerate(found)]
        (run.folder / records.FILE).write_bytes(records.encode(games))
        return run, models.load_model(run.folder / "model.safetensors", run.params), found

    return stored


def test_the_figure_shows_the_nearest_states_and_the_table_says_where_they_are(
    tmp_path, shown, evaluated
):
    run, network, games = evaluated(3, 9, 15, 21, 27)
    table = neighbours.show_neighbours(study(tmp_path)["boxing_final"])
    seen = []
    for number, record in enumerate(games):
        played = trajectory(run.params, record)
        steps = range(0, len(record.actions), 2 if number else 1)
        stacks = np.stack([observation_at(played, step, 4) for step in steps])
        hidden = network.convolutions(torch.from_numpy(stacks))
        seen.append((steps, network.hidden(hidden).relu().double()))
    mean = np.mean(
        np.concatenate(
            [
                torch.cdist(seen[one][1], seen[other][1]).flatten().numpy()
                for one in range(5)
                for other in range(one)
            ]
        )
    )
    (figure,) = shown.figures.values()
    panels = np.array(figure.axes).reshape(3, 4)
    moments = {"a quarter": 7, "half": 14, "three quarters": 21}  # of 30 steps
    for row, (moment, at) in zip(panels, moments.items(), strict=True):
        own, *near = table[table.moment == moment].to_dict("records")
        assert (own["game"], own["step"], own["distance"], own["off"]) == (0, at, 0, 0)
        best = sorted(
            (float((states - seen[0][1][at]).norm(dim=1).min()), number)
            for number, (_, states) in enumerate(seen)
            if number
        )[:3]
        assert [one["game"] for one in near] == [number for _, number in best]
        assert [one["distance"] for one in near] == pytest.approx(
            [distance / mean for distance, _ in best], rel=1e-3
        )
        for axes, one in zip(row, (own, *near), strict=True):
            steps, states = seen[one["game"]]
            away = float((states[steps.index(one["step"])] - seen[0][1][at]).norm())
            assert away / mean == pytest.approx(one["distance"], rel=1e-3, abs=1e-6)
            for step, env in enumerate(records.replay(run.params, games[one["game"]])):
                if step == one["step"]:
                    assert (axes.images[0].get_array() == env.render()).all()
                    assert one["points"] == env.points()[0]
            told = [float(each) for each in re.findall(r"\d+\.\d+", axes.get_xlabel())]
            said = [one["step"] / 15, one["distance"]]
            assert told == pytest.approx(said[: 1 + (one is not own)], abs=0.051)


def test_how_far_off_the_boxers_are_is_the_mean_of_both():
    assert neighbours._off([(0, 0), (10, 10)], [(3, 4), (10, 11)]) == 3
    assert np.isnan(neighbours._off([], []))


def test_without_games_its_place_is_held_and_with_too_few_it_says_why(tmp_path, shown, evaluated):
    assert neighbours.show_neighbours(study(tmp_path)["boxing_final"]).empty
    assert shown.texts == ["[]{#fig-boxing-final-neighbours .absent}"]
    evaluated(3, 9, 15, 3)
    assert neighbours.show_neighbours(study(tmp_path)["boxing_final"]).empty
    assert "4 openings" in shown.texts[-1]
    assert "{#fig-boxing-final-neighbours .absent}" in shown.texts[-1]
    assert not shown.figures
