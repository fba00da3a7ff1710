"""Every parameter reaches its place: each is changed alone, and its effect is looked for there."""

import shutil
from dataclasses import asdict
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
import torch
from conftest import SMALL
from safetensors.torch import load_file

from atari_dqn import evaluation, params, training
from atari_dqn.agents import AGENTS
from atari_dqn.envs import AtariEnv, EpisodeRecord, VectorEnv
from atari_dqn.evaluation import player_of
from atari_dqn.native import new_learner
from atari_dqn.params import Parameters
from atari_dqn.replay import Batch
from atari_dqn.runs import evaluations, models, recorder, tables
from atari_dqn.runs.models import load_model, read_model
from atari_dqn.runs.run import Run, runs_of
from atari_dqn.schedules import epsilon_greedy
from atari_dqn.training import Episode, Trainer

CASES = {}  # {parameters: check}; a check takes `make`, and what it makes differs in these alone


def case(*names):
    def register(check):
        CASES[names] = check
        return check

    return register


@pytest.fixture
def make(small):
    """Trainers, of one emulator, that differ from one another in the given parameters only."""

    def trainer(agent="dqn", initial=None, **changes):
        return Trainer(small(**{"environments": 1, **changes}), agent, 1, initial)

    return trainer


def steps(trainer, count):
    return [episode for _, episode in zip(range(count), trainer.run(), strict=False) if episode]


@case("game")
def _(make, *_):
    for game, actions in (("boxing", 18), ("breakout", 4)):
        trainer = make(game=game)
        assert trainer.learner.q_values(trainer.envs.observations()).shape[1] == actions


@case("frame_skip")
def _(make, *_):
    for skip in (2, 5):
        trainer = make(frame_skip=skip, noop_max=0)
        steps(trainer, 7)
        assert trainer.envs.envs[0].frames == 7 * skip


@case("frame_stack")
def _(make, *_):
    for stack in (1, 3):
        trainer = make(frame_stack=stack)
        steps(trainer, 3)
        assert trainer.envs.observations().shape[-1] == stack
        assert trainer.memory.sample(2).s_t.shape[-1] == stack


@case("noop_max")
def _(make, *_):
    for most in (0, 3, 30):
        game = make(noop_max=most).envs.envs[0]
        idle = set()
        for _ in range(20):
            game.reset()
            idle.add(game.frames)
        assert idle <= set(range(min(1, most), most + 1))
        assert len(idle) > most / 4


@case("max_game_frames")
def _(make, *_):
    for most in (80, 120):
        trainer = make(max_game_frames=most)
        (first, *_) = steps(trainer, 40)
        assert most <= first.frames < most + 4


@case("sticky_actions")
def _(make, monkeypatch, _):
    shares = []
    for probability in (0.0, 0.9):
        trainer, executed = make(sticky_actions=probability, noop_max=0), []
        game = trainer.envs.envs[0]
        for action in np.tile([1, 2, 3, 4, 5], 20).tolist():
            game.step(action)
            executed.append(game.last_action == action)
        shares.append(np.mean(executed))
    assert shares[0] == 1
    assert shares[1] < 0.6


@case("difficulty")
def _(make, *_):
    memories = []
    for difficulty in (0, 3):
        trainer = make(difficulty=difficulty)
        game, rng = trainer.envs.envs[0], np.random.default_rng(0)
        for _ in range(300):
            game.step(int(rng.integers(18)))
        memories.append(game.ram().tobytes())
    assert memories[0] != memories[1]


def paying(monkeypatch, points):
    """Lets every frame pay."""
    act = AtariEnv._act
    monkeypatch.setattr(AtariEnv, "_act", lambda self, action: act(self, action) * 0 + points)


@case("clip_rewards")
def _(make, monkeypatch, _):
    paying(monkeypatch, 3.0)
    for clip, reward in ((True, 1), (False, 12)):
        trainer = make(clip_rewards=clip)
        steps(trainer, 5)
        assert set(trainer.memory.rewards[1:5].ravel()) == {reward}


@case("life_loss_penalty")
def _(make, *_):
    for penalty in (0.0, 0.75):
        trainer = make(game="breakout", life_loss_penalty=penalty, max_game_frames=1000)
        steps(trainer, 120)
        assert trainer.memory.rewards.min() == -penalty


@case("epsilon_start", "epsilon_decay", "epsilon_floor")
def _(make, monkeypatch, _):
    used = []

    def choose(q_values, probability, rng):
        used.append(probability)
        return epsilon_greedy(q_values, probability, rng)

    monkeypatch.setattr(training, "epsilon_greedy", choose)
    schedule = {"epsilon_start": 0.7, "epsilon_decay": 0.5, "epsilon_floor": 0.2}
    steps(make(**schedule, max_game_frames=60), 60)
    assert used[0] == 0.7
    assert set(used) == {0.7, 0.35, 0.2}
    assert used[-1] == 0.2


@case("environments")
def _(make, *_):
    for count in (1, 4):
        trainer = make(environments=count)
        steps(trainer, 4)
        assert trainer.agent_steps == 4 * count


@case("replay_capacity")
def _(make, *_):
    for capacity in (40, 60):
        trainer = make(replay_capacity=capacity)
        steps(trainer, 70)
        assert len(trainer.memory) == capacity


@case("learning_starts", "update_period")
def _(make, *_):
    for starts, period in ((30, 2), (30, 5), (50, 5)):
        trainer = make(learning_starts=starts, update_period=period)
        steps(trainer, 70)  # two of them begin a game: 68 agent steps
        assert trainer.learner.updates == (68 - starts) // period


@case("batch_size")
def _(make, monkeypatch, _):
    for size in (3, 8):
        trainer, sizes = make(batch_size=size, learning_starts=20), set()
        learn = trainer.learner.learn
        monkeypatch.setattr(
            trainer.learner,
            "learn",
            lambda batch, sizes=sizes, learn=learn: sizes.add(len(batch.a_tm1)) or learn(batch),
        )
        steps(trainer, 40)
        assert sizes == {size}


def first_step(trainer):
    """How far the weights move at most in the first update: Adam's whole step size, as its
    moments are the gradient and its square, if its epsilon is small."""
    before = trainer.learner.weights()
    before = {name: weight.clone() for name, weight in before.items()}
    while not trainer.learner.updates:
        steps(trainer, 1)
    assert trainer.learner.updates == 1
    after = trainer.learner.weights()
    return max((after[name] - before[name]).abs().max().item() for name in after)


LEARNERS = ("native", "torch")


@case("learning_rate", "adam_epsilon")
def _(make, *_):
    for learner in LEARNERS:
        for rate, epsilon, low, high in (
            *((1e-3, 1e-8, 0.9e-3, 1.01e-3), (1e-5, 1e-8, 0.9e-5, 1.2e-5)),
            (1e-3, 1e3, 1e-12, 1e-5),
        ):
            changes = {"learner": learner, "learning_rate": rate, "adam_epsilon": epsilon}
            assert low < first_step(make(**changes, learning_starts=10)) < high


@case("warmup_games", "warmup_learning_rate")
def _(make, *_):
    warmup = {"warmup_games": 1000, "warmup_learning_rate": 1e-6, "learning_rate": 1e-3}
    for learner in LEARNERS:
        assert first_step(make(learner=learner, **warmup)) < 2e-5


@case("gamma")
def _(make, *_):
    for gamma in (0.5, 0.9):
        trainer = make(gamma=gamma)
        steps(trainer, 20)
        assert set(trainer.memory.sample(50).discount_t) == {np.float32(gamma)}


@case("n_steps")
def _(make, *_):
    trainer = make(n_steps=3, gamma=0.5)
    steps(trainer, 20)
    assert set(trainer.memory.sample(200).discount_t) == {0.125, 0.25, 0.5}


@case("target_update_period", "tau")
def _(make, *_):
    for learner in LEARNERS:
        for period, tau in ((5, 1.0), (9, 0.5)):
            changes = {"target_update_period": period, "tau": tau, "learning_starts": 10}
            trainer = make(learner=learner, **changes)
            start = trainer.learner.get_state()["target"]["hidden.bias"].clone()
            while trainer.learner.updates < period:
                assert torch.equal(trainer.learner.get_state()["target"]["hidden.bias"], start)
                steps(trainer, 1)
            state = trainer.learner.get_state()
            wanted = (1 - tau) * start + tau * state["online"]["hidden.bias"]
            torch.testing.assert_close(state["target"]["hidden.bias"], wanted)
            assert not torch.equal(wanted, start)


@case("transferred_layers", "freeze_convolutions")
def _(make, *_):
    source = make().learner.weights()
    source = {name: torch.full_like(weight, 1e-3) for name, weight in source.items()}
    for layers in ("all", "convolutions"):
        for frozen in (True, False):
            changes = {"transferred_layers": layers, "freeze_convolutions": frozen}
            trainer = make(initial=source, learning_starts=10, **changes)
            weights = trainer.learner.weights()
            assert (weights["convolutions.0.weight"] == 1e-3).all()
            assert (weights["hidden.weight"] == 1e-3).all() == (layers == "all")
            assert not (weights["output.weight"] == 1e-3).all()
            steps(trainer, 30)
            assert trainer.learner.updates
            still = (trainer.learner.weights()["convolutions.0.bias"] == 1e-3).all()
            assert still == frozen


@case("initial_weights")
def _(make, monkeypatch, folder):
    for experiment in ("", "other"):
        run = Run(Parameters(**{**SMALL, "initial_weights": experiment}), folder)
        assert (run.source() is None) == (experiment == "")


@case("evaluation_games", "evaluation_epsilon", "evaluation_difficulties", "evaluation_stickiness")
def _(make, monkeypatch, folder):
    chances, choose = set(), evaluation.epsilon_greedy

    def chosen(q_values, probability, rng):
        chances.add(probability)
        return choose(q_values, probability, rng)

    monkeypatch.setattr(evaluation, "epsilon_greedy", chosen)
    changes = {"evaluation_games": 1, "evaluation_epsilon": 0.25, "episodes": 1, "environments": 1}
    beside = {"evaluation_difficulties": [2], "evaluation_stickiness": [0.5]}
    run = Run(Parameters(**{**SMALL, **changes, **beside}), folder)
    recorder.train(run)
    played = pd.read_csv(run.folder / "evaluations.csv")
    assert played.groupby(["difficulty", "sticky_actions"]).size().to_dict() == {
        **{(0, 0.0): 1, (0, 0.5): 1},
        (2, 0.0): 1,
    }
    assert set(played.epsilon) == {0.25} == chances


@case("snapshot_games", "episodes")
def _(make, monkeypatch, folder):
    changes = {"snapshot_games": [2], "episodes": 3, "environments": 1, "evaluation_games": 1}
    run = Run(Parameters(**{**SMALL, **changes}), folder)
    recorder.train(run)
    assert [path.name for path in run.folder.glob("snapshots/*")] == ["games-00002.safetensors"]
    assert len(pd.read_csv(run.folder / "episodes.csv")) == 3


@case("device", "learner")
def _(make, *_):
    assert [make(learner=learner).learner.kind for learner in LEARNERS] == list(LEARNERS)
    assert str(make(device="cpu", learner="torch").learner.device) == "cpu"


@case("emulator_processes")
def _(make, *_):
    assert len(make(environments=4, emulator_processes=3).envs.others) == 2


@pytest.mark.native  # some cases: both learners are asked
@pytest.mark.parametrize("names", CASES, ids=", ".join)
def test_it_reaches_its_place(names, make, monkeypatch, tmp_path):
    CASES[names](make, monkeypatch, tmp_path)


BOOKKEEPING = {"experiment", "profile", "agents", "seeds", "variations"}


def test_no_parameter_is_left_out():
    named = [name for names in CASES for name in names]
    assert len(named) == len(set(named))
    assert set(named) == set(Parameters.model_fields) - BOOKKEEPING


# ---- Training does what it is told ---------------------------------------------------------------


def streams(trainer):
    """Where each random stream of a run stands: its emulators', its memory's and its own."""
    games = [game.np_random for game in trainer.envs.envs]
    return [str(rng.bit_generator.state) for rng in (*games, trainer.memory.rng, trainer.rng)]


def test_every_random_stream_is_another_one_and_evaluation_has_its_own(small):
    """Neither two streams of training, nor two seeds, nor two games of evaluation draw the same."""
    trainers = [Trainer(small(environments=4), "dqn", seed) for seed in (1, 2)]
    used = [stream for trainer in trainers for stream in streams(trainer)]
    assert len(set(used)) == 2 * (4 + 2)
    first, second = (trainer.learner.weights()["hidden.weight"] for trainer in trainers)
    assert not (first == second).any()
    table, drawn = evaluation.EpisodeInProgress(small()), set()
    for seed in (1, 2):
        for number in range(3):
            table.start(number, seed)
            drawn |= {str(rng.bit_generator.state) for rng in (table.rng, table.env.np_random)}
    assert len(drawn) == 2 * 3 * 2
    assert not drawn & set(used)


def test_a_game_that_restarts_draws_other_idle_frames(small):
    games = VectorEnv(small(environments=1, max_game_frames=40), np.random.SeedSequence(1))
    ended = [game for _ in range(60) for game in games.step(np.zeros(1, int)).finished]
    assert len({game.record.idle_frames for game in ended}) > len(ended) / 2 > 2


def test_each_game_gets_the_best_action_for_what_is_seen_there(make, monkeypatch):
    trainer = make(environments=2, epsilon_start=0.0, epsilon_floor=0.0)
    rng, best, play = np.random.default_rng(0), [], trainer.envs.step

    def q_values(observations):
        np.testing.assert_array_equal(observations, trainer.envs.observations())
        values = rng.random((2, 18))
        best.append(values.argmax(axis=1).tolist())
        return values

    def step(actions):
        assert actions.tolist() == best[-1]
        return play(actions)

    monkeypatch.setattr(trainer.learner, "q_values", q_values)
    monkeypatch.setattr(trainer.envs, "step", step)
    steps(trainer, 10)
    assert len(best) == 10


def learns_like(learner):
    """The rules, by name, whose target the learner's next update moves towards.

    Its target network gets the outputs of its own network, each moved on by one action, so that
    the two disagree on the best.
    """
    state = learner.get_state()
    target = {
        name: weight.roll(1, 0) if name.endswith(("output.weight", "output.bias")) else weight
        for name, weight in state["online"].items()
    }
    rng = np.random.default_rng(0)
    s_tm1, s_t = rng.integers(0, 256, (2, 16, 84, 84, 4)).astype(np.uint8)
    rewards, discounts = np.zeros(16, np.float32), np.full(16, 0.9, np.float32)
    batch = Batch(s_tm1, rng.integers(0, 18, 16), rewards, discounts, s_t)
    chosen = learner.q_values(s_tm1)[range(16), batch.a_tm1]
    best = learner.q_values(s_t).argmax(axis=1)
    learner.set_weights(target)
    q_t = learner.q_values(s_t)
    learner.set_state({**state, "target": target})
    loss, _ = learner.learn(batch)
    values = {"dqn": q_t.max(axis=1), "double": q_t[range(16), best]}
    losses = {rule: np.mean((0.9 * value - chosen) ** 2) for rule, value in values.items()}
    return [rule for rule, wanted in losses.items() if loss == pytest.approx(wanted, rel=1e-3)]


def recorder_of(run):
    run.folder.mkdir(parents=True)
    return recorder.Recorder(run)


def test_an_experiment_has_a_run_of_every_agent_and_seed(small, tmp_path):
    wanted = [(agent, seed) for agent in AGENTS for seed in (4, 2)]
    found = runs_of(small(agents=list(AGENTS), seeds=[4, 2]), tmp_path)
    assert sorted((run.agent, run.seed) for run in found) == sorted(wanted)
    assert len({run.folder for run in found}) == len({run.state_folder for run in found}) == 6


def test_a_run_trains_its_agent_from_its_seed(small, tmp_path):
    trainers = {}
    for run in runs_of(small(agents=list(AGENTS), seeds=[4, 2], environments=1), tmp_path):
        if (run.agent, run.seed) != ("dueling_double_dqn", 2):  # the five others suffice
            recorder = recorder_of(run)
            trainers[run.agent, run.seed] = recorder.trainer
            recorder.close()
    drawn = {key: streams(trainer) for key, trainer in trainers.items()}
    assert drawn["dqn", 4] == drawn["double_dqn", 4] == drawn["dueling_double_dqn", 4]
    assert drawn["dqn", 2] == drawn["double_dqn", 2] != drawn["dqn", 4]
    for (agent, _), trainer in trainers.items():
        dueling = "value_output.weight" in trainer.learner.weights()
        assert dueling == (agent == "dueling_double_dqn")
        assert learns_like(trainer.learner) == ["dqn" if agent == "dqn" else "double"]


# ---- What is written down is what happened -------------------------------------------------------


def test_loss_and_q_are_means_since_games_last_finished_and_logged_under_their_names(
    make, monkeypatch
):
    trainer, losses = make(), []

    def learn(batch):
        trainer.learner.updates += 1
        losses.append(float(trainer.learner.updates))
        return losses[-1], 100 + losses[-1]

    monkeypatch.setattr(trainer.learner, "learn", learn)
    for _ in range(3):
        losses.clear()
        while not (episodes := steps(trainer, 1)):
            pass
        assert losses
        assert episodes[0].loss == np.mean(losses)
        assert episodes[0].mean_q == 100 + np.mean(losses)


def test_steps_and_frames_are_counted_over_all_finished_games(make):
    trainer = make(noop_max=0, frame_skip=3, max_game_frames=60)
    ended = steps(trainer, 70)
    assert [episode.length for episode in ended] == [20, 20, 20]
    assert [episode.agent_steps for episode in ended] == [20, 40, 60]
    assert [episode.frames for episode in ended] == [60, 120, 180]


def test_the_check_of_values_learns_from_the_same_rewards_as_training(small, monkeypatch):
    paying(monkeypatch, 3.0)
    monkeypatch.setattr(evaluation, "VALUE_GAMES", 2)
    for clip, reward in ((True, 1), (False, 12)):
        parameters = small(clip_rewards=clip, gamma=0.0)
        player = lambda states: np.zeros((len(states), 18), np.float32)  # noqa: E731
        held_out = np.zeros((8, 84, 84, 4), np.uint8)
        check, _ = evaluation.check_values(player, parameters, held_out, 1, seed=1)
        assert check.realised == reward


SEEN = {"VALUES_PERIOD": 2, "VALUE_GAMES": 1, "HELD_OUT_STATES": 16}


@pytest.fixture(scope="module")
def watched(tmp_path_factory):
    """A finished run, and what was seen meanwhile: the weights after every game, how far the run
    had come, and who played the final evaluation."""
    folder, seen = tmp_path_factory.mktemp("watched"), SimpleNamespace(weights={}, players=[])
    settings = {"agents": ["dueling_double_dqn"], "seeds": [3], "episodes": 4}
    settings |= {"snapshot_games": [2], "target_update_period": 1000, "evaluation_epsilon": 0.25}
    seen.run = Run(Parameters(**{**SMALL, **settings}), folder)
    log, play = recorder.Recorder.log, evaluation.play

    def watch(recorder, episode):
        seen.weights[episode.episode] = recorder.trainer.learner.weights()  # a copy
        seen.steps, seen.updates = recorder.trainer.agent_steps, recorder.trainer.learner.updates
        log(recorder, episode)

    def watch_play(player, *arguments):
        seen.players.append(player)
        return play(player, *arguments)

    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("ATARI_DQN_STATE", str(folder / "state"))
        for name, value in SEEN.items():
            patch.setattr(params, name, value)
            patch.setattr(evaluation, name, value, raising=False)
        patch.setattr(recorder.Recorder, "log", watch)
        patch.setattr(evaluation, "play", watch_play)
        recorder.train(seen.run)
    return seen


def published(run):
    return player_of(load_model(run.folder / "model.safetensors", run.params), run.params)


def test_snapshots_and_the_model_are_the_online_network_after_their_games(watched):
    paths = models.stored(watched.run)
    assert list(paths) == [2, 4]
    for games, path in paths.items():
        stored = load_file(path)
        for name, weight in watched.weights[games].items():
            assert torch.equal(stored[name], weight.half()), (games, name)


def test_values_are_checked_with_the_network_of_that_game_and_the_runs_own_settings(
    watched, monkeypatch
):
    for name, value in SEEN.items():
        monkeypatch.setattr(params, name, value)
        monkeypatch.setattr(evaluation, name, value, raising=False)
    rows = pd.read_csv(watched.run.folder / "values.csv")
    assert rows.episode.tolist() == [2, 4]
    parameters = watched.run.params
    learner = new_learner(AGENTS["dueling_double_dqn"], 18, parameters, seed=0)
    held_out = evaluation.held_out_states(parameters)
    for row in rows.to_dict("records"):
        learner.set_weights(watched.weights[row["episode"]])
        check, _ = evaluation.check_values(
            learner.q_values, parameters, held_out, row["episode"], seed=3
        )
        assert row == pytest.approx(asdict(check), rel=1e-12)


def test_the_final_evaluation_plays_the_published_model(watched):
    """Not the one in memory, which is more exact."""
    states = np.random.default_rng(0).integers(0, 256, (8, 84, 84, 4)).astype(np.uint8)
    (player,) = watched.players
    np.testing.assert_array_equal(player(states), published(watched.run)(states))


def rows_of(games):
    table = pd.DataFrame([game.row() for game in games])
    return table.sort_values("game", ignore_index=True)


def test_evaluations_are_the_games_of_the_runs_own_seed(watched):
    stored = pd.read_csv(watched.run.folder / "evaluations.csv")
    assert set(stored.trained_games) == {4}
    assert set(stored.seed) == {3}
    played = rows_of(evaluation.play(published(watched.run), watched.run.params, 2, seed=3))
    pd.testing.assert_frame_equal(stored[list(played)], played, rtol=1e-12)


def test_a_later_evaluation_keeps_the_runs_seed_and_changes_what_it_is_told(watched, tmp_path):
    shutil.copytree(watched.run.folder, tmp_path / "seed-3")
    changes = {"difficulty": 2, "sticky_actions": 0.5, "evaluation_epsilon": 0.75}
    returned = evaluations.evaluate(tmp_path / "seed-3", changes, games=1)
    parameters = watched.run.params.model_copy(update=changes)
    played = rows_of(evaluation.play(published(watched.run), parameters, 1, seed=3))
    pd.testing.assert_frame_equal(returned[list(played)], played, check_exact=True)
    stored = pd.read_csv(tmp_path / "seed-3" / "evaluations.csv")
    assert stored[stored.difficulty == 2].trained_games.tolist() == [4]


def test_tables_are_read_with_the_names_of_their_run(watched):
    table = tables.of_runs([watched.run], "episodes.csv")
    for column, name in {"experiment": "small", "agent": "dueling_double_dqn", "seed": 3}.items():
        assert set(table[column]) == {name}


def test_provenance_counts_steps_and_updates(watched):
    stored = watched.run.provenance()
    assert (stored["agent_steps"], stored["updates"]) == (watched.steps, watched.updates)
    assert 0 < watched.updates < watched.steps


def test_a_transfer_run_starts_from_the_model_of_the_same_agent_and_seed(watched, small):
    changes = {"experiment": "transfer", "initial_weights": "small"}
    parameters = watched.run.params.model_copy(update=changes)
    run = Run(parameters, watched.run.results)
    assert run.source().folder == watched.run.folder
    recorder = recorder_of(run)
    source = read_model(watched.run.folder / "model.safetensors")
    state = recorder.trainer.learner.get_state()
    recorder.close()
    for network in (state["online"], state["target"]):
        for name, weight in network.items():
            assert torch.equal(weight, source[name]) == ("output" not in name), name


def test_time_is_logged_by_both_clocks_and_goes_on_after_a_stop(small, tmp_path, monkeypatch):
    clocks = SimpleNamespace(wall=1000.0, cpu=50.0)
    monkeypatch.setattr(
        recorder,
        "time",
        SimpleNamespace(monotonic=lambda: clocks.wall, process_time=lambda: clocks.cpu),
    )

    def log(recorder, episode):
        clocks.wall, clocks.cpu = clocks.wall + 60, clocks.cpu + 7
        recorder.log(Episode(episode, 1, 1, 0.0, 1, 0.5, 0.0, 0.0, EpisodeRecord(1, b"", None)))
        recorder.save()
        recorder.write_provenance()
        recorder.close()

    run = Run(small(environments=1), tmp_path)
    log(recorder_of(run), 1)
    clocks.wall, clocks.cpu = 30.0, 2.0  # another process, on a machine that started anew
    log(recorder.Recorder(run), 2)
    timing = pd.read_csv(run.folder / "timing.csv")
    assert timing.to_dict("list") == {
        "episode": [1, 2],
        "seconds": [60, 120],
        "cpu_seconds": [7, 14],
    }
    provenance = run.provenance()
    assert (provenance["wall_clock_seconds"], provenance["cpu_seconds"]) == (120, 14)
