"""The built-in components, registered by the same entry point and hook as anybody else's."""

from __future__ import annotations

from tactile_loc.plugin import INTERFACE_VERSION, ComponentSpec, hookimpl

LEARNED, KISS = "tactile-loc[learned]", "tactile-loc[kiss]"
# slot, name, class, what it is, and what to install for it
BUILT_IN = [
    ("sensor", "gelslim", "sensors.presets:GelSlim", "GelSlim with the paper's camera"),
    ("sensor", "gelsight-mini", "sensors.presets:GelSightMini", "GelSight Mini, nominal"),
    ("sensor", "digit", "sensors.presets:Digit", "DIGIT, nominal, its gel taken for flat"),
    ("sensor", "digit-curved", "sensors.presets:CurvedDigit", "DIGIT, nominal, with its curved gel"),
    ("sensor", "file", "sensors.file:FileSensor", "any sensor described by a TOML file"),
    ("sensor", "calibrated", "sensors.calibrated:CalibratedSensor", "a sensor that was calibrated for images", LEARNED),
    ("renderer", "heightmap", "renderers.heightmap:HeightmapRenderer",
     "one height map a rotation, all translations cut from it; fastest"),
    ("renderer", "raycast", "renderers.raycast:RaycastRenderer", "exact ray casting (open3d)"),
    ("renderer", "zbuffer", "renderers.zbuffer:ZBufferRenderer", "exact, triangle by triangle, a pose at a time"),
    ("renderer", "pyrender", "renderers.pyrender.renderer:PyrenderRenderer",
     "OpenGL through EGL, headless, as in the paper"),
    ("grid", "face", "grids.face:FaceGrid", "x, y and yaw on one face, optional small tilts"),
    ("grid", "hopf", "grids.hopf:HopfGrid", "all rotations (Hopf/HEALPix) times the plane"),
    ("grid", "whole", "grids.whole:WholeGrid",
     "every direction, by the places of the object that touch first: the default"),
    ("encoder", "pixel", "encoders.pixel:PixelEncoder", "direct comparison of contact shapes, no training"),
    ("encoder", "moco", "encoders.moco.encoder:MocoEncoder",
     "learned by contrast in simulation, for one object", LEARNED),
    ("matcher", "dense", "matchers.dense:DenseMatcher", "exact, one matrix product"),
    ("matcher", "faiss", "matchers.faiss:FaissMatcher", "faiss: exact (flat) or approximate"),
    ("refiner", "none", "refiners.none:NoRefiner", "the grid pose as it is"),
    ("refiner", "joint", "refiners.joint:JointRefiner",
     "point to plane on the object's surface, one pose against all touches at once; knows how sure it is"),
    ("refiner", "icp", "refiners.icp:IcpRefiner", "point-to-plane ICP (open3d)"),
    ("refiner", "filterreg", "refiners.filterreg.refiner:FilterRegRefiner",
     "point-to-plane EM with a Gaussian mixture, as in the paper; many candidates at once"),
    ("refiner", "kiss-icp", "refiners.kiss:KissIcpRefiner",
     "point-to-point ICP with a robust kernel (kiss-icp)", KISS),
    ("refiner", "render", "refiners.render.refiner:RenderRefiner",
     "renders the pose and compares every pixel; the most accurate on clean touches, slower"),
    ("fuser", "product", "fusers.product:ProductFuser", "product of the touches' probabilities and the prior"),
    ("fuser", "kinematic", "fusers.kinematic:KinematicFuser",
     "contact or no contact only, whatever the touches show: the paper's baseline"),
]  # fmt: skip


@hookimpl
def tactile_loc_components() -> list[ComponentSpec]:
    """Return the built-in components of all seven slots."""
    return [
        ComponentSpec(slot, name, f"{__name__}.{kind}", summary, "".join(requires), INTERFACE_VERSION)
        for slot, name, kind, summary, *requires in BUILT_IN
    ]
