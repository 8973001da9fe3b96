"use strict";
// Shared by pages with scenes in 3D: surfaces, lines, words, sensors and cameras.
const solids = (() => {
  const { numbers } = page;

  const FINE = { facenormalsepsilon: 0, vertexnormalsepsilon: 0 }; // so that small faces have normals
  const SOLID = { ...FINE, ambient: 0.5, diffuse: 0.65, specular: 0.08, roughness: 0.7 };
  const PAINTED = { ...FINE, ambient: 0.7, diffuse: 0.4, specular: 0.02, roughness: 0.9 };
  // Plotly places lamps in clip space. This lamp is behind the viewer, to the right and above.
  const LAMP = { x: -0.8, y: -1.5, z: 1.001 };

  function surface(mesh) {
    const places = numbers(mesh.vertices_mm, Float32Array), faces = numbers(mesh.faces, Int32Array);
    const column = (values, k) => values.filter((_, index) => index % 3 === k);
    const [x, y, z] = [0, 1, 2].map((k) => column(places, k)), [i, j, k] = [0, 1, 2].map((n) => column(faces, n));
    return { at: { x, y, z }, faces: { i, j, k } };
  }

  function moved({ x, y, z }, T) { // T: the rows of [R t], twelve numbers, mm
    const row = (r) => x.map((_, n) => T[r] * x[n] + T[r + 1] * y[n] + T[r + 2] * z[n] + T[r + 3]);
    return { x: row(0), y: row(4), z: row(8) };
  }

  const LIT = { flatshading: true, hoverinfo: "skip", lighting: SOLID, lightposition: LAMP };
  const solid = (at, faces, color, more) => ({ type: "mesh3d", ...at, ...faces, color, ...LIT, ...more });
  const UNSEEN = { type: "scatter3d", hoverinfo: "skip" };
  const lines = (at, color, width) => ({ ...UNSEEN, mode: "lines", ...at, line: { color, width } });
  const words = (at, color, size) => ({ ...UNSEEN, mode: "text", ...at, textfont: { color, size } });

  // A scene without plotly's box of axes, because the sensor has its own scale. All axes have equal scales.
  function space(name, bounds, camera) {
    const [x, y, z] = bounds.map((range) => ({ range, visible: false, autorange: false }));
    const lengths = bounds.map(([low, high]) => high - low), unit = Math.cbrt(lengths[0] * lengths[1] * lengths[2]);
    const aspectratio = { x: lengths[0] / unit, y: lengths[1] / unit, z: lengths[2] / unit };
    const scene = { aspectmode: "manual", aspectratio, xaxis: x, yaxis: y, zaxis: z, camera: fitted(name, camera) };
    return { showlegend: false, margin: { l: 0, r: 0, t: 0, b: 0 }, scene };
  }

  // The camera is computed for a square. In a narrower element, the camera moves further away.
  function fitted(name, { eye, center, up }) {
    const place = document.getElementById(name), away = Math.max(1, place.clientHeight / place.clientWidth);
    const further = (k) => center[k] + away * (eye[k] - center[k]);
    return { eye: { x: further("x"), y: further("y"), z: further("z") }, center, up };
  }

  // A sensor: its gel, the housing around it, and the outline of the contact.
  const pad = (c, { gel, housing, contact }, opacity = 1) => [
    solid(gel, {}, c.gel, { opacity }), solid(housing, {}, c.housing, { opacity }), lines(contact, "#e03131", 3),
  ];

  return { surface, moved, solid, lines, words, pad, space, PAINTED, LAMP };
})();
