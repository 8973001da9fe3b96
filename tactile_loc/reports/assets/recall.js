"use strict";
// The page of an evaluation of what `run` answers.
(() => {
  const { data, plain, axis, draw, render } = page;
  const { logAxis, onChange, value, colour } = errors;
  const SHORTEST_MM = 0.02, LONGEST_MM = 50;
  const COLOURS = ["#2f9e62", "#dd6b20", "#8a63d2", "#c2417e", "#64748b", "#a0aec0"]; // of the verdicts

  const several = data.groups.some((group) => group.object === "all");
  const pooled = data.groups.filter((group) => !several || group.object === "all");
  const encoders = [...new Set(data.groups.map((group) => group.encoder))];
  const count = (touches) => (touches === 1 ? "1 touch" : `${touches} touches`);
  const name = (group) => plain(encoders.length > 1 ? `${count(group.touches)}, ${group.encoder}` : count(group.touches));

  function curve(group, k) {
    const sorted = group.errors_mm[value("kind")][value("metric")].map((e) => Math.max(e, SHORTEST_MM));
    const known = sorted.filter((e) => e <= LONGEST_MM), share = (n) => (100 * n) / sorted.length;
    return {
      type: "scatter", mode: "lines", name: name(group), x: [SHORTEST_MM, ...known, LONGEST_MM],
      y: [0, ...known.map((_, n) => share(n + 1)), share(known.length)],
      line: { shape: "hv", color: colour(k), width: 2 },
      hovertemplate: `${name(group)}: %{y:.0f} % within %{x:.3g} mm<extra></extra>`,
    };
  }

  draw("curves", (c) => {
    const shown = data.groups.filter((group) => group.object === value("object") && group.noise === value("noise"));
    const range = [Math.log10(SHORTEST_MM), Math.log10(LONGEST_MM)];
    const yaxis = axis(c, { title: { text: "examples (%)" }, range: [0, 101] });
    return { data: shown.map(curve), layout: { showlegend: true, xaxis: logAxis(c, "error (mm)", { range }), yaxis } };
  });

  draw("verdicts-plot", (c) => {
    const places = pooled.map((group) => `${name(group)}, ${plain(group.noise)}`);
    const bars = data.verdicts.map((verdict, k) => ({
      type: "bar", orientation: "h", name: verdict, y: places, x: pooled.map((group) => group.verdicts[k]),
      marker: { color: COLOURS[k] }, hovertemplate: `${verdict}: %{x}<extra></extra>`,
    }));
    const xaxis = axis(c, { title: { text: "examples" } }), yaxis = axis(c, { type: "category", autorange: "reversed" });
    return { data: bars, layout: { barmode: "stack", showlegend: true, xaxis, yaxis } };
  });

  draw("reliability-plot", (c) => {
    const ideal = { type: "scatter", mode: "lines", x: [0, 100], y: [0, 100], showlegend: false, hoverinfo: "skip",
                    line: { dash: "dash", color: c.soft, width: 1 } };
    const traces = data.reliability.map(({ touches, bins }, k) => ({
      type: "scatter", mode: "lines+markers", name: count(touches),
      x: bins.map((b) => b.stated), y: bins.map((b) => b.right), text: bins.map((b) => b.examples),
      marker: { size: bins.map((b) => 5 + 2 * Math.sqrt(b.examples)), color: colour(k) }, line: { width: 1, color: colour(k) },
      hovertemplate: "stated %{x:.0f} %, right %{y:.0f} %, %{text} examples<extra></extra>",
    }));
    const scale = { range: [-3, 103] };
    const xaxis = axis(c, { ...scale, title: { text: "stated probability (%)" } });
    const yaxis = axis(c, { ...scale, title: { text: "first poses within 1 mm (%)" } });
    return { data: [ideal, ...traces], layout: { showlegend: true, xaxis, yaxis } };
  });

  onChange(["object", "noise", "kind", "metric"], () => render("curves"));
})();
