"""What people who come for the weights find: the list of agents, and how the README loads them."""

import json
import re
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import torch
from safetensors.torch import load_file
from synthetic import check, evaluate, store

from atari_dqn import evaluation, params
from atari_dqn.envs import AtariEnv
from atari_dqn.networks import DuelingNetwork
from atari_dqn.report import catalogue
from atari_dqn.report.video import television
from atari_dqn.runs import plan, recorder, records
from atari_dqn.runs.models import load_model, model_bytes, read_model
from atari_dqn.runs.run import Run

ROOT = Path(__file__).parents[1]
STORED = sorted((ROOT / "results" / "runs" / "boxing_final").glob("*/seed-1/model.safetensors"))


@pytest.fixture(scope="module")
def readme():
    """What the README's own code defines."""
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    (code,) = re.findall(r"```python\n(.*?)```", text, re.DOTALL)
    assert "atari_dqn" not in code
    names = {}
    with pytest.MonkeyPatch.context() as here:
        here.chdir(ROOT)
        exec(code, names)
    return names


@pytest.fixture(scope="module")
def observations():
    """Bytes [3, 84, 84, 4] of a game of random moves."""
    game, rng = AtariEnv("boxing"), np.random.default_rng(1)
    images = [game.reset(seed=1)[0]]
    images += [game.step(int(rng.integers(18)))[0] for _ in range(60)]
    return torch.tensor(np.stack([np.stack(images[at : at + 4], -1) for at in (0, 30, 57)]))


def values(network, observations):
    with torch.no_grad():
        return network(observations)


def test_the_readmes_own_network_is_a_stored_agents(readme, observations):
    (path,) = [path for path in STORED if path.parts[-3] == "double_dqn"]
    stored = params.parse(params.read_values(path.with_name("params.yaml")), "stored")
    expected = values(load_model(path, stored), observations)
    ours = values(readme["network"], observations.permute(0, 3, 1, 2))
    assert ours.shape == (3, 18)
    torch.testing.assert_close(ours, expected, rtol=1e-4, atol=1e-5)
    assert not torch.allclose(ours[0], ours[2])
    turned = values(readme["network"], observations.flip(3).permute(0, 3, 1, 2))
    assert not torch.allclose(turned, expected, rtol=1e-4, atol=1e-5), "the newest image first"


@pytest.mark.parametrize("path", STORED, ids=lambda path: path.parts[-3])
def test_every_stored_agent_loads_into_the_readmes_network(readme, path, observations):
    network = readme["QNetwork"](load_file(path))
    assert values(network, observations.permute(0, 3, 1, 2)).isfinite().all()
    weights = read_model(path)
    assert network.state_dict().keys() == weights.keys()
    assert all((network.state_dict()[name] == value).all() for name, value in weights.items())


@pytest.mark.parametrize("stack", [4, 1])
def test_the_readmes_network_has_duelling_heads_and_other_stacks(
    readme, observations, tmp_path, stack
):
    torch.manual_seed(1)
    path = tmp_path / "model.safetensors"
    path.write_bytes(model_bytes(DuelingNetwork(stack, 6).state_dict(), 7))
    expected = DuelingNetwork(stack, 6)
    expected.load_state_dict(read_model(path))
    seen = observations[..., :stack]
    ours = values(readme["QNetwork"](load_file(path)), seen.permute(0, 3, 1, 2))
    torch.testing.assert_close(ours, values(expected, seen), rtol=1e-4, atol=1e-5)


def listed(folder):
    """The rows of the list, by its headings."""
    text = (folder / "README.md").read_text(encoding="utf-8")
    lines = [re.split(r" *\| *", line)[1:-1] for line in text.splitlines() if line.startswith("|")]
    return [dict(zip(lines[0], line, strict=True)) for line in lines[2:]]


def linked(folder, cell):
    path = folder / re.fullmatch(r"\[\w+\]\((.*)\)", cell)[1]
    assert path.is_file()
    return path


def in_progress(run):
    """Makes a complete run one that is not evaluated yet."""
    (run.folder / "evaluations.csv").unlink()
    path = run.folder / "status.json"
    path.write_text(path.read_text().replace('"complete"', '"interrupted"'))


def film(run, **heading):
    """The video of the one episode of a run with this heading."""
    (record,) = [
        record for said, record in records.read_file(run.folder) if heading.items() <= said.items()
    ]
    return television(records.replay(run.params, record))


def test_the_list_says_of_every_agent_what_is_stored(tmp_path, small, monkeypatch):
    done = Run(small(profile="full", episodes=2, game="pong"), tmp_path)
    changed = {"gamma": 0.5, "experiment": "small+01234567"}
    other = Run(
        small(profile="full", episodes=2, agents=["dueling_double_dqn"], **changed), tmp_path
    )
    monkeypatch.setattr(plan, "files", lambda profile: [])
    recorder.train(done)
    recorder.train(other)
    in_progress(other)
    table = pd.read_csv(done.folder / "episodes.csv").assign(score=[4.0, -9.5])
    table.to_csv(done.folder / "episodes.csv", index=False)
    monkeypatch.setattr(catalogue, "RECENT", 1)
    catalogue.write("full", tmp_path, tmp_path)
    first, second = listed(tmp_path)
    assert list(first) == [
        *("experiment", "game", "agent", "seed", "training games", "training", "greedy"),
        *("weights", "records", "video"),
    ]
    greedy = pd.read_csv(done.folder / "evaluations.csv").score.mean()
    assert list(first.values())[:7] == [
        *("small", "Pong", "Double DQN", "1", "2 of 2"),
        *(
            "−9.5",
            f"{greedy:.1f} (2 games, after 2)".replace("-", "−"),
        ),
    ]
    assert linked(tmp_path, first["weights"]) == done.folder / "model.safetensors"
    assert linked(tmp_path, first["records"]) == done.folder / "games.jsonl.zst"
    shown = linked(tmp_path, first["video"]).read_bytes()
    assert shown == film(done, kind="evaluation", game=0, sticky_actions=0.0)
    assert second["experiment"] == "small: +01234567"
    assert (second["agent"], second["game"]) == ("Dueling Double DQN", "Boxing")
    assert (second["greedy"], second["video"]) == ("–", "–")


def test_the_list_is_the_same_every_time_and_renews_only_what_changed(tmp_path, small, monkeypatch):
    run = Run(small(profile="full", episodes=1), tmp_path)
    monkeypatch.setattr(plan, "files", lambda profile: [])
    catalogue.write("full", tmp_path, tmp_path)
    text = (tmp_path / "README.md").read_text()
    assert "None yet." in text
    assert (tmp_path / re.search(r"\]\((.*)#", text)[1]).samefile(ROOT / "README.md")
    recorder.train(run)
    catalogue.write("full", tmp_path, tmp_path)
    before = (tmp_path / "README.md").read_bytes()
    video = linked(tmp_path, listed(tmp_path)[0]["video"])
    made = video.stat().st_mtime_ns
    catalogue.write("full", tmp_path, tmp_path)
    assert (tmp_path / "README.md").read_bytes() == before
    assert video.stat().st_mtime_ns == made
    longer = Run(small(profile="full", episodes=2), tmp_path)
    recorder.train(longer)
    catalogue.write("full", tmp_path, tmp_path)
    assert not video.exists()
    assert linked(tmp_path, listed(tmp_path)[0]["video"]).name.startswith("00002-")


def test_greedy_games_are_of_the_last_check_or_else_of_the_newest_model_that_was_evaluated(
    tmp_path,
):
    run = store(tmp_path, "boxing_final", "dqn", np.zeros(300))
    assert catalogue.greedy_play(run) is None
    check(run, [1.0, 2.0, 3.0])
    found = catalogue.greedy_play(run)
    assert (found.trained, found.episodes, found.score) == (300, params.VALUE_GAMES, 3.0)
    for trained, games, score in ((200, 30, 70.0), (250, 10, 20.0)):
        evaluate(run, games=games, trained=trained, add=trained > 200, score=score)
    evaluate(run, games=10, trained=250, add=True, difficulty=3, score=-50.0)
    found = catalogue.greedy_play(run)
    assert (found.trained, found.episodes, found.score) == (250, 10, pytest.approx(20.0))


def test_a_run_in_progress_is_listed_with_its_last_check(tmp_path, small, monkeypatch):
    run = Run(small(profile="full", episodes=1), tmp_path)
    monkeypatch.setattr(plan, "files", lambda profile: [])
    monkeypatch.setattr(params, "VALUES_PERIOD", 1)
    monkeypatch.setattr(evaluation, "HELD_OUT_STATES", 8)
    for module in (params, evaluation):
        monkeypatch.setattr(module, "VALUE_GAMES", 3)
    recorder.train(run)
    in_progress(run)
    catalogue.write("full", tmp_path, tmp_path)
    (row,) = listed(tmp_path)
    checked = pd.read_csv(run.folder / "values.csv").score.iloc[-1]
    assert row["greedy"] == f"{checked:.1f} (3 games, after 1)".replace("-", "−")
    assert linked(tmp_path, row["video"]).read_bytes() == film(
        run, kind="values", episode=1, game=3
    )
    status = json.loads((run.folder / "status.json").read_text())
    assert row["training games"] == f"{status['episodes_done']} of 1"
