"""What the benchmarks share: their command line, the objects that it names, and touches of these objects."""

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from tactile_loc import Localizer, ObjectModel, RobotTouches, SensorGeometry, load_object
from tactile_loc.plugin import registry
from tactile_loc.plugin.helpers import make_transform, rotation_about

ROOT = Path(__file__).parents[1]
TURNED_DEG, MOVED_MM = 8.0, 2.0  # errors of a candidate near the true pose


def make_parser(about: str | None, objects: Sequence[str]) -> argparse.ArgumentParser:
    """Return a parser of a command line that names objects. Its help is the benchmark's docstring."""
    parser = argparse.ArgumentParser(description=about, formatter_class=argparse.RawDescriptionHelpFormatter)
    named = f"FILE[:UNITS] or the name of a demo object; default: {' '.join(objects)}"
    parser.add_argument("objects", nargs="*", default=objects, help=named)
    return parser


def make_data_parser(about: str | None) -> argparse.ArgumentParser:
    """Return a parser of a command line that names the folder of the public sets of images."""
    parser = argparse.ArgumentParser(description=about, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=_find_data, default=str(ROOT.parent / "shared" / "data" / "tactile"))
    return parser


def _find_data(path: str) -> Path:
    if not Path(path).is_dir():
        raise argparse.ArgumentTypeError(f"there is no {path}; give --data")
    return Path(path)


def write_head(*names: str) -> str:
    """Return the head of a Markdown table."""
    return f"| {' | '.join(names)} |\n|{'---|' * len(names)}"


def split_asked(asked: str) -> tuple[str, Any]:
    """Return the path or the name of an object, and the unit of its file."""
    path, _, units = asked.partition(":")
    return path, units or "auto"


def name_asked(asked: str) -> str:
    """Return the name of an object: that of its file, without the suffix."""
    return Path(split_asked(asked)[0]).stem


def load_asked(asked: str) -> ObjectModel:
    """Return an object that the command line names."""
    return load_object(*split_asked(asked))


def open_asked(asked: str, **settings: Any) -> Localizer:
    """Return a localizer of an object that the command line names; `settings` are those of `Localizer.create`."""
    path, units = split_asked(asked)
    return Localizer.create(path, units=units, **settings)


def make_source(obj: ObjectModel, geometry: SensorGeometry, **errors: Any) -> RobotTouches:
    """Return touches that are drawn by ray casting, which no localizer uses. `errors` are those of RobotTouches."""
    return RobotTouches(obj, geometry, registry().create("renderer", "zbuffer", {}), **errors)


def move_near(T: np.ndarray, centroid_m: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Return a pose (4, 4), metres, rotated by 8 degrees about the centroid and moved by about 2 mm along each axis."""
    R = rotation_about(rng.normal(size=3), np.radians(TURNED_DEG))
    middle = T[:3, :3] @ centroid_m + T[:3, 3]
    return make_transform(R, middle - R @ middle + 1e-3 * MOVED_MM * rng.normal(size=3)) @ T
