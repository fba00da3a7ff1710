"""Games on record: played again they are the same games, and a table that lies is found out."""

import json
import shutil
import sys
import tracemalloc
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import zstandard
from conftest import SMALL

from atari_dqn import __main__, evaluation, params
from atari_dqn.envs import AtariEnv, EpisodeRecord, make_env
from atari_dqn.params import Parameters
from atari_dqn.runs import compression, evaluations, recorder, records
from atari_dqn.runs.audit import Difference, verify
from atari_dqn.runs.files import RunError
from atari_dqn.runs.records import RecordError
from atari_dqn.runs.run import Run


@pytest.mark.parametrize("sticky", [0.0, 0.25])
@pytest.mark.parametrize(("game", "difficulty"), [("boxing", 3), ("breakout", 0)])
def test_a_recorded_game_is_the_same_in_another_emulator_frame_for_frame(
    small, game, difficulty, sticky
):
    """Also the third game of an emulator, with another seed and in the middle of its chance."""
    parameters = small(game=game, difficulty=difficulty, sticky_actions=sticky, max_game_frames=900)
    played, rng = make_env(parameters), np.random.default_rng(0)
    played.reset(seed=7)
    for _ in range(3):
        before = played.reset()[0]
        seen, ended = [(before.tobytes(), played.ram().tobytes())], False
        while not ended:
            image, *_ = result = played.step(int(rng.integers(len(played.actions))))
            ended = result[2] or result[3]
            seen.append((image.tobytes(), played.ram().tobytes()))
    other = make_env(parameters)
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
    game, resumed = make_env(parameters), make_env(parameters)
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
    ({"kind": "training", "episode": 1}, EpisodeRecord(5, bytes([0, 17, 3]), None)),
    ({"kind": "training", "episode": 2}, EpisodeRecord(30, bytes(range(18)) * 9, RNG)),
    ({"kind": "values", "episode": 2, "game": 40}, EpisodeRecord(1, b"", None)),
]
HERE = Path("here")


def evaluated(game, difficulty=0):
    settings = {"difficulty": difficulty, "sticky_actions": 0.0, "epsilon": 0.001, "seed": 1}
    return {"kind": "evaluation", "trained_games": 2, **settings, "game": game}


def test_what_is_written_reads_back_and_is_plain_json_lines(tmp_path):
    data = records.encode(SOME[:1]) + records.encode(SOME[1:])
    assert list(records.read(data, HERE)) == SOME
    path = tmp_path / records.FILE
    path.write_bytes(data)
    table = pd.read_json(path, lines=True, compression="zstd")  # as anyone may read it
    assert table.actions[0] == "ARD"
    assert table.idle_frames.tolist() == [5, 30, 1]
    assert list(records.read(b"", HERE)) == []


@pytest.mark.parametrize("place", [9, 60, -3])
def test_damage_is_noticed_and_named(place):
    whole = b"".join(records.encode([game]) for game in SOME)
    data = bytearray(whole)
    data[place] ^= 1
    with pytest.raises(RecordError, match="here is damaged after"):
        list(records.read(bytes(data), HERE))
    with pytest.raises(RecordError, match="here is damaged after 2 games"):
        list(records.read(whole[:-4], HERE))


@pytest.mark.parametrize(
    "heading", [{"kind": "training"}, {"kind": "match", "episode": 1}, {"episode": 1}]
)
def test_a_game_of_no_kind_is_damage(heading):
    with pytest.raises(RecordError, match="here is damaged after 0 games"):
        list(records.read(records.encode([(heading, SOME[0][1])]), HERE))


GAME = {"kind": "training", "episode": 1, "idle_frames": 1, "actions": "A"}
CHANCE = ["0x1", "0x3", 0, 0]
MALFORMED = {
    "lists within lists": "[" * 50_000,
    "no mapping": "[1]",
    **{f"idle frames {said!r}": GAME | {"idle_frames": said} for said in ("x", 1.5, -1, True)},
    **{f"episode {said!r}": GAME | {"episode": said} for said in ([1], "1", -1, 1.0, None)},
    "a kind of kinds": GAME | {"kind": ["training"]},
    **{
        f"chance {number}": GAME | {"rng": chance}
        for number, chance in enumerate(
            (
                *("x", [], CHANCE[:3], [hex(2**128), *CHANCE[1:]], ["-0x1", *CHANCE[1:]]),
                *([1, *CHANCE[1:]], [*CHANCE[:2], 2, 0], [*CHANCE[:3], 2**32], [*CHANCE[:3], "0"]),
            )
        )
    },
    "actions that are no letters": GAME | {"actions": [0, 1]},
    "an epsilon above one": GAME
    | {**dict.fromkeys(records.KEYS["evaluation"], 0), "kind": "evaluation", "epsilon": 2},
}


@pytest.mark.parametrize("what", MALFORMED)
def test_what_no_game_can_be_is_refused_in_a_line_whatever_holds_it(what):
    line = MALFORMED[what]
    text = line if isinstance(line, str) else json.dumps(line)
    whole = compression.encode(json.dumps(GAME).encode() + b"\n")
    with pytest.raises(RecordError, match=r"^here is damaged after 1 games: .") as error:
        list(records.read(whole + compression.encode(text.encode() + b"\n"), HERE))
    assert len(str(error.value).splitlines()) == 1
    assert len(str(error.value)) < 500
    chance = json.dumps(GAME | {"rng": CHANCE}).encode() + b"\n"
    assert len(list(records.read(whole + compression.encode(chance), HERE))) == 2


def test_a_frame_that_unpacks_to_gigabytes_is_refused_before_it_has(tmp_path):
    zeros = zstandard.ZstdCompressor().compressobj()
    million = bytes(2**20)
    bomb = b"".join(zeros.compress(million) for _ in range(1024)) + zeros.flush()
    assert len(bomb) < 10**6
    tracemalloc.start()
    with pytest.raises(RecordError, match="a frame holds more than 67,108,864 bytes"):
        list(records.read(bomb, HERE))
    (tmp_path / compression.FILE).write_bytes(bomb)
    with pytest.raises(RunError, match=r"games\.jsonl\.zst is damaged: a frame holds more than"):
        compression.check(tmp_path, torn=True)
    _, most = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert most < 2**29


@pytest.mark.parametrize(
    ("changes", "record", "said"),
    [
        ({}, EpisodeRecord(31, b"", None), "no game begins after 31 idle frames"),
        ({"difficulty": 9}, EpisodeRecord(1, b"", None), "boxing has no difficulty 9"),
    ],
)
def test_a_game_that_cannot_be_set_up_is_refused(small, changes, record, said):
    with pytest.raises(RecordError, match=said):
        records.begin(small().model_copy(update=changes), record)
    records.begin(small(), EpisodeRecord(30, b"", None))


def test_a_run_whose_model_is_missing_does_not_verify(run, tmp_path, command):
    bad = tmp_path / "bad"
    shutil.copytree(run, bad)
    (bad / "model.safetensors").unlink()
    code, said, errors = command("verify", bad, "--episodes", 1)
    assert (code, said) == (1, "")
    assert f"{bad / 'model.safetensors'} is missing, and a complete run has one" in errors


def test_the_other_runs_are_verified_after_one_whose_records_cannot_be_played(
    run, tmp_path, command
):
    bad = tmp_path / "bad"
    shutil.copytree(run, bad)
    games = records.read_file(bad)
    games[0] = (games[0][0], replace(games[0][1], idle_frames=10**9))
    (bad / records.FILE).write_bytes(records.encode(games))
    code, said, errors = command("verify", bad, run)
    assert code == 1
    assert said == f"{run}: 9 of 9 games played again, all as the tables say\n"
    assert "no game begins after 1000000000 idle frames" in errors
    assert "games.jsonl.zst: " in errors
    assert "Traceback" not in errors
    assert "\n2 of 9 games" in "\n" + command("verify", run, "--episodes", 2)[1].split(": ")[1]


def test_evaluations_come_last_and_take_the_place_of_the_same_games():
    old, new = EpisodeRecord(2, bytes([4]), None), EpisodeRecord(3, bytes([5]), None)
    before = [(evaluated(10), old), (evaluated(1), old), *SOME]
    data = records.with_evaluations(before, [(evaluated(1), new), (evaluated(0, 3), new)])
    assert list(records.read(data, HERE)) == [
        *SOME,
        *((evaluated(1), new), (evaluated(10), old), (evaluated(0, 3), new)),
    ]


def test_checks_of_values_follow_their_games_whenever_another_process_has_done_them():
    one, two, check = SOME
    three = ({"kind": "training", "episode": 3}, EpisodeRecord(7, bytes([1]), None))
    late = records.with_evaluations([one, two, three, check], [])
    assert late == records.with_evaluations([one, two, check, three], [])
    assert list(records.read(late, HERE)) == [one, two, check, three]


def test_a_game_is_told_from_others_however_late_it_begins():
    games = [EpisodeRecord(idle, bytes([1, 2]), None) for idle in (1, 255, 256, 257, 600)]
    assert len({records.digest(game) for game in games}) == len(games)


SHORT = {"VALUES_PERIOD": 2, "VALUE_GAMES": 3, "HELD_OUT_STATES": 8}  # of the check of values


@pytest.fixture(autouse=True)
def short(monkeypatch):
    for name, value in SHORT.items():
        monkeypatch.setattr(params, name, value)
        monkeypatch.setattr(evaluation, name, value, raising=False)


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    """A run with sticky actions, two checks of values and two conditions of evaluation."""
    folder = tmp_path_factory.mktemp("recorded")
    more = {"episodes": 5, "sticky_actions": 0.25, "evaluation_difficulties": [0, 3]}
    run = Run(Parameters(**{**SMALL, **more, "max_game_frames": 300}), folder)
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("ATARI_DQN_STATE", str(folder / "state"))
        for name, value in SHORT.items():
            patch.setattr(params, name, value)
            patch.setattr(evaluation, name, value, raising=False)
        recorder.train(run)
    return run


@pytest.fixture
def run(trained, tmp_path):
    """A copy of it that may be changed."""
    shutil.copytree(trained.folder, tmp_path / "seed-1")
    return tmp_path / "seed-1"


def test_a_run_agrees_with_its_records(run):
    named = list(verify(run, None))
    assert sum(name.startswith("training") for name in named) == 5
    assert sum(name.startswith("evaluation") for name in named) == 4
    assert [name for name in named if "greedy" in name] == [
        *("the 3 greedy games after game 2", "the 3 greedy games after game 4")
    ]
    assert len(list(verify(run, 3))) == 3
    headings = [heading for heading, _ in records.read_file(run)]
    assert [h["episode"] for h in headings if h["kind"] == "training"] == [1, 2, 3, 4, 5]


def test_what_is_evaluated_later_is_on_record_too(run):
    evaluations.evaluate(run, {"difficulty": 2}, games=3)
    evaluations.evaluate(run, {"difficulty": 2}, games=3)
    kinds = [(h["kind"], h.get("difficulty")) for h, _ in records.read_file(run)]
    assert kinds.count(("evaluation", 2)) == 3
    assert len(list(verify(run, None))) == 5 + 4 + 3 + 2


def test_evaluations_stay_on_record_when_a_run_goes_on(tmp_path, small):
    """Also those of a process that evaluates while another trains, and whose training was killed
    in the middle of a line."""
    run = Run(small(episodes=2), tmp_path)
    recorder.train(run)
    evaluations.evaluate(run.folder, {"difficulty": 1}, games=1)
    longer = Run(small(episodes=4), tmp_path)
    log = recorder.Recorder.log

    def evaluate_meanwhile(self, episode):
        log(self, episode)
        if episode.episode == 3:
            evaluations.evaluate(run.folder, {"difficulty": 2}, games=1)
            with (run.folder / records.FILE).open("ab") as file:
                file.write(b"(\xb5/\xfd half a game")
            raise KeyboardInterrupt

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(recorder.Recorder, "log", evaluate_meanwhile)
        with pytest.raises(KeyboardInterrupt):
            recorder.train(longer)
    recorder.train(longer)
    kinds = [name.split()[0] for name in verify(run.folder, None)]
    assert (kinds.count("training"), kinds.count("evaluation")) == (4, 2 + 2 + 1 + 1)


@pytest.mark.parametrize(
    ("file", "row", "column", "said"),
    [
        (
            "episodes.csv",
            3,
            "score",
            r"training game \(episode 4\): score is .* in .*/episodes.csv",
        ),
        (
            "episodes.csv",
            0,
            "length",
            r"training game \(episode 1\): length is .* in .*/episodes.csv",
        ),
        (
            "episodes.csv",
            2,
            "frames",
            r"training game \(episode 3\): frames is .* in .*/episodes.csv",
        ),
        ("evaluations.csv", 1, "score", r"evaluation game .*game 1\): score is .*/evaluations.csv"),
        ("evaluations.csv", 3, "frames", r"evaluation game .*difficulty 3.*: frames is"),
        ("evaluations.csv", 0, "conceded", r"evaluation game .*game 0\): conceded is"),
        ("evaluations.csv", 2, "distance", r"evaluation game .*difficulty 3.*: distance is"),
        ("values.csv", 1, "score", r"the 3 greedy games after game 4: score is .* in .*values.csv"),
        (
            "values.csv",
            0,
            "realised",
            r"the 3 greedy games after game 2: realised is .*/values.csv",
        ),
    ],
)
def test_one_point_more_in_a_table_is_found(run, file, row, column, said):
    table = pd.read_csv(run / file)
    table.loc[row, column] += 1
    table.to_csv(run / file, index=False)
    with pytest.raises(Difference, match=said):
        list(verify(run, None))


def rewrite(run, file, change):
    table = pd.read_csv(run / file)
    change(table).to_csv(run / file, index=False)


def without(run, wanted):
    """Takes games off the record."""
    kept = [game for game in records.read_file(run) if not wanted(game[0])]
    (run / records.FILE).write_bytes(records.encode(kept))


def last_two(run, table, column, value):
    """A second row of the last game, with another number, before the true one."""
    return pd.concat([table[:-1], table[-1:].assign(**{column: value}), table[-1:]])


LACKING = {
    "a row of training": (
        lambda run: rewrite(run, "episodes.csv", lambda table: table[:-1]),
        r"episodes.csv, line 6: missing, since status.json says 5 games",
    ),
    "a game of training": (
        lambda run: without(run, lambda heading: heading.get("episode") == 3),
        r"games.jsonl.zst has 0 games, not 1, of training game \(episode 3\) in episodes.csv",
    ),
    "a row in the middle": (
        lambda run: rewrite(run, "episodes.csv", lambda table: table.replace({"episode": 3}, 6)),
        r"episodes.csv, line 4: episode 6 should be 3",
    ),
    "a check of values": (
        lambda run: rewrite(run, "values.csv", lambda table: table[:1]),
        r"values.csv, line 3: missing, since episodes.csv has 5 games",
    ),
    "a game behind a check of values": (
        lambda run: without(run, lambda heading: heading.get("game") == 7),
        r"has 2 games, not 3, of values game \(episode 2\) in values.csv",
    ),
    "a row of the evaluation": (
        lambda run: rewrite(run, "evaluations.csv", lambda table: table[1:]),
        r"evaluations.csv, line 2: game 1 should be 0",
    ),
    "the evaluation": (
        lambda run: (run / "evaluations.csv").unlink(),
        r"evaluations.csv is missing, and a complete run has one",
    ),
    "everything": (
        lambda run: (
            [rewrite(run, name, lambda table: table[:0]) for name in ("episodes.csv", "values.csv")]
            and (run / records.FILE).write_bytes(b"")
        ),
        r"episodes.csv, line 2: missing, since status.json says 5 games",
    ),
    "one row's uniqueness": (
        lambda run: rewrite(run, "episodes.csv", lambda t: last_two(run, t, "score", 99)),
        r"episodes.csv, line 7: episode 5 should be 6",
    ),
    "an evaluation's uniqueness": (
        lambda run: rewrite(run, "evaluations.csv", lambda t: last_two(run, t, "score", 99)),
        r"evaluations.csv, line 6: game 1 should be 2",
    ),
    "the parameters it was trained with": (
        lambda run: (run / "params.yaml").write_text(
            (run / "params.yaml").read_text().replace("gamma: 0.99", "gamma: 0.98")
        ),
        r"params.yaml is not what provenance.json says of the run",
    ),
    "a row of an evaluation that was broken off": (
        lambda run: (run / records.FILE).write_bytes(
            records.with_evaluations(records.read_file(run), [(evaluated(0), SOME[0][1])])
        ),
        r"evaluation game \(trained_games 2.*is on record, but not in .*; `evaluate` with the same",
    ),
}


@pytest.mark.parametrize("what", LACKING)
def test_a_complete_run_that_lacks_something_is_found(run, what):
    """However few of its games are played again."""
    spoil, said = LACKING[what]
    spoil(run)
    with pytest.raises(RunError, match=said):
        list(verify(run, 1))


DAMAGED = {
    "no number": (
        *("episodes.csv", lambda text: text.replace("\n1,", "\n1x,")),
        r"episodes\.csv, line 2: episode: '1x' should be a whole number",
    ),
    "a conflict": (
        "episodes.csv",
        lambda text: "<<<<<<< HEAD\n" + text,
        r"episodes\.csv, line 1: '<<<<<<< HEAD' should be the header episode,agent_steps",
    ),
    "nothing": ("values.csv", lambda text: "", r"values\.csv, line 1: '' should be the header"),
    "half a line": (
        *("evaluations.csv", lambda text: text[:-2]),
        r"evaluations\.csv, line 5: '.*' is cut short",
    ),
    "no status": ("status.json", lambda text: text[:-5], r"status\.json is missing or damaged"),
}


@pytest.mark.parametrize("what", DAMAGED)
def test_a_damaged_table_is_named(run, what):
    file, spoil, said = DAMAGED[what]
    (run / file).write_text(spoil((run / file).read_text()))
    with pytest.raises(RunError, match=said):
        list(verify(run, 1))


def test_records_that_lack_their_chance_are_refused(small):
    for sticky, rng in ((0.25, None), (0.0, RNG)):
        with pytest.raises(RecordError, match=f"sticky_actions is {sticky}"):
            list(records.replay(small(sticky_actions=sticky), EpisodeRecord(1, b"", rng)))


def test_an_evaluation_is_not_played_for_a_damaged_file(run, monkeypatch):
    data = (run / records.FILE).read_bytes()
    (run / records.FILE).write_bytes(data[:-5])
    monkeypatch.setattr(evaluation, "play", None)
    with pytest.raises(RecordError, match=rf"{run}/games.jsonl.zst is damaged after"):
        evaluations.evaluate(run, {"difficulty": 1}, games=1)


class Killed(BaseException):
    pass


@pytest.mark.parametrize(
    ("call", "method"),
    [(1, "_append"), (3, "_append"), (4, "_append"), (3, "_record"), (5, "_append"), (2, "save")],
)
def test_a_run_killed_between_two_writes_verifies_before_and_after_it_goes_on(
    tmp_path, small, monkeypatch, call, method
):
    """In the second game too, after which values are checked, or as its checkpoint is due."""
    run, calls = Run(small(episodes=2, max_game_frames=200, evaluation_games=1), tmp_path), []
    write = getattr(recorder.Recorder, method)

    def killed(self, *arguments):
        calls.append(arguments)
        if len(calls) == call:
            raise Killed
        return write(self, *arguments)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(recorder.Recorder, method, killed)
        with pytest.raises(Killed):
            recorder.train(run)
    assert len(list(verify(run.folder, None))) <= 3
    recorder.train(run)
    assert len(list(verify(run.folder, None))) == 2 + 1 + 1


def test_half_a_game_at_the_end_is_allowed_while_a_run_goes_on(run):
    with (run / records.FILE).open("ab") as file:
        file.write(compression.encode(bytes(range(200)))[:-9])
    with pytest.raises(RecordError, match="is damaged after"):
        list(verify(run, 1))
    status = (run / "status.json").read_text()
    (run / "status.json").write_text(status.replace("complete", "running"))
    assert len(list(verify(run, 1))) == 1
    path = run / records.FILE
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 1
    path.write_bytes(data)
    with pytest.raises(RunError, match=f"{path} is damaged"):
        list(verify(run, 1))


def test_a_run_that_comes_back_from_its_checkpoint_verifies(tmp_path, small):
    """Evaluations are gone with its folder, from the tables and the records alike."""
    run = Run(small(episodes=1), tmp_path)
    recorder.train(run)
    evaluations.evaluate(run.folder, {"difficulty": 1}, games=1)
    longer = Run(small(episodes=2), tmp_path)
    recorder.train(longer)
    shutil.rmtree(run.folder)
    recorder.train(longer)
    assert len(list(verify(run.folder, None))) == 2 + small().evaluation_games + 1


def test_an_action_that_the_cartridge_lacks_is_refused(small):
    with pytest.raises(RecordError, match="breakout has no action 9"):
        list(records.replay(small(game="breakout"), EpisodeRecord(1, bytes([2, 9]), None)))


@pytest.fixture
def command(monkeypatch, capsys):
    """Runs the command line here; returns its exit code and what it wrote to stdout and stderr."""

    def call(*arguments):
        monkeypatch.setattr(sys, "argv", ["atari_dqn", *map(str, arguments)])
        with pytest.raises(SystemExit) as ended:
            __main__.main()
        return ended.value.code, *capsys.readouterr()

    return call


def test_the_command_line_verifies_replays_and_makes_videos(run, tmp_path, command):
    video = tmp_path / "game.mp4"
    code, said, _ = command("replay", run, "--episode", 2, "--video", video)
    assert code == 0
    row = pd.read_csv(run / "episodes.csv").loc[1]
    assert f"game 2: {row.score:g} points, {row.length:.0f} agent steps" in said
    assert video.read_bytes()[4:8] == b"ftyp"
    code, said, _ = command("verify", run, run)
    assert code == 0
    assert said == f"{run}: 9 of 9 games played again, all as the tables say\n" * 2
    assert command("verify", run, "--all", "--episodes", 2)[0] == 2
    rewrite(run, "episodes.csv", lambda table: table.assign(score=table.score - (table.index == 1)))
    code, _, errors = command("verify", run)
    assert code == 1
    assert errors.splitlines()[-1].startswith("error: training game (episode 2): score is")
    code, _, errors = command("replay", run, "--episode", 77)
    assert code == 1
    assert "has no training game 77; it has 1 to 5" in errors


def test_the_records_of_a_long_run_are_small():
    """3,000 training games are less than 3 MB, whatever an agent does."""
    rng = np.random.default_rng(0)

    def game(number):
        actions = bytes(rng.integers(18, size=1785).tolist())
        return {"kind": "training", "episode": number}, EpisodeRecord(17, actions, None)

    data = records.with_evaluations([game(number) for number in range(1, 201)], [])
    assert len(data) / 200 * 3000 < 3e6
    while_training = records.encode([game(1)])
    assert len(while_training) * 3000 < 4e6


def test_an_unplayed_game_has_an_empty_record():
    game = AtariEnv("boxing")
    game.reset(seed=0)
    assert game.played().actions == b""
    assert 1 <= game.played().idle_frames <= 30
