"use strict";
// The page of a study: the part's surface, coloured by one of several values of its faces, with marks.
(() => {
  const { data, numbers, draw, render } = page;
  const { surface, lines, words, space, PAINTED, LAMP } = solids;
  const shape = surface(data.mesh), choice = document.getElementById("shown");
  const GOOD_LAST = ["#9b1130", "#ee6c2b", "#f6c65b", "#a9cf6b", "#2f9e62"];
  const UNREACHED = -1; // the value of faces that no press touches

  // Values begin a little above 0, so that only unreached faces have the first colour.
  function scale(c, goodLast) {
    const shown = goodLast ? GOOD_LAST : [...GOOD_LAST].reverse();
    return [[0, c.bare], [0.01, c.bare], ...shown.map((colour, k) => [0.0101 + (0.9899 * k) / (shown.length - 1), colour])];
  }

  draw("surface", (c) => {
    const { values, high, label, goodLast, marks } = data.maps[Number(choice.value)];
    const low = -0.0102 * high; // of the scale, whose first hundredth is grey
    const painted = {
      type: "mesh3d", ...shape.at, ...shape.faces, flatshading: true, lighting: PAINTED, lightposition: LAMP,
      intensity: numbers(values, Float32Array).map((value) => (value <= UNREACHED ? low : value)), intensitymode: "cell",
      cmin: low, cmax: high, colorscale: scale(c, goodLast), hoverinfo: "skip",
      colorbar: { title: { text: label, side: "right" }, thickness: 12, len: 0.75, nticks: 6 },
    };
    const marked = {
      ...words(marks, c.ink, 14), mode: "markers+text", marker: { size: 5, color: c.ink }, textposition: "middle right",
    };
    const traces = [painted, marked, lines(data.triad.lines, c.soft, 4), words(data.triad.names, c.soft, 12)];
    return { data: traces, layout: space("surface", data.bounds, data.camera) };
  });

  choice.addEventListener("change", () => render("surface"));
})();
