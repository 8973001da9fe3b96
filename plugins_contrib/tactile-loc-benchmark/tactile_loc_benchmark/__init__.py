"""A benchmark for tactile-loc: suites of objects and touch sources, on which any method locates the objects."""

from tactile_loc.plugin import CommandSpec, ComponentSpec, hookimpl
from tactile_loc.plugin.helpers import ComponentKind

INTERFACE = 2
FOLDER = "./plugins_contrib/tactile-loc-benchmark"  # of this package in a clone of tactile-loc, for pip
SOLVERS, CYCLEGAN = f"{FOLDER}[sources]", f"{FOLDER}[cyclegan]"
# name: class, summary, and what pip installs if a library is missing
SOURCES = {
    "simulated": ("simulated:RenderedTouches", "contact shapes by a renderer of tactile-loc", ""),
    "contact-mechanics-layer": (
        "layer:ElasticLayer",
        "contact shapes on an elastic layer, by ContactMechanics",
        SOLVERS,
    ),
    "tamaas-half-space": ("half_space:ElasticHalfSpace", "contact shapes on an elastic half-space, by tamaas", SOLVERS),
    "taxim": ("taxim_images:TaximImages", "images of a GelSight or GelSight Mini, by Taxim", SOLVERS),
    "tactile-mnist": (
        "cycle_gan:CycleGanImages",
        "images of a GelSight Mini, by the CycleGAN of tactile-mnist",
        CYCLEGAN,
    ),
    "ycb-slide": ("ycb_slide:YcbSlide", "recorded images of a DIGIT that slides over ten objects", ""),
    "gelslim-shapes": ("gelslim_shapes:GelslimShapes", "recorded images of a prism with known poses", SOLVERS),
}
# name: class and summary
METHODS = {
    "tactile-loc": ("ours:TactileLoc", "tactile-loc itself, with any settings"),
    "pixel-matching": (
        "pixel_matching:PixelMatching",
        "compares the pixels of contact shapes with drawn ones, without registration",
    ),
    "icp-starts": ("icp_starts:IcpFromStarts", "point-to-plane ICP from many starts"),
    "fpfh-ransac": ("feature_registration:FpfhRansac", "FPFH features and RANSAC (open3d), then ICP"),
    "fast-global-registration": (
        "feature_registration:FastGlobalRegistration",
        "FPFH features and fast global registration (open3d), then ICP",
    ),
    "transform-consensus": (
        "transform_consensus:TransformConsensus",
        "votes of pairs of touched points for poses, then verification and ICP",
    ),
    "particle-filter": ("particle_filter:ParticleFilter", "a particle filter that compares drawn contact shapes"),
}


@hookimpl
def register_commands() -> list[CommandSpec]:
    """Return the command of this package."""
    summary = "Compare methods on touches from several sources."
    return [CommandSpec("benchmark", summary, f"{__name__}.command:benchmark")]


@hookimpl
def register_kinds() -> list[ComponentKind]:
    """Return the two kinds of components that a benchmark combines."""
    return [
        ComponentKind(
            "touch-source",
            checks=f"{__name__}.checks.touch_sources",
            templates=__name__,
            example="contact shapes by ray casting, with errors of the press depth",
            usage="tactile-loc benchmark --source {name}",
        ),
        ComponentKind(
            "method",
            checks=f"{__name__}.checks.methods",
            templates=__name__,
            example="the best of many random poses",
            usage="tactile-loc benchmark --method {name}",
        ),
    ]


@hookimpl
def tactile_loc_components() -> list[ComponentSpec]:
    """Return the sources of touches and the methods. A class is imported on first use."""
    sources = [
        ComponentSpec("touch-source", name, f"{__name__}.sources.{target}", summary, requires, INTERFACE)
        for name, (target, summary, requires) in SOURCES.items()
    ]
    methods = [
        ComponentSpec("method", name, f"{__name__}.methods.{target}", summary, interface=INTERFACE)
        for name, (target, summary) in METHODS.items()
    ]
    return [*sources, *methods]
