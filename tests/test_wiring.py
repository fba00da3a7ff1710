"""Every parameter reaches its place: each is changed alone, and its effect is looked for there."""

import numpy as np
import pandas as pd
import pytest
import torch

from atari_dqn import evaluation, recording, training
from atari_dqn.agents import AGENTS
from atari_dqn.envs import AtariGame
from atari_dqn.exploration import epsilon_greedy
from atari_dqn.params import Parameters
from atari_dqn.runs import Run
from atari_dqn.training import Trainer

CASES = {}  # {parameters: check}; a check takes `make`, and what it makes differs in these alone


def case(*names):
    def register(check):
        CASES[names] = check
        return check

    return register


@pytest.fixture
def make(small):
    """Trainers that differ from one another in the given parameters only."""
    return lambda agent="dqn", initial=None, **changes: Trainer(small(**changes), agent, 1, initial)


def steps(trainer, count):
    return [episode for _, episode in zip(range(count), trainer.run(), strict=False) if episode]


@case("game")
def _(make, *_):
    assert [make(game=g).learner.q_values(make(game=g).games.observations()).shape[1]
            for g in ("boxing", "breakout")] == [18, 4]  # fmt: skip


@case("frame_skip")
def _(make, *_):
    for skip in (2, 5):
        trainer = make(frame_skip=skip, noop_max=0)
        steps(trainer, 7)
        assert trainer.games.games[0].frames == 7 * skip


@case("frame_stack")
def _(make, *_):
    for stack in (1, 3):
        trainer = make(frame_stack=stack)
        steps(trainer, 3)
        assert trainer.games.observations().shape[-1] == stack
        assert trainer.memory.sample(2).s_t.shape[-1] == stack


@case("noop_max")
def _(make, *_):
    for most in (0, 3, 30):
        game = make(noop_max=most).games.games[0]
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
        game = trainer.games.games[0]
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
        game, rng = trainer.games.games[0], np.random.default_rng(0)
        for _ in range(300):
            game.step(int(rng.integers(18)))
        memories.append(game.ram().tobytes())
    assert memories[0] != memories[1]


def paying(monkeypatch, points):
    """Lets every frame pay."""
    act = AtariGame._act
    monkeypatch.setattr(AtariGame, "_act", lambda self, action: act(self, action) * 0 + points)


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
    assert set(used) in ({0.7, 0.2}, {0.7, 0.35, 0.2})  # two games may end together
    assert used[-1] == 0.2


@case("environments")
def _(make, *_):
    for count in (1, 5):
        trainer = make(environments=count)
        steps(trainer, 4)
        assert trainer.agent_steps == 4 * count


@case("replay_capacity")
def _(make, *_):
    for capacity in (40, 60):
        trainer = make(replay_capacity=capacity)
        steps(trainer, 50)
        assert len(trainer.memory) == capacity


@case("learning_starts", "update_period")
def _(make, *_):
    for starts, period in ((30, 2), (30, 5), (50, 5)):
        trainer = make(learning_starts=starts, update_period=period)
        steps(trainer, 40)
        assert trainer.learner.updates == (80 - starts) // period


@case("batch_size")
def _(make, monkeypatch, _):
    for size in (3, 8):
        trainer, sizes = make(batch_size=size), set()
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
            assert low < first_step(make(**changes)) < high


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


@case("target_update_period", "tau")
def _(make, *_):
    for learner in LEARNERS:
        for period, tau in ((5, 1.0), (9, 0.5)):
            changes = {"target_update_period": period, "tau": tau, "environments": 1}
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
            trainer = make(initial=source, **changes)
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
    parameters = make().params
    for experiment in ("", "other"):
        run = Run(parameters.model_copy(update={"initial_weights": experiment}), folder)
        assert (run.source() is None) == (experiment == "")


@case("evaluation_games", "evaluation_epsilon", "evaluation_difficulties", "evaluation_stickiness")
def _(make, monkeypatch, folder):
    chances, choose = set(), evaluation.epsilon_greedy

    def chosen(q_values, probability, rng):
        chances.add(probability)
        return choose(q_values, probability, rng)

    monkeypatch.setattr(evaluation, "epsilon_greedy", chosen)
    changes = {"evaluation_games": 3, "evaluation_epsilon": 0.25, "episodes": 1}
    beside = {"evaluation_difficulties": [2], "evaluation_stickiness": [0.5]}
    run = Run(make().params.model_copy(update={**changes, **beside}), folder)
    recording.train(run)
    played = pd.read_csv(run.folder / "evaluations.csv")
    assert played.groupby(["difficulty", "sticky_actions"]).size().to_dict() == {
        **{(0, 0.0): 3, (0, 0.5): 3},
        (2, 0.0): 3,
    }
    assert set(played.epsilon) == {0.25} == chances


@case("snapshot_games", "episodes")
def _(make, monkeypatch, folder):
    run = Run(make().params.model_copy(update={"snapshot_games": [2], "episodes": 3}), folder)
    recording.train(run)
    assert [path.name for path in run.folder.glob("snapshots/*")] == ["games-00002.safetensors"]
    assert len(pd.read_csv(run.folder / "episodes.csv")) == 3


@case("device", "learner")
def _(make, *_):
    assert [make(learner=learner).learner.kind for learner in LEARNERS] == list(LEARNERS)
    assert str(make(device="cpu", learner="torch").learner.device) == "cpu"


@pytest.mark.parametrize("names", CASES, ids=", ".join)
def test_it_reaches_its_place(names, make, monkeypatch, tmp_path):
    CASES[names](make, monkeypatch, tmp_path)


BOOKKEEPING = {"experiment", "profile", "agents", "seeds", "variations"}


def test_no_parameter_is_left_out():
    named = [name for names in CASES for name in names]
    assert len(named) == len(set(named))
    assert set(named) == set(Parameters.model_fields) - BOOKKEEPING


# ---- What is written down is what happened -------------------------------------------------------


def test_loss_and_q_are_logged_under_their_names(make, monkeypatch):
    trainer, losses = make(), []

    def learn(batch):
        trainer.learner.updates += 1
        losses.append(float(len(losses)))
        return losses[-1], 100.0

    monkeypatch.setattr(trainer.learner, "learn", learn)
    while not (episodes := steps(trainer, 1)):
        pass
    assert episodes[0].mean_q == 100.0
    assert episodes[0].loss == np.mean(losses)


def test_the_check_of_values_learns_from_the_same_rewards_as_training(small, monkeypatch):
    paying(monkeypatch, 3.0)
    monkeypatch.setattr(evaluation, "VALUE_GAMES", 2)
    for clip, reward in ((True, 1), (False, 12)):
        parameters = small(clip_rewards=clip, gamma=0.0)
        player = lambda states: np.zeros((len(states), 18), np.float32)  # noqa: E731
        held_out = np.zeros((8, 84, 84, 4), np.uint8)
        check, _ = evaluation.check_values(player, parameters, held_out, 1, seed=1)
        assert check.realised == reward


def test_evaluation_has_random_streams_of_its_own(make, small):
    """Neither its emulators nor its exploration repeat what training has drawn."""
    trainer = make(environments=8)
    used = {str(game.np_random.bit_generator.state) for game in trainer.games.games}
    used |= {str(trainer.rng.bit_generator.state), str(trainer.memory.rng.bit_generator.state)}
    drawn = set()
    for number in range(12):
        table = evaluation.Table(small())
        table.start(number, seed=1)
        drawn |= {str(rng.bit_generator.state) for rng in (table.rng, table.emulator.np_random)}
    assert len(drawn) == 24
    assert not drawn & used


def test_agents_differ_as_their_names_say(make):
    learners = {agent: make(agent=agent).learner for agent in AGENTS}
    assert [("value_output.weight" in learner.weights()) for learner in learners.values()] == [
        *(False, False),
        True,
    ]
