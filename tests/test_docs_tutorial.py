"""The blocks of docs/tutorial-plugin.md run in order and give the output that the page shows."""

import csv
import json
import os
import re
import subprocess
import sys
import sysconfig
import venv
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest
from page_helpers import read_page

PAGE = read_page("tutorial-plugin.md")
BLOCK = re.compile(r"(?:^`(?P<path>[\w/.-]+)`\n\n)?^```(?P<language>\w*)\n(?P<text>.*?)^```$", re.MULTILINE | re.DOTALL)
OFFLINE = {"PIP_NO_INDEX": "1", "PIP_NO_BUILD_ISOLATION": "0", "PIP_DISABLE_PIP_VERSION_CHECK": "1"}
FEWER = "from tactile_loc.locate.probability import temperature; temperature.TOUCHES //= 10"  # as in the other tests
COMMANDS = {
    "tactile-loc": f"{FEWER}\nfrom tactile_loc_cli.main import main\nif __name__ == '__main__':\n    main()",
    "pip": "import sys; from pip._internal.cli.main import main; sys.exit(main())",
}
LARGEST_MODULE = 40  # lines of code
LIKE_THE_PAGE = 0.3  # allowed relative difference of medians from those of the page


@dataclass(frozen=True)
class Block:
    """A block of the page: its language, its text, and the path of the file that it shows, if any."""

    language: str
    text: str
    path: str | None


def blocks() -> list[Block]:
    return [Block(m["language"], m["text"], m["path"]) for m in BLOCK.finditer(PAGE)]


def test_every_block_is_a_command_its_output_or_a_file():
    assert PAGE.count("\n```") == 2 * len(blocks())
    before = None
    for block in blocks():
        assert block.language in ("bash", "text", "python", "toml")
        assert (block.path is not None) == (block.language in ("python", "toml"))
        assert block.language != "text" or before == "bash"
        before = block.language


def test_the_refiner_is_short():
    (module,) = [block.text for block in blocks() if block.language == "python"]
    code = re.sub(r'""".*?"""', "", module, flags=re.DOTALL).splitlines()
    own = [line for line in code if line.strip() and not line.lstrip().startswith(("from ", "import ", "#"))]
    assert len(own) <= LARGEST_MODULE
    assert re.findall(r"tactile_loc[\w.]*", module) == ["tactile_loc.plugin"]


@pytest.fixture
def environment(tmp_path: Path) -> dict[str, str]:
    """A separate virtual environment that sees the packages installed here; nothing is downloaded."""
    folder = tmp_path / "venv"
    venv.create(folder, symlinks=True)
    python = folder / "bin" / "python"
    site = folder / "lib" / f"python{sys.version_info.major}.{sys.version_info.minor}" / "site-packages"
    ours = {sysconfig.get_path("purelib"), sysconfig.get_path("platlib")}
    (site / "ours.pth").write_text("".join(f"import site; site.addsitedir({folder!r})\n" for folder in sorted(ours)))
    for name, code in COMMANDS.items():
        script = folder / "bin" / name
        script.write_text(f"#!{python}\n{code}\n")
        script.chmod(0o755)
    path = os.pathsep.join([str(folder / "bin"), os.environ["PATH"]])
    inherited = {k: v for k, v in os.environ.items() if not k.startswith(("TACTILE_LOC", "PYTEST"))}
    return {**inherited, **OFFLINE, "PATH": path, "TACTILE_LOC_STORE": str(tmp_path / "store")}


@pytest.fixture
def empty(tmp_path: Path) -> Path:
    folder = tmp_path / "empty"
    folder.mkdir()
    return folder


@pytest.mark.slow
def test_the_tutorial_gives_the_output_that_it_shows(environment, empty):
    shown = ""
    for block in blocks():
        if block.path:
            (empty / block.path).write_text(block.text)
        elif block.language == "bash":
            done = subprocess.run(
                ["sh", "-e", "-c", block.text], cwd=empty, env=environment, capture_output=True, text=True, check=False
            )
            assert done.returncode == 0, block.text + done.stdout + done.stderr
            shown = done.stdout
        else:
            assert re.fullmatch(pattern(block.text), shown), f"the page shows\n{block.text}\nbut this came out\n{shown}"
    errors = json.loads((empty / "tactile-loc-result" / "result.json").read_text())["errors"]
    assert errors["best_m"] < errors["closest_in_grid_m"]
    shown_mm = re.search(r"falls from ([\d.]+) mm .* to ([\d.]+) mm. .*`joint` reaches ([\d.]+) mm", PAGE)
    assert shown_mm
    assert median_chosen_mm(empty / "sweep") == pytest.approx(
        dict(zip(("none", "pattern-search", "joint"), map(float, shown_mm.groups()), strict=True)), rel=LIKE_THE_PAGE
    )


def pattern(text: str) -> str:
    """A pattern of an output: "..." matches any text in a line, or any lines if alone; spaces do not matter."""
    return "".join(lines(text))


def lines(text: str) -> Iterator[str]:
    for line in text.splitlines():
        if line.strip() == "...":
            yield r"(?:.*\n)*?"
        else:
            yield r"[ ]*" + r"[ ]+".join(".*".join(map(re.escape, w.split("..."))) for w in line.split()) + r"[ ]*\n"


def median_chosen_mm(folder: Path) -> dict[str, float]:
    """The median error of each refiner of a sweep."""
    with (folder / "sweep.csv").open() as file:
        return {row["refiner"]: float(row["chosen_median_mm"]) for row in csv.DictReader(file)}
