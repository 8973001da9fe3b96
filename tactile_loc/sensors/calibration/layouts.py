"""Layouts of photos of a pressed ball, as other tools write them: recognised by the files, and converted to one folder.

Each layout has a function that looks at a folder or a file. It returns what it found, or None for another layout.
"""

import math
import re
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

import numpy as np

from tactile_loc.core.runtime.errors import CalibrationError
from tactile_loc.io.csv_tables import Row, read_number, read_table
from tactile_loc.io.images import IMAGE_SUFFIXES, read_photo, write_image
from tactile_loc.io.sensor_files import write_sensor_file
from tactile_loc.sensors.calibration.labels import Image
from tactile_loc.sensors.calibration.press_table import SENSOR, TABLE, write_table
from tactile_loc.sensors.calibration.untouched import is_named_untouched
from tactile_loc.sensors.reading.rectification import StatedView
from tactile_loc.store.arrays import load_npz, measure_npz
from tactile_loc.store.files import list_files, order_as_counted, read_json, read_text

HALF = 0.5  # pixel centres are at whole numbers in other tools, and at half integers in tactile-loc
SHEET = "labels.png"  # the picture of the circles that were found
SAME_BALL_MM = 1e-3
COLUMNS = {  # names of the columns of a table of circles, lower case; the first that exists is used
    "image": ("image", "img_name", "img_names", "img", "image_name", "filename", "file", "name", "path"),
    "x": ("center_x", "centre_x", "x_px", "center_x_px", "cx", "x"),
    "y": ("center_y", "centre_y", "y_px", "center_y_px", "cy", "y"),
    "radius": ("radius", "radius_px", "r_px", "r"),
}

CircleValues = tuple[float, float, float]


@dataclass(frozen=True, eq=False)
class PressSet:
    """Photos of presses in a known layout.

    `tool` names the layout, and `holds` what was found. `photos` maps a name for each photo to its file or its image
    (H, W, 3). `circles` maps names to the ball's circle: x, y and radius, pixels from the centre of the first pixel.
    If there are circles, the photos without one show the untouched gel. The set may state the ball and the scale.
    """

    tool: str
    holds: str
    photos: Mapping[str, Path | Image]
    circles: Mapping[str, CircleValues] = field(default_factory=dict)
    ball_radius_mm: float | None = None
    mm_per_px: float | None = None

    def describe(self) -> str:
        """Return a sentence that says which layout was recognised, and what is used."""
        used = "its circles are used" if self.circles else "the ball's circles are found in the photos"
        return f"recognised {self.tool}: {self.holds}; {used}"


def recognise_set(source: Path) -> PressSet:
    """Return the photos in a folder or file, in the first layout of LAYOUTS that fits.

    Raises CalibrationError when a layout fits but cannot be read, or when there is no photo.
    """
    if not source.exists():
        raise CalibrationError(f"there is no {source}; give a folder with photos of presses, or a video")
    for look in LAYOUTS:
        try:
            found = look(source)
        except (OSError, KeyError, ValueError, IndexError, TypeError, CalibrationError) as error:
            named = getattr(error, "filename", None)
            reason = getattr(error, "strerror", None) or error
            raise CalibrationError(
                f"{source} looks like {look.__name__.removeprefix('find_')} presses, but cannot be read "
                f"({f'{named}: ' if named else ''}{reason}); repair these files, or move the photos into a new folder"
            ) from error
        if found is not None:
            return found
    raise CalibrationError(f"there is no photo of a press in {source}; give PNG or JPEG files, or a video")


def convert_presses(
    source: Path,
    out: Path,
    ball_radius_mm: float | None = None,
    mm_per_px: float | None = None,
    view: StatedView | None = None,
) -> Path:
    """Convert presses with labels by another tool to a folder of presses `out`, and return the path of the table.

    The folder gets a sensor file of square pixels, `mm_per_px` mm wide, and circles in these pixels. `view` states how
    the camera sees the gel, if it does not see it straight. The default ball and scale are those that the set states.
    Raises CalibrationError when the source holds no labels, or when the ball or the scale is unknown.
    """
    found = recognise_set(source)
    if not found.circles:
        raise CalibrationError(f"{source} holds no circles of presses ({found.tool}); find them with `label_presses`")
    view = view or StatedView()
    ball_mm = ball_radius_mm or found.ball_radius_mm
    scale_mm = mm_per_px or (found.mm_per_px if view.gel_mm is None else None)
    if not (ball_mm and ball_mm > 0 and (view.gel_mm is not None or (scale_mm and scale_mm > 0))):
        raise CalibrationError(
            f"{source} does not state its ball and scale; give `ball_radius` and `mm_per_px`, positive numbers in mm"
        )
    out.mkdir(parents=True, exist_ok=True)
    rows: list[tuple[str, CircleValues | None]] = []
    for name, photo in found.photos.items():
        circle = found.circles.get(name)
        file = name.replace("/", "-")
        if isinstance(photo, Path):
            (out / file).write_bytes(photo.read_bytes())
        else:
            write_image(out / file, photo)
        rows.append((file, None if circle is None else (circle[0] + HALF, circle[1] + HALF, circle[2])))
    camera, photo_map = view.make_camera(read_photo(out / rows[0][0]).shape[:2], scale_mm)
    write_sensor_file(out / SENSOR, camera, photo_map)
    if photo_map is not None:
        rows = [(file, circle and photo_map.move_circle(circle)) for file, circle in rows]
    return write_table(out / TABLE, rows, ball_mm)


def find_gs_sdk(source: Path) -> PressSet | None:
    """Find background.png, and for each press a folder with gelsight.png and label.npz (center, radius).

    The folders may lie in folders for each ball. Then catalog.csv states the diameters (`diameter(mm)`).
    """
    labels = _list_inside(source, "label.npz")
    if not labels:
        return None
    photos: dict[str, Path | Image] = {path.name: path for path in _list_untouched(source)}
    circles = {}
    for label in labels:
        name = label.with_name("gelsight.png").relative_to(source).as_posix()
        values = load_npz(label)
        x, y = map(float, values["center"].ravel())
        photos[name], circles[name] = source / name, (x, y, float(values["radius"].item()))
        _require_file(source / name)
    catalog = source / "catalog.csv"
    rows = read_table(catalog, "press", CalibrationError).rows if catalog.is_file() else []
    balls_mm = {read_number(row, "diameter(mm)", CalibrationError) / 2 for row in rows}
    if balls_mm and max(balls_mm) - min(balls_mm) > SAME_BALL_MM:
        stated = ", ".join(f"{2 * radius_mm:g}" for radius_mm in sorted(balls_mm))
        raise CalibrationError(f"catalog.csv lists balls of {stated} mm; calibrate with one folder for each ball")
    holds = f"{len(labels)} folders with gelsight.png and label.npz"
    return PressSet("a gs_sdk set", holds, photos, circles, min(balls_mm, default=None))


def find_taxim(source: Path) -> PressSet | None:
    """Find a data pack (.npz) with imgs, f0, touch_center and touch_radius: the file, or a folder that holds it."""
    needed = {"imgs", "f0", "touch_center", "touch_radius"}
    packs = [source] if source.is_file() else list_files(source, {".npz"})
    pack = next((path for path in packs if path.suffix.lower() == ".npz" and needed & measure_npz(path).keys()), None)
    if pack is None:
        return None
    values = load_npz(pack, needed)
    photos: dict[str, Path | Image] = {"background.png": values["f0"].astype(np.uint8)}
    circles = {}
    presses = zip(values["imgs"].astype(np.uint8), values["touch_center"], values["touch_radius"], strict=True)
    for number, (image, (x, y), radius) in enumerate(presses):
        name = f"{number:04d}.png"
        photos[name], circles[name] = image, (float(x), float(y), float(radius))
    return PressSet("a Taxim set", f"{pack.name} with {len(circles)} images and circles", photos, circles)


def find_py3dcal(source: Path) -> PressSet | None:
    """Find annotations, blank_images and probe_images.

    The annotations are probe_data.csv (img_name, x_mm, y_mm, penetration_depth_mm), and, if the set was annotated,
    annotations.csv (also x_px, y_px) and metadata.json (px_per_mm, probe_radius_mm).
    """
    roots = (source, source / "sensor_calibration_data")
    root = next((path for path in roots if (path / "annotations" / "probe_data.csv").is_file()), None)
    if root is None:
        return None
    blanks = list_files(root / "blank_images", IMAGE_SUFFIXES) if (root / "blank_images").is_dir() else []
    table, metadata = (root / "annotations" / name for name in ("annotations.csv", "metadata.json"))
    photos: dict[str, Path | Image] = {path.relative_to(source).as_posix(): path for path in blanks}
    if not (table.is_file() and metadata.is_file()):
        presses = list_files(root / "probe_images", IMAGE_SUFFIXES)
        photos |= {path.relative_to(source).as_posix(): path for path in presses}
        return PressSet("a py3DCal set", f"{len(presses)} images in probe_images, without annotations", photos)
    stated = read_json(metadata)
    radius_mm, px_per_mm = float(stated["probe_radius_mm"]), float(stated["px_per_mm"])

    def read_radius_px(row: Row) -> float:
        depth_mm = min(abs(read_number(row, "penetration_depth_mm", CalibrationError)), radius_mm)
        return px_per_mm * math.sqrt(depth_mm * (2 * radius_mm - depth_mm))

    labelled, circles = _read_circles(table, list_files(root / "probe_images", IMAGE_SUFFIXES), read_radius_px)
    photos |= labelled
    return PressSet("a py3DCal set", f"{len(circles)} annotated images", photos, circles, radius_mm, 1 / px_per_mm)


def find_table(source: Path) -> PressSet | None:
    """Find a table whose columns name images and circles: see COLUMNS. FOTS writes csv/annotate.csv."""
    for table in _list_inside(source, "*.csv", 1):
        columns = _match_columns(table)
        if table.name == TABLE or columns.keys() != COLUMNS.keys():
            continue
        radius, names = columns["radius"], ", ".join(columns.values())
        read_radius_px = partial(read_number, name=radius, error=CalibrationError)
        photos, circles = _read_circles(table, _list_photos(source), read_radius_px)
        untouched = {path.name: path for path in _list_untouched(source)}
        tool = "a FOTS set" if table.name == "annotate.csv" else "a table of circles"
        where = table.relative_to(source).as_posix()
        return PressSet(tool, f"{where} with {len(circles)} circles (columns {names})", untouched | photos, circles)
    return None


def find_list(source: Path) -> PressSet | None:
    """Find a text file labels*.txt with lines `image (x, y) radius` or `image x y radius`, and the untouched gel."""
    tables = list_files(source, {".txt"}, "labels*.txt") if source.is_dir() else []
    if not tables:
        return None
    if len(tables) > 1:
        raise ValueError(f"there are {len(tables)} files labels*.txt; there must be one")
    photos: dict[str, Path | Image] = {path.name: path for path in _list_untouched(source)}
    circles, beside = {}, _list_photos(source, 0)
    for line in filter(str.strip, read_text(tables[0]).splitlines()):
        found = re.fullmatch(r"\s*(\S+?)\s+\(?\s*([^\s,()]+)[\s,]+([^\s,()]+)\s*\)?[\s,]+(\S+)\s*", line)
        if found is None:
            raise ValueError(f"{tables[0].name} has the line {line!r}; write: image (x, y) radius")
        name, x, y, radius = found.groups()
        photo = _find_photo(name, beside, tables[0])
        photos[photo.name], circles[photo.name] = photo, (float(x), float(y), float(radius))
    if not circles:
        raise ValueError(f"{tables[0].name} lists no press")
    return PressSet("a list of circles", f"{tables[0].name} with {len(circles)} lines", photos, circles)


def find_press_folders(source: Path) -> PressSet | None:
    """Find a folder for each press or for each kind of photo, and no presses beside these folders.

    If folders hold several photos of different names, those of the name that is in all folders are the presses.
    """
    beside = [path for path in _list_photos(source, 0) if not is_named_untouched(path.name)]
    inside = [path for path in _list_photos(source, 1) if path.parent != source]
    if beside or not inside:
        return None
    folders = {path.parent for path in inside}
    counts = Counter(path.name for path in inside)
    shared = [name for name, count in counts.items() if count == len(folders) > 2]
    if len(shared) > 1:
        raise ValueError(f"each folder holds {', '.join(sorted(shared))}; leave only the tactile photo in each folder")
    presses = [path for path in inside if not shared or path.name in shared or is_named_untouched(path.name)]
    photos = {path.relative_to(source).as_posix(): path for path in [*_list_untouched(source, 0), *presses]}
    return PressSet("one folder per press", f"{len(photos)} photos in {len(folders)} folders", photos)


def find_photos(source: Path) -> PressSet | None:
    """Find a flat folder of photos."""
    photos = {path.name: path for path in _list_photos(source, 0)}
    return PressSet("a folder of photos", f"{len(photos)} photos", photos) if photos else None


LAYOUTS = (find_gs_sdk, find_taxim, find_py3dcal, find_table, find_list, find_press_folders, find_photos)


def _list_inside(folder: Path, pattern: str, depth: int = 2) -> list[Path]:
    """Return the files in a folder, down to a depth of folders, whose name matches a pattern; no hidden ones."""
    if not folder.is_dir():
        return []
    found = [path for n in range(depth + 1) for path in folder.glob("/".join(["*"] * n + [pattern])) if path.is_file()]
    shown = [p for p in found if not any(part.startswith(".") for part in p.relative_to(folder).parts)]
    return sorted(shown, key=lambda path: (order_as_counted(path.parent), order_as_counted(path)))


def _list_photos(folder: Path, depth: int = 1) -> list[Path]:
    """Return the photos in a folder, down to a depth of folders, without the sheet of labels."""
    found = _list_inside(folder, "*", depth)
    return [path for path in found if path.suffix.lower() in IMAGE_SUFFIXES and path.name != SHEET]


def _list_untouched(folder: Path, depth: int = 0) -> list[Path]:
    """Return the photos in a folder that are named like the untouched gel."""
    return [path for path in _list_photos(folder, depth) if is_named_untouched(path.name)]


def _require_file(path: Path) -> None:
    if not path.is_file():
        raise CalibrationError(f"there is no {path}")


def _find_photo(name: str, images: Sequence[Path], table: Path) -> Path:
    """Return the image with a name in a table, which may lack the suffix, or have the folder of another machine."""
    last = re.split(r"[/\\]", name)[-1]
    found = next((path for path in images if last in (path.name, path.stem)), None)
    if found is None:
        raise CalibrationError(f"{table.name} lists {name}, but there is no such photo")
    return found


def _match_columns(table: Path) -> dict[str, str]:
    """Return the names of a table's columns by their meaning; empty if it is not a table."""
    try:
        columns = read_table(table, "press", CalibrationError).columns
    except CalibrationError:
        return {}
    by_lower = {name.lower(): name for name in columns}
    found = {meaning: next((by_lower[n] for n in names if n in by_lower), None) for meaning, names in COLUMNS.items()}
    return {meaning: name for meaning, name in found.items() if name is not None}


def _read_circles(
    table: Path, images: Sequence[Path], read_radius_px: Callable[[Row], float]
) -> tuple[dict[str, Path | Image], dict[str, CircleValues]]:
    """Return the photos and circles of a table, by the photos' names."""
    columns = _match_columns(table)
    photos: dict[str, Path | Image] = {}
    circles = {}
    for row in read_table(table, "press", CalibrationError).rows:
        photo = _find_photo(row[columns["image"]], images, table)
        x, y = (read_number(row, columns[axis], CalibrationError) for axis in ("x", "y"))
        photos[photo.name], circles[photo.name] = photo, (x, y, read_radius_px(row))
    return photos, circles
