"""Put a located pose into a GTSAM factor graph, with its covariance in GTSAM's order and axes."""

import argparse

import gtsam
import matplotlib.pyplot as plt
import numpy as np

from tactile_loc import Localizer, save_figure

parser = argparse.ArgumentParser(description=__doc__)
parser.add_argument("--picture", metavar="PATH", help="draw the standard deviations as PNG")
picture = parser.parse_args().picture


def swap_halves(covariance: np.ndarray, R: np.ndarray) -> np.ndarray:
    """Swap translations and rotations of a covariance (6, 6), and turn its axes by R (3, 3)."""
    J = np.kron([[0, 1], [1, 0]], R)
    return J @ covariance @ J.T


def make_noise(T: np.ndarray, covariance: np.ndarray) -> gtsam.noiseModel.Gaussian:
    """Return the noise of a pose T_frame_object (4, 4) with a covariance (6, 6) of tactile-loc.

    tactile-loc: first x, y, z, then rotations, about the axes of the frame. GTSAM: first rotations, about the object's
    own axes, then x, y, z along these axes. `swap_halves(marginal, T[:3, :3])` converts a marginal back.
    """
    return gtsam.noiseModel.Gaussian.Covariance(swap_halves(covariance, T[:3, :3].T))


localizer = Localizer.create("pin", sensor="gelsight-mini")
touch = localizer.simulate(seed=6)[0]  # its verdict is certain: a factor stands for one pose
best = localizer.localize(touch).best
SENSOR, OBJECT = gtsam.symbol("s", 0), gtsam.symbol("o", 0)

# The arm gives the sensor's pose within 1 mm and half a degree, a camera the object's within 5 mm and 5 degrees.
T_base_sensor = np.array([[1, 0, 0, 0.5], [0, -1, 0, 0.1], [0, 0, -1, 0.1], [0, 0, 0, 1.0]])
arm, camera = (np.diag([metres] * 3 + [np.radians(deg)] * 3) ** 2 for metres, deg in ((1e-3, 0.5), (5e-3, 5)))
T_base_object = T_base_sensor @ touch.T_sensor_object  # the camera's errors are left out here
graph, initial = gtsam.NonlinearFactorGraph(), gtsam.Values()
graph.add(gtsam.PriorFactorPose3(SENSOR, gtsam.Pose3(T_base_sensor), make_noise(T_base_sensor, arm)))
graph.add(gtsam.PriorFactorPose3(OBJECT, gtsam.Pose3(T_base_object), make_noise(T_base_object, camera)))
seen = gtsam.Pose3(best.T_sensor_object)
graph.add(gtsam.BetweenFactorPose3(SENSOR, OBJECT, seen, make_noise(best.T_sensor_object, best.covariance)))
initial.insert(SENSOR, gtsam.Pose3(T_base_sensor))
initial.insert(OBJECT, gtsam.Pose3(T_base_object))
solved = gtsam.LevenbergMarquardtOptimizer(graph, initial).optimize()
fused = swap_halves(gtsam.Marginals(graph, solved).marginalCovariance(OBJECT), solved.atPose3(OBJECT).matrix()[:3, :3])

stds = {name: 1e3 * np.sqrt(np.diag(C)[:3]) for name, C in (("camera", camera), ("camera, touch and arm", fused))}
for name, std_mm in stds.items():
    print(f"{name}: standard deviations along the base's x, y, z: {std_mm.round(2)} mm")
if picture:
    figure, axes = plt.subplots(figsize=(6, 3.2), layout="constrained")
    for k, (name, std_mm) in enumerate(stds.items()):
        axes.bar(np.arange(3) + 0.4 * k - 0.2, std_mm, 0.38, label=name)
    axes.set(xticks=range(3), xticklabels="xyz", ylabel="standard deviation (mm)", title="object in the base frame")
    axes.set_ylim(0, 6.5)
    axes.legend(frameon=False, ncols=2)
    save_figure(picture, figure)
