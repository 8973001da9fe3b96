"""The check of the project's English flags bad phrases, and passes good sentences."""

import check_prose
import pytest
from check_prose import LONGEST, find_faults, read_code

# For each pattern: a bad sentence, the reported phrase, and a similar good sentence.
SAMPLES = [
    ("The user is told why.", "is told", "The message tells the user why."),
    ("The path was said before.", "was said", "As the page says, the path comes first."),
    ("A mesh was given that is none.", "that is none", "A touch that is None is skipped."),
    ("All rows but for the last are read.", "but for", "It is meant not for one sensor but for all."),
    ("The poses are far from one another.", "one another", "Give one or another seed."),
    ("Each touch is located for itself.", "for itself", "The store makes room for its files."),
    ("Is that so, the run ends.", "Is that so", "If so, the run ends."),
    ("Unless the file says so, it is skipped.", "says so", "The file says some of it."),
    ("Use a ball, a pin or the like.", "the like", "Maximise the likelihood."),
    ("An object that nobody touched.", "nobody", "*nobody*: no touch is named."),
    ("The rest of what is located is kept.", "of what is located", "The table shows what was found."),
    ("What is refused is named.", "What is refused is ...", "What can go wrong: the file is absent."),
    ("What is refused has a name.", "What is refused has ...", "What is refused?"),
    ("Whoever installs it can use it.", "Whoever installs it can ...", "Whatever was damaged, it is rebuilt."),
    ("Is a circle wrong, edit its row.", "Is a circle wrong, ...", "Is a circle wrong?"),
    ("Should the run fail, start it again.", "Should the run fail, ...", "Have a reader read, and judge it."),
    ("word " * (LONGEST + 1), "word word word word ...", "word " * LONGEST),
]


@pytest.mark.parametrize(("bad", "phrase", "good"), SAMPLES, ids=[phrase for _, phrase, _ in SAMPLES])
def test_a_bad_sentence_is_flagged_and_a_good_one_passes(bad, phrase, good):
    assert f"'{phrase}'" in [fault.partition(": ")[0] for fault in find_faults(bad)]
    assert list(find_faults(good)) == []


def test_every_pattern_flags_a_sample():
    advice = {fault.partition(": ")[2] for bad, _, _ in SAMPLES for fault in find_faults(bad)}
    assert advice >= {*check_prose.PHRASES.values(), *check_prose.STARTS.values()}


def test_code_is_split_into_docstrings_messages_and_comments():
    code = '''"""A module.

Its second paragraph.
"""
KEY = "word"  # a trailing comment


# A comment of
# two lines
def act(path):
    """Act at once."""
    raise ValueError(f"{path} is not there: look at {path}")  # noqa: B904
    print(
        "one text "
        "in two lines"
    )
'''
    assert sorted((line, " ".join(text.split())) for line, text in read_code(code)) == [
        (1, "A module."), (3, "Its second paragraph."), (5, "a trailing comment"), (8, "A comment of two lines"),
        (11, "Act at once."), (12, "CODE is not there: look at CODE"), (14, "one text in two lines"),
    ]  # fmt: skip


@pytest.mark.parametrize("text", ["Poses are compared with each other.", "Poses are compared with one another."])
def test_faults_are_printed_with_their_location_and_fail(tmp_path, capsys, text):
    (tmp_path / "docs").mkdir()
    (tmp_path / "docs/page.md").write_text(f"# Page\n\n{text}\n")
    (tmp_path / "docs/cli.md").write_text("A generated page, as nobody writes it.\n")
    (tmp_path / "scripts").mkdir()
    (tmp_path / "scripts/tool.py").write_text(f'"""Fine."""\n# {text}\n')
    is_bad = "one another" in text
    assert check_prose.main(tmp_path) == is_bad
    lines = [f"{name}: 'one another': write 'each other'\n" for name in ("docs/page.md:3", "scripts/tool.py:2")]
    assert capsys.readouterr().out == "".join(lines) * is_bad
