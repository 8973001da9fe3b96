"""The built-in components. They are registered through the same entry point and hook as third-party plugins."""

from tactile_loc.plugin import ComponentSpec, hookimpl
from tactile_loc.plugin.helpers import INTERFACE_VERSION

FAISS, ICP, KISS = "tactile-loc[faiss]", "tactile-loc[icp]", "tactile-loc[kiss]"
LEARNED, RENDER = "tactile-loc[learned]", "tactile-loc[render]"
# name, class, summary, and the extra to install; the folder of a class is named after its slot
BUILT_IN = [
    ("gelslim", "sensors.presets:GelSlim", "GelSlim with the paper's camera"),
    ("gelsight-mini", "sensors.presets:GelSightMini", "GelSight Mini, nominal"),
    ("gelsight-r15", "sensors.presets:GelSightR15", "GelSight R1.5, nominal"),
    ("digit", "sensors.presets:Digit", "DIGIT, nominal, with a flat gel"),
    ("digit-curved", "sensors.presets:CurvedDigit", "DIGIT, nominal, with its curved gel"),
    ("file", "sensors.file:FileSensor", "any sensor described by a TOML file"),
    ("calibrated", "sensors.calibrated:CalibratedSensor", "a sensor calibrated from its images"),
    ("heightmap", "renderers.heightmap:HeightmapRenderer", "one height map for all poses of a rotation; fastest"),
    ("raycast", "renderers.raycast:RaycastRenderer", "exact ray casting (open3d)", RENDER),
    ("zbuffer", "renderers.zbuffer:ZBufferRenderer", "exact, draws each triangle of each pose"),
    ("pyrender", "renderers.pyrender.renderer:PyrenderRenderer", "OpenGL (EGL), as in the paper", RENDER),
    ("face", "grids.face:FaceGrid", "x, y and yaw on one face, with optional small tilts"),
    ("hopf", "grids.hopf:HopfGrid", "all rotations (Hopf/HEALPix) times the plane"),
    ("whole", "grids.whole:WholeGrid", "all directions: the places that can touch first (default)"),
    ("pixel", "encoders.pixel:PixelEncoder", "compares contact shapes directly, no training"),
    ("moco", "encoders.moco.encoder:MocoEncoder", "contrastive network, trained for one object", LEARNED),
    ("dense", "matchers.dense:DenseMatcher", "exact, one matrix product"),
    ("faiss", "matchers.faiss:FaissMatcher", "faiss: exact (flat) or approximate", FAISS),
    ("none", "refiners.none:NoRefiner", "returns the grid pose unchanged"),
    ("joint", "refiners.joint:JointRefiner", "point-to-plane registration to all touches, with a covariance"),
    ("icp", "refiners.icp:IcpRefiner", "point-to-plane ICP (open3d)", ICP),
    ("filterreg", "refiners.filterreg.refiner:FilterRegRefiner", "point-to-plane EM, as in the paper"),
    ("kiss-icp", "refiners.kiss:KissIcpRefiner", "point-to-point ICP with a robust kernel (kiss-icp)", KISS),
    ("render", "refiners.render.refiner:RenderRefiner", "compares every pixel; slower, most accurate without noise"),
    ("product", "fusers.product:ProductFuser", "product of the touches' probabilities and the prior"),
    ("kinematic", "fusers.kinematic:KinematicFuser", "uses contact or no contact only: the paper's baseline"),
]


@hookimpl
def tactile_loc_components() -> list[ComponentSpec]:
    """Return the built-in components of all seven slots."""
    return [
        ComponentSpec(kind.split("s.")[0], name, f"{__name__}.{kind}", summary, "".join(requires), INTERFACE_VERSION)
        for name, kind, summary, *requires in BUILT_IN
    ]
