"""Log a result to the Rerun viewer: the gel, the touch, and the object in every pose that is still possible."""

import argparse

import rerun as rr
import rerun.blueprint as rrb

from tactile_loc import Localizer

parser = argparse.ArgumentParser(description=__doc__)
parser.add_argument("--out", metavar="PATH", default="touch.rrd", help="file to write; open it with `rerun touch.rrd`")
out = parser.parse_args().out

localizer = Localizer.create("hook", sensor="gelsight-mini")
touch = localizer.simulate(seed=4)[0]
result = localizer.localize(touch)
mesh, geometry = localizer.object.mesh, touch.geometry

recording = rr.RecordingStream("tactile-loc example")  # or rr.init(..., spawn=True), to open the viewer at once
recording.save(out)
recording.log("touch", rr.DepthImage(touch.contact_shape.depth_m, meter=1.0))

# The sensor frame has x right, y down and z out of the gel, in metres. Rerun calls this RDF.
recording.log("sensor", rr.ViewCoordinates.RDF, static=True)
x0, x1, y0, y1 = geometry.rectangle
recording.log("sensor/gel", rr.Boxes3D(centers=[geometry.gel_middle_m], sizes=[[x1 - x0, y1 - y0, 0]]), static=True)

equal = result.equal_explanations
for rank, hypothesis in enumerate(equal, 1):
    T, path = hypothesis.T_sensor_object, f"sensor/pose-{rank}"
    colour = (124, 159, 199, 255 if rank == 1 else 50)  # only the first pose is opaque
    recording.log(path, rr.Transform3D(translation=T[:3, 3], mat3x3=T[:3, :3]))
    recording.log(path, rr.Mesh3D(vertex_positions=mesh.vertices_m, triangle_indices=mesh.faces, albedo_factor=colour))
    recording.log(path, rr.AnyValues(probability=hypothesis.probability, imprint_iou=hypothesis.imprint_iou))

recording.log("verdict", rr.TextDocument(str(result)))
recording.send_blueprint(rrb.Blueprint(collapse_panels=True))
recording.disconnect()
print(f"{out}: {len(equal)} poses explain the touch equally well")
