"use strict";
// The page of a benchmark.
(() => {
  const { data, plain, axis, draw, render } = page;
  const { logAxis, onChange, value, colour } = errors;
  const SHORTEST_MM = 0.02, LONGEST_MM = 50;
  const PLOTS = ["success-plot", "curves-plot", "reliability-plot", "times-plot"];

  const within = () => Number(value("within"));
  const share = (group) => group.within[within()];
  const colourOf = (method) => colour(data.methods.indexOf(method));
  const title = () => `examples within ${data.within_mm[within()]} mm (%)`;
  const ofSource = () => data.groups.filter((group) => group.source === value("source"));
  const shown = () => ofSource().filter((group) => group.touches === Number(value("touches")));
  const ofMethod = (method) => ofSource().filter((group) => group.method === method).sort((a, b) => a.touches - b.touches);
  const methods = () => data.methods.filter((method) => ofMethod(method).length);
  const PERCENT = { range: [-3, 105] };

  draw("success-plot", (c) => {
    const traces = methods().map((method, k, all) => {
      const groups = ofMethod(method), aside = 0.06 * (k - (all.length - 1) / 2); // so that bars do not hide each other
      return {
        type: "scatter", mode: "lines+markers", name: plain(method), x: groups.map((g) => g.touches + aside),
        y: groups.map(share), line: { color: colourOf(method), width: 1.5 }, marker: { color: colourOf(method), size: 8 },
        error_y: {
          type: "data", symmetric: false, thickness: 1.2, width: 4,
          array: groups.map((g) => g.ranges[within()][1] - share(g)),
          arrayminus: groups.map((g) => share(g) - g.ranges[within()][0]),
        },
        hovertemplate: `${plain(method)}: %{y:.0f} %<extra></extra>`,
      };
    });
    const numbers = [...new Set(ofSource().map((group) => group.touches))];
    const xaxis = axis(c, { title: { text: "touches" }, tickvals: numbers });
    return { data: traces, layout: { showlegend: true, xaxis, yaxis: axis(c, { ...PERCENT, title: { text: title() } }) } };
  });

  function curve(group) {
    const sorted = group.errors_mm[value("kind")].map((e) => Math.max(e, SHORTEST_MM));
    const known = sorted.filter((e) => e <= LONGEST_MM), percent = (n) => (100 * n) / sorted.length;
    return {
      type: "scatter", mode: "lines", name: plain(group.method), x: [SHORTEST_MM, ...known, LONGEST_MM],
      y: [0, ...known.map((_, n) => percent(n + 1)), percent(known.length)],
      line: { shape: "hv", color: colourOf(group.method), width: 2 },
      hovertemplate: `${plain(group.method)}: %{y:.0f} % within %{x:.3g} mm<extra></extra>`,
    };
  }

  draw("curves-plot", (c) => {
    const range = [Math.log10(SHORTEST_MM), Math.log10(LONGEST_MM)];
    const yaxis = axis(c, { title: { text: "examples (%)" }, range: [0, 101] });
    const xaxis = logAxis(c, "pose error (mm)", { range });
    return { data: shown().map(curve), layout: { showlegend: true, xaxis, yaxis } };
  });

  draw("reliability-plot", (c) => {
    const ideal = { type: "scatter", mode: "lines", x: [0, 100], y: [0, 100], showlegend: false, hoverinfo: "skip",
                    line: { dash: "dash", color: c.soft, width: 1 } };
    const traces = shown().filter((group) => group.bins.length).map(({ method, bins }) => ({
      type: "scatter", mode: "lines+markers", name: plain(method), x: bins.map((b) => b.stated),
      y: bins.map((b) => b.right), text: bins.map((b) => b.examples), line: { width: 1, color: colourOf(method) },
      marker: { size: bins.map((b) => 5 + 2 * Math.sqrt(b.examples)), color: colourOf(method) },
      hovertemplate: "stated %{x:.0f} %, right %{y:.0f} %, %{text} examples<extra></extra>",
    }));
    const xaxis = axis(c, { ...PERCENT, title: { text: "stated probability (%)" } });
    const yaxis = axis(c, { ...PERCENT, title: { text: "first poses within 1 mm (%)" } });
    return { data: [ideal, ...traces], layout: { showlegend: true, xaxis, yaxis } };
  });

  draw("times-plot", (c) => {
    const traces = methods().map((method) => {
      const groups = ofMethod(method).filter((group) => group.seconds !== null);
      return {
        type: "scatter", mode: "lines+markers", name: plain(method), x: groups.map((g) => g.seconds), y: groups.map(share),
        text: groups.map((g) => g.touches), line: { width: 1, color: colourOf(method) },
        marker: { size: groups.map((g) => 6 + 2 * g.touches), color: colourOf(method) },
        hovertemplate: `${plain(method)}, %{text} touches: %{y:.0f} % in %{x:.3g} s<extra></extra>`,
      };
    });
    const yaxis = axis(c, { ...PERCENT, title: { text: title() } });
    return { data: traces, layout: { showlegend: true, xaxis: logAxis(c, "median time (s)"), yaxis } };
  });

  onChange(["source", "touches", "within", "kind"], () => PLOTS.forEach(render));
})();
