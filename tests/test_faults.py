"""What goes wrong around a run: it is named, and nothing that was good is lost."""

import os

import pytest
from safetensors.torch import load_file

from atari_dqn.native import NativeLearner
from atari_dqn.runs import checkpoints, evaluations, models, recorder
from atari_dqn.runs.files import RunError
from atari_dqn.runs.run import Run


def test_a_loss_that_is_not_finite_stops_the_run_and_the_last_checkpoint_is_kept(
    tmp_path, small, monkeypatch
):
    run, learn = Run(small(learner="native"), tmp_path), NativeLearner.learn
    monkeypatch.setattr(recorder, "CHECKPOINT_SECONDS", 0.0)

    def diverging(self, batch):
        loss, q = learn(self, batch)
        return (float("nan"), q) if self.updates == 20 else (loss, q)

    monkeypatch.setattr(NativeLearner, "learn", diverging)
    with pytest.raises(RunError, match=r"no longer finite .* try a learning_rate below 0\.0001"):
        recorder.train(run, None)
    assert run.state() == "failed"
    saved = checkpoints.load(run.state_folder)
    assert 0 < saved["trainer"]["learner"]["updates"] < 20
    monkeypatch.setattr(NativeLearner, "learn", learn)
    recorder.train(run, None)
    assert run.state() == "complete"


@pytest.fixture(scope="module")
def model():
    """The bytes of a small network's file, and its network."""
    from atari_dqn.networks import NatureNetwork

    return models.model_bytes(NatureNetwork(1, 2).state_dict(), 3000)


@pytest.mark.parametrize("place", [0.02, 0.3, 0.5, 0.999])
def test_a_flipped_bit_of_a_models_weights_is_noticed(tmp_path, model, place):
    path = tmp_path / "model.safetensors"
    path.write_bytes(model)
    weights = models.read_model(path)
    assert set(weights) == set(load_file(path))
    damaged = bytearray(model)
    damaged[int(place * len(model))] ^= 1
    path.write_bytes(damaged)
    with pytest.raises(RunError, match=r"model\.safetensors is damaged: it does not have"):
        models.read_model(path)


def test_a_flipped_bit_of_the_number_of_its_games_is_noticed(tmp_path, model):
    path = tmp_path / "model.safetensors"
    path.write_bytes(model.replace(b" 3000", b" 2000", 1))
    assert models.trained_games(path) == 2000
    with pytest.raises(RunError, match="does not have the checksum"):
        models.read_model(path)


@pytest.mark.parametrize("content", [b"", b"no weights", b"\xff" * 64])
def test_what_is_no_model_is_named(tmp_path, content):
    path = tmp_path / "model.safetensors"
    path.write_bytes(content)
    for read in (models.read_model, models.trained_games):
        with pytest.raises(RunError, match=r"model\.safetensors cannot be read: "):
            read(path)


def test_no_game_is_played_whose_result_could_not_be_stored(tmp_path, small, monkeypatch):
    run = Run(small(episodes=1), tmp_path)
    recorder.train(run, None)
    monkeypatch.setattr(os, "access", lambda path, mode: False)  # a superuser may write everywhere
    monkeypatch.setattr(evaluations.evaluation, "play", None)
    with pytest.raises(RunError, match="cannot be written to"):
        evaluations.evaluate(run.folder, {})
