"""Place the mesh and the touched points in one Open3D scene, and measure how far they are from each other."""

import argparse

import matplotlib.pyplot as plt
import numpy as np
import open3d as o3d

from tactile_loc import Localizer, save_figure
from tactile_loc.plugin.helpers import make_contact_cloud

parser = argparse.ArgumentParser(description=__doc__)
parser.add_argument("--picture", metavar="PATH", help="draw the scene as PNG")
picture = parser.parse_args().picture

localizer = Localizer.create("head", sensor="gelsight-mini")
touch = localizer.simulate(seed=2, noise="mild")[0]
best = localizer.localize(touch).best

# Open3D transforms points as tactile-loc does, here in metres: p_sensor = T_sensor_object @ p_object.
vertices_m, faces = localizer.object.mesh.vertices_m, localizer.object.mesh.faces
mesh = o3d.geometry.TriangleMesh(o3d.utility.Vector3dVector(vertices_m), o3d.utility.Vector3iVector(faces))
mesh.transform(best.T_sensor_object)

points_m, _ = make_contact_cloud(touch.contact_shape, touch.geometry, walls=False)  # in the sensor frame
cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points_m))
# o3d.visualization.draw([mesh, cloud]) opens a window. The rest of this script needs no window.

scene = o3d.t.geometry.RaycastingScene()
scene.add_triangles(o3d.t.geometry.TriangleMesh.from_legacy(mesh))
gap_mm = 1e3 * scene.compute_distance(o3d.core.Tensor(points_m.astype(np.float32))).numpy()
print(f"{len(points_m)} touched points, half of them within {np.median(gap_mm):.3f} mm of the mesh")

if picture:  # the side of the object that the sensor sees; the touched points are orange
    middle_m = mesh.get_center()
    eye_m = middle_m + np.array([0.02, -0.03, -0.09])
    rays = scene.create_rays_pinhole(fov_deg=40, center=middle_m, eye=eye_m, up=[0, -1, 0], width_px=640, height_px=640)
    hits = scene.cast_rays(rays)
    normals, distance = hits["primitive_normals"].numpy(), hits["t_hit"].numpy()
    hit = np.isfinite(distance)
    light = np.abs((normals * rays.numpy()[..., 3:]).sum(axis=2)) / np.linalg.norm(rays.numpy()[..., 3:], axis=2)
    image = np.ones((*hit.shape, 3))
    image[hit] = light[hit, None] * [0.50, 0.64, 0.80]
    seen_m = rays.numpy()[hit][:, :3] + distance[hit, None] * rays.numpy()[hit][:, 3:]
    seen = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(seen_m))
    touched = np.zeros(hit.shape, bool)
    touched[hit] = np.asarray(seen.compute_point_cloud_distance(cloud)) < 2e-4
    image[touched] = light[touched, None] * [0.95, 0.45, 0.15]
    figure, axes = plt.subplots(figsize=(5, 5), layout="constrained")
    axes.imshow(np.clip(image, 0, 1))
    axes.set_axis_off()
    save_figure(picture, figure)
