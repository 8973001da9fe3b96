"""The scene in MuJoCo: an arm with a parallel gripper and two gels, a part, a clamp, and a plate with a hole.

World frame: the hole's mouth is at the origin, and z points up. Gripper frame: z points up, the fingers close along y,
and the origin is midway between the middles of the gels. Lengths are in metres, forces in newtons.
"""

import mujoco
import numpy as np
from shapes import Part, Points, make_hole

GEL_X_M, GEL_Z_M, GEL_THICK_M = 15.2e-3, 20.3e-3, 4e-3
CELLS_X, CELLS_Z = 2, 2  # the gel is a grid of boxes, so that an area touches in many points
OPEN_M = 16e-3  # from the gripper's middle to a gel of the open gripper
TIMESTEP_S = 1e-3
DENSITY = 1500.0  # of parts, kg/m^3
ARM_STIFFNESS = (2000.0, 2000.0, 3000.0, 5.0, 5.0, 5.0)  # N/m along x, y, z; N m/rad about z, y, x
ARM_DAMPING = (90.0, 90.0, 110.0, 0.2, 0.2, 0.2)
AXES = ("x", "y", "z", "yaw", "pitch", "roll")
GEL_CONTACT = 'solref="0.005 1" solimp="0.5 0.95 0.0006" friction="1.2 0.005 0.0001"'
HOLE_CONTACT = 'solref="0.002 1" solimp="0.95 0.99 0.0001" friction="0.25 0.005 0.0001"'
OPTIONS = (
    f'<option timestep="{TIMESTEP_S}" integrator="implicitfast" cone="elliptic" impratio="10" noslip_iterations="2"/>'
)
LOOK = (
    '<visual><headlight ambient=".45 .45 .45" diffuse=".5 .5 .5" specular=".1 .1 .1"/>'
    '<global offwidth="960" offheight="720"/> <map znear="0.01"/></visual>'
)
SKY = '<texture name="sky" type="skybox" builtin="flat" rgb1="1 1 1" rgb2="1 1 1" width="8" height="8"/>'
LIGHT = '<light pos="-0.2 -0.4 0.6" dir="0.3 0.6 -1" diffuse=".4 .4 .4"/>'
CLAMP = '<geom name="clamp" type="box" size=".004 .004 .002" contype="0" conaffinity="0" rgba="0 0 0 0"/>'
PALM = (
    '<inertial pos="0 0 .05" mass="0.8" diaginertia="2e-3 2e-3 2e-3"/>'
    '<geom type="box" pos="0 0 .062" size=".012 .034 .008" contype="0" conaffinity="0" rgba=".25 .28 .33 1"/>'
    '<geom type="cylinder" pos="0 0 .09" size=".014 .02" contype="0" conaffinity="0" rgba=".25 .28 .33 1"/>'
)
EQUALITIES = (
    '<weld name="clamp" body1="clamp" body2="part" relpose="0 0 0 1 0 0 0" active="false"/>'
    '<joint joint1="left" joint2="right" solref="0.002 1" solimp=".99 .999 .001"/>'
)


def build_model(part: Part, clearance_m: float) -> mujoco.MjModel:
    """Return the model of the scene. The hole is `clearance_m` wider than the part's shank."""
    return mujoco.MjModel.from_xml_string(write_xml(part, clearance_m))


def write_xml(part: Part, clearance_m: float) -> str:
    """Return the scene in MuJoCo's XML."""
    hole = make_hole(part.shank, clearance_m)
    meshes = [*_name_meshes("part", part.pieces), *_name_meshes("hole", hole)]
    assets = "".join(f'<mesh name="{name}" vertex="{_join(piece)}"/>' for name, piece in meshes)
    pieces = "".join(
        f'<geom type="mesh" mesh="part{k}" density="{DENSITY}" contype="1" conaffinity="2" rgba=".93 .6 .2 1"/>'
        for k in range(len(part.pieces))
    )
    walls = "".join(
        f'<geom type="mesh" mesh="hole{k}" contype="2" conaffinity="1" priority="1" {HOLE_CONTACT} '
        'rgba=".62 .66 .72 1"/>'
        for k in range(len(hole))
    )
    joints = "".join(
        f'<joint name="{name}" type="{"slide" if k < 3 else "hinge"}" axis="{axis}"/>'
        for k, (name, axis) in enumerate(zip(AXES, ("1 0 0", "0 1 0", "0 0 1", "0 0 1", "0 1 0", "1 0 0"), strict=True))
    )
    motors = "".join(
        f'<position joint="{name}" kp="{kp}" kv="{kv}"/>'
        for name, kp, kv in zip(AXES, ARM_STIFFNESS, ARM_DAMPING, strict=True)
    )
    fingers = _write_finger("left", -1) + _write_finger("right", 1)
    return "\n".join([
        "<mujoco>", '<compiler angle="radian"/>', OPTIONS, LOOK,
        f"<asset>{assets}{SKY}</asset>",
        "<worldbody>", LIGHT,
        f'<body name="plate">{walls}</body>',
        f'<body name="clamp" mocap="true">{CLAMP}</body>',
        f'<body name="part"><freejoint/>{pieces}</body>',
        f'<body name="gripper" gravcomp="1">{joints}{PALM}{fingers}</body>',
        "</worldbody>", f"<equality>{EQUALITIES}</equality>",
        f'<actuator>{motors}<motor name="left" joint="left"/><motor name="right" joint="right"/></actuator>',
        "</mujoco>",
    ])  # fmt: skip


def _write_finger(name: str, side: int) -> str:
    """Return a finger on the side -1 or 1 of the gripper; its joint closes the gripper with growing values."""
    x_m, z_m = GEL_X_M / CELLS_X, GEL_Z_M / CELLS_Z
    cells = "".join(
        f'<geom type="box" pos="{x_m * (i - (CELLS_X - 1) / 2):.7f} {side * GEL_THICK_M / 2} '
        f'{z_m * (k - (CELLS_Z - 1) / 2):.7f}" size="{x_m / 2:.7f} {GEL_THICK_M / 2} {z_m / 2:.7f}" contype="2" '
        f'conaffinity="1" priority="1" {GEL_CONTACT} rgba=".55 .8 .95 .55" mass="0"/>'
        for i in range(CELLS_X)
        for k in range(CELLS_Z)
    )
    return f"""
<body name="{name}" pos="0 {side * OPEN_M} 0" gravcomp="1">
  <joint name="{name}" type="slide" axis="0 {-side} 0" range="0 {OPEN_M}" damping="30"/>
  <inertial pos="0 0 0" mass="0.1" diaginertia="1e-4 1e-4 1e-4"/>
  <geom type="box" pos="0 {side * 9e-3} .018" size=".009 .005 .036" contype="0" conaffinity="0" rgba=".38 .42 .48 1"/>
  {cells}
</body>"""


def _name_meshes(kind: str, pieces: tuple[Points, ...]) -> list[tuple[str, Points]]:
    return [(f"{kind}{k}", piece) for k, piece in enumerate(pieces)]


def _join(points_m: Points) -> str:
    return " ".join(f"{value:.9g}" for value in np.ravel(points_m))
