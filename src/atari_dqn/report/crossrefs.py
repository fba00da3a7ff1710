"""The report's text between the notebooks and the typesetters: labels, numbers, completeness.

A label begins with what it names: fig- or vid- (both are figures), tbl-, sec-, eq-. Where a
figure or table has nothing to show yet, a division of class `absent` carries its label, so that
what refers to it stays whole.

Computed text refers to a label by `@fig-...`. The notebooks' own text is also read in JupyterLab,
which knows no labels: there a label hides in a comment, `<!-- {#fig-...} -->`, and a reference is a
link with the number that the last report gave it, `[Figure 7](#fig-...)`. `make numbers` renews
these.
"""

import json
import re
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

from ruamel.yaml import YAML

from atari_dqn.runs.files import RunError, project_root

NAMES = "results/report/names.json"  # what the last report called each label

KINDS = {"fig": "Figure", "vid": "Figure", "tbl": "Table", "sec": "Section", "eq": "Equation"}
_LABEL = re.compile(r'(?:\{#|\bid=")((?:fig|vid|tbl|sec|eq)-[a-z0-9-]+)( \.absent)?')
_REASON = re.compile(r"^:{3,} \{#([a-z0-9-]+) \.absent\}\n(?!:{3,}$)[^\n]*\S", re.MULTILINE)
_REFERENCE = re.compile(r"(?<![\w@-])@((?:fig|vid|tbl|sec|eq)-[a-z0-9]+(?:-[a-z0-9]+)*)")
_HEADING = re.compile(r"^(#+) (.*?)(?: \{([^{}\n]*)\})?$", re.MULTILINE)
_FENCED = re.compile(r"^(`{3,})[^`\n]*\n.*?^\1$", re.MULTILINE | re.DOTALL)
_EQUATION = re.compile(r"\$\$((?:(?!\$\$).)+)\$\$\s*\{#(eq-[a-z0-9-]+)\}", re.DOTALL)
_NUMBERED = re.compile(r"\{#(eq-[a-z0-9-]+) \.equation\}")
_FIGURE = re.compile(
    r"^!\[[^\n]*\]\([^\n]*\)\{#(fig-[a-z0-9-]+)( alt=\"[^\"\n]{20,}\")?", re.MULTILINE
)


_HIDDEN = re.compile(r"<!-- (\{[^{}]*\}) -->")
_LINK = re.compile(r"\[[^\[\]]+\]\(#((?:fig|vid|tbl|sec|eq)-[a-z0-9-]+)\)(?!\{)")


def from_notebook(text: str) -> str:
    """A notebook's own text with labels and references as pandoc and `finish` know them."""
    return _LINK.sub(r"@\1", _HIDDEN.sub(r"\1", text))


def finish(text: str) -> str:
    """Numbers what carries a label and turns every `@fig-...` into a link with its number.

    Raises RunError if a label is given twice or referred to without existing, or if a figure has
    no text alternative.
    """
    text = _EQUATION.sub(r"[$$\1$$]{#\2 .equation}", text)  # pandoc gives formulas no label
    found = [match[1] for match in _LABEL.finditer(text)]
    twice = [label for label, count in Counter(found).items() if count > 1]
    if twice:
        raise RunError(f"labels given twice: {', '.join(twice)}")
    silent = [match[1] for match in _FIGURE.finditer(text) if not match[2]]
    if silent:
        raise RunError(f"figures without a text alternative of 20 letters: {', '.join(silent)}")
    numbers = _numbers(text)
    unknown = {match[1] for match in _REFERENCE.finditer(text)} - set(numbers)
    if unknown:
        raise RunError(f"references to labels that do not exist: {', '.join(sorted(unknown))}")
    text = _NUMBERED.sub(
        lambda match: f'{{#{match[1]} .equation number="{numbers[match[1]]}"}}', text
    )
    text = _letter_appendices(text)
    return _REFERENCE.sub(lambda match: _link(match[1], numbers[match[1]]), text)


def names(text: str) -> dict[str, str]:
    """{label: "Figure 7"} of every label in the text, as references name it."""
    return {label: _name(label, number) for label, number in _numbers(text).items()}


def renumber(notebook: Path, names: dict[str, str]) -> bool:
    """Writes the names of labels into the links of a notebook's own text; whether any changed."""
    before = notebook.read_text(encoding="utf-8")
    after = _LINK.sub(lambda link: f"[{names.get(link[1], 'below')}](#{link[1]})", before)
    if after != before:
        notebook.write_text(after, encoding="utf-8")
    return after != before


def labels(text: str) -> set[str]:
    """Every label in the text, of what is there and of what is still absent."""
    return {match[1] for match in _LABEL.finditer(text)}


def check_completeness(text: str, path: Path) -> tuple[int, int]:
    """How many things the source report holds, and how many of them wait for runs in `text`.

    The file at `path` lists what the source report holds: {group: [{..., labels: [label, ...]}]}.
    Raises RunError if one has no place at all, or a place that is empty without a reason: the
    reason is in the place itself, or in the last badge of runs before it in its chapter.
    """
    absent = {match[1] for match in _LABEL.finditer(text) if match[2]}
    excused = {match[1] for match in _REASON.finditer(text)}
    for chapter in re.split(r"^# ", _FENCED.sub("", text), flags=re.MULTILINE):
        _, *badges = re.split(r"^::: \{\.badge", chapter, flags=re.MULTILINE)
        for part in badges:
            if ".partial" in part.partition("}")[0]:
                excused |= labels(part)
    shown = labels(text) - (absent - excused)
    groups = YAML(typ="safe", pure=True).load(path.read_text(encoding="utf-8"))
    gaps = [
        f"{group}: {entry['what']} ({label})"
        for group, entries in groups.items()
        for entry in entries
        for label in entry["labels"] or ["no label"]
        if label not in shown
    ]
    if gaps:
        raise RunError(f"{path.name} lists what the report does not show: {'; '.join(gaps)}")
    entries = [entry for group in groups.values() for entry in group]
    return len(entries), sum(not absent.isdisjoint(entry["labels"]) for entry in entries)


def _numbers(text: str) -> dict[str, str]:
    """{label: number}, counted in the order of the text; absent ones are not counted."""
    counts: Counter[str] = Counter()
    numbers = {}
    for match in _LABEL.finditer(text):
        kind = KINDS[match[1].partition("-")[0]]
        if kind == "Section":
            continue
        if match[2]:
            numbers[match[1]] = ""
            continue
        counts[kind] += 1
        numbers[match[1]] = str(counts[kind])
    return numbers | _section_numbers(text)


def _section_numbers(text: str) -> dict[str, str]:
    numbers = {}
    for heading, number in _headings(text):
        label = re.search(r"#(sec-[a-z0-9-]+)", heading[3] or "")
        if label:
            numbers[label[1]] = number
    return numbers


def _headings(text: str) -> Iterator[tuple[re.Match[str], str]]:
    """The numbered headings, with their numbers: 1, 1.1, ... as pandoc counts them, and A, A.1, ...
    from the first chapter of class `appendix` on.

    Raises RunError if a chapter without that class follows: paper counts on.
    """
    counts: list[int] = []
    lettered = False
    code = _FENCED.sub(lambda match: " " * len(match[0]), text)  # a comment in code is no heading
    for match in _HEADING.finditer(code):
        attributes = (match[3] or "").split()
        if ".unnumbered" in attributes:
            continue
        level = len(match[1])
        if level == 1 and lettered and ".appendix" not in attributes:
            raise RunError(f"a chapter after the appendices is none itself: {match[2]}")
        if level == 1 and not lettered and ".appendix" in attributes:
            counts, lettered = [], True
        counts = [*counts[:level], *[0] * (level - len(counts))]
        counts[level - 1] += 1
        first = chr(ord("A") + counts[0] - 1) if lettered else str(counts[0])
        yield match, ".".join([first, *map(str, counts[1:])])


def _letter_appendices(text: str) -> str:
    """Gives the headings of appendices their numbers, which pandoc then leaves alone."""
    parts, end = [], 0
    for heading, number in _headings(text):
        if number[0].isalpha():
            attributes = " ".join(filter(None, [heading[3], f'number="{number}"']))
            parts += [text[end : heading.start()], f"{heading[1]} {heading[2]} {{{attributes}}}"]
            end = heading.end()
    return "".join([*parts, text[end:]])


def _link(label: str, number: str) -> str:
    return f"[{_name(label, number)}](#{label}){{.ref}}"


def _name(label: str, number: str) -> str:
    kind = "Appendix" if number[:1].isalpha() else KINDS[label.partition("-")[0]]
    return f"{kind}\N{NO-BREAK SPACE}{number}" if number else f"{kind.lower()} still to come"


if __name__ == "__main__":
    known = json.loads((project_root() / NAMES).read_text(encoding="utf-8"))
    for path in sorted((project_root() / "notebooks").glob("[0-9]*.ipynb")):
        if renumber(path, known):
            print(f"renumbered: {path.name}")
