"""Whoever changes training code must decide whether it changes results."""

import ast
import hashlib
import io
import tokenize
from pathlib import Path

import pytest

import atari_dqn
from atari_dqn.params import NOT_TRAINING, TRAINING_VERSION, Parameters

MODULES = (
    "games",
    "envs",
    "emulators",
    "networks",
    "replay",
    "agents",
    "gpu",
    "schedules",
    "training",
    "native/__init__",
)
# If this test fails: do the same parameters and seed still give the same run, bit for bit? If so,
# put the new hash here. (Of learner.cpp, a digest in test_native.py tells.) If not, raise
# TRAINING_VERSION in params.py too: stored runs become stale.
EXPECTED = (3, "dc6b45b086767cff1f9394f68f56e5788485faca8d06ece2417ba68f36538b37")
BLOCKS = {tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT}


def code_hash(*sources):
    """SHA-256 of the sources' tokens and blocks: comments, docstrings and layout do not count."""
    digest = hashlib.sha256()
    for source in sources:
        docstrings = {
            (node.lineno, node.col_offset)
            for node in ast.walk(ast.parse(source))
            if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)
        }
        skipping = False  # until the end of a docstring's line
        for token in tokenize.generate_tokens(io.StringIO(source).readline):
            if token.type == tokenize.STRING and token.start in docstrings:
                skipping = True
            elif token.type == tokenize.NEWLINE and skipping:
                skipping = False
            elif token.type in BLOCKS:
                digest.update(tokenize.tok_name[token.type].encode())
            elif token.type not in (tokenize.COMMENT, tokenize.NL):
                digest.update(token.string.encode())
    return digest.hexdigest()


def training_code():
    folder = Path(atari_dqn.__file__).parent
    return [(folder / f"{name}.py").read_text("utf-8") for name in MODULES]


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
    "target_update_period": 2000,
    "tau": 1.0,
    "warmup_games": 0,
    "warmup_learning_rate": 0.0,
    "initial_weights": "",
    "transferred_layers": "all",
    "freeze_convolutions": False,
    "n_steps": 1,
}


def test_defaults_to_which_identities_are_relative_never_change():
    assert Parameters(experiment="any").model_dump(exclude=NOT_TRAINING) == DEFAULTS


def test_a_change_of_training_code_is_noticed():
    assert (TRAINING_VERSION, code_hash(*training_code())) == EXPECTED


SOURCE = '''"""A module."""
def learn(batches):
    """Learns."""
    for batch in batches:
        update(batch)
        count()
'''


def test_a_line_moved_out_of_its_block_is_a_change():
    moved = SOURCE.replace("        count()", "    count()")
    assert code_hash(moved) != code_hash(SOURCE)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("        count()", "        # all\n\n        count()  # them"),
        ('"""Learns."""', '"""Learns\n\n    from them."""  # all'),
        ('    """Learns."""\n', ""),
        ('"""A module."""\n', "\n\n"),
        ("update(batch)", "update(\n            batch\n        )"),
    ],
)
def test_comments_docstrings_and_layout_are_no_change(old, new):
    changed = SOURCE.replace(old, new)
    assert changed != SOURCE
    assert code_hash(changed) == code_hash(SOURCE)
