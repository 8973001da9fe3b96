"use strict";
// The page of a run: the candidates (list, cards, on the sensor), the distribution, and the times.
(() => {
  const { data, plain, numbers, axis, draw, render, pickable } = page;
  const { surface, moved, solid, lines, words, pad, space, PAINTED, LAMP } = solids;
  const candidates = data.candidates;
  let chosen = 0;

  const mm = (value) => value.toFixed(2);
  const percent = (share) => (share < 0.001 ? "< 0.1 %" : `${(100 * share).toFixed(1)} %`);

  // ---- the object on the sensor
  const body = surface(data.mesh);

  const pads = (c) => data.pads.flatMap((one, k) => pad(c, one, k === 0 ? 1 : 0.15)); // others must not hide the object

  function ghost(c) {
    if (!data.truth) return [];
    const at = moved(body.at, data.truth), path = { x: [], y: [], z: [] };
    for (const [a, b] of data.creases) for (const k of "xyz") path[k].push(at[k][a], at[k][b], null);
    return [solid(at, body.faces, c.truth, { opacity: 0.3, name: "true pose" }), lines(path, c.truth, 5)];
  }

  draw("scene", (c) => {
    const object = solid(moved(body.at, candidates[chosen].T), body.faces, c.steel, { name: "object" });
    const traces = [object, ...pads(c), ...ghost(c)];
    return { data: traces, layout: space("scene", data.bounds, data.camera) };
  });

  // ---- probability over the object's surface
  draw("surface", (c) => {
    const found = data.surface, shape = surface(found.mesh), [low, high] = found.range;
    const ticks = Array.from({ length: Math.floor(high) - Math.ceil(low) + 1 }, (_, n) => Math.ceil(low) + n);
    const painted = {
      type: "mesh3d", ...shape.at, ...shape.faces, cmin: low, cmax: high, flatshading: true,
      lighting: PAINTED, lightposition: LAMP,
      intensity: numbers(found.log_density, Float32Array),
      colorscale: [[0, c.bare], [0.35, "#f6c65b"], [0.65, "#ee6c2b"], [1, "#9b1130"]],
      colorbar: {
        title: { text: "% per mm²", side: "right" }, thickness: 12, len: 0.75,
        tickvals: ticks, ticktext: ticks.map((power) => String(+(10 ** power).toPrecision(3))),
      },
      hovertemplate: "x %{x:.1f}, y %{y:.1f}, z %{z:.1f} mm<extra></extra>",
    };
    const marks = { ...words(found.marks, c.ink, 13), mode: "markers+text", marker: { size: 4, color: c.ink } };
    const traces = [painted, marks, lines(found.triad.lines, c.soft, 4), words(found.triad.names, c.soft, 12)];
    return { data: traces, layout: space("surface", found.bounds, found.camera) };
  });

  // ---- probability over rotations
  draw("yaw", (c) => {
    const { deg, percent: shares, width } = data.yaw, rings = { gridcolor: c.grid, linecolor: c.line };
    const bars = {
      type: "barpolar", theta: deg, r: shares, width: deg.map(() => width), marker: { color: c.accent },
      hovertemplate: "%{theta:.1f}°: %{r:.2f} %<extra></extra>",
    };
    const radialaxis = {
      ...rings, ticksuffix: " %", range: [0, 1.05 * Math.max(...shares)], nticks: 4, angle: 22, tickangle: 22,
      tickfont: { size: 11, color: c.soft },
    };
    const polar = { bgcolor: "rgba(0,0,0,0)", angularaxis: { ...rings, dtick: 45, ticksuffix: "°" }, radialaxis };
    return { data: [bars], layout: { margin: { l: 45, r: 45, t: 30, b: 30 }, polar } };
  });

  draw("side", (c) => {
    const { kind, x, y, percent: shares } = data.side;
    const middle = (edges) => edges.slice(1).map((edge, k) => (edge + edges[k]) / 2);
    const names = kind === "lean"
      ? ["lean towards x (°)", "lean towards y (°)"]
      : ["azimuth about the object's z (°)", "elevation above its xy plane (°)"];
    const map = {
      type: "heatmap", x, y, z: shares, colorbar: { title: { text: "%" }, thickness: 12 },
      colorscale: [[0, c.panel], [0.15, "#f6c65b"], [0.5, "#ee6c2b"], [1, "#9b1130"]],
      customdata: middle(y).map((b) => middle(x).map((a) => [a, b])),
      hovertemplate: "%{customdata[0]:.0f}°, %{customdata[1]:.0f}°: %{z:.2f} %<extra></extra>",
    };
    const [xaxis, yaxis] = names.map((text) => axis(c, { title: { text } }));
    return { data: [map], layout: { xaxis, yaxis } };
  });

  // ---- probability and imprint IoU of the candidates
  draw("modes", (c) => {
    const opacity = candidates.map((_, k) => (k === chosen ? 1 : 0.55));
    const bars = (name, key, color, shown) => ({
      type: "bar", orientation: "h", name, y: candidates.map((one) => one.rank),
      x: candidates.map((one) => 100 * one[key]),
      marker: { color, opacity }, text: candidates.map((one) => shown(one[key])), textposition: "outside",
      constraintext: "none", textfont: { size: 11 }, cliponaxis: false,
      hovertemplate: `candidate %{y}: ${name} %{x:.2f} %<extra></extra>`,
    });
    const whole = (share) => `${Math.round(100 * share)} %`;
    const traces = [
      bars("probability", "probability", c.accent, percent), bars("imprint IoU", "imprint_iou", c.second, whole),
    ];
    const yaxis = axis(c, { autorange: "reversed", dtick: 1, title: { text: "candidate" } });
    const xaxis = axis(c, { range: [0, 112], tickvals: [0, 20, 40, 60, 80, 100], title: { text: "%" } });
    return { data: traces, layout: { bargap: 0.25, margin: { r: 50 }, xaxis, yaxis } };
  });

  draw("times", (c) => {
    const bars = {
      type: "bar", orientation: "h", y: data.times.map(([stage]) => plain(stage)), x: data.times.map(([, ms]) => ms),
      marker: { color: c.accent }, text: data.times.map(([, ms]) => `${ms.toPrecision(3)} ms`), textposition: "outside",
      constraintext: "none", textfont: { size: 11 }, cliponaxis: false, hoverinfo: "skip",
    };
    const xaxis = axis(c, { title: { text: "time (ms)" }, rangemode: "tozero" });
    return { data: [bars], layout: { margin: { r: 70 }, xaxis, yaxis: axis(c, { autorange: "reversed" }) } };
  });

  // ---- choosing a candidate
  const picks = [...document.querySelectorAll("tr.pick, .card")];

  function mark() {
    const { rank, probability, imprint_iou, error_mm: error } = candidates[chosen];
    for (const one of picks) one.setAttribute("aria-selected", String(Number(one.dataset.number) === chosen));
    const off = error === null ? "" : `, error ${mm(error)} mm`;
    const text = `Candidate ${rank}: ${percent(probability)}, imprint IoU ${Math.round(100 * imprint_iou)} %${off}`;
    document.getElementById("chosen").textContent = text;
  }

  function choose(number) {
    chosen = number;
    const { x, y, z } = moved(body.at, candidates[chosen].T);
    Plotly.restyle("scene", { x: [x], y: [y], z: [z] }, [0]);
    render("modes");
    mark();
  }

  for (const element of picks) pickable(element, () => choose(Number(element.dataset.number)));
  document.getElementById("modes").on("plotly_click", (event) => choose(event.points[0].pointIndex));
  mark();
})();
