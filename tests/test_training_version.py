"""Whoever changes training code must decide whether it changes results."""

import ast
import hashlib
import io
import tokenize
from pathlib import Path

import atari_dqn
from atari_dqn.params import NOT_TRAINING, TRAINING_VERSION, Parameters

MODULES = ("envs", "networks", "replay", "agents", "exploration", "training")
# If this test fails: do the same parameters and seed still give the same run, bit for bit? If so,
# put the new hash here. If not, raise TRAINING_VERSION in params.py too: stored runs become stale.
EXPECTED = (1, "2584e33d8d998b8dff82661d24a3aefe536ce365747660a92dfdd60a99f569d6")


def code_hash():
    """SHA-256 of the modules' tokens: comments, docstrings and layout do not count."""
    digest = hashlib.sha256()
    layout = {tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT}
    for name in MODULES:
        source = (Path(atari_dqn.__file__).parent / f"{name}.py").read_text()
        docstrings = {
            (node.lineno, node.col_offset)
            for node in ast.walk(ast.parse(source))
            if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)
        }
        for token in tokenize.generate_tokens(io.StringIO(source).readline):
            if token.type not in layout and token.start not in docstrings:
                digest.update(token.string.encode())
    return digest.hexdigest()


# Never edit a line; a new parameter adds one, with a default that changes nothing.
DEFAULTS = {
    "game": "boxing",
    "frame_skip": 4,
    "frame_stack": 4,
    "noop_max": 30,
    "max_game_frames": 108_000,
    "sticky_actions": 0.0,
    "difficulty": 0,
    "clip_rewards": True,
    "life_loss_penalty": 0.0,
    "epsilon_start": 1.0,
    "epsilon_decay": 0.995,
    "epsilon_floor": 0.01,
    "environments": 8,
    "replay_capacity": 1_000_000,
    "learning_starts": 20_000,
    "update_period": 4,
    "batch_size": 32,
    "learning_rate": 1e-4,
    "adam_epsilon": 1e-8,
    "gamma": 0.99,
    "target_update_period": 1000,
    "tau": 1.0,
    "warmup_games": 0,
    "warmup_learning_rate": 0.0,
    "initial_weights": "",
    "transferred_layers": "all",
    "freeze_convolutions": False,
}


def test_defaults_to_which_identities_are_relative_never_change():
    assert Parameters(experiment="any").model_dump(exclude=NOT_TRAINING) == DEFAULTS


def test_a_change_of_training_code_is_noticed():
    assert (TRAINING_VERSION, code_hash()) == EXPECTED
