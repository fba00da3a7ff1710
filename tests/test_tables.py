"""Damaged tables: they are named by file and line, and cost nothing but their own run."""

import json
import os
import re
import shutil
from dataclasses import fields
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from conftest import SMALL
from synthetic import AGENTS, evaluate, store, study, style

from atari_dqn import evaluation, params
from atari_dqn.params import Parameters
from atari_dqn.report import build, catalogue, cost, notebook
from atari_dqn.report.explorer import StoredAgents
from atari_dqn.runs import compression, evaluations, plan, recorder, records, tables, weights
from atari_dqn.runs.files import RunError
from atari_dqn.runs.robustness import Trial
from atari_dqn.runs.run import Run
from atari_dqn.runs.styles import Boxing, Breakout

ROOT = Path(__file__).parents[1]
SHORT = {"VALUES_PERIOD": 2, "VALUE_GAMES": 1, "HELD_OUT_STATES": 8}  # of the check of values
TABLES = (*tables.GROWING, tables.EVALUATIONS)
DQN, DOUBLE, _ = AGENTS


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    """A complete run of five games, with two checks of values and two conditions of evaluation."""
    folder = tmp_path_factory.mktemp("trained")
    more = {"episodes": 5, "evaluation_difficulties": [0, 3]}
    run = Run(Parameters.model_validate({**SMALL, **more}), folder)
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("ATARI_DQN_STATE", str(folder / "state"))
        for name, value in SHORT.items():
            patch.setattr(params, name, value)
            patch.setattr(evaluation, name, value, raising=False)
        recorder.train(run, None)
    return run


@pytest.fixture(params=["complete", "interrupted"])
def run(request, trained, tmp_path, monkeypatch):
    """A copy of it, or of the same as if it had been stopped."""
    for name in ("VALUES_PERIOD", "VALUE_GAMES"):
        monkeypatch.setattr(params, name, SHORT[name])
    copy = Run(trained.params, tmp_path)
    shutil.copytree(trained.folder, copy.folder)
    say(copy, state=request.param)
    return copy


def say(run, **what):
    path = run.folder / "status.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | what))


def complete(run):
    return run.status()["state"] == "complete"


def with_letter(line):
    """In the number before its last digit."""
    return re.sub(r"(\d)(?!.*\d)", r"x\1", line)


# What is done to the lines of a table, header and first row first, and the line that is then named
DAMAGE = {
    "a repeated row": (lambda head, one, *rest: [head, one, one, *rest], 3),
    "a missing row": (lambda head, one, *rest: [head, *rest], 2),
    "a swapped pair": (lambda head, one, two, *rest: [head, two, one, *rest], 2),
    "a letter in a number": (lambda head, one, *rest: [head, with_letter(one), *rest], 2),
    "a number too large": (lambda head, one, *rest: [head, "9" * 400 + one, *rest], 2),
    "nothing for a number": (lambda head, one, *rest: [head, one[one.index(",") :], *rest], 2),
    "a field more": (lambda head, one, two, *rest: [head, one, two + ",1", *rest], 3),
    "a field less": (lambda head, one, *rest: [head, one.rpartition(",")[0], *rest], 2),
    "an empty line": (lambda head, one, *rest: [head, "", one, *rest], 2),
    "a header of another version": (lambda head, *rest: [head.replace(",", ",new,", 1), *rest], 1),
    "no header": (lambda head, *rest: rest, 1),
    "a header alone": (lambda head, *rest: [head], 2),
    "lines of another system": (lambda *lines: [line + "\r" for line in lines], 1),
}


@pytest.mark.parametrize("what", DAMAGE)
@pytest.mark.parametrize("name", TABLES)
def test_damage_is_named_by_file_and_line(run, name, what):
    assert tables.damage(run) == ""
    spoil, line = DAMAGE[what]
    path = run.folder / name
    path.write_text("\n".join([*spoil(*path.read_text().splitlines()), ""]), newline="")
    said = tables.damage(run)
    assert said.startswith(f"{path}, line {line}: ")
    assert len(said.splitlines()) == 1
    with pytest.raises(RunError, match=re.escape(said)):
        tables.check(run.folder)


@pytest.mark.parametrize(("order", "line"), [((3, 0), 4), ((0, 3, 0), 6)])
def test_evaluations_under_settings_out_of_their_order_are_named(run, order, line):
    path = run.folder / tables.EVALUATIONS
    head, *rows = path.read_text().splitlines(keepends=True)
    under = {0: rows[:2], 3: rows[2:]}  # by difficulty
    path.write_text("".join([head, *(row for each in order for row in under[each])]))
    said = tables.damage(run)
    assert said.startswith(f"{path}, line {line}: should be above: rows are sorted by ")


@pytest.mark.parametrize("data", [b"", b"\0" * 100, bytes(range(256)) * 9, b"\xff\xfe", b"\n"])
@pytest.mark.parametrize("name", TABLES)
def test_what_is_no_table_at_all_is_named(run, name, data):
    (run.folder / name).write_bytes(data)
    said = tables.damage(run)
    assert said.startswith(f"{run.folder / name}, line 1: ")
    assert said.isprintable()
    assert len(said) < 600


def cuts(data):
    """Where a file is cut: at the end of every line, and at any byte."""
    ends = {place for place, byte in enumerate(data, 1) if byte == 10} - {len(data)}
    return sorted(ends | {*np.random.default_rng(1).integers(len(data), size=8).tolist()})


@pytest.mark.parametrize("name", TABLES)
def test_a_table_that_is_cut_anywhere_passes_for_whole_in_no_complete_run(run, name):
    """In one that is not, its first rows are there, or it is named too."""
    path = run.folder / name
    data, whole = path.read_bytes(), tables.read(run.folder, name)
    for place in cuts(data):
        path.write_bytes(data[:place])
        if complete(run):
            assert tables.damage(run).startswith(f"{path}, line "), place
            continue
        left, said = rows_or_error(run, name)
        if left is None:
            assert said.startswith(f"{path}, line "), place
        else:
            rows = data[:place].count(b"\n") - 1
            assert left.equals(whole[:rows].astype(left.dtypes)), place


def rows_or_error(run, name):
    try:
        return tables.read(run.folder, name), ""
    except RunError as error:
        return None, str(error)


@pytest.mark.parametrize("name", tables.GROWING)
def test_half_a_line_is_left_out_while_the_run_is_not_complete(run, name):
    path = run.folder / name
    rows = tables.read(run.folder, name)
    with path.open("a") as file:
        file.write("6,7")
    if complete(run):
        assert f"{path}, line {len(rows) + 2}: '6,7' is cut short" in tables.damage(run)
    else:
        assert tables.damage(run) == ""
        assert tables.read(run.folder, name).equals(rows)


def test_evaluations_are_never_half_a_line(run):
    """They are replaced as a whole."""
    path = run.folder / tables.EVALUATIONS
    path.write_text(path.read_text() + "7")
    assert tables.damage(run) == f"{path}, line 6: '7' is cut short, without a new line"


def test_games_that_another_table_tells_of_are_missed(run):
    path = run.folder / tables.EPISODES
    lines = path.read_text().splitlines(keepends=True)
    path.write_text("".join(lines[:4]))
    why = "status.json says 5 games" if complete(run) else "timing.csv tells of game 5"
    assert tables.damage(run) == f"{path}, line 5: missing, since {why}"


def test_a_game_more_than_a_complete_run_has_is_one_too_many(run):
    say(run, episodes_done=4)
    said = f"{run.folder / tables.EPISODES}, line 6: one too many, since status.json says 4 games"
    assert tables.damage(run) == (said if complete(run) else "")


def test_what_training_is_about_to_write_is_not_missed(run):
    """After a game its time, and now and then a check of values."""
    for name in (tables.TIMING, tables.VALUES):
        path = run.folder / name
        path.write_text("".join(path.read_text().splitlines(keepends=True)[:-1]))
    assert bool(tables.damage(run)) == complete(run)


def test_a_run_that_moves_on_between_two_looks_is_not_damaged(run, monkeypatch):
    read, path = tables.read, run.folder / tables.TIMING
    whole = path.read_text()
    path.write_text("".join(whole.splitlines(keepends=True)[:2]))

    def written(seconds):
        path.write_text(whole)

    monkeypatch.setattr(tables.time, "sleep", written)
    assert bool(tables.damage(run)) == complete(run)
    assert len(read(run.folder, tables.TIMING)) == (1 if complete(run) else 5)


@pytest.mark.parametrize("text", ["", "[]", "{}", '{"state": "complete"}', "[" * 100_000])
@pytest.mark.parametrize("name", ["status.json", "provenance.json"])
def test_a_file_that_does_not_say_what_it_should_is_named(run, name, text):
    (run.folder / name).write_text(text)
    assert tables.damage(run).startswith(f"{run.folder / name} is missing or damaged (")


def test_the_columns_are_those_that_are_written():
    written = {
        **recorder.LOGS,
        tables.EVALUATIONS: [*evaluation.PLAYED_COLUMNS, "trained_games"],
        tables.STYLES["boxing"]: [field.name for field in fields(Boxing)],
        tables.STYLES["breakout"]: [field.name for field in fields(Breakout)],
        tables.ROBUSTNESS: [field.name for field in fields(Trial)],
    }
    assert {name: list(columns) for name, columns in tables.COLUMNS.items()} == written


@pytest.mark.parametrize("folder", sorted((ROOT / "results" / "runs").glob("*/*/seed-*")))
def test_the_runs_of_this_repository_are_whole(folder):
    tables.check(folder)


def test_numbers_are_read_to_the_last_digit(run):
    path = run.folder / tables.EVALUATIONS
    texts = [line.split(",")[12] for line in path.read_text().splitlines()[1:]]
    assert tables.read(run.folder, path.name).distance.tolist() == [float(text) for text in texts]


# ---- What else there is goes on ------------------------------------------------------------------


def cut(path, line=40):
    """Cuts a table in the middle of a line."""
    lines = path.read_text().splitlines(keepends=True)
    path.write_text("".join(lines[: line - 1]) + lines[line - 1][:5])


@pytest.fixture
def two(tmp_path):
    """Two complete runs of `boxing_final`, the first of which is damaged, and what is said."""
    bad, good = (store(tmp_path, "boxing_final", agent, np.ones(3000)) for agent in (DQN, DOUBLE))
    for run in (bad, good):
        evaluate(run)
    cut(bad.folder / tables.EPISODES)
    return bad, good, f"{bad.folder / tables.EPISODES}, line 40: "


def test_a_section_leaves_a_damaged_run_out_and_names_it(two, shown):
    bad, good, said = two
    found = study(good.results)
    section = found["boxing_final"]
    assert section.usable == section.stored == [good]
    assert set(section.episodes.agent) == set(section.evaluations.agent) == {DOUBLE}
    assert not section.complete
    assert section.damaged[bad.name].startswith(said)
    assert found.stored == [good]
    assert found.damaged == section.damaged
    notebook.show_badge(section)
    (text,) = shown.texts
    assert "**1 of 3 runs complete**" in text
    where = f"results/runs/{bad.name}/episodes.csv, line 40: "
    assert f"{bad.name} is damaged and not shown: `{where}'39,97' is cut short" in text
    cost.show_hours(found)
    assert shown.texts[-1].startswith("The 1 stored runs took 30.0 wall-clock hours")


def test_a_section_of_damaged_runs_alone_does_not_pass_for_one_that_has_not_begun(two, shown):
    _, good, _ = two
    cut(good.folder / tables.TIMING)
    notebook.show_badge(study(good.results)["boxing_final"])
    assert "**Nothing to show** of 3 runs of 3,000 games." in shown.texts[0]
    assert shown.texts[0].count("is damaged and not shown") == 2


def test_status_says_what_is_wrong_with_a_run_and_shows_the_others(two):
    bad, good, said = two
    table = plan.status([bad, good])
    assert table.state[0].startswith(f"damaged ({said}")
    assert (table.games.tolist(), table.state[1], table.score[1]) == ([0, 3000], "complete", 1.0)


def test_stored_runs_are_those_that_can_be_read_and_the_others_are_named(two, shown):
    bad, good, said = two
    assert [run.folder for run in plan.stored("full", [], good.results)] == [good.folder]
    (line,) = plan.damaged("full", [], good.results)
    assert line.startswith(said)
    notebook.show_damaged("full", good.results)
    assert f"- `results/runs/{bad.name}/episodes.csv, line 40: " in shown.texts[-1]
    cut(good.folder / tables.EPISODES)
    with pytest.raises(RunError, match=f"no agent is stored in .*; left out: {said}"):
        StoredAgents("full", good.results)


def test_the_list_of_agents_names_a_damaged_run(two):
    _, good, _ = two
    catalogue.write("full", good.results, good.results)
    last = (good.results / "README.md").read_text().splitlines()[-1]
    assert last.startswith("Left out, since it cannot be read: `results/runs/boxing_final/dqn/")


def test_the_report_measures_nothing_of_a_damaged_run(two, monkeypatch):
    _, good, _ = two
    measured = []
    monkeypatch.setattr(build.robustness, "measure", measured.append)
    build._measure("full", good.results)
    assert good.folder in [run.folder for run in measured]
    assert len(measured) == 5, "of six"


def test_a_report_names_a_damaged_run_and_goes_on(two, monkeypatch):
    def sections(*_):
        raise RunError("the sections are executed")

    bad, good, said = two
    (good.folder / "provenance.json").write_text("{")
    path = bad.folder / "provenance.json"
    path.write_text(path.read_text().replace("2026-01", "2026-02"))
    monkeypatch.setattr(build, "_measure", lambda *_: None)
    monkeypatch.setattr(build, "_execute", sections)
    with (
        pytest.warns(UserWarning, match="; left out$") as warned,
        pytest.raises(RunError, match="the sections are executed"),
    ):
        build.build("full", good.results)
    lines = [str(each.message) for each in warned]
    assert [line.startswith(said) for line in lines] == [True, False]
    assert "provenance.json is missing or damaged" in lines[1]
    assert build._moment(good.results).month == 2


def tried(run):
    """Gives a run what `robustness.measure` writes."""
    run.robustness.parent.mkdir(parents=True)
    trials = pd.DataFrame([Trial("sequence", 7, 1.0, 90, 300), Trial("mirrored", 0, 2.0, 90, 300)])
    trials.to_csv(run.robustness, index=False)
    return run.robustness


def styled(run):
    style(run, np.ones(3))
    return run.styles


@pytest.mark.parametrize("measured", [styled, tried])
@pytest.mark.parametrize("damage", ["a letter", "a repeated row"])
def test_a_damaged_file_beside_a_run_is_named_with_its_remedy(tmp_path, measured, damage):
    run = store(tmp_path, "boxing_final", DQN, np.ones(300))
    path = measured(run)
    assert tables.damage(run) == ""
    head, first, *rest = path.read_text().splitlines(keepends=True)
    first = first + first if damage == "a repeated row" else "x" + first
    path.write_text("".join([head, first, *rest]))
    said = tables.damage(run)
    assert said.startswith(f"{path}, line {3 if damage == 'a repeated row' else 2}: ")
    assert said.endswith("; without the file, `report` measures it again")


def test_no_game_is_played_for_a_damaged_table_of_evaluations(run, monkeypatch):
    path = run.folder / tables.EVALUATIONS
    path.write_text(path.read_text().replace("\n0,", "\n1,", 1))
    monkeypatch.setattr(evaluations.evaluation, "play", None)
    with pytest.raises(RunError, match=r"evaluations.csv, line 2: game 1 should be 0"):
        evaluations.evaluate(run.folder, {}, games=1)


def test_a_run_without_its_checkpoint_is_refused_whatever_its_table_holds(run):
    if complete(run):
        return
    (run.folder / tables.EPISODES).write_bytes(b"\xff\n\xff\n")
    with pytest.raises(RunError, match="holds 1 games, but their checkpoint is not in"):
        recorder.train(run, None)


def test_runs_are_read_into_one_table_with_whose_rows_they_are(two):
    _, good, _ = two
    other = store(good.results, "boxing_final", DOUBLE, np.zeros(7), seed=2)
    table = tables.of_runs([good, other], tables.EPISODES)
    assert table.groupby("seed").size().to_dict() == {1: 3000, 2: 7}
    assert set(table.experiment) == {"boxing_final"}
    assert isinstance(tables.of_runs([], tables.EPISODES), pd.DataFrame)


def test_a_run_that_just_begins_has_nothing_that_could_be_damaged(small, tmp_path):
    run = Run(small(), tmp_path)
    run.folder.mkdir(parents=True)
    with run.lock():
        assert run.state() == "running"
        assert tables.damage(run) == ""


@pytest.mark.parametrize("name", ["model.safetensors", "games.jsonl.zst"])
@pytest.mark.parametrize("place", [0.3, 0.9])
def test_a_run_with_a_flipped_bit_in_a_binary_file_is_damaged(run, name, place):
    path = run.folder / name
    data = bytearray(path.read_bytes())
    data[int(place * len(data))] ^= 4
    path.write_bytes(data)
    assert tables.damage(run).startswith(f"{path} is damaged: ")


def test_a_model_that_is_damaged_after_it_was_checked_is_found(run):
    assert tables.damage(run) == ""
    path = run.folder / "model.safetensors"
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 4
    path.write_bytes(data)
    assert tables.damage(run).startswith(f"{path} is damaged: ")


def test_half_a_game_at_the_end_of_the_records_is_damage_in_a_complete_run_only(run):
    path = run.folder / compression.FILE
    frame = compression.encode(bytes(range(200)))
    path.write_bytes(path.read_bytes() + frame[: len(frame) // 2])
    fault = f"{path} is damaged: the last game is cut short" if run.state() == "complete" else ""
    assert tables.damage(run) == fault


@pytest.mark.parametrize("name", [*TABLES, "model.safetensors", compression.FILE])
def test_a_file_that_a_run_lacks_is_named(run, name):
    """In one that goes on, values, evaluations and the model may be still to come."""
    (run.folder / name).unlink()
    said = tables.damage(run)
    if complete(run) or name in (tables.EPISODES, tables.TIMING, compression.FILE):
        assert said.startswith(f"{run.folder / name} is missing, ")
        assert len(said.splitlines()) == 1
    else:
        assert said == ""


@pytest.mark.parametrize("kept", [0, 10])
def test_records_of_fewer_games_than_the_tables_tell_of_are_named(run, kept):
    path, games = run.folder / compression.FILE, records.read_file(run.folder)
    assert len(games) == 5 + 2 + 4
    path.write_bytes(records.encode(games[:kept]) if kept else b"")
    assert tables.damage(run) == f"{path} holds {kept} games, and the tables tell of 11"
    path.write_bytes(records.encode([*games, games[0]]))
    assert tables.damage(run) == "", "a game whose row is about to be written"


def test_the_model_of_a_complete_run_is_that_of_its_last_game(run):
    path = run.folder / "model.safetensors"
    path.write_bytes(weights.pack(weights.read(path), 4))
    said = f"{path} is of 4 games, and status.json says 5"
    assert tables.damage(run) == (said if complete(run) else "")


# What is written into the second row of a table, by column
IMPOSSIBLE = [
    *((tables.EPISODES, "frames", value) for value in ("-1", "0", "1")),
    *((tables.EPISODES, "length", value) for value in ("0", "-5", "9999")),
    *((tables.EPISODES, "epsilon", value) for value in ("1.5", "-0.1", "2e-1x")),
    *((tables.EPISODES, "score", value) for value in ("inf", "nan", "1e400", "1e+99")),
    *((tables.EPISODES, "agent_steps", value) for value in ("1", "-3")),
    *((tables.TIMING, name, "0") for name in ("seconds", "cpu_seconds")),
    *((tables.EVALUATIONS, name, "-1") for name in ("length", "frames", "epsilon", "seed")),
    (tables.EVALUATIONS, "length", "0"),
]


@pytest.mark.parametrize(("name", "column", "value"), IMPOSSIBLE)
def test_a_number_that_no_game_can_have_is_named_by_its_line(run, name, column, value):
    path = run.folder / name
    head, one, two, *rest = path.read_text().splitlines()
    fields = two.split(",")
    fields[head.split(",").index(column)] = value
    path.write_text("\n".join([head, one, ",".join(fields), *rest, ""]))
    above = "frames" if column == "length" and value == "9999" else column
    assert tables.damage(run).startswith(f"{path}, line 3: {above}")


def test_parameters_of_another_agent_are_named(run):
    path = run.folder / params.STORED
    path.write_text(path.read_text().replace('["double_dqn"]', '["dqn"]', 1))
    said = f"{path}: agents: ['dqn'] should be ['double_dqn'], as its folder says"
    assert tables.damage(run) == said


@pytest.mark.parametrize("make", [Path.mkdir, os.mkfifo])
@pytest.mark.parametrize(
    "name", ["status.json", "provenance.json", *TABLES, "model.safetensors", compression.FILE]
)
def test_a_folder_or_a_pipe_in_the_place_of_a_file_is_named_at_once(run, name, make):
    path = run.folder / name
    path.unlink()
    make(path)
    assert tables.damage(run) == f"{path}: must be a regular file"
    build._snapshot(run.results)


def test_a_check_of_styles_that_lacks_a_game_is_not_shown(tmp_path):
    run = store(tmp_path, "boxing_final", DQN, np.ones(300))
    path = styled(run)
    assert set(study(tmp_path)["boxing_final"].styles.episode) == {100, 200, 300}
    lines = path.read_text().splitlines(keepends=True)
    lines.pop(1 + params.VALUE_GAMES)  # the second check's first game
    path.write_text("".join(lines))
    assert set(study(tmp_path)["boxing_final"].styles.episode) == {100, 300}
    style(run, np.ones(3), greedy=params.VALUE_GAMES - 1)  # of every check the same game is lacking
    assert study(tmp_path)["boxing_final"].styles.empty


def test_a_table_that_is_changed_by_who_has_read_it_is_whole_for_the_next(run):
    table = tables.read(run.folder, tables.EPISODES)
    table["score"] = -1.0
    assert (tables.read(run.folder, tables.EPISODES).score != -1.0).any()
