"""Touch again until the verdict is certain, each time where the most information is expected."""

import argparse

import matplotlib.pyplot as plt
import numpy as np

from tactile_loc import (
    Localizer,
    RobotTouches,
    Verdict,
    choose_next_touch,
    draw_approaches,
    localize_together,
    save_figure,
)
from tactile_loc.plugin import registry

parser = argparse.ArgumentParser(description=__doc__)
parser.add_argument("--picture", metavar="PATH", help="draw the probability after each touch as PNG")
picture = parser.parse_args().picture

localizer, rng = Localizer.create("hook", sensor="gelsight-mini"), np.random.default_rng(1)
geometry = localizer.sensor.geometry
robot = RobotTouches(localizer.object, geometry, registry().create("renderer", "zbuffer", {}))  # instead of a robot
approaches = draw_approaches(localizer.object, geometry, 60, 0.6, rng)  # the poses that your robot can reach
touches, _ = robot.draw_example(1, rng)

history = []
while True:
    result = localize_together([(localizer, touch) for touch in touches], top=30)
    history.append((result.verdict, result.probability_within("1mm"), len(result.equal_explanations)))
    print(f"{len(touches)} touches: {result.verdict}, {result.count_explanations()}")
    if result.verdict is Verdict.CERTAIN or len(touches) == 6:
        break
    for rated in choose_next_touch(result, approaches).ranked:
        start = rated.approach
        touch = robot.approach(start.T_base_sensor, start.press_m, start.name, rng)
        if touch is not None:  # None: the sensor met nothing
            touches.append(touch)
            break
    else:
        break  # nothing that the robot can reach makes a touch

if picture:
    count = np.arange(1, len(history) + 1)
    figure, axes = plt.subplots(figsize=(6, 3.5), layout="constrained")
    axes.plot(count, [100 * probability for _, probability, _ in history], "o-")
    for x, (verdict, probability, _) in zip(count, history, strict=True):
        axes.annotate(verdict, (x, 100 * probability), xytext=(4, 6), textcoords="offset points")
    axes.set(xlabel="touches", ylabel="within 1 mm of the truth, %", xticks=count, ylim=(0, 112))
    save_figure(picture, figure)
