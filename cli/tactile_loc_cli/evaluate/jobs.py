"""The objects, encoders and options of an evaluation, and the files and tables that it writes and shows."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from tactile_loc.core.runtime.errors import ConfigError
from tactile_loc.data import DEMO_OBJECTS
from tactile_loc.slots.registry import SLOTS, registry
from tactile_loc_cli import options
from tactile_loc_cli.console import say, say_table, say_written
from tactile_loc_cli.options import Noise, RunOptions, declare

if TYPE_CHECKING:
    from tactile_loc.core.objects.mesh import ObjectModel
    from tactile_loc.evaluation.simulated_touches import SimulatedTouches
    from tactile_loc.evaluation.text_tables import EvaluationResults
    from tactile_loc.io.config import RunConfig

Job = tuple["RunConfig", "ObjectModel"]
COMPARED = ("grid", "renderer", "matcher", "refiner", "fuser")
_PART = re.compile(r"(\d+)(?:\.\.(\d+))?")


@dataclass(frozen=True)
class Asked:
    """What is evaluated: the command's own options. Raises ConfigError for options that do not go together."""

    object: Annotated[
        list[str] | None,
        declare("--object FILE|DEMO", "Mesh file or demo object; may be repeated. Default: all demo objects."),
    ] = None
    touches: Annotated[
        list[Path] | None,
        declare(
            "--touches FILE|FOLDER",
            "Your own touches with known poses: a CSV table, the folder that `simulate` wrote, or a list of touches "
            "(.toml); may be repeated. Default: simulated touches.",
        ),
    ] = None
    count: Annotated[
        int | None,
        declare(
            "--count N",
            "Number of simulated examples for each object, noise and seed. Default: 20.",
            min=1,
            max=100_000,
        ),
    ] = None
    together: Annotated[
        str | None,
        declare(
            "--together RANGE",
            "Locate from these numbers of touches together: 1..7, or 1,2,3 (at most 20). Default: 1..3; of your own "
            "touches, all.",
        ),
    ] = None
    noise: Annotated[
        list[Noise] | None,
        declare("--noise <none|mild|strong>", "Noise of simulated touches; may be repeated. Default: none and strong."),
    ] = None
    seed: Annotated[
        list[int] | None, declare("--seed N", "Seed of the simulated touches; may be repeated. Default: 0.", min=0)
    ] = None
    encoder: Annotated[list[str] | None, declare("--encoder NAME", "Encoder; may be repeated. Default: pixel.")] = None
    out: Annotated[Path, declare("--out FOLDER", "Folder of the results.")] = Path("evaluation")
    store: options.Store = None

    def __post_init__(self) -> None:
        simulated = {"--noise": self.noise, "--count": self.count, "--seed": self.seed}
        for flag, given in simulated.items():
            if given and self.touches:
                raise ConfigError(
                    f"{flag} needs simulated touches; leave it out, or leave out --touches {self.touches[0]}"
                )

    @property
    def noises(self) -> tuple[Noise, ...]:
        """The given noises, each once."""
        return tuple(dict.fromkeys(self.noise or ()))

    @property
    def seeds(self) -> tuple[int, ...]:
        """The seeds, each once."""
        return tuple(dict.fromkeys(self.seed or (0,)))

    @property
    def numbers(self) -> tuple[int, ...] | None:
        """The given numbers of touches in ascending order. Raises ConfigError if they cannot be read."""
        from tactile_loc.evaluation.table import MOST_FUSED

        if self.together is None:
            return None
        numbers: set[int] = set()
        for part in self.together.replace(" ", "").split(","):
            match = _PART.fullmatch(part)
            first, last = (int(match[1]), int(match[2] or match[1])) if match else (0, 0)
            if not 1 <= first <= last <= MOST_FUSED:
                raise ConfigError(
                    f"--together cannot be {self.together!r}; give a range or a list of numbers from 1 to "
                    f"{MOST_FUSED}, such as 1..7 or 1,2,3"
                )
            numbers.update(range(first, last + 1))
        return tuple(sorted(numbers))


def list_jobs(given: RunOptions, asked: Asked, touches: SimulatedTouches | None) -> list[Job]:
    """Return every object with every encoder. `touches` are the simulated ones, if any.

    Bad input raises its error here, before the first evaluation.
    """
    from tactile_loc.io.config import parse_overrides, parse_settings
    from tactile_loc.io.meshes.mesh_files import load_object

    in_file = read_setting(given.config, "object", "path")
    paths = asked.object or ([in_file] if in_file else list(DEMO_OBJECTS))
    if given.symmetry is not None and len(paths) > 1:
        raise ConfigError("--symmetry needs a single object; give one --object")
    words = list(given.option or [])
    names: list[str | None] = [*asked.encoder] if asked.encoder else [None]
    overrides = parse_overrides(parse_settings(words)[1]).get("encoder", {})
    if touches is not None:
        given = dataclasses.replace(given, noise=Noise(touches.noise))
    jobs = []
    for path in dict.fromkeys(paths):
        each = [
            dataclasses.replace(given, object=path, encoder=name, option=choose_options(name, names, words, overrides))
            for name in dict.fromkeys(names)
        ]
        settings = [options.make_config(one) for one in each]
        chosen = settings[0].object
        obj = load_object(chosen.path, chosen.units, chosen.symmetry)
        for setting in settings:
            if touches is not None:
                options.open_localizer(setting, None, obj)
            jobs.append((setting, obj))
    _require_names(jobs)
    return jobs


def choose_options(
    encoder: str | None, encoders: Sequence[str | None], words: list[str], overrides: dict[str, Any]
) -> list[str]:
    """Return the options for one of several encoders, without the options that only other encoders have."""
    if encoder is None or len(set(encoders)) == 1 or not overrides:
        return words
    known = {name: set(registry().load("encoder", str(name)).Options.model_fields) for name in encoders}
    foreign = {
        option for option in overrides if option not in known[encoder] and any(option in k for k in known.values())
    }
    return [word for word in words if not any(word.replace(" ", "").startswith(f"encoder.{o}=") for o in foreign)]


def read_setting(path: Path | None, table: str, key: str) -> str | None:
    """Return a text from a table of the configuration file, or None if it is missing.

    If a slot is only a component's name instead of a table, return this name.
    """
    from tactile_loc.io.toml import read_toml

    found = {} if path is None else read_toml(path).get(table, {})
    value = found.get(key) if isinstance(found, dict) else found if table in SLOTS else None
    return value if isinstance(value, str) else None


def _require_names(jobs: Sequence[Job]) -> None:
    """Raise ConfigError if two objects have the same name."""
    found: dict[str, str] = {}
    for settings, obj in jobs:
        other = found.setdefault(obj.name, settings.object.path)
        if other != settings.object.path:
            raise ConfigError(
                f"{other} and {settings.object.path} are both called {obj.name}; rename one, or run them separately"
            )


def say_results(found: EvaluationResults, left: int, name_encoders: bool = True) -> None:
    """Show the tables of an evaluation that have a title. A column with a single encoder may be left out."""
    for title, _, table in found.tables:
        if title:
            column = table[0].index("encoder")
            if not name_encoders and len({row[column] for row in table[1:]}) == 1:
                table = [[*row[:column], *row[column + 1 :]] for row in table]
            say(title)
            say_table(table, left=left)
            say()


def summarise_results(found: EvaluationResults, written: Sequence[Path]) -> dict[str, Any]:
    """Show the paths of the files. Return an evaluation's document with these paths, without each example's numbers."""
    document = {name: value for name, value in found.document.items() if name != "examples"}
    return {**document, "written": say_written(written)}
