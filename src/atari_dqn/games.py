"""What is known of the games: the cartridges by name, and facts that no parameter changes."""

from dataclasses import dataclass
from math import inf


@dataclass(frozen=True)
class GameFacts:
    """What is known of a cartridge.

    The random and human mean scores are those of `dqn_zoo/atari_data.py` (Quan and Ostrovski,
    2020), which Schwarzer et al. (2023) use too; the difficulties are the emulator's.
    """

    name: str  # the emulator's
    random: float  # points, mean of uniformly random play
    human: float  # points, mean of a professional tester
    difficulties: tuple[int, ...]  # settings of the switches that it reads
    wins_at: float = inf  # points from which a game is won, where that can be
    fire_to_serve: bool = False  # FIRE brings the ball into play, at the start and after every
    # lost life
    idle_cycle: int | None = None  # idle frames after which a game begins as if there had been
    # none, where nothing moves before the first action
    score_cells: tuple[int, int] | None = None  # RAM cells of the points of the agent and of its
    # rival (`boxing_points`); 0xC0 once one has knocked the other out
    arm_cells: tuple[tuple[int, int], tuple[int, int]] | None = None  # RAM cells of how far each
    # arm of the agent, and of its rival, is out, 0 to 72 (measured, tests/test_ram.py)
    boxers: tuple[tuple[int, int], tuple[int, int]] | None = None  # RAM cells of x and y, in
    # pixels, of the agent and of its rival (Anand et al., 2019)
    full_frames: int | None = None  # of a game that only its clock ends, where there is one
    scoreboard: int = 0  # rows of an observation, from its top, with the score and a clock or lives
    field: tuple[slice, slice] | None = None  # rows and columns of an observation in which the game
    # is played, as far from its left edge as from its right
    bar: slice | None = None  # columns of an observation, from its left edge, that are black in
    # every picture, where the right edge has none
    clock_cells: tuple[int, int] | None = None  # RAM cells of a clock that runs down: minutes in
    # the upper half of the first, seconds in the second, as decimal digits

    @property
    def title(self) -> str:
        return self.name.replace("_", " ").title()

    def opening(self, idle_frames: int) -> int:
        """Which of the different games begins after so many idle frames."""
        return idle_frames % self.idle_cycle if self.idle_cycle else idle_frames


GAMES = {
    facts.name: facts
    for facts in (
        GameFacts("alien", 227.8, 7127.7, (0, 1, 2, 3)),
        GameFacts("amidar", 5.8, 1719.5, (0, 3)),
        GameFacts("assault", 222.4, 742.0, (0,)),
        GameFacts("asterix", 210.0, 8503.3, (0,)),
        GameFacts("asteroids", 719.1, 47388.7, (0, 3)),
        GameFacts("atlantis", 12850.0, 29028.1, (0,)),
        GameFacts("bank_heist", 14.2, 753.1, (0, 1, 2, 3)),
        GameFacts("battle_zone", 2360.0, 37187.5, (0,)),
        GameFacts("beam_rider", 363.9, 16926.5, (0, 1)),
        GameFacts("berzerk", 123.7, 2630.4, (0,)),
        GameFacts("bowling", 23.1, 160.7, (0, 1)),
        GameFacts(
            "boxing",
            0.1,
            12.1,
            (0, 1, 2, 3),
            1,
            score_cells=(18, 19),
            arm_cells=((55, 57), (59, 61)),
            boxers=((32, 34), (33, 35)),
            full_frames=7141,
            scoreboard=10,
            field=(slice(10, 70), slice(14, 70)),  # the ring with its ropes
            bar=slice(0, 5),
            clock_cells=(16, 17),
        ),
        GameFacts(
            "breakout",
            1.7,
            30.5,
            (0, 1),
            864,
            fire_to_serve=True,
            idle_cycle=4,
            scoreboard=6,
            field=(slice(6, 84), slice(4, 80)),  # between the walls, whose feet differ in colour
        ),
        GameFacts("centipede", 2090.9, 12017.0, (0,)),
        GameFacts("chopper_command", 811.0, 7387.8, (0, 1)),
        GameFacts("crazy_climber", 10780.5, 35829.4, (0, 1)),
        GameFacts("defender", 2874.5, 18688.9, (0, 1)),
        GameFacts("demon_attack", 152.1, 1971.0, (0, 1)),
        GameFacts("double_dunk", -18.6, -16.4, (0,), 1),
        GameFacts("enduro", 0.0, 860.5, (0,)),
        GameFacts("fishing_derby", -91.7, -38.7, (0, 1, 2, 3), 1),
        GameFacts("freeway", 0.0, 29.6, (0, 1)),
        GameFacts("frostbite", 65.2, 4334.7, (0,)),
        GameFacts("gopher", 257.6, 2412.5, (0, 1)),
        GameFacts("gravitar", 173.0, 3351.4, (0,)),
        GameFacts("hero", 1027.0, 30826.4, (0,)),
        GameFacts("ice_hockey", -11.2, 0.9, (0, 1, 2, 3), 1),
        GameFacts("jamesbond", 29.0, 302.8, (0,)),
        GameFacts("kangaroo", 52.0, 3035.0, (0,)),
        GameFacts("krull", 1598.0, 2665.5, (0,)),
        GameFacts("kung_fu_master", 258.5, 22736.3, (0,)),
        GameFacts("montezuma_revenge", 0.0, 4753.3, (0,)),
        GameFacts("ms_pacman", 307.3, 6951.6, (0,)),
        GameFacts("name_this_game", 2292.3, 8049.0, (0, 1)),
        GameFacts("phoenix", 761.4, 7242.6, (0,)),
        GameFacts("pitfall", -229.4, 6463.7, (0,)),
        GameFacts("pong", -20.7, 14.6, (0, 1, 2, 3), 1),
        GameFacts("private_eye", 24.9, 69571.3, (0, 1, 2, 3)),
        GameFacts("qbert", 163.9, 13455.0, (0, 1)),
        GameFacts("riverraid", 1338.5, 17118.0, (0, 1)),
        GameFacts("road_runner", 11.5, 7845.0, (0,)),
        GameFacts("robotank", 2.2, 11.9, (0,)),
        GameFacts("seaquest", 68.4, 42054.7, (0, 1)),
        GameFacts("skiing", -17098.1, -4336.9, (0,)),
        GameFacts("solaris", 1236.3, 12326.7, (0,)),
        GameFacts("space_invaders", 148.0, 1668.7, (0, 1)),
        GameFacts("star_gunner", 664.0, 10250.0, (0,)),
        GameFacts("surround", -10.0, 6.5, (0, 1, 2, 3), 1),
        GameFacts("tennis", -23.8, -8.3, (0, 1, 2, 3), 1),
        GameFacts("time_pilot", 3568.0, 5229.2, (0, 1, 2)),
        GameFacts("tutankham", 11.4, 167.6, (0,)),
        GameFacts("up_n_down", 533.4, 11693.2, (0, 1, 2, 3)),
        GameFacts("venture", 0.0, 1187.5, (0, 1, 2, 3)),
        GameFacts("video_pinball", 16256.9, 17667.9, (0, 1)),
        GameFacts("wizard_of_wor", 563.5, 4756.5, (0, 1)),
        GameFacts("yars_revenge", 3092.9, 54576.9, (0, 1)),
        GameFacts("zaxxon", 32.5, 9173.3, (0,)),
    )
}


KNOCK_OUT = 100  # points of Boxing that end a game; the best score is these and none conceded


def boxing_points(cell: int) -> int:
    """The points that a memory cell of Boxing holds: a decimal digit in each half, or a
    knock-out's."""
    return KNOCK_OUT if cell == 0xC0 else 10 * (cell >> 4) + (cell & 0xF)
