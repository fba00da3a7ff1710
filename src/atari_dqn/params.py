"""What defines a run: one strict, typed object, read from a YAML file.

Anything wrong with a file (an unknown or repeated key, a wrong type, a value out of range) is a
`ParameterError` of one line that names the file, the key, the value and what would be right.
"""

import copy
import difflib
import hashlib
import json
import re
from collections.abc import Collection
from functools import lru_cache
from pathlib import Path
from typing import Annotated, Any, Literal, get_args

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    ValidationError,
    field_validator,
    model_validator,
)
from ruamel.yaml import YAML
from ruamel.yaml.composer import Composer, ComposerError
from ruamel.yaml.constructor import ConstructorError, SafeConstructor
from ruamel.yaml.error import YAMLError
from ruamel.yaml.events import ScalarEvent

from atari_dqn.games import GAMES

# Raise by one when the training code changes in a way that changes results; runs of another
# version are stale. tests/test_training_version.py fails until somebody has decided.
TRAINING_VERSION = 3

AGENT_NAMES = ("dqn", "double_dqn", "dueling_double_dqn")  # what they are, `agents.AGENTS` says
Profile = Literal["full", "quick", "smoke"]
PROFILES: tuple[str, ...] = get_args(Profile)

# The protocol of the checks of values while training, which no file changes
VALUES_PERIOD = 100  # training games between two
VALUE_GAMES = 20  # greedy games behind each
HELD_OUT_STATES = 512  # of random play, whose values are followed too
EVALUATION = 99  # sets the random streams of evaluation apart from those of training


# What a file may ask of its reader. Ours have two thousand bytes, and lists within two mappings.
LARGEST_FILE = 10_000  # bytes: they can take half a second
LONGEST_VALUE = 500  # characters: no message is longer, and Python takes so long a number
DEEPEST = 8  # lists and mappings within one another
MOST_BASES = 20  # files behind one

MOST = 2**32 - 1  # of a seed, and of whatever is counted: no run comes near, no library minds


def printable(text: str) -> str:
    """A text as one line that a terminal can be shown: names of files may hold anything."""
    return "".join(char if char.isprintable() else repr(char)[1:-1] for char in text)


class ParameterError(ValueError):
    """A bad parameter; the message is one line, fit to be shown to a user as it is."""

    def __init__(self, message: str):
        super().__init__(printable(message))


def shown(value: Any) -> str:
    """A value as a message names it: the beginning of a long one."""
    try:
        text = repr(value)
    except (ValueError, RecursionError):  # a number of thousands of digits, a list of lists of ...
        return f"this {type(value).__name__}"
    return text if len(text) <= 200 else f"{text[:180]}... ({len(text):,} characters)"


def _scientific(value: Any) -> Any:
    """YAML 1.1, which papermill reads, takes 1e-4 for text: accept it as the number it is."""
    if isinstance(value, str) and re.fullmatch(r"[+-]?\d+(\.\d*)?[eE][+-]?\d+", value):
        return float(value)
    return value


def check_profile(name: object) -> None:
    """Raises ParameterError on an unknown profile, which would name a folder."""
    if name not in PROFILES:
        raise ParameterError(f"profile: {shown(name)} is not allowed: {hint(name, PROFILES)}")


def hint(name: object, known: Collection[str]) -> str:
    """What to say of a name that is not among those known."""
    near = difflib.get_close_matches(name, known, n=1) if isinstance(name, str) else []
    return f"did you mean {near[0]!r}?" if near else f"must be one of {', '.join(known)}"


def _named(kind: str, name: str, known: Collection[str]) -> str:
    if name not in known:
        raise ValueError(f"no such {kind}; {hint(name, known)}")
    return name


def _experiment(name: str) -> str:
    """Refuses what names no file and no folders of its own; the hash is `_renamed`'s."""
    if not re.fullmatch(r"[a-z0-9_]{1,100}(\+[0-9a-f]{8})?", name):
        raise ValueError("must be of a-z, 0-9 and _, 100 at most")
    return name


AgentName = Annotated[str, AfterValidator(lambda name: _named("agent", name, AGENT_NAMES))]
GameName = Annotated[str, AfterValidator(lambda name: _named("game", name, GAMES))]
ExperimentName = Annotated[str, AfterValidator(_experiment)]
SourceName = Annotated[str, AfterValidator(lambda name: name and _experiment(name))]
Count = Annotated[int, Field(le=MOST)]
Number = Annotated[float, BeforeValidator(_scientific), Field(allow_inf_nan=False)]


class Parameters(BaseModel):
    """One experiment: the game, the agents and seeds to train, and every setting of the training.

    Each field's description begins with its unit. Fields below `Training` decide what is learned
    and make up the identity of a run (`identity`); those above and below them do not. A default,
    once published, never changes, since identities are relative to it: what experiments should
    use goes into their files.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)

    experiment: ExperimentName = Field(description="name")
    profile: Profile = Field("full", description="name; quick and smoke runs are no evidence")
    agents: list[AgentName] = Field(
        ["dqn", "double_dqn", "dueling_double_dqn"], min_length=1, description="names"
    )
    seeds: list[Annotated[Count, Field(ge=0)]] = Field([1], min_length=1, description="integers")
    episodes: Count = Field(3000, ge=1, description="games to train for")

    # Training: the game and what the agent sees of it
    game: GameName = Field("boxing", description="name of the cartridge")
    frame_skip: int = Field(4, ge=1, le=16, description="frames an action is held for")
    frame_stack: int = Field(4, ge=1, le=8, description="images an observation holds")
    noop_max: int = Field(  # after ten seconds a game may be over before it begins
        30, ge=0, le=600, description="frames; maximum number of idle frames at the start"
    )
    max_game_frames: Count = Field(
        108_000, ge=1, description="frames after which a game is cut off"
    )
    sticky_actions: Number = Field(0.0, ge=0, lt=1, description="probability per frame")
    difficulty: int = Field(0, ge=0, le=3, description="switches; 1 slows the agent, 2 its rival")
    clip_rewards: bool = Field(True, description="learn from the reward's sign only")
    life_loss_penalty: Number = Field(
        0.0, ge=0, le=1e6, description="reward subtracted for a lost life"
    )

    # Training: exploration
    epsilon_start: Number = Field(1.0, ge=0, le=1, description="probability of a random action")
    epsilon_decay: Number = Field(0.995, gt=0, le=1, description="factor per finished game")
    epsilon_floor: Number = Field(
        0.01, ge=0, le=1, description="lowest probability of a random action"
    )

    # Training: replay and learning
    environments: int = Field(8, ge=1, le=64, description="emulators stepped in turn")
    replay_capacity: int = Field(  # 1 GB of memory holds a million
        1_000_000, ge=1, le=10_000_000, description="transitions remembered"
    )
    learning_starts: Count = Field(20_000, ge=0, description="agent steps before the first update")
    update_period: Count = Field(4, ge=1, description="agent steps per update")
    batch_size: int = Field(32, ge=1, le=4096, description="transitions per update")
    learning_rate: Number = Field(1e-4, gt=0, le=1, description="step size of Adam")
    warmup_games: Count = Field(0, ge=0, description="games in which the learning rate rises")
    warmup_learning_rate: Number = Field(
        0.0, ge=0, le=1, description="step size before the first game"
    )
    adam_epsilon: Number = Field(  # a smaller float32 is 0; beside a larger one nothing moves
        1e-8, ge=1e-30, le=1e6, description="added to Adam's denominator"
    )
    gamma: Number = Field(0.99, ge=0, lt=1, description="discount per agent step")
    n_steps: int = Field(1, ge=1, le=16, description="agent steps of reward before a value is used")
    target_update_period: Count = Field(2000, ge=1, description="updates between target updates")
    tau: Number = Field(1.0, gt=0, le=1, description="fraction moved towards the online weights")

    # Training: transfer
    initial_weights: SourceName = Field(
        "", description="experiment whose model of the same agent and seed to start from; or none"
    )
    transferred_layers: Literal["all", "convolutions"] = Field(
        "all", description="all but the output layers, or the convolutions only"
    )
    freeze_convolutions: bool = Field(False, description="never change the convolutions")

    # Not training
    variations: dict[str, dict[str, Any]] = Field(
        {}, max_length=100, description="label: {parameter: value}; each is run beside the others"
    )
    snapshot_games: list[Annotated[Count, Field(ge=1)]] = Field(  # 3 MB each, in memory too
        [], max_length=100, description="games after which the weights are kept"
    )
    device: Literal["auto", "cpu", "cuda"] = Field("auto", description="where networks live")
    learner: Literal["auto", "native", "torch"] = Field(
        "auto", description="what makes the updates; auto is the native one on a CPU, if it builds"
    )
    emulator_processes: int = Field(
        1, ge=1, le=64, description="processes that share a run's emulators; 1 steps them in turn"
    )
    evaluation_games: Count = Field(100, ge=1, description="games of the final evaluation")
    evaluation_epsilon: Number = Field(0.001, ge=0, le=1, description="probability, evaluating")
    evaluation_difficulties: list[int] = Field(
        [], description="switches; the final evaluation is repeated with each"
    )
    evaluation_stickiness: list[Annotated[Number, Field(ge=0, lt=1)]] = Field(
        [], description="probabilities a frame; likewise"
    )

    @field_validator(
        *("agents", "seeds", "snapshot_games", "evaluation_difficulties", "evaluation_stickiness")
    )
    @classmethod
    def _no_repeats(cls, values: list) -> list:
        if len(set(values)) != len(values):
            raise ValueError("no value may be listed twice")
        return values

    @model_validator(mode="after")
    def _fits_together(self) -> "Parameters":
        allowed = GAMES[self.game].difficulties
        if self.difficulty not in allowed:
            raise _key_error("difficulty", self.difficulty, f"{self.game} has {allowed}")
        if not set(self.evaluation_difficulties) <= set(allowed):
            key = "evaluation_difficulties"
            raise _key_error(key, self.evaluation_difficulties, f"{self.game} has {allowed}")
        if self.replay_capacity % self.environments:
            raise _key_error(
                "replay_capacity",
                self.replay_capacity,
                f"a multiple of environments ({self.environments}) is needed",
            )
        smallest = self.environments * (self.frame_stack + 2)
        if self.replay_capacity < smallest:
            raise _key_error("replay_capacity", self.replay_capacity, f"at least {smallest}")
        if self.epsilon_floor > self.epsilon_start:
            raise _key_error("epsilon_floor", self.epsilon_floor, "above epsilon_start")
        for label, changes in self.variations.items():
            if not re.fullmatch(r"\w[\w .,:/+%()×=-]{,59}", label):  # reports print it
                raise _key_error("variations", label, "a label is words, numbers and .,:/+%()×=-")
            if not changes or set(changes) & (NOT_VARIANT | EVALUATED_BESIDES):
                raise _key_error("variations", label, "names parameters that vary the training")
        resolved = [_variation(self, label).variant() for label in self.variations]
        if len(set(resolved)) < len(resolved):
            raise _key_error("variations", list(self.variations), "two of them are the same")
        return self

    def variant(self) -> str:
        """Eight hexadecimal digits that name these settings among an experiment's variants."""
        exclude = NOT_VARIANT | EVALUATED_BESIDES
        return _digest(self.model_dump(exclude=exclude, exclude_defaults=True))[:8]

    def identity(self) -> str:
        """SHA-256 (hex) of what decides what is learned.

        Only values that differ from the defaults count, so that a new parameter with a neutral
        default leaves every earlier run valid; `episodes` does not, so that raising it continues
        a run.
        """
        return _digest(self.model_dump(exclude=NOT_TRAINING, exclude_defaults=True))


NOT_VARIANT = {"experiment", "profile", "agents", "seeds", "episodes", "variations"}
MACHINE = {"device", "learner", "emulator_processes"}  # what computes a run is no part of it
NOT_VARIANT |= MACHINE
NOT_TRAINING = NOT_VARIANT | {"snapshot_games", "evaluation_games", "evaluation_epsilon"}
EVALUATED_BESIDES = {"evaluation_difficulties", "evaluation_stickiness"}
NOT_TRAINING |= EVALUATED_BESIDES


def _variation(params: Parameters, label: str) -> Parameters:
    """`params` with one of their variations put on top."""
    values = {**params.model_dump(), "variations": {}, **params.variations[label]}
    try:
        return Parameters.model_validate(values)
    except ValidationError as error:
        raise _key_error("variations", label, _one_line(error, {})) from None


def _digest(values: Any) -> str:
    return hashlib.sha256(json.dumps(values, sort_keys=True).encode()).hexdigest()


def _key_error(key: str, value: Any, why: str) -> ValueError:
    return ValueError(f"{key}: {shown(value)} is not allowed: {why}")


class Values(dict[str, Any]):
    """Keys and values of a parameter file and its bases; `files` has the base of each that is from
    one."""

    files: dict[str, Path]


def _unknown_key(key: str) -> str:
    nearest = difflib.get_close_matches(key, Parameters.model_fields, n=1)
    hint = f"did you mean {nearest[0]!r}?" if nearest else "see params/ for the keys"
    return f"unknown key {shown(key)}: {hint}"


def _one_line(error: ValidationError, files: dict[str, Path]) -> str:
    """What pydantic found, as one line for people: key, value and what is allowed; the first five
    of many things."""
    lines = []
    for detail in error.errors()[:5]:
        key = ".".join(str(part) for part in detail["loc"])
        if detail["type"] == "extra_forbidden":
            lines.append(_unknown_key(key))
        elif detail["type"] == "missing":
            lines.append(f"key {key!r} is missing")
        else:
            message = detail["msg"].removeprefix("Value error, ")
            if key:  # else the validator of the whole has named it
                message = message[0].lower() + message[1:]
                message = f"{key}: {shown(detail['input'])} is not allowed: {message}"
            lines.append(message)
        named = str(detail["loc"][0]) if detail["loc"] else lines[-1].partition(":")[0]
        if named in files:
            lines[-1] += f" (it is in {files[named]})"
    more = error.error_count() - len(lines)
    return "; ".join([*lines, f"and {more:,} more"] if more else lines)


def parse(values: dict[str, Any], source: str) -> Parameters:
    """The parameters that `values` hold; `source` (a file's name) begins every error's line."""
    try:
        return Parameters.model_validate(values)
    except ValidationError as error:
        files = values.files if isinstance(values, Values) else {}
        raise ParameterError(f"{source}: {_one_line(error, files)}") from None


def stored_parameters(folder: Path, overrides: dict[str, Any] | None = None) -> Parameters:
    """The parameters of a stored run, with `overrides` on top.

    Those of MACHINE are the defaults: another machine may have trained the run. Raises
    ParameterError.
    """
    path = folder / STORED
    given = parse({**read_values(path), **(overrides or {})}, str(path))
    fields = Parameters.model_fields
    return given.model_copy(update={key: fields[key].default for key in MACHINE})


def read_values(path: Path) -> Values:
    """The keys and values of a YAML file, on top of those of the files that its `base` names, from
    the first to the last, but for their `experiment`; their paths are relative to its own."""
    return _read_values(path, (), [])


def _read_values(path: Path, above: tuple[Path, ...], read: list[Path]) -> Values:
    """`above` are the files on the way to this one, `read` is of all so far: two bases of two bases
    each, and so on, are a thousand after ten floors."""
    read.append(path)
    if len(read) > MOST_BASES:
        raise ParameterError(f"{read[0]}: base: more than {MOST_BASES} files are behind this one")
    values = _read_file(path)
    given = values.pop("base", [])
    names = [given] if isinstance(given, str) else given
    if not isinstance(names, list) or not all(_is_name(name) for name in names):
        raise ParameterError(
            f"{path}: base: {shown(given)} is not allowed: must be a file, or a list"
        )
    merged = Values()
    merged.files = {}
    for name in names:
        base = path.parent / name
        if any(base.resolve() == other.resolve() for other in (path, *above)):
            raise ParameterError(f"{path}: base: {name!r} is not allowed: it is based on this file")
        if not base.is_file():
            raise ParameterError(f"{path}: base: {name!r} is not allowed: there is no {base}")
        inherited = _read_values(base, (path, *above), read)
        inherited.pop("experiment", None)
        merged.update(inherited)
        merged.files |= {key: inherited.files.get(key, base) for key in inherited}
    merged.update(values)
    for key in values:
        merged.files.pop(key, None)
    return merged


def _is_name(value: Any) -> bool:
    return isinstance(value, str) and value.isprintable()


def _read_file(path: Path) -> dict[str, Any]:
    try:
        if path.exists() and not (path.is_file() or path.is_dir()):  # a pipe may never say a word
            raise ParameterError(f"{path}: must be a regular file")
        with path.open("rb") as file:
            data = file.read(LARGEST_FILE + 1)
        if len(data) > LARGEST_FILE:
            raise ParameterError(f"{path}: a parameter file has {LARGEST_FILE:,} bytes at most")
        values = _plain_yaml(data.decode("utf-8"))
    except OSError as error:
        why = f"{path}: {str(error.strerror).lower()}"
        raise ParameterError(why + (_nearest(path) if not path.exists() else "")) from None
    except (YAMLError, UnicodeDecodeError) as error:
        raise ParameterError(f"{path}: " + _yaml_message(error)) from None
    if not isinstance(values, dict) or not all(isinstance(key, str) for key in values):
        raise ParameterError(f"{path}: expected lines of 'key: value'")
    return values


class _Composer(Composer):
    """Refuses what a few lines can hide a million values in, or more floors than Python has room
    for on its stack, before it is built; and tags, for which no parameter has a use."""

    def compose_node(self, parent: Any, index: Any) -> Any:
        event, problem = self.parser.peek_event(), None
        if event.anchor is not None:  # an alias has its anchor's
            problem = f"an anchor or alias ({event.anchor}) is not allowed: write the value itself"
        elif event.tag is not None:
            problem = f"a tag ({event.tag}) is not allowed: write the value alone"
        elif self.depth > DEEPEST:
            problem = f"more than {DEEPEST} lists and mappings within one another"
        elif isinstance(event, ScalarEvent) and len(event.value) > LONGEST_VALUE:
            problem = f"a value of more than {LONGEST_VALUE} characters"
        elif parent is not None and index is None and not isinstance(event, ScalarEvent):
            problem = "a key must be a name"
        if problem:
            raise ComposerError(None, None, problem, event.start_mark)
        return super().compose_node(parent, index)


class _Constructor(SafeConstructor):
    """Says where a value is that looks like a date or a number and is none."""

    def construct_object(self, node: Any, deep: bool = False) -> Any:
        try:
            return super().construct_object(node, deep)
        except ValueError as error:
            problem = f"{shown(node.value)} is not allowed: {error}"
            raise ConstructorError(None, None, problem, node.start_mark) from None


def _plain_yaml(text: str) -> Any:
    """The value of a YAML document; what it looks like is what it is. Raises YAMLError."""
    return copy.deepcopy(_parsed(text))  # which whoever asked may change


@lru_cache  # by the text: most files have the same bases, and all are asked for again and again
def _parsed(text: str) -> Any:
    yaml = YAML(typ="safe", pure=True)
    yaml.Composer, yaml.Constructor = _Composer, _Constructor
    return yaml.load(text)


def _nearest(path: Path) -> str:
    """A hint at a file that a wrong path may mean: one beside it, or an experiment's by name."""
    found = {file.stem: file for folder in ("params", path.parent) for file in _files(Path(folder))}
    near = difflib.get_close_matches(path.stem, found, n=1)
    return f"; did you mean {found[near[0]]}?" if near else ""


def _files(folder: Path) -> list[Path]:
    return sorted(folder.glob("*.yaml"))


def files_behind(path: Path) -> list[Path]:
    """A parameter file, and those that it is based on."""
    given = _read_file(path).get("base", [])
    names = [given] if isinstance(given, str) else given
    return [path, *(file for name in names for file in files_behind(path.parent / name))]


def _yaml_message(error: Exception) -> str:
    problem = getattr(error, "problem", None) or str(error).splitlines()[0]
    problem = problem.split(" with value")[0]  # "found duplicate key "gamma" with value ..."
    mark = getattr(error, "problem_mark", None)
    return f"line {mark.line + 1}: {problem}" if mark else problem


STORED = "params.yaml"  # of a run: every parameter, resolved


def load(path: Path | str, overrides: dict[str, Any] | None = None) -> Parameters:
    """Parameters from a file, named after it, or from a stored run's params.yaml, with `overrides`
    put on top.

    An override that changes anything but which agents and seeds are run moves
    the experiment to a name of its own, `<experiment>+<hash8>`: what the file describes is never
    touched.
    """
    path = Path(path)
    values = read_values(path)
    named = values.setdefault("experiment", path.stem)
    if named != path.stem and path.name != STORED:
        raise ParameterError(
            f"{path}: experiment: {shown(named)} is not allowed: "
            f"must be the file's name, {path.stem!r}"
        )
    base = parse(values, str(path))
    changed = parse({**values, **(overrides or {})}, f"{path} with overrides")
    for key in ("experiment", "profile", *sorted(EVALUATED_BESIDES)):
        now, was = getattr(changed, key), getattr(base, key)
        if now != was:
            hint = "; `evaluate` plays a stored run otherwise" if key in EVALUATED_BESIDES else ""
            raise ParameterError(
                f"{key}: {shown(now)} is not allowed: {path} has {shown(was)}{hint}"
            )
    return _renamed(base, changed)


def variants(params: Parameters) -> dict[str, Parameters]:
    """{label: parameters} of an experiment's variations; the experiment itself, if it has none.

    A variation is what `load` with the same overrides would give.
    """
    if not params.variations:
        return {params.experiment: params}
    return {label: _renamed(params, _variation(params, label)) for label in params.variations}


def _renamed(base: Parameters, changed: Parameters) -> Parameters:
    """`changed` under a name of its own, if it differs from `base` in more than what is picked."""
    picks = {"agents", "seeds", "device", "learner", "emulator_processes", "variations"}
    if changed.model_dump(exclude=picks) == base.model_dump(exclude=picks):
        return changed
    name, _, renamed = base.experiment.partition("+")
    # what differs from a changed experiment must not bear the name of what differs from its file
    variant = _digest([renamed, changed.variant()])[:8] if renamed else changed.variant()
    return changed.model_copy(update={"experiment": f"{name}+{variant}"})


def resolve(values: dict[str, Any], folder: Path) -> Parameters:
    """Parameters from a notebook's values: `experiment` and `profile` name a file in `folder`
    (the project's params/), and the other values are put on top of it, as `load` does.

    An experiment without a file there must bring all that differs from the defaults, and name its
    game, lest a name that is spelt wrong trains something else. A `base` comes from `papermill -f
    FILE`, which knows nothing of bases: it must be that of the file in `folder`.
    """
    values, base = dict(values), values.get("base")
    values.pop("base", None)
    given = parse(values, "notebook parameters")
    profile = "" if given.profile == "full" else given.profile
    path = folder / profile / f"{given.experiment}.yaml"
    if base is not None and (not path.exists() or _read_file(path).get("base") != base):
        raise ParameterError(
            f"base: {shown(base)} is not allowed: {path} has another, and a notebook takes no "
            "other files with bases; `python -m atari_dqn train FILE` does"
        )
    if path.exists():
        return load(path, values)
    names = [file.stem for file in folder.glob("*.yaml")]
    nearest = difflib.get_close_matches(given.experiment, names, n=1, cutoff=0.85)
    why = f"did you mean {nearest[0]!r}?" if nearest else "and no game is given"
    if given.experiment in names:
        why = "there is with profile full"
    if nearest or "game" not in values:
        raise ParameterError(
            f"experiment: {given.experiment!r} is not allowed: there is no {path}; {why}"
        )
    return given


def conditions(params: Parameters) -> list[Parameters]:
    """What a finished run is evaluated with: as it was trained, then at the difficulties, and then
    with the sticky actions, that it asks for besides."""
    changes: list[dict[str, Any]] = [
        *({"difficulty": switches} for switches in params.evaluation_difficulties),
        *({"sticky_actions": probability} for probability in params.evaluation_stickiness),
    ]
    changed = (params.model_copy(update=change) for change in changes)
    return [params, *(each for each in changed if each != params)]


def pick(params: Parameters, agent: str | None, seed: int | None) -> Parameters:
    """The same experiment with one agent and one seed only, where they are given."""
    if agent is not None and agent not in AGENT_NAMES:
        raise ParameterError(f"agent: {shown(agent)} is not allowed: {hint(agent, AGENT_NAMES)}")
    if seed is not None and (type(seed) is not int or not 0 <= seed <= MOST):
        raise ParameterError(
            f"seed: {shown(seed)} is not allowed: must be a whole number from 0 to {MOST}"
        )
    agents = params.agents if agent is None else [agent]
    seeds = params.seeds if seed is None else [seed]
    return params.model_copy(update={"agents": agents, "seeds": seeds})


def parse_overrides(texts: list[str]) -> dict[str, Any]:
    """['KEY=VALUE', ...], as the command line takes them; values are read as YAML."""
    overrides: dict[str, Any] = {}
    for text in texts:
        key, equals, value = text.partition("=")
        given = f"--set {shown(text)}"
        if not equals or not key:
            raise ParameterError(f"{given}: expected KEY=VALUE")
        if key not in Parameters.model_fields:
            raise ParameterError(f"{given}: {_unknown_key(key)}")
        if key in overrides:
            raise ParameterError(f"{given}: {key} is set twice")
        if len(value) > LARGEST_FILE:
            raise ParameterError(f"{given}: a value has {LARGEST_FILE:,} characters at most")
        try:
            overrides[key] = _plain_yaml(value)
        except YAMLError as error:
            raise ParameterError(f"{given}: {_yaml_message(error)}") from None
    return overrides


def title(agent: str) -> str:
    """An agent's name in prose: Double DQN is that of double_dqn."""
    return " ".join("DQN" if word == "dqn" else word.capitalize() for word in agent.split("_"))


def text(params: Parameters) -> str:
    """Every parameter, resolved, as YAML with its unit beside it."""
    return "".join(
        f"{key}: {json.dumps(getattr(params, key))}  # {field.description}\n"
        for key, field in Parameters.model_fields.items()
    )
