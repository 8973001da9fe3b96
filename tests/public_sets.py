"""Writers of ball presses in the format of each supported public set."""

from pathlib import Path

import numpy as np
from press_sets import write_image

# x, y, radius; the origin is the centre of the first pixel; the last circle is slightly larger than the ball
CIRCLES = [(20.0, 31.0, 5.0), (40.0, 12.5, 7.0), (33.0, 35.0, 13.0)]


def write_gs_sdk(source: Path, images: np.ndarray, background: np.ndarray) -> Path:
    source.mkdir()
    write_image(source / "background.png", background)
    for number, image, circle in zip((2, 10, 11), images, CIRCLES, strict=True):
        folder = source / str(number)
        folder.mkdir()
        write_image(folder / "gelsight.png", image)
        np.savez(folder / "label.npz", center=np.array(circle[:2]), radius=np.array(circle[2]))
    return source


def write_taxim(source: Path, images: np.ndarray, background: np.ndarray) -> Path:
    source.mkdir()
    circles = np.array(CIRCLES)
    np.savez(
        source / "pack.npz", imgs=images, f0=background, touch_center=circles[:, :2],
        touch_radius=circles[:, 2], names=np.array(["a", "b", "c"]),
    )  # fmt: skip
    return source / "pack.npz"


def write_fots(source: Path, images: np.ndarray, _: np.ndarray) -> Path:
    (source / "gelsight").mkdir(parents=True)
    (source / "csv").mkdir()
    lines = ["img_names,center_x,center_y,radius"]
    for number, (image, circle) in enumerate(zip(images, CIRCLES, strict=True)):
        write_image(source / "gelsight" / f"{number}.png", image)
        lines.append(f"/somewhere/else/gelsight/{number}.png,{','.join(map(str, circle))}")
    (source / "csv" / "annotate.csv").write_text("\n".join(lines) + "\n")
    return source


def write_circles(source: Path, images: np.ndarray, background: np.ndarray) -> Path:
    source.mkdir()
    write_image(source / "background.png", background)
    lines = []
    for number, (image, (x, y, radius)) in enumerate(zip(images, CIRCLES, strict=True)):
        write_image(source / f"press_{number}.png", image)
        lines.append(f"press_{number}.png ({x}, {y}) {radius}")
    (source / "labels.txt").write_text("\n".join(lines) + "\n\n")
    return source


def write_py3dcal(source: Path, images: np.ndarray, background: np.ndarray) -> Path:
    """A set whose press depths give the circles' radii: a ball of 3 mm, 4 px/mm."""
    root = source / "sensor_calibration_data"
    for name in ("annotations", "blank_images", "probe_images"):
        (root / name).mkdir(parents=True)
    write_image(root / "blank_images" / "blank.png", background)
    probed, annotated = (
        ["img_name,x_mm,y_mm,penetration_depth_mm"],
        ["img_name,x_mm,y_mm,penetration_depth_mm,x_px,y_px"],
    )
    for number, (image, (x, y, radius)) in enumerate(zip(images, CIRCLES, strict=True)):
        name = f"{number}_X{number}.0Y2.0Z1.0.png"
        write_image(root / "probe_images" / name, image)
        depth = 3 - np.sqrt(max(9 - (radius / 4) ** 2, 0))
        probed.append(f"{name},{number},2,{depth}")
        annotated.append(f"{name},{number},2,{depth},{x},{y}")
    (root / "annotations" / "probe_data.csv").write_text("\n".join(probed) + "\n")
    (root / "annotations" / "annotations.csv").write_text("\n".join(annotated) + "\n")
    (root / "annotations" / "metadata.json").write_text('{"px_per_mm": 4.0, "probe_radius_mm": 3.0}')
    return source


PUBLIC_SETS = {  # with circles
    "gs_sdk": write_gs_sdk,
    "taxim": write_taxim,
    "fots": write_fots,
    "circles": write_circles,
    "py3dcal": write_py3dcal,
}
