"""The widgets of explore.ipynb, driven as a person's clicks would drive them."""

import asyncio
import io

import numpy as np
import pytest
from conftest import SMALL
from PIL import Image

from atari_dqn import params
from atari_dqn.analysis.study import Section
from atari_dqn.report import explorer as module
from atari_dqn.report.explorer import NEW, UNCHANGED, Curves, Explorer, StoredAgents, interactive
from atari_dqn.runs import recorder, records
from atari_dqn.runs.files import RunError
from atari_dqn.runs.run import Run


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    """Two agents of one experiment, and one that plays another game."""
    folder = tmp_path_factory.mktemp("results")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("ATARI_DQN_STATE", str(folder / "state"))
        for changes in (
            {"agents": ["dqn"], "seeds": [2], "snapshot_games": [1]},
            {"agents": ["dueling_double_dqn"]},
            {"agents": ["dqn"], "experiment": "other+0123abcd", "game": "breakout"},
        ):
            recorder.train(Run(params.Parameters(**{**SMALL, **changes}), folder))
    (folder / "runs" / "small" / "dqn" / "seed-2.1").mkdir()  # kept aside
    (folder / "runs" / "small" / "dqn" / "seed-2.1" / "model.safetensors").write_bytes(b"")
    return folder


@pytest.fixture
def panel(results):
    return Explorer("smoke", results, "small", "dqn", 2)


def shown(panel):
    return np.asarray(Image.open(io.BytesIO(panel.picture.value)))


def options(dropdown):
    return [name for name, _ in dropdown.options]


def test_what_is_stored_is_offered_and_what_was_asked_for_is_opened(panel):
    assert options(panel.run[0]) == ["other: +0123abcd", "small"]
    assert [choice.value for choice in panel.run] == ["small", "dqn", 2]
    assert options(panel.run[1]) == ["DQN", "Dueling Double DQN"]
    assert options(panel.checkpoint) == ["3 games", "1 games"]
    assert options(panel.kind) == ["training", "evaluation", "new, greedy"]
    assert (panel.number.value, panel.number.max) == (3, 3)
    assert panel.facts.value.startswith("training game 3: step 0 of 29; best action ")
    assert options(panel.other) == ["Dueling Double DQN (small, seed 1)", "DQN (small, seed 2)"]
    assert panel.count.value == "of 3: training game 3"
    panel.run[0].value = "other: +0123abcd"
    assert [choice.value for choice in panel.run] == ["other: +0123abcd", "dqn", 1]


def test_what_a_game_is_played_on_with_is_of_the_opened_one_whatever_is_chosen(panel):
    choices = (panel.difficulty, panel.clock, panel.other)
    before = [options(choice) for choice in choices]
    panel.run[0].value = "other: +0123abcd"
    assert [options(choice) for choice in choices] == before
    panel.open.click()
    assert options(panel.clock) == [UNCHANGED], "a game without one"
    assert options(panel.difficulty) == [UNCHANGED, "0", "1"]
    assert options(panel.other) == ["DQN (other: +0123abcd, seed 1)"]


def test_the_slider_shows_the_recorded_steps(panel, results):
    run = Run(params.Parameters(**{**SMALL, "agents": ["dqn"], "seeds": [2]}), results)
    panel.number.value = 2
    panel.open.click()
    (record,) = (
        record
        for heading, record in records.read_file(run.folder)
        if heading == {"kind": "training", "episode": 2}
    )
    screens = [game.render().copy() for game in records.replay(run.params, record)]
    assert panel.moment.max == panel.player.max == len(screens) - 1
    for step in (0, 17, len(screens) - 1):
        panel.moment.value = step
        assert (panel.games[0].screen(step) == screens[step]).all()
        assert f"training game 2: step {step} of {len(screens) - 1};" in panel.facts.value
    before = shown(panel)
    panel.moment.value = 3
    assert (shown(panel) != before).any()
    name = panel.games[0].names[record.actions[3]].lower()
    assert f"played {name[:2]}" in panel.facts.value


def test_evaluation_games_are_played_under_their_own_conditions(panel):
    panel.kind.value = "evaluation"
    panel.open.click()
    said = "evaluation game 1 after 3 training games (difficulty 0, sticky actions 0"
    assert said in panel.facts.value, "the first that is played as the agent was trained"
    assert said in panel.count.value
    panel.number.value = panel.number.max
    assert said not in panel.count.value, "a game of the last condition"
    assert panel.message.value == ""


def test_another_network_may_judge_the_game(panel):
    panel.moment.value = 9
    before = panel.games[0]
    panel.checkpoint.value = 1
    panel.open.click()
    now = panel.games[0]
    assert now.title == "DQN, 1 games"
    assert now.actions == before.actions
    assert not np.allclose(now.q_values, before.q_values)


def test_a_new_game_is_the_one_that_evaluation_plays(panel):
    panel.kind.value = NEW
    panel.number.value = 4
    panel.open.click()
    game = panel.games[0]
    assert game.ended
    assert all(action == game.best(step) for step, action in enumerate(game.actions))
    assert panel.facts.value.startswith("new game 4: step 0 of 23;")
    assert game.record == module.new_record(panel.params, 3)


def test_another_agent_plays_on_beside(panel):
    panel.moment.value = 20
    panel.compare.click()
    first, other = panel.games
    assert other.title == "Dueling Double DQN, 3 games"
    assert other.actions[:20] == first.actions[:20]
    assert other.actions[20:] == [other.best(step) for step in range(20, other.last)]
    assert panel.moment.value == 20
    panel.moment.value = panel.moment.max  # of the longer one
    assert not panel.compare.disabled


def test_the_agent_plays_on_with_what_was_changed(panel):
    panel.moment.value, panel.difficulty.value = 10, 3
    recorded = panel.games[0]
    asyncio.run(pressed(panel, panel.let_play))
    game = panel.games[0]
    assert game is not recorded
    assert game.ended
    assert game.changes == {10: {"difficulty": 3}}
    said = "training game 3, played on by the agent from step 10 with difficulty 3: step"
    assert panel.facts.value.startswith(said)
    assert game.actions[10:] == [game.best(step) for step in range(10, game.last)]
    assert panel.moment.value == game.last, "the picture goes along"
    assert panel.stop.disabled
    assert "play" not in panel.message.value


async def pressed(panel, button, after=None):
    """Presses a button, and waits until what it began has ended; `after` happens soon."""
    button.click()
    if after:
        await asyncio.sleep(0.2)
        after()
    await asyncio.wait([panel.task] if panel.task else [asyncio.sleep(0)])


def test_a_person_plays_on_with_the_keys_even_where_they_are_only_tapped(panel):
    panel.moment.value = 5
    names = panel.games[0].names
    panel.key({"type": "keydown", "code": "ArrowLeft"})
    panel.key({"type": "keydown", "code": "Space"})
    panel.key({"type": "keyup", "code": "Space"})
    panel.key({"type": "keydown", "code": "KeyQ"})
    asyncio.run(pressed(panel, panel.take_over))
    played = [names[action] for action in panel.games[0].actions[5:]]
    assert played == ["LEFTFIRE", *["LEFT"] * (len(played) - 1)]
    panel.moment.value = 5
    asyncio.run(pressed(panel, panel.take_over))
    assert {names[action] for action in panel.games[0].actions[5:]} == {"NOOP"}


def test_a_key_held_as_the_mouse_leaves_the_picture_is_let_go(panel):
    panel.moment.value = 5
    panel.key({"type": "keydown", "code": "ArrowLeft"})
    asyncio.run(pressed(panel, panel.take_over, lambda: panel.key({"type": "mouseleave"})))
    played = [panel.games[0].names[action] for action in panel.games[0].actions[5:]]
    assert (played[0], played[-1]) == ("LEFT", "NOOP")


def test_stopping_leaves_what_was_played(panel):
    panel.moment.value = 0

    def stop():
        assert not panel.stop.disabled
        panel.stop.click()

    async def stopped():
        panel.let_play.click()
        task = panel.task
        await asyncio.sleep(0.3)
        stop()
        await asyncio.wait([task])

    asyncio.run(stopped())
    assert panel.stop.disabled
    assert 0 < panel.games[0].last < 50
    assert panel.task is None


def test_a_game_that_is_over_is_not_played_on(panel):
    panel.moment.value = panel.moment.max
    game = panel.games[0]
    panel.let_play.click()
    assert panel.games == [game]
    assert panel.task is None
    assert "over" in panel.message.value


def test_damaged_weights_are_told_in_the_panel(panel, results, monkeypatch):
    def damaged(*_):
        raise RunError("model.safetensors cannot be read")

    monkeypatch.setattr(StoredAgents, "critic", damaged)
    panel.open.click()
    assert panel.message.value == "model.safetensors cannot be read"
    assert not panel.open.disabled


def test_without_an_agent_one_line_says_so(tmp_path):
    with pytest.raises(RunError, match=r"no agent is stored in .*runs"):
        Explorer("smoke", tmp_path)


def test_without_widgets_a_picture_and_its_facts_are_shown(panel, monkeypatch):
    displayed, said = [], []
    monkeypatch.setattr(module, "display", displayed.append)
    monkeypatch.setattr(module, "show_text", said.append)
    panel.show(False)
    (picture,) = displayed
    assert picture.data == panel.picture.value
    assert said == [f"*{panel.facts.value}*"]
    panel.show(True)
    assert displayed[1] is panel.panel


@pytest.mark.parametrize(
    ("wanted", "server", "found"),
    [(None, True, True), (None, False, False), (True, False, True), (False, True, False)],
)
def test_widgets_are_shown_where_a_jupyter_server_has_opened_the_notebook(
    monkeypatch, wanted, server, found
):
    monkeypatch.delenv("JPY_SESSION_NAME", raising=False)
    if server:
        monkeypatch.setenv("JPY_SESSION_NAME", "explore.ipynb")
    assert interactive(wanted) is found


@pytest.fixture
def section(tmp_path):
    """The smoke version of an experiment, of which one agent is stored."""
    section = Section("boxing_final", "smoke", str(tmp_path))
    recorder.train(next(run for run in section.runs if run.agent == "dqn"))
    return Section("boxing_final", "smoke", str(tmp_path))


def test_curves_are_drawn_again_when_a_choice_changes(section):
    curves = Curves(section)
    drawn = [curves.picture.value]
    curves.window.value = 2
    drawn.append(curves.picture.value)
    curves.source.value = False
    curves.published.value = False
    drawn.append(curves.picture.value)
    assert len(set(drawn)) == 3
    assert all(svg.count("<svg") == 1 for svg in drawn)
    assert list(curves.agents) == ["dqn"]
    curves.agents["dqn"].value = False
    assert curves.picture.value == "No agent is chosen."


def test_curves_without_widgets_are_the_reports(section, shown, monkeypatch, tmp_path):
    module.show_curves(section, False)
    assert "fig-boxing-final-curves" in shown.figures
    monkeypatch.setattr(module, "display", None)
    module.show_curves(Section("boxing_final", "smoke", str(tmp_path / "empty")), True)
    assert any("Not started" in text for text in shown.texts)
