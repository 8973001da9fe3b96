"""Locate an object with two sensors of different kinds at once."""

import argparse
from dataclasses import replace

import numpy as np

from tactile_loc import Localizer, draw_result, save_figure

parser = argparse.ArgumentParser(description=__doc__)
parser.add_argument("--picture", metavar="PATH", help="draw the result as PNG")
picture = parser.parse_args().picture

# A gripper with a GelSight Mini on one finger and a GelSlim on the other.
mini = Localizer.create("hook", sensor="gelsight-mini")
slim = mini.for_sensor("gelslim")

# With a robot, T_base_sensor comes from the joint positions. Here, it comes from the simulated object's pose.
T_base_object = np.array([[0, -1, 0, 0.4], [1, 0, 0, 0.1], [0, 0, 1, 0.05], [0, 0, 0, 1.0]])
touches = [
    replace(touch, T_base_sensor=T_base_object @ np.linalg.inv(touch.T_sensor_object), name=name)
    for localizer, touch, name in (
        (mini, mini.simulate(7, seed=4)[6], "GelSight Mini"),
        (slim, slim.simulate(7, seed=8)[6], "GelSlim"),
    )
]

alone = [mini.localize(touch) for touch in touches]
together = mini.localize(touches)

for result in (*alone, together):
    names = " and ".join(touch.name for touch in result.touches)
    error_mm = 1e3 * result.measure_errors_m(mini.object)[0]  # only a simulation knows it
    print(f"{names}: {result.verdict}, {len(result.equal_explanations)} equal poses, {error_mm:.2f} mm off")
print(together)

if picture:
    scene = mini.scene.match_touch(together.touch)
    save_figure(picture, draw_result(together, scene, "Two sensors of different kinds"))
