"""Games on record: played again they are the same games, and a table that lies is found out."""

import json
import subprocess
import sys

import numpy as np
import pandas as pd
import pytest
import zstandard

from atari_dqn import audit, evaluation, recording, records, runs
from atari_dqn.audit import Difference, verify
from atari_dqn.envs import AtariGame, GameRecord, game_of
from atari_dqn.records import RecordError
from atari_dqn.runs import Run


@pytest.mark.parametrize("sticky", [0.0, 0.25])
@pytest.mark.parametrize(("game", "difficulty"), [("boxing", 3), ("breakout", 0)])
def test_a_recorded_game_is_the_same_in_another_emulator_frame_for_frame(
    small, game, difficulty, sticky
):
    """Also the third game of an emulator, with another seed and in the middle of its chance."""
    parameters = small(game=game, difficulty=difficulty, sticky_actions=sticky, max_game_frames=900)
    played, rng = game_of(parameters), np.random.default_rng(0)
    played.reset(seed=7)
    for _ in range(3):
        before = played.reset()[0]
        seen, ended = [(before.tobytes(), played.ram().tobytes())], False
        while not ended:
            image, *_ = result = played.step(int(rng.integers(len(played.actions))))
            ended = result[2] or result[3]
            seen.append((image.tobytes(), played.ram().tobytes()))
    other = game_of(parameters)
    other.reset(seed=99)
    image, _ = other.reset(options={"record": played.played()})
    again = [(image.tobytes(), other.ram().tobytes())]
    for action in played.played().actions:
        again.append((other.step(action)[0].tobytes(), other.ram().tobytes()))
    assert again == seen
    assert (other.score, other.length, other.frames) == (
        *(played.score, played.length, played.frames),
    )
    assert other.played() == played.played()


def test_a_game_goes_on_its_record_through_a_stop(small):
    parameters = small(sticky_actions=0.25)
    game, resumed = game_of(parameters), game_of(parameters)
    game.reset(seed=1)
    for action in (1, 5, 3):
        game.step(action)
    resumed.set_state(game.get_state())
    for each in (game, resumed):
        each.step(4)
    assert resumed.played() == game.played()
    assert resumed.played().actions == bytes([1, 5, 3, 4])


RNG = np.random.default_rng(3).bit_generator.state
SOME = [
    ("training", {"episode": 1}, GameRecord(5, bytes([0, 17, 3]), None)),
    ("training", {"episode": 2}, GameRecord(30, bytes(range(18)) * 9, RNG)),
    ("values", {"episode": 2, "game": 40}, GameRecord(1, b"", None)),
]


def test_what_is_written_reads_back_and_is_plain_json_lines(tmp_path):
    data = b"".join(records.encode(*game) for game in SOME)
    expected = [({"kind": kind, **heading}, record) for kind, heading, record in SOME]
    assert list(records.read(data, "here")) == expected
    path = tmp_path / records.FILE
    path.write_bytes(data)
    table = pd.read_json(path, lines=True, compression="zstd")  # as anyone may read it
    assert table.actions[0] == "ARD"
    assert table.idle_frames.tolist() == [5, 30, 1]
    assert list(records.read(b"", "here")) == []


@pytest.mark.parametrize("place", [9, 60, -3])
def test_damage_is_noticed_and_named(place):
    data = bytearray(b"".join(records.encode(*game) for game in SOME))
    data[place] ^= 1
    with pytest.raises(RecordError, match="here is damaged after"):
        list(records.read(bytes(data), "here"))
    with pytest.raises(RecordError, match="here is damaged after 2 games"):
        list(records.read(bytes(b"".join(records.encode(*game) for game in SOME)[:-4]), "here"))


def test_other_games_of_the_same_heading_take_the_place_of_the_old_ones():
    data = b"".join(records.encode(*game) for game in SOME)
    new = GameRecord(2, bytes([4]), None)
    data = records.replaced(data, "values", [({"episode": 2, "game": 40}, new)])
    data = records.replaced(data, "evaluation", [({"game": 0}, new)])
    kept = [({"kind": kind, **heading}, record) for kind, heading, record in SOME[:2]]
    assert list(records.read(data, "here")) == [
        *kept,
        ({"kind": "values", "episode": 2, "game": 40}, new),
        ({"kind": "evaluation", "game": 0}, new),
    ]


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    """A run with sticky actions, two checks of values and two conditions of evaluation."""
    from conftest import SMALL

    from atari_dqn.params import Parameters

    folder = tmp_path_factory.mktemp("recorded")
    patch = pytest.MonkeyPatch()
    patch.setenv("ATARI_DQN_STATE", str(folder / "state"))
    patch.setattr(recording, "VALUES_PERIOD", 2)
    patch.setattr(evaluation, "VALUE_GAMES", 3)
    patch.setattr(audit, "VALUE_GAMES", 3)
    more = {"episodes": 5, "sticky_actions": 0.25, "evaluation_difficulties": [0, 3]}
    run = Run(Parameters(**{**SMALL, **more, "max_game_frames": 600}), folder)
    recording.train(run)
    yield run
    patch.undo()


@pytest.fixture
def run(trained, tmp_path):
    """A copy of it that may be changed."""
    import shutil

    shutil.copytree(trained.folder, tmp_path / "seed-1")
    return tmp_path / "seed-1"


def test_a_run_agrees_with_its_records(run):
    named = list(verify(run, None))
    assert sum(name.startswith("training") for name in named) == 5
    assert sum(name.startswith("evaluation") for name in named) == 4
    assert [name for name in named if "greedy" in name] == [
        *("3 greedy games after game 2", "3 greedy games after game 4")
    ]
    assert len(list(verify(run, 3))) == 3
    headings = [heading for heading, _ in records.read_file(run)]
    assert [h["episode"] for h in headings if h["kind"] == "training"] == [1, 2, 3, 4, 5]


def test_what_is_evaluated_later_is_on_record_too(run):
    runs.evaluate(run, {"difficulty": 2}, games=3)
    runs.evaluate(run, {"difficulty": 2}, games=3)
    kinds = [(h["kind"], h.get("difficulty")) for h, _ in records.read_file(run)]
    assert kinds.count(("evaluation", 2)) == 3
    assert len(list(verify(run, None))) == 5 + 4 + 3 + 2


def test_evaluations_stay_on_record_when_a_run_goes_on(tmp_path, small):
    """Also those of a process that evaluates while another trains, and whose training was killed
    in the middle of a line."""
    run = Run(small(episodes=2), tmp_path)
    recording.train(run)
    runs.evaluate(run.folder, {"difficulty": 1}, games=1)
    longer = Run(small(episodes=4), tmp_path)
    log = recording.Recorder.log

    def evaluate_meanwhile(self, episode):
        log(self, episode)
        if episode.episode == 3:
            runs.evaluate(run.folder, {"difficulty": 2}, games=1)
            with (run.folder / records.FILE).open("ab") as file:
                file.write(b"(\xb5/\xfd half a game")
            raise KeyboardInterrupt

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(recording.Recorder, "log", evaluate_meanwhile)
        with pytest.raises(KeyboardInterrupt):
            recording.train(longer)
    recording.train(longer)
    kinds = [name.split()[0] for name in verify(run.folder, None)]
    assert (kinds.count("training"), kinds.count("evaluation")) == (4, 2 + 2 + 1 + 1)


@pytest.mark.parametrize(
    ("file", "row", "column", "said"),
    [
        ("episodes.csv", 3, "score", r"training game \(episode 4\): score is .* in episodes.csv"),
        ("episodes.csv", 0, "length", r"training game \(episode 1\): length is .* in episodes.csv"),
        ("episodes.csv", 2, "frames", r"training game \(episode 3\): frames is .* in episodes.csv"),
        ("evaluations.csv", 1, "score", r"evaluation game .*game 1\): score is .* evaluations.csv"),
        ("evaluations.csv", 3, "frames", r"evaluation game .*difficulty 3.*: frames is"),
        ("values.csv", 1, "score", r"the greedy games after game 4: score is .* in values.csv"),
    ],
)
def test_one_point_more_in_a_table_is_found(run, file, row, column, said):
    table = pd.read_csv(run / file)
    table.loc[row, column] += 1
    table.to_csv(run / file, index=False)
    with pytest.raises(Difference, match=said):
        list(verify(run, None))


def test_a_missing_or_invented_game_is_found(run):
    episodes = pd.read_csv(run / "episodes.csv")
    episodes.iloc[:-1].to_csv(run / "episodes.csv", index=False)
    with pytest.raises(Difference, match=r"\('training', 5\) is on record, but in no table"):
        list(verify(run, 1))
    episodes.to_csv(run / "episodes.csv", index=False)
    whole = (run / records.FILE).read_bytes()
    kept = [
        records.encode(heading.pop("kind"), heading, record)
        for heading, record in records.read(whole, "here")
        if heading.get("episode") != 3
    ]
    (run / records.FILE).write_bytes(b"".join(kept))
    with pytest.raises(Difference, match=r"\('training', 3\) is in a table, but not on record"):
        list(verify(run, 1))
    (run / records.FILE).unlink()
    with pytest.raises(RecordError, match=r"games\.jsonl\.zst: No such file"):
        list(verify(run, 1))


def test_an_action_that_the_cartridge_lacks_is_refused(small):
    with pytest.raises(RecordError, match="breakout has no action 9"):
        list(records.replay(small(game="breakout"), GameRecord(1, bytes([2, 9]), None)))


def command(*arguments):
    return subprocess.run(
        [sys.executable, "-m", "atari_dqn", *map(str, arguments)], capture_output=True, text=True
    )


def test_the_command_line_verifies_replays_and_films(run, tmp_path):
    film = tmp_path / "game.mp4"
    replayed = command("replay", run, "--episode", 2, "--video", film)
    assert replayed.returncode == 0, replayed.stderr
    row = pd.read_csv(run / "episodes.csv").loc[1]
    assert f"game 2: {row.score:g} points, {row.length:.0f} agent steps" in replayed.stdout
    assert film.read_bytes()[4:8] == b"ftyp"
    assert "all as the tables say" in command("verify", run).stdout
    episodes = pd.read_csv(run / "episodes.csv")
    episodes.loc[1, "score"] -= 1
    episodes.to_csv(run / "episodes.csv", index=False)
    found = command("verify", run)
    assert found.returncode == 1
    assert found.stderr.splitlines()[-1].startswith("error: training game (episode 2): score is")
    absent = command("replay", run, "--episode", 77)
    assert absent.returncode == 1
    assert "has no training game 77" in absent.stderr
    assert "Traceback" not in absent.stderr


def test_records_are_small(small):
    """Whatever an agent does, less than 0.6 bytes a step and 120 a game."""
    rng = np.random.default_rng(0)
    actions = bytes(rng.integers(18, size=1785).tolist())
    data = records.encode("training", {"episode": 1234}, GameRecord(17, actions, None))
    assert len(data) < 0.6 * 1785 + 120
    assert json.loads(zstandard.ZstdDecompressor().decompress(data))["episode"] == 1234


def test_an_unplayed_game_has_an_empty_record():
    game = AtariGame("boxing")
    game.reset(seed=0)
    assert game.played().actions == b""
    assert 1 <= game.played().idle_frames <= 30
