import re
from pathlib import Path

import pytest
from ruamel.yaml import YAML

from atari_dqn import params
from atari_dqn.params import ParameterError, Parameters
from atari_dqn.runs import plan

ROOT = Path(__file__).parents[1]
FILES = [path for profile in params.PROFILES for path in plan.files(profile)]
# What only some experiments need to name.
RARE = {
    *("device", "learner", "emulator_processes", "variations", "n_steps"),
    *("warmup_games", "warmup_learning_rate"),
    *("evaluation_difficulties", "evaluation_stickiness"),
    *("initial_weights", "transferred_layers", "freeze_convolutions"),
}


def write(folder, text, name="mine.yaml"):
    path = folder / name
    path.write_text(text)
    return path


@pytest.mark.parametrize("profile", params.PROFILES)
def test_every_experiment_has_a_file_of_every_profile(profile):
    files = plan.files(profile)
    assert [path.stem for path in files if path.stem in plan.ORDER] == list(plan.ORDER)
    for path in files:
        assert params.load(path).profile == profile


def test_the_full_files_name_every_training_parameter():
    for path in plan.files("full"):
        missing = set(Parameters.model_fields) - set(params.read_values(path))
        assert missing <= RARE, path


COMMITTED = [  # a reader's own experiment beside them need not say as much
    path
    for path in sorted((ROOT / "params").rglob("*.yaml"))
    if path.stem in plan.ORDER or path.parent.name == "base"
]


@pytest.mark.parametrize("path", COMMITTED, ids=str)
def test_every_value_in_a_committed_file_has_its_unit_beside_it(path):
    for line in path.read_text().splitlines():
        assert not line or "# " in line, line


def test_small_versions_say_only_how_they_are_smaller():
    size = {
        *("profile", "agents", "episodes", "max_game_frames", "replay_capacity"),
        *("batch_size", "learning_starts", "update_period", "target_update_period"),
        "epsilon_decay",
        *("warmup_games", "snapshot_games", "evaluation_games", "variations"),
    }
    for profile in ("quick", "smoke"):
        for path in plan.files(profile):
            full = params.load(ROOT / "params" / path.name)
            small = params.load(path)
            own = YAML(typ="safe", pure=True).load(path.read_text())
            assert set(own) <= size | {"base", "experiment"}, path
            assert small.model_dump(exclude=size) == full.model_dump(exclude=size), path
            assert set(small.agents) <= set(full.agents), path
            assert small.variations.items() <= full.variations.items(), path


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("epsiodes: 3", "unknown key 'epsiodes': did you mean 'episodes'?"),
        ("gamma: 0.9\ngamma: 0.8", 'line 2: found duplicate key "gamma"'),
        ("batch_size: 1.5", "batch_size: 1.5 is not allowed: input should be a valid integer"),
        ("clip_rewards: 1", "clip_rewards: 1 is not allowed: input should be a valid boolean"),
        ("gamma: 1.0", "gamma: 1.0 is not allowed: input should be less than 1"),
        ("learning_rate: fast", "learning_rate: 'fast' is not allowed"),
        ("learning_rate: .nan", "learning_rate: nan is not allowed"),
        ("game: brekaout", "game: 'brekaout' is not allowed: no such game; did you mean 'brea"),
        ("game: chess", "no such game; must be one of alien, amidar, "),
        (
            "agents: [dqn, ddqn]",
            "'ddqn' is not allowed: no such agent; did you mean 'dqn'?",
        ),
        ("agents: [dqn, dqn]", "no value may be listed twice"),
        ("seeds: [-1]", "seeds.0: -1 is not allowed"),
        ("game: breakout\ndifficulty: 3", "difficulty: 3 is not allowed: breakout has (0, 1)"),
        ("environments: 3", "replay_capacity: 1000000 is not allowed: a multiple"),
        ("epsilon_start: 0.005", "epsilon_floor: 0.01 is not allowed: above epsilon_start"),
        ("experiment: other", "must be the file's name, 'mine'"),
        ("gamma: [", "line "),
        ("just words", "expected lines of 'key: value'"),
    ],
)
def test_a_bad_file_is_one_clear_line_with_file_key_and_value(tmp_path, text, said):
    path = write(tmp_path, text)
    with pytest.raises(ParameterError) as caught:
        params.load(path)
    message = str(caught.value)
    assert said in message
    assert str(path) in message
    assert "\n" not in message


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(ParameterError, match=r"nowhere\.yaml: no such file"):
        params.load(tmp_path / "nowhere.yaml")


@pytest.mark.parametrize("text", ["1e-4", "1.0e-4", "0.0001", "'1e-4'"])
def test_a_learning_rate_may_be_written_in_any_notation(tmp_path, text):
    assert params.load(write(tmp_path, f"learning_rate: {text}")).learning_rate == 1e-4


def test_identity_ignores_episodes_and_defaults_but_not_training():
    plain = Parameters(experiment="a")
    assert plain.identity() == Parameters(experiment="b", episodes=9, gamma=0.99).identity()
    assert plain.identity() != Parameters(experiment="a", gamma=0.9).identity()


def test_overrides_move_an_experiment_to_a_name_of_its_own(tmp_path):
    path = write(tmp_path, "gamma: 0.9")
    changed = params.load(path, {"gamma": 0.8})
    assert changed.experiment == f"mine+{changed.variant()}"
    # one seed, or a value that is the file's own, is no change
    assert params.load(path, {"seeds": [7], "gamma": 0.9}).experiment == "mine"
    with pytest.raises(ParameterError, match="experiment: 'other' is not allowed"):
        params.load(path, {"experiment": "other"})
    # more games continue the very same run
    longer, longest = params.load(path, {"episodes": 10}), params.load(path, {"episodes": 20})
    assert longer.experiment == longest.experiment != "mine"


def test_variations_of_a_changed_experiment_are_not_those_of_its_file(tmp_path):
    path = write(tmp_path, "variations:\n  slow: {learning_rate: 1e-5}\n  fast: {gamma: 0.5}")

    def names(overrides):
        return {each.experiment for each in params.variants(params.load(path, overrides)).values()}

    own = names({})
    assert own == {
        params.load(path, {k: v}).experiment for k, v in (("learning_rate", 1e-5), ("gamma", 0.5))
    }
    for overrides in ({"episodes": 10}, {"noop_max": 3}, {"batch_size": 8}):
        changed = names(overrides)
        assert len(changed) == 2
        assert not changed & own, overrides


def test_a_stored_runs_parameters_describe_that_very_run(tmp_path):
    for text in ("gamma: 0.9", "variations:\n  fast: {gamma: 0.5}"):
        base = params.pick(params.load(write(tmp_path, text), {"noop_max": 3}), "dqn", 4)
        (run,) = params.variants(base).values()
        (tmp_path / "params.yaml").write_text(params.text(run))
        (again,) = params.variants(params.load(tmp_path / "params.yaml")).values()
        assert again == run


def test_values_injected_into_a_notebook_are_overrides_of_the_file_they_name(tmp_path):
    write(tmp_path, "gamma: 0.9\nlearning_rate: 1e-3")
    values = {"experiment": "mine", "learning_rate": "1e-3"}
    assert params.resolve(values, tmp_path) == params.load(tmp_path / "mine.yaml")
    assert params.resolve({**values, "gamma": 0.8}, tmp_path).experiment.startswith("mine+")
    assert params.resolve({"experiment": "new", "game": "breakout"}, tmp_path).game == "breakout"
    with pytest.raises(ParameterError, match=r"experiment: 'other' is not allowed: there is no"):
        params.resolve({"experiment": "other", "profile": "full", "gamma": 0.5}, tmp_path)
    with pytest.raises(ParameterError, match="there is with profile full"):
        params.resolve({**values, "profile": "quick"}, tmp_path)
    write(tmp_path, "gamma: 0.9", "boxing_final.yaml")
    with pytest.raises(ParameterError, match=r"did you mean 'boxing_final'\?"):
        params.resolve({"experiment": "boxing_finl", "game": "boxing"}, tmp_path)


def test_a_file_differs_from_its_bases_of_which_the_last_one_counts(tmp_path, monkeypatch):
    (tmp_path / "quick").mkdir()
    write(tmp_path, "gamma: 0.5\nepisodes: 7\nbatch_size: 8", "common.yaml")
    write(tmp_path, "base: common.yaml\ngamma: 0.9\nreplay_capacity: 80000")
    write(tmp_path, "profile: quick\nreplay_capacity: 800", "small.yaml")
    path = write(tmp_path / "quick", "base: [../mine.yaml, ../small.yaml]\nepisodes: 5")
    loaded = params.load(path)
    assert (loaded.gamma, loaded.batch_size) == (0.9, 8)
    assert (loaded.replay_capacity, loaded.episodes, loaded.profile) == (800, 5, "quick")
    monkeypatch.chdir(tmp_path / "quick")  # bases are found from the file, not from here
    assert params.load("mine.yaml") == loaded


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("base: nowhere.yaml", "base: 'nowhere.yaml' is not allowed: there is no"),
        ("base: mine.yaml", "base: 'mine.yaml' is not allowed: it is based on this file"),
        ("base: other.yaml", "base: 'mine.yaml' is not allowed: it is based on this file"),
        ("base: 3", "base: 3 is not allowed: must be a file, or a list"),
        ("base: [3]", "base: [3] is not allowed: must be a file, or a list"),
        ("base: bad.yaml", "bad.yaml: line 1"),
    ],
)
def test_a_bad_base_is_one_clear_line(tmp_path, text, said):
    write(tmp_path, "base: mine.yaml", "other.yaml")
    write(tmp_path, "gamma: [", "bad.yaml")
    with pytest.raises(ParameterError) as caught:
        params.load(write(tmp_path, text))
    assert said in str(caught.value)


def test_a_full_file_does_not_become_small_by_its_profiles_name(tmp_path):
    path = write(tmp_path, "gamma: 0.9\nreplay_capacity: 80000\nepisodes: 100")
    with pytest.raises(ParameterError, match=r"profile: 'quick' is not allowed: .*has 'full'"):
        params.load(path, {"profile": "quick"})


def test_papermill_may_be_given_a_file_with_bases(tmp_path):
    write(tmp_path, "gamma: 0.5", "common.yaml")
    path = write(tmp_path, "experiment: mine\nbase: common.yaml\nbatch_size: 8")
    as_injected = YAML(typ="safe", pure=True).load(path.read_text())
    assert params.resolve(as_injected, tmp_path) == params.load(path)


@pytest.mark.parametrize(
    "path",
    [path for path in FILES if path.stem in plan.ORDER],
    ids=lambda path: f"{path.parent.name}/{path.stem}",
)
def test_papermill_trains_what_the_file_says_that_it_is_given(path):
    """On top of the front notebook's defaults, as papermill injects it."""
    defaults = {"experiment": "boxing_final", "profile": "quick"}
    injected = YAML(typ="safe", pure=True).load(path.read_text())
    assert params.resolve({**defaults, **injected}, ROOT / "params") == params.load(path)


def test_a_notebook_takes_no_file_with_a_base_from_elsewhere(tmp_path):
    write(tmp_path, "gamma: 0.5", "common.yaml")
    write(tmp_path, "base: common.yaml")
    for values in ({"experiment": "own", "game": "boxing"}, {"experiment": "mine"}):
        with pytest.raises(
            ParameterError, match=r"base: 'other.yaml' is not allowed: .*train FILE"
        ):
            params.resolve({**values, "base": "other.yaml"}, tmp_path)


def test_what_is_wrong_in_a_base_is_looked_for_there(tmp_path):
    write(tmp_path, "experiment: lowest\ngama: 0.5\ngamma: 2", "lowest.yaml")
    write(tmp_path, "base: lowest.yaml\nepisodes: -1", "base.yaml")
    with pytest.raises(ParameterError) as caught:
        params.load(write(tmp_path, "base: base.yaml\nbatch_size: 0"))
    said = str(caught.value)
    assert f"unknown key 'gama': did you mean 'gamma'? (it is in {tmp_path}/lowest.yaml)" in said
    assert re.search(rf"gamma: 2 is not allowed: [^;]* \(it is in {tmp_path}/lowest.yaml\)", said)
    assert re.search(rf"episodes: -1 is not allowed: [^;]* \(it is in {tmp_path}/base.yaml\)", said)
    assert re.search(r"batch_size: 0 is not allowed: [^;(]*(;|$)", said)


def test_what_is_evaluated_besides_gives_an_experiment_no_other_name(tmp_path):
    path = write(tmp_path, "gamma: 0.9")
    before = params.load(path, {"gamma": 0.8}).experiment
    path.write_text("gamma: 0.9\nevaluation_difficulties: [0, 1]\nevaluation_stickiness: [0.25]")
    assert params.load(path, {"gamma": 0.8}).experiment == before
    with pytest.raises(ParameterError, match=r"evaluation_difficulties: \[1\] .*`evaluate` plays"):
        params.load(path, {"evaluation_difficulties": [1]})  # the same run: nothing would be played


def test_what_is_dumped_reads_back_the_same(tmp_path, small):
    path = tmp_path / "small.yaml"
    path.write_text(params.text(small(gamma=0.5)))
    assert params.load(path) == small(gamma=0.5)


@pytest.mark.parametrize("texts", [["gamma"], ["=3"], ["gamma=["], ["gamma=0", "gamma=1"]])
def test_a_bad_override_says_what_is_expected(texts):
    with pytest.raises(ParameterError, match="--set"):
        params.parse_overrides(texts)


def test_overrides_outside_training_have_a_name_of_their_own_too(tmp_path):
    path = write(tmp_path, "gamma: 0.9")
    names = {params.load(path, {"evaluation_games": n}).experiment for n in (1, 5, 100)}
    assert len(names) == 3


@pytest.mark.parametrize(("agent", "seed"), [("ddqn", 1), ("dqn", -1), ("dqn", 1.5), ("dqn", "a")])
def test_only_a_known_agent_and_a_whole_seed_can_be_picked(agent, seed):
    with pytest.raises(ParameterError, match="is not allowed"):
        params.pick(Parameters(experiment="any"), agent, seed)


def test_variations_are_what_the_same_overrides_would_give(tmp_path):
    text = "variations: {slow: {learning_rate: 1.0e-5}, same: {gamma: 0.99}}"
    path = write(tmp_path, text)
    variants = params.variants(params.load(path))
    alone = {"learning_rate": 1e-5, "variations": {}}
    assert variants["slow"] == params.load(path, alone)
    assert variants["slow"].experiment.startswith("mine+")
    assert variants["same"].experiment == "mine"
    assert list(params.variants(Parameters(experiment="plain"))) == ["plain"]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("variations: {a: {gama: 0.9}}", "did you mean 'gamma'"),
        ("variations: {a: {gamma: 2}}", "gamma: 2 is not allowed"),
        ("variations: {a: {}}", "'a' is not allowed"),
        ("variations: {a: {episodes: 5}}", "'a' is not allowed"),
        ("variations: {a: {evaluation_difficulties: [1]}}", "'a' is not allowed"),
        ("variations: {a: {gamma: 0.99}, b: {batch_size: 32}}", "two of them are the same"),
    ],
)
def test_a_bad_variation_is_refused_with_its_label(tmp_path, text, said):
    with pytest.raises(ParameterError, match="variations") as caught:
        params.load(write(tmp_path, text))
    assert said in str(caught.value)
