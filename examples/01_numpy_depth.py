"""Locate an object from a depth map in numpy. You state the meaning and the unit of the numbers."""

import argparse

import numpy as np

from tactile_loc import Localizer, Touch, draw_result, save_figure

parser = argparse.ArgumentParser(description=__doc__)
parser.add_argument("--picture", metavar="PATH", help="draw the result as PNG")
picture = parser.parse_args().picture

localizer = Localizer.create("pin", sensor="gelsight-mini")
print("The sensor's images have (rows, columns) =", localizer.sensor.geometry.shape)

# Replace these arrays by one of yours. The same touch is given here in the three ways in which sensors report depth.
simulated = localizer.simulate(seed=6)[0]
pressed_in_mm = 1e3 * (simulated.press_depth_m - simulated.contact_shape.depth_m)
arrays = {
    "indentation": pressed_in_mm,  # how far the gel is pressed in; 0 without contact
    "height": -pressed_in_mm,  # height above the untouched gel; 0 without contact
    "distance": np.where(pressed_in_mm > 0, pressed_in_mm.max() - pressed_in_mm, np.nan),  # from full penetration
}

results = {}
for kind, array_mm in arrays.items():
    touch = Touch.from_depth(array_mm, kind=kind, unit="mm", sensor=localizer.sensor, name=kind)
    results[kind] = localizer.localize(touch)
    x, y, z = 1e3 * results[kind].best.T_sensor_object[:3, 3]
    print(f"{kind:12} pressed in by {1e3 * touch.press_depth_m:.2f} mm: origin at {x:.2f}, {y:.2f}, {z:.2f} mm")

result = results["indentation"]
print(result)

if picture:
    scene = localizer.scene.match_touch(result.touch)
    save_figure(picture, draw_result(result, scene, "A depth map from numpy"))
