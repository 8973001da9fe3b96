"""Project a located object into the sensor's image with OpenCV: camera matrix, rvec and tvec."""

import argparse

import cv2
import numpy as np
import trimesh

from tactile_loc import Localizer
from tactile_loc.sensors.optics.lamps import OPTICS
from tactile_loc.sensors.optics.simulate import render_touches

parser = argparse.ArgumentParser(description=__doc__)
parser.add_argument("--picture", metavar="PATH", help="draw the image and the projected outline as PNG")
picture = parser.parse_args().picture

localizer = Localizer.create("head", sensor="gelslim")  # a pinhole camera; the other sensors are orthographic
touch = localizer.simulate(seed=9)[0]
geometry, shape = touch.geometry, touch.contact_shape
(photo,) = render_touches(
    shape.depth_m[None], [shape.press_depth_m], geometry, OPTICS["gelslim"], np.random.default_rng(0)
)
T = localizer.localize(touch).best.T_sensor_object

# The sensor frame is OpenCV's camera frame: x right, y down, z forward. OpenCV puts (0, 0) at the centre of the first
# pixel, and tactile-loc (0.5, 0.5). For an image that is enlarged k times, multiply by k before the half is subtracted.
k = 4
photo = cv2.resize(photo[..., ::-1], None, fx=k, fy=k, interpolation=cv2.INTER_CUBIC)  # OpenCV's colours are BGR
camera = np.array([[k * geometry.fx, 0, k * geometry.cx - 0.5], [0, k * geometry.fy, k * geometry.cy - 0.5], [0, 0, 1]])
rvec, tvec = cv2.Rodrigues(T[:3, :3])[0], T[:3, 3]  # radians; metres
print("rvec", rvec.ravel().round(4), "tvec", tvec.round(4))

# The outline of the contact is where the object's surface crosses the plane of the untouched gel.
mesh = trimesh.Trimesh(localizer.object.mesh.vertices_m, localizer.object.mesh.faces)
T_object_sensor = np.linalg.inv(T)
normal, origin_m = T_object_sensor[:3, 2], T_object_sensor[:3, :3] @ [0, 0, geometry.surface_m] + T_object_sensor[:3, 3]
segments_m = trimesh.intersections.mesh_plane(mesh, normal, origin_m)  # (N, 2, 3), in the object frame
pixels = cv2.projectPoints(segments_m.reshape(-1, 3), rvec, tvec, camera, None)[0].reshape(-1, 2, 2)

inside = [bool((segment >= 0).all() and (segment < photo.shape[0]).all()) for segment in pixels]
print(f"{len(pixels)} line segments, {sum(inside)} of them in the image")
if picture:
    for start, end in np.rint(pixels).astype(int):
        cv2.line(photo, tuple(map(int, start)), tuple(map(int, end)), (255, 255, 255), 2, cv2.LINE_AA)
    cv2.imwrite(picture, photo)
