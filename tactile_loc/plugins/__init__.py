"""The built-in components, registered by the same entry point and hook as anybody else's."""

from __future__ import annotations

from tactile_loc.plugin import ComponentSpec, hookimpl

_HERE = "tactile_loc.plugins"


@hookimpl
def tactile_loc_components() -> list[ComponentSpec]:
    """Return the built-in components of all seven slots."""
    return [
        ComponentSpec("sensor", "gelslim", f"{_HERE}.sensors.presets:GelSlim", "GelSlim with the paper's camera"),
        ComponentSpec("sensor", "gelsight-mini", f"{_HERE}.sensors.presets:GelSightMini", "GelSight Mini, nominal"),
        ComponentSpec("sensor", "digit", f"{_HERE}.sensors.presets:Digit", "DIGIT, nominal"),
        ComponentSpec("sensor", "file", f"{_HERE}.sensors.file:FileSensor", "any sensor described by a TOML file"),
        ComponentSpec(
            "sensor",
            "calibrated",
            f"{_HERE}.sensors.calibrated:CalibratedSensor",
            "a sensor that was calibrated for images",
            requires="tactile-loc[learned]",
        ),
        ComponentSpec(
            "renderer",
            "heightmap",
            f"{_HERE}.renderers.heightmap:HeightmapRenderer",
            "one height map a rotation, all translations cut from it; fastest",
        ),
        ComponentSpec(
            "renderer", "raycast", f"{_HERE}.renderers.raycast:RaycastRenderer", "exact ray casting (open3d)"
        ),
        ComponentSpec(
            "renderer",
            "zbuffer",
            f"{_HERE}.renderers.zbuffer:ZBufferRenderer",
            "exact, triangle by triangle, a pose at a time",
        ),
        ComponentSpec(
            "renderer",
            "pyrender",
            f"{_HERE}.renderers.pyrender.renderer:PyrenderRenderer",
            "OpenGL through EGL, headless, as in the paper",
        ),
        ComponentSpec("grid", "face", f"{_HERE}.grids.face:FaceGrid", "x, y and yaw on one face, optional small tilts"),
        ComponentSpec("grid", "hopf", f"{_HERE}.grids.hopf:HopfGrid", "all rotations (Hopf/HEALPix) times the plane"),
        ComponentSpec(
            "encoder",
            "pixel",
            f"{_HERE}.encoders.pixel:PixelEncoder",
            "direct comparison of contact shapes, no training",
        ),
        ComponentSpec(
            "encoder",
            "moco",
            f"{_HERE}.encoders.moco.encoder:MocoEncoder",
            "learned by contrast in simulation, for one object",
            requires="tactile-loc[learned]",
        ),
        ComponentSpec("matcher", "dense", f"{_HERE}.matchers.dense:DenseMatcher", "exact, one matrix product"),
        ComponentSpec("matcher", "faiss", f"{_HERE}.matchers.faiss:FaissMatcher", "faiss: exact (flat) or approximate"),
        ComponentSpec("refiner", "none", f"{_HERE}.refiners.none:NoRefiner", "the grid pose as it is"),
        ComponentSpec("refiner", "icp", f"{_HERE}.refiners.icp:IcpRefiner", "point-to-plane ICP (open3d)"),
        ComponentSpec(
            "refiner",
            "filterreg",
            f"{_HERE}.refiners.filterreg.refiner:FilterRegRefiner",
            "point-to-plane EM with a Gaussian mixture, as in the paper; many candidates at once",
        ),
        ComponentSpec(
            "refiner",
            "kiss-icp",
            f"{_HERE}.refiners.kiss:KissIcpRefiner",
            "point-to-point ICP with a robust kernel (kiss-icp)",
            requires="tactile-loc[kiss]",
        ),
        ComponentSpec(
            "refiner",
            "render",
            f"{_HERE}.refiners.render.refiner:RenderRefiner",
            "renders the pose and compares every pixel; the most accurate on clean touches, slower",
        ),
        ComponentSpec(
            "fuser",
            "product",
            f"{_HERE}.fusers.product:ProductFuser",
            "product of the touches' probabilities and the prior",
        ),
        ComponentSpec(
            "fuser",
            "kinematic",
            f"{_HERE}.fusers.kinematic:KinematicFuser",
            "contact or no contact only, whatever the touches show: the paper's baseline",
        ),
    ]
