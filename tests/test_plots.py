"""What the figures' axes hold: every curve its own numbers, in its own unit, under its own name."""

import cv2
import numpy as np
import pandas as pd
import pytest
from matplotlib import pyplot as plt
from synthetic import AGENTS, TITLES, check, evaluate, lines_of, named_lines, numbers, store, study

from atari_dqn import games
from atari_dqn.analysis.study import Section
from atari_dqn.report import plots, results

DQN, DOUBLE, DUELING = AGENTS
GAMES = np.arange(1, 201)
SHOWN = np.arange(100, 201)  # games that have a mean of 100


def slope(times):
    """The mean of the last hundred scores where the n-th is `times` n."""
    return times * (SHOWN - 49.5)


@pytest.fixture
def panels(tmp_path, shown):
    """The axes of the learning curves by their units: DQN from two seeds, Double DQN from one."""
    store(tmp_path, "boxing_final", DQN, 0.1 * GAMES, seed=1)
    store(tmp_path, "boxing_final", DQN, 0.3 * GAMES, seed=2)
    store(tmp_path, "boxing_final", DOUBLE, 0.5 * GAMES, seed=1)
    results.show_curves(Section("boxing_final", "full", str(tmp_path), [DQN, DOUBLE], [1, 2]))
    figure = shown.figures["fig-boxing-final-curves"]
    return {axes.get_xlabel(): axes for axes in figure.axes}


def curves(axes, agent):
    return [(line.get_xdata(), line.get_ydata()) for line in drawn(axes, agent)]


def drawn(axes, agent):
    """The curves in an agent's colour."""
    colour = plots.STYLES[agent].colour
    return [
        line
        for line in axes.get_lines()
        if len(line.get_xdata()) > 2 and line.get_color() == colour and line.get_marker() == "None"
    ]


def marks(axes, which=""):
    """{name: (xs, ys)} of the points that stand alone."""
    return {
        line.get_label(): (list(line.get_xdata()), list(line.get_ydata()))
        for line in axes.get_lines()
        if line.get_linestyle() == "None" and which in line.get_label()
    }


@pytest.mark.parametrize(
    ("unit", "a_game"),
    [("training games", 1), ("million frames", 0.02), ("hours of processor time", 0.01 / 9)],
)
def test_every_seed_has_its_own_curve_against_each_unit(panels, unit, a_game):
    found = curves(panels[unit], DQN)
    assert len(found) == (3 if unit == "training games" else 2)
    for (xs, ys), times in zip(found[:2], (0.1, 0.3), strict=True):
        assert xs == pytest.approx(SHOWN * a_game)
        assert ys == pytest.approx(slope(times))
    (xs, ys), *_ = curves(panels[unit], DOUBLE)
    assert xs == pytest.approx(SHOWN * a_game)
    assert ys == pytest.approx(slope(0.5))
    assert "score" in panels[unit].get_ylabel() or unit.startswith("hours")


def test_the_bold_curve_is_the_mean_of_an_agents_seeds(panels):
    *_, (xs, ys) = curves(panels["training games"], DQN)
    assert xs == pytest.approx(SHOWN)
    assert ys == pytest.approx(slope(0.2))


def test_the_main_panel_is_the_largest_and_its_means_stand_out(panels):
    heights = {name: axes.get_position().height for name, axes in panels.items()}
    assert heights.pop("training games") > 2 * max(heights.values())
    main, *lower = panels.values()
    *seeds, mean = drawn(main, DQN)
    assert all(mean.get_linewidth() > 2 * seed.get_linewidth() for seed in seeds)
    for axes in lower:
        assert all(mean.get_linewidth() > line.get_linewidth() for line in drawn(axes, DQN))


@pytest.mark.parametrize("seeds", [2, 3])
def test_a_band_over_seeds_needs_three_of_them(tmp_path, shown, seeds):
    offsets = np.arange(seeds) - np.mean(range(seeds))  # points
    for seed, offset in enumerate(offsets, start=1):
        store(tmp_path, "boxing_final", DQN, np.full(200, 10 + offset), seed=seed)
    numbered = list(range(1, seeds + 1))
    results.show_curves(Section("boxing_final", "full", str(tmp_path), [DQN], numbered))
    label = "fig-boxing-final-curves"
    bands = shown.figures[label].axes[0].collections
    assert len(bands) == (seeds == 3)
    assert ("bold" in shown.captions[label]) == (seeds == 3)
    if bands:
        heights = bands[0].get_paths()[0].vertices[:, 1]
        half = 4.3027 * 1 / 3**0.5  # Student's t of two degrees of freedom; three means 1 apart
        assert (heights.min(), heights.max()) == pytest.approx((10 - half, 10 + half), abs=1e-3)


def test_an_agent_has_one_look_and_no_other_thing_has_its_colour(panels):
    for agent in (DQN, DOUBLE):
        lines = [line for axes in panels.values() for line in drawn(axes, agent)]
        assert len({line.is_dashed() for line in lines}) == 1
    looks = plots.STYLES.values()
    assert len({look.colour for look in looks}) == len({look.line for look in looks}) == len(looks)
    for count in (2, 3, 5):
        shades = plots.shades(count)
        assert len(set(shades)) == count
        assert not set(shades) & {look.colour for look in looks}


def test_the_source_reports_scores_are_hollow_points_in_their_agents_colour(tmp_path, shown):
    """As far as the curves reach and a third further: the marks are every 500 episodes."""
    store(tmp_path, "boxing_final", DOUBLE, 0.1 * np.arange(1, 781))
    store(tmp_path, "boxing_final", DQN, 0.1 * GAMES)
    label = "fig-boxing-final-curves"
    results.show_curves(Section("boxing_final", "full", str(tmp_path), [DQN, DOUBLE]))
    main, *lower = shown.figures[label].axes
    assert marks(main) == {
        "DQN, source report": ([500, 1000], [10.61, 51.62]),
        "Double DQN, source report": ([500, 1000], [28.99, 80.19]),
        "Double DQN, ours over the same games": ([500], [pytest.approx(25.05)]),
    }
    for line in main.get_lines():
        if line.get_linestyle() == "None":
            theirs = "source report" in line.get_label()
            assert (line.get_markerfacecolor() == "white") == theirs
            agent = DOUBLE if "Double" in line.get_label() else DQN
            assert line.get_color() == plots.STYLES[agent].colour
    assert not any(marks(axes, "source") for axes in lower)
    assert "means of the last 500 games, hollow the source report's" in shown.captions[label]
    assert "source report" in [text.get_text() for text in main.get_legend().get_texts()]


def test_a_caption_tells_of_no_marks_that_are_not_drawn_yet(tmp_path, shown):
    store(tmp_path, "boxing_final", DQN, np.zeros(150))  # of 500 episodes; of 5 million frames
    results.show_curves(study(tmp_path)["boxing_final"])
    caption = shown.captions["fig-boxing-final-curves"]
    assert "Circles" not in caption
    assert "Grey marks" not in caption
    store(tmp_path, "boxing_final", DQN, np.zeros(450))
    results.show_curves(study(tmp_path)["boxing_final"])
    caption = shown.captions["fig-boxing-final-curves"]
    assert caption.index("Circles") < caption.index("Grey marks")


def test_an_experiment_of_another_length_has_no_marks_of_the_source_report(tmp_path, shown):
    stored = study(tmp_path)
    assert results.source_points(stored["boxing_low_gamma"]).empty
    found = results.source_points(stored["breakout_late"]).dropna()
    assert found.values.tolist() == [[DQN, 3000, 26.32, 500]]
    store(tmp_path, "boxing_low_gamma", DUELING, np.zeros(900))
    results.show_curves(stored["boxing_low_gamma"])
    assert "source" not in shown.captions["fig-boxing-low-gamma-curves"]


def test_curves_are_named_after_their_agents_and_the_axis_after_its_window(panels):
    axes = panels["training games"]
    named = named_lines(axes)
    assert list(named) == ["DQN", "Double DQN"]
    assert named["Double DQN"][0][1] == pytest.approx(slope(0.5))
    assert numbers(axes.get_ylabel()) == [100]


def test_human_and_random_lines_lie_at_their_scores_and_are_named(panels):
    for axes in panels.values():
        assert [ys for _, ys in lines_of(axes, ":")] == [[12.1, 12.1], [0.1, 0.1]]
    notes = {note.get_text(): note.xy[1] for note in panels["training games"].texts}
    assert notes == {"human 12.1": 12.1, "random\nplay 0.1": 0.1}


def test_the_name_of_random_play_lies_beside_the_panel_where_no_curve_does(panels):
    main = panels["training games"]
    main.figure.canvas.draw()
    (note,) = (note for note in main.texts if "random" in note.get_text())
    box, panel = note.get_window_extent(), main.get_window_extent()
    assert panel.x1 < box.x0 < box.x1 <= main.figure.bbox.x1
    line = main.transData.transform((0, 0.1))[1]
    assert box.y0 < line < box.y1, "at the height of its line"


def test_published_scores_stand_at_their_frames_as_far_as_ours_reach(panels):
    """Ours reach four million frames; the marks are at 5, 10 and 21."""
    assert marks(panels["million frames"]) == {
        "DQN, Dopamine": ([5], [2.6]),
        "DQN, Adam, Dopamine": ([5], [24.0]),
        "Rainbow, Dopamine": ([5], [18.0]),
    }


def test_of_seeds_that_have_come_less_far_the_mean_ends_where_one_ends(tmp_path, shown):
    store(tmp_path, "boxing_final", DQN, np.full(200, 10.0), seed=1)
    store(tmp_path, "boxing_final", DQN, np.full(150, 30.0), seed=2)
    results.show_curves(Section("boxing_final", "full", str(tmp_path), [DQN], [1, 2]))
    axes = shown.figures["fig-boxing-final-curves"].axes[0]
    one, two, mean = curves(axes, DQN)
    assert [xs[-1] for xs, _ in (one, two, mean)] == [200, 150, 150]
    assert mean[1] == pytest.approx(np.full(51, 20.0))


def test_at_another_difficulty_there_is_nothing_to_compare_with(tmp_path, shown):
    store(tmp_path, "boxing_expert", DQN, 0.1 * GAMES)
    results.show_curves(study(tmp_path)["boxing_expert"])
    for axes in shown.figures["fig-boxing-expert-curves"].axes:
        assert lines_of(axes, ":") == []
    assert "uman" not in shown.captions["fig-boxing-expert-curves"]


def test_curves_of_breakout_have_breakouts_references(tmp_path, shown):
    store(tmp_path, "breakout_final", DUELING, 0.1 * GAMES)
    results.show_curves(study(tmp_path)["breakout_final"])
    label = "fig-breakout-final-curves"
    for axes in shown.figures[label].axes:
        assert [ys[0] for _, ys in lines_of(axes, ":")] == [30.5, 1.7]
    assert numbers(shown.captions[label])[:2] == [100, 1]  # episodes per point; seeds
    assert "Breakout" in shown.captions[label]


def test_discounts_are_each_the_curve_of_their_own_experiment(tmp_path, shown):
    slopes = {"boxing_low_gamma": 0.1, "boxing_final": 0.2, "boxing_high_gamma": 0.3}
    for experiment, times in slopes.items():
        store(tmp_path, experiment, DUELING, times * GAMES)
    store(tmp_path, "boxing_final", DQN, 9 * GAMES)  # is another agent's
    stored = study(tmp_path)
    results.show_discounts([stored[name] for name in slopes], DUELING, "fig-discounts")
    (axes,) = shown.figures["fig-discounts"].axes
    games = np.arange(33, 201)  # the first experiment's window is a 30th of its 1,000 games
    named = named_lines(axes)
    assert list(named) == ["discount 0.9", "discount 0.99", "discount 0.995"]
    for ((xs, ys),), times in zip(named.values(), slopes.values(), strict=True):
        assert xs == pytest.approx(games)
        assert ys == pytest.approx(times * (games - 16))
    assert axes.get_xlabel() == "training games"
    assert numbers(axes.get_ylabel()) == [33]
    assert numbers(shown.captions["fig-discounts"]) == [33]
    assert "Dueling Double DQN" in shown.captions["fig-discounts"]
    assert [ys[0] for _, ys in lines_of(axes, ":")] == [12.1, 0.1]


def test_a_discount_that_is_not_trained_yet_has_no_curve(tmp_path, shown):
    for experiment in ("boxing_final", "boxing_high_gamma"):
        store(tmp_path, experiment, DUELING, 0.1 * GAMES)
    stored = study(tmp_path)
    sections = [stored[name] for name in ("boxing_low_gamma", "boxing_final", "boxing_high_gamma")]
    results.show_discounts(sections, DUELING, "fig-discounts")
    (axes,) = shown.figures["fig-discounts"].axes
    assert list(named_lines(axes)) == ["discount 0.99", "discount 0.995"]


def test_predicted_realised_and_held_out_values_are_told_apart_by_their_lines(tmp_path, shown):
    for place, agent in enumerate(AGENTS):
        run = store(tmp_path, "boxing_final", agent, np.zeros(300))
        base = 10.0 * place + np.array([1.0, 2.0, 4.0])
        check(run, np.zeros(3), predicted=base, realised=base + 0.5, held_out=base - 0.5)
    results.show_values(study(tmp_path)["boxing_final"])
    panels = shown.figures["fig-boxing-final-values"].axes
    assert [axes.get_title(loc="left") for axes in panels] == list(TITLES.values())
    for place, (axes, agent) in enumerate(zip(panels, AGENTS, strict=True)):
        base = 10.0 * place + np.array([1.0, 2.0, 4.0])
        lines = {line.get_label(): line for line in axes.get_lines()}
        for name, expected in (
            ("predicted", base),
            ("what followed", base + 0.5),
            ("prediction for fixed random states", base - 0.5),
        ):
            xs, ys = lines[name].get_data()
            assert list(xs) == [100, 200, 300]
            assert ys == pytest.approx(expected)
        colour = plots.STYLES[agent].colour
        assert lines["predicted"].get_color() == colour
        assert lines["prediction for fixed random states"].get_color() == colour
        looks = {(line.get_marker(), str(line.get_markerfacecolor())) for line in lines.values()}
        assert len(looks) == 3
        assert axes.get_xlabel() == "training games"
    assert panels[0].get_ylabel() == "value of a state"
    caption = shown.captions["fig-boxing-final-values"]
    told = ["predicts", "(dots)", "return that followed", "(grey circles)", "overestimates"]
    assert sorted(told, key=caption.index) == told
    assert numbers(caption)[:4] == [20, 100, 20, 512]
    assert "lost life" not in caption


def test_an_agent_with_a_single_check_of_its_values_has_no_panel(tmp_path, shown):
    for agent, checks in ((DQN, 3), (DOUBLE, 1)):
        run = store(tmp_path, "breakout_final", agent, np.zeros(300))
        check(run, np.zeros(checks))
    results.show_values(study(tmp_path)["breakout_final"])
    panels = shown.figures["fig-breakout-final-values"].axes
    assert [axes.get_title(loc="left") for axes in panels] == ["DQN"]
    assert "less 1 for a lost life" in shown.captions["fig-breakout-final-values"]


def test_overestimation_is_shaded_and_underestimation_is_not(tmp_path, shown):
    for agent, realised in ((DQN, 1.0), (DOUBLE, 3.0)):
        run = store(tmp_path, "boxing_final", agent, np.zeros(300))
        check(run, np.zeros(3), predicted=np.full(3, 2.0), realised=np.full(3, realised))
    results.show_values(study(tmp_path)["boxing_final"])
    over, under = shown.figures["fig-boxing-final-values"].axes
    (shade,) = over.collections
    heights = np.concatenate([path.vertices[:, 1] for path in shade.get_paths()])
    assert (heights.min(), heights.max()) == (1.0, 2.0)
    assert not any(len(path.vertices) for band in under.collections for path in band.get_paths())


def test_evaluation_scores_stand_beside_their_agent(tmp_path, shown):
    for agent, mean in ((DUELING, 30.0), (DQN, 10.0)):
        run = store(tmp_path, "boxing_final", agent, np.zeros(300))
        evaluate(run, score=mean)
        evaluate(run, add=True, score=-70.0, sticky_actions=0.25)
    results.show_evaluations(study(tmp_path)["boxing_final"])
    (axes,) = shown.figures["fig-boxing-final-evaluation"].axes
    assert [tick.get_text() for tick in axes.get_yticklabels()] == ["DQN", "Dueling Double DQN"]
    dots, means, spans = [], {}, {}
    for line in axes.get_lines():
        xs, ys = (np.asarray(values, float) for values in line.get_data())
        place = round(float(np.mean(ys)))
        if line.get_marker() == "o":
            dots.append((place, xs, line.get_color()))
        elif line.get_marker() == "D":
            means[place] = xs.item()
        elif line.get_linestyle() == "-":
            spans[place] = xs
    assert [(place, len(xs), colour) for place, xs, colour in dots] == [
        (0, 40, plots.STYLES[DQN].colour),
        (1, 40, plots.STYLES[DUELING].colour),
    ]
    assert [xs.mean() for _, xs, _ in dots] == pytest.approx([10.0, 30.0])
    assert means == pytest.approx({0: 10.0, 1: 30.0})
    for place, (low, high) in spans.items():
        # of 40 values evenly spread over two points
        assert high - low == pytest.approx(2 * 1.96 * 2 / 12**0.5 / 40**0.5, abs=0.06)
        assert low < means[place] < high
    assert len(spans) == 2
    assert axes.get_xlabel() == "score of a game"
    assert {"10.0", "30.0", "human 12.1", "random play 0.1"} == {
        note.get_text() for note in axes.texts
    }
    assert numbers(shown.captions["fig-boxing-final-evaluation"])[:2] == [40, 0.1]


def test_each_run_of_an_agent_has_its_own_mean(tmp_path, shown):
    for seed, mean, played in ((1, 10.0, 40), (2, 50.0, 30)):
        run = store(tmp_path, "boxing_final", DQN, np.zeros(300), seed=seed)
        evaluate(run, score=mean, games=played)
    results.show_evaluations(Section("boxing_final", "full", str(tmp_path), [DQN], [1, 2]))
    (axes,) = shown.figures["fig-boxing-final-evaluation"].axes
    found = [line.get_data() for line in axes.get_lines() if line.get_marker() == "D"]
    assert [xs.item() for xs, _ in map(np.asarray, found)] == pytest.approx([10.0, 50.0])
    heights = [float(np.asarray(ys).item()) for _, ys in found]
    assert abs(heights[0] - heights[1]) > 0.2
    assert numbers(shown.captions["fig-boxing-final-evaluation"])[0] == 30, "the fewest"


def test_smoothing_never_mixes_seeds_agents_or_variations():
    rows = [
        {"variation": v, "agent": a, "seed": s, "episode": n, "score": float(v + a + s)}
        for v in (100, 200) for a in (10, 20) for s in (1, 2) for n in (1, 2, 3)
    ]  # fmt: skip
    table = pd.DataFrame(rows).sample(frac=1, random_state=0).sort_values("episode")
    smooth = plots.smoothed(table, 2)
    assert sorted(smooth.episode.unique()) == [2, 3]
    assert (smooth["mean"] == smooth.variation + smooth.agent + smooth.seed).all()


def test_preprocessing_is_drawn_with_the_pictures_of_one_real_step():
    """The grey image is the greater of the last two frames, resized; the stack ends with it."""
    figure = plots.preprocessing(["boxing"])
    shown = [axes.get_images()[0].get_array() for axes in figure.axes if axes.get_images()]
    third, fourth, greatest, small, *stack = shown
    assert [one.shape for one in (third, fourth, greatest)] == [(210, 160, 3)] * 2 + [(210, 160)]
    assert (third != fourth).any(), "two different frames"
    grey = [cv2.cvtColor(one.data, cv2.COLOR_RGB2GRAY).astype(int) for one in (third, fourth)]
    assert np.abs(np.maximum(*grey) - greatest.astype(int)).mean() < 1
    resized = cv2.resize(greatest.data, (84, 84), interpolation=cv2.INTER_AREA)
    assert (small == resized).all()
    assert len(stack) == 4
    assert (stack[-1] == small).all()
    assert (stack[0] != small).any()
    written = " ".join(text.get_text() for axes in figure.axes for text in axes.texts)
    for word in ("maximum", "resize", "stack", "clipped", "Boxing"):
        assert word in written
    plt.close(figure)


def test_long_names_of_curves_stay_within_the_figure():
    table = pd.DataFrame({"episode": range(1, 11), "score": 1.0, "agent": "dqn", "seed": 1})
    names = [f"learning rate 0.00{number}, batch size 64" for number in range(1, 5)]
    curves = pd.concat([table.assign(label=name, experiment=name) for name in names])
    with plt.rc_context():
        plots.style()
        figure = plots.comparison(curves, games.GAMES["boxing"], 2, "label")
        figure.draw_without_rendering()
    right = figure.axes[0].get_legend().get_window_extent().x1
    assert right <= figure.bbox.x1


def test_no_curve_is_drawn_against_hours_of_which_some_are_a_gpus(tmp_path, shown):
    beside = [{"processor": "any", "device": "cuda", "commit": "a" * 40}]
    store(tmp_path, "boxing_final", DQN, np.zeros(150))
    store(tmp_path, "boxing_final", DOUBLE, np.zeros(150), sessions=beside)
    results.show_curves(study(tmp_path)["boxing_final"])
    units = [axes.get_xlabel() for axes in shown.figures["fig-boxing-final-curves"].axes]
    assert units == ["training games", "million frames"]
    assert "processor" not in shown.captions["fig-boxing-final-curves"]


def test_the_legend_of_three_agents_and_the_source_lies_within_the_figure(tmp_path, shown):
    plots.style()
    for agent in AGENTS:
        store(tmp_path, "boxing_final", agent, np.zeros(600))
    results.show_curves(Section("boxing_final", "full", str(tmp_path)))
    figure = shown.figures["fig-boxing-final-curves"]
    figure.canvas.draw()
    main, *_ = figure.axes
    legend = main.get_legend()
    assert len(legend.get_texts()) == 5
    frame, box = figure.bbox, legend.get_window_extent()
    assert frame.x0 <= box.x0 < box.x1 <= frame.x1
    assert main.get_window_extent().width > 0.8 * frame.width
