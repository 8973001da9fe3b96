"""The built-in components. They are registered through the same entry point and hook as third-party plugins."""

from tactile_loc.plugin import ComponentSpec, hookimpl
from tactile_loc.plugin.helpers import INTERFACE_VERSION

FAISS, ICP, KISS = "tactile-loc[faiss]", "tactile-loc[icp]", "tactile-loc[kiss]"
LEARNED, RENDER = "tactile-loc[learned]", "tactile-loc[render]"
# slot, name, class, summary, and the extra to install
BUILT_IN = [
    ("sensor", "gelslim", "sensors.presets:GelSlim", "GelSlim with the paper's camera"),
    ("sensor", "gelsight-mini", "sensors.presets:GelSightMini", "GelSight Mini, nominal"),
    ("sensor", "digit", "sensors.presets:Digit", "DIGIT, nominal, with a flat gel"),
    ("sensor", "digit-curved", "sensors.presets:CurvedDigit", "DIGIT, nominal, with its curved gel"),
    ("sensor", "file", "sensors.file:FileSensor", "any sensor described by a TOML file"),
    ("sensor", "calibrated", "sensors.calibrated:CalibratedSensor", "a sensor calibrated from its images"),
    (
        "renderer",
        "heightmap",
        "renderers.heightmap:HeightmapRenderer",
        "one height map for each rotation, shared by all translations; fastest",
    ),
    ("renderer", "raycast", "renderers.raycast:RaycastRenderer", "exact ray casting (open3d)", RENDER),
    ("renderer", "zbuffer", "renderers.zbuffer:ZBufferRenderer", "exact, draws each triangle of each pose"),
    (
        "renderer",
        "pyrender",
        "renderers.pyrender.renderer:PyrenderRenderer",
        "OpenGL through EGL, headless, as in the paper",
        RENDER,
    ),
    ("grid", "face", "grids.face:FaceGrid", "x, y and yaw on one face, with optional small tilts"),
    ("grid", "hopf", "grids.hopf:HopfGrid", "all rotations (Hopf/HEALPix) times the plane"),
    ("grid", "whole", "grids.whole:WholeGrid", "all directions: the places that can touch first (default)"),
    ("encoder", "pixel", "encoders.pixel:PixelEncoder", "compares contact shapes directly, no training"),
    (
        "encoder",
        "moco",
        "encoders.moco.encoder:MocoEncoder",
        "contrastive network, trained in simulation for one object",
        LEARNED,
    ),
    ("matcher", "dense", "matchers.dense:DenseMatcher", "exact, one matrix product"),
    ("matcher", "faiss", "matchers.faiss:FaissMatcher", "faiss: exact (flat) or approximate", FAISS),
    ("refiner", "none", "refiners.none:NoRefiner", "returns the grid pose unchanged"),
    (
        "refiner",
        "joint",
        "refiners.joint:JointRefiner",
        "point-to-plane registration of one pose to all touches at once, with a covariance",
    ),
    ("refiner", "icp", "refiners.icp:IcpRefiner", "point-to-plane ICP (open3d)", ICP),
    (
        "refiner",
        "filterreg",
        "refiners.filterreg.refiner:FilterRegRefiner",
        "point-to-plane EM with a Gaussian mixture, as in the paper; all candidates at once",
    ),
    ("refiner", "kiss-icp", "refiners.kiss:KissIcpRefiner", "point-to-point ICP with a robust kernel (kiss-icp)", KISS),
    (
        "refiner",
        "render",
        "refiners.render.refiner:RenderRefiner",
        "renders the pose and compares every pixel; slower, most accurate on clean touches",
    ),
    ("fuser", "product", "fusers.product:ProductFuser", "product of the touches' probabilities and the prior"),
    ("fuser", "kinematic", "fusers.kinematic:KinematicFuser", "uses contact or no contact only: the paper's baseline"),
]


@hookimpl
def tactile_loc_components() -> list[ComponentSpec]:
    """Return the built-in components of all seven slots."""
    return [
        ComponentSpec(slot, name, f"{__name__}.{kind}", summary, "".join(requires), INTERFACE_VERSION)
        for slot, name, kind, summary, *requires in BUILT_IN
    ]
