"""Fixtures of all tests, also those of the annexes in plugins_contrib.

They are small objects with known sizes, cameras, a store, result folders, the command line, and the folder of larger
data.
"""

from __future__ import annotations

import dataclasses
import gc
import math
import os
import subprocess
from collections import Counter
from collections.abc import Callable, Iterator
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
import trimesh
from cli_helpers import HANGS_S, Cli, command
from extras import find_missing_cause, find_missing_library
from report_helpers import UNFRIENDLY, write_recall, write_run, write_sweep
from tactile_loc_cli import console
from tactile_loc_cli.main import app
from typer.testing import CliRunner, Result

from tactile_loc.core.geometry.rigid import make_translation
from tactile_loc.core.objects.mesh import ObjectModel, TriangleMesh
from tactile_loc.core.objects.symmetry import SymmetryGroup
from tactile_loc.core.sensing.gel import Gel
from tactile_loc.core.sensing.scene import Scene
from tactile_loc.core.sensing.sensor_geometry import SensorGeometry
from tactile_loc.core.sensing.touch import Touch
from tactile_loc.locate.localizer import Localizer
from tactile_loc.locate.probability import temperature
from tactile_loc.locate.result.localization import Localization
from tactile_loc.plugins.renderers.heightmap import HeightmapRenderer
from tactile_loc.store.store import StageStore
from tactile_loc.testing.problems import LOPSIDED_CAMERAS
from tactile_loc.view import one_versus_several, pictures, pose_panel, raytracing

if TYPE_CHECKING:
    from matplotlib.figure import Figure

STORE = Path(__file__).parent / "tests" / "store"
SHARED_DATA = Path(__file__).parents[1] / "shared" / "data"

# Several processes run small tests at once, so more library threads would only compete for the cores.
for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(variable, "1")

MakeObject = Callable[..., ObjectModel]


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Sort the tests: first the store, then files with slow tests, then files with many tests.

    The tests of the store fork, which takes long in a large process. Short files come last, so that all processes
    finish at about the same time.
    """
    slow = {item.path for item in items if item.get_closest_marker("slow")}
    size = Counter(item.path for item in items)
    rank = {path: number for number, path in enumerate(sorted(size, key=lambda path: -size[path]))}
    items.sort(key=lambda item: (item.path.parent != STORE, item.path not in slow, rank[item.path]))


@pytest.hookimpl(wrapper=True)
def pytest_make_collect_report(collector: pytest.Collector) -> Iterator[None]:
    """Skip a file that imports a library of an extra that is not installed."""
    report = yield
    if report.outcome == "failed" and (missing := find_missing_library(str(report.longrepr))):
        report.outcome, report.longrepr = "skipped", (str(collector.path), 0, f"Skipped: {missing} is not installed")
    return report


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item: pytest.Item, call: pytest.CallInfo) -> Iterator[None]:
    """Skip a test that fails because a library of an extra is not installed."""
    report = yield
    if call.excinfo is not None and report.outcome == "failed":
        missing = find_missing_cause(call.excinfo.value)
        if missing is not None:
            report.outcome, report.longrepr = "skipped", (str(item.path), 0, f"Skipped: {missing} is not installed")
    return report


def pytest_collection() -> None:
    """Collect no garbage while tests are collected, because nearly everything stays."""
    gc.disable()


def pytest_collection_finish() -> None:
    """Exclude the collected tests from garbage collection, which makes it faster, as rarer collections do."""
    gc.collect()
    gc.freeze()
    gc.set_threshold(10_000)
    gc.enable()


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """The folder of larger meshes and real touches, which are not part of the project."""
    if not SHARED_DATA.is_dir():
        pytest.skip(f"there is no {SHARED_DATA}: it holds meshes and touches that are not part of the project")
    return SHARED_DATA


@pytest.fixture(autouse=True, scope="session")
def shipped_touches() -> Iterator[int]:
    """The number of touches for fitting a temperature; the tests use much fewer, because few depend on it."""
    shipped = temperature.TOUCHES
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(temperature, "TOUCHES", shipped // 20)
        yield shipped


@pytest.fixture(autouse=True, scope="session")
def unhurried_disk() -> Iterator[None]:
    """Skip fsync: no test cuts the power, so none needs to wait for the disk."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(os, "fsync", lambda descriptor: None)
        yield


@pytest.fixture(autouse=True, scope="session")
def small_pictures() -> Iterator[None]:
    """Draw pictures with few pixels and without layout, because most tests only check that a picture exists."""
    from matplotlib.layout_engine import ConstrainedLayoutEngine

    class LeftAlone(ConstrainedLayoutEngine):
        def execute(self, fig: Figure) -> None:
            pass

    with pytest.MonkeyPatch.context() as patch:
        for drawing in (pose_panel, one_versus_several):
            patch.setattr(drawing, "PIXELS", drawing.PIXELS // 4)
        patch.setattr(raytracing, "LIT_PX", raytracing.LIT_PX // 4)
        patch.setattr(pictures, "DPI", pictures.DPI // 2)
        patch.setattr(pictures, "LAYOUT", LeftAlone())
        yield


@pytest.fixture(autouse=True, scope="session")
def one_command() -> Iterator[None]:
    """Make the command of an application once, and not for each of its calls in this process."""
    import typer.testing

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(typer.testing, "_get_command", lru_cache(typer.testing._get_command))
        yield


@pytest.fixture(scope="module")
def arranged_pictures() -> Iterator[None]:
    """Draw pictures with the layout that users get, for the tests of the pictures themselves."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(pictures, "LAYOUT", "constrained")
        yield


@pytest.fixture(autouse=True, scope="session")
def quick_machine() -> Iterator[None]:
    """Write no lines of progress, which a busy machine would add to stderr."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(console, "EVERY_S", math.inf)
        yield


@pytest.fixture(scope="session")
def store_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of one store for the whole session, so that models are built once."""
    return tmp_path_factory.mktemp("store")


@pytest.fixture(scope="session")
def store(store_folder: Path) -> StageStore:
    """The store of the whole session."""
    return StageStore(store_folder)


@pytest.fixture
def cli(store_folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Cli:
    """Run the command in this process, in an empty folder."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("TACTILE_LOC_STORE", str(store_folder))

    def invoke(*words: object) -> Result:
        done = CliRunner().invoke(app, [*map(str, words)], prog_name="tactile-loc")
        skip_if_missing(done.exit_code, done.stderr)
        return done

    return invoke


def skip_if_missing(code: int, stderr: str) -> None:
    """Skip the test if a command ended because a library of an extra is not installed."""
    if code and (missing := find_missing_library(stderr)):
        pytest.skip(f"{missing} is not installed")


@pytest.fixture
def run_process(store_folder: Path, tmp_path: Path) -> Callable[..., subprocess.CompletedProcess[str]]:
    """Run the command in a process of its own; keywords are environment variables."""

    def run(*words: object, **environment: str) -> subprocess.CompletedProcess[str]:
        line = command(*words)
        variables = {**os.environ, "TACTILE_LOC_STORE": str(store_folder), **environment}
        done = subprocess.run(line, cwd=tmp_path, env=variables, capture_output=True, text=True, timeout=HANGS_S)
        skip_if_missing(done.returncode, done.stderr)
        return done

    return run


@pytest.fixture(scope="session")
def make_object() -> MakeObject:
    """Make an ObjectModel of a trimesh in metres: `make_object(solid, symmetry="none", name="part")`."""

    def make(solid: trimesh.Trimesh, symmetry: str = "none", name: str = "part") -> ObjectModel:
        mesh = TriangleMesh(np.array(solid.vertices), np.array(solid.faces, np.int64))
        return ObjectModel(name, mesh, SymmetryGroup.parse(symmetry, mesh.centroid_m))

    return make


@pytest.fixture(scope="session")
def make_box(make_object: MakeObject) -> MakeObject:
    """Make a box of the given sides in metres, its centre at the origin."""
    return lambda *sides_m, symmetry="none": make_object(trimesh.creation.box(sides_m), symmetry, "box")


@pytest.fixture(scope="session")
def box(make_box: MakeObject) -> ObjectModel:
    """A box of 30 x 20 x 12 mm without declared symmetry."""
    return make_box(0.030, 0.020, 0.012)


@pytest.fixture(scope="session")
def cylinder(make_object: MakeObject) -> ObjectModel:
    """A cylinder about z, 8 mm in radius and 30 mm long, with the declared symmetry zinf*x2."""
    return make_object(trimesh.creation.cylinder(0.008, 0.030, sections=64), "zinf*x2", "cylinder")


@pytest.fixture(params=list(LOPSIDED_CAMERAS))
def camera(request: pytest.FixtureRequest) -> SensorGeometry:
    """Non-square pixels, an off-centre principal point, more columns than rows."""
    return LOPSIDED_CAMERAS[request.param]


@pytest.fixture(scope="session")
def flat_camera() -> SensorGeometry:
    """Orthographic, 60 x 44 pixels, off centre: x in [-11.6, 12.4], y in [-8.4, 9.2] mm."""
    return SensorGeometry("orthographic", 60, 44, 2500.0, 2500.0, 29.0, 21.0, 0.010, 0.002)


@pytest.fixture(scope="session")
def press_block_elastically(make_box: MakeObject, flat_camera: SensorGeometry) -> Callable[[float, float], Touch]:
    """Press a block of the given sides, metres, 0.8 mm deep into a gel that is displaced far around it, too."""

    def press(x_m: float, y_m: float) -> Touch:
        sensor = dataclasses.replace(flat_camera, gel=Gel(thickness_m=5e-3)).press(8e-4)
        scene = Scene(make_box(x_m, y_m, 0.010), sensor, HeightmapRenderer())
        shape = scene.contact_shape(make_translation([1e-3, 0.0, 0.02]), 8e-4)
        displaced_m = np.ptp(np.nonzero(shape.contact)[1]) * sensor.pixel_pitch_m
        assert displaced_m > 1.4 * x_m
        return Touch(shape, sensor)

    return press


@pytest.fixture(scope="session")
def pinhole() -> SensorGeometry:
    """A pinhole with more columns than rows and unequal focal lengths; about 38 x 30 mm on the surface."""
    return SensorGeometry("pinhole", 64, 48, 42.0, 40.0, 31.0, 25.0, 0.025, 0.002)


@pytest.fixture(scope="session")
def make_scene() -> Callable[[ObjectModel, SensorGeometry], Scene]:
    """Make a scene rendered by the height map renderer."""
    return lambda obj, geometry: Scene(obj, geometry, HeightmapRenderer())


@pytest.fixture(scope="session")
def localizer(store: StageStore) -> Localizer:
    """The pin on a coarse grid."""
    return Localizer.create("pin", grid={"name": "face", "spacing_mm": 8}, store=store)


@pytest.fixture(scope="session")
def localization(localizer: Localizer) -> Localization:
    """One localisation, shared by the tests that write or draw it."""
    return localizer.localize(localizer.simulate(1, seed=0)[0])


@pytest.fixture(scope="session")
def run_folder(localizer: Localizer, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The result of one simulated touch; tests must not change it."""
    return write_run(tmp_path_factory.mktemp("run"), localizer)


@pytest.fixture(scope="session")
def unfriendly_run(localizer: Localizer, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The result of one simulated touch; the names of object and touch contain HTML."""
    obj = dataclasses.replace(localizer.object, name=UNFRIENDLY, notes=(UNFRIENDLY,))
    other = Localizer(localizer.config, obj, localizer.store)
    return write_run(tmp_path_factory.mktemp("unfriendly"), other, touch_name=UNFRIENDLY)


@pytest.fixture(scope="session")
def recall_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An evaluation of what `run` answers, with random results."""
    return write_recall(tmp_path_factory.mktemp("recall"))


@pytest.fixture(scope="session")
def sweep_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A sweep, with random results."""
    return write_sweep(tmp_path_factory.mktemp("sweep"))


@pytest.fixture(scope="module")
def one_thread() -> Iterator[None]:
    """Run torch on one thread, which trains small networks faster while other tests run."""
    torch = pytest.importorskip("torch")
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(threads)
