"use strict";
// The page of an evaluation from one touch.
(() => {
  const { data, plain, axis, draw, render } = page;
  const { FLOOR, logAxis, decadeAxis, onChange, value, colour, symbol } = errors;
  const AT_FIRST = ["best-1", "reg-1", "chosen", "reg-10", "closest"]; // a click on its name shows another

  const chosen = (name) => document.getElementById(name).selectedOptions[0].textContent;
  const title = () => `${chosen("metric")} (${chosen("scale")})`;

  function scaled(run, line, metric) {
    const by = value("scale") === "share" ? run.random_mm[metric] : 1, least = FLOOR * run.random_mm[metric];
    return run.errors_mm[line][metric].map((e) => Math.max(e, least) / by);
  }

  // Return a trace for each line, over all objects or for one object.
  function groups(metric) {
    const one = value("object"), runs = one === "" ? data.runs : [data.runs[Number(one)]];
    return data.lines.map((line, k) => ({
      name: line, colour: colour(k), hidden: one === "" && !AT_FIRST.includes(line),
      places: runs.map((run) => [one === "" ? run.name : line, scaled(run, line, metric)]),
    }));
  }

  function distribution({ name, colour: color, hidden, places }, shape) {
    const base = {
      name, x: places.flatMap(([place, values]) => values.map(() => plain(place))),
      y: places.flatMap(([, values]) => values),
      line: { color, width: 1.4 }, fillcolor: `${color}66`, legendgroup: name, visible: hidden ? "legendonly" : true,
    };
    if (shape === "box") return { ...base, type: "box", boxpoints: "outliers", marker: { size: 3, color } };
    const inside = { box: { visible: true, width: 0.25 }, meanline: { visible: false }, points: false };
    const y = base.y.map(Math.log10);
    return { ...base, y, type: "violin", ...inside, spanmode: "hard", scalemode: "width", hoverinfo: "skip" };
  }

  draw("errors", (c) => {
    const shape = value("shape"), made = groups(value("metric")), together = value("object") === "";
    const logs = made.flatMap((group) => group.places.flatMap(([, values]) => values.map(Math.log10)));
    const range = [logs.reduce((a, b) => Math.min(a, b)) - 0.15, logs.reduce((a, b) => Math.max(a, b)) + 0.15];
    const yaxis = shape === "violin" ? decadeAxis(c, title(), range) : logAxis(c, title(), { range });
    const mode = together ? "group" : "overlay";
    const layout = {
      yaxis, xaxis: axis(c, { type: "category" }), showlegend: together, boxmode: mode, violinmode: mode, boxgap: 0.15,
      violingap: 0.15, legend: { y: -0.12 },
    };
    return { data: made.map((group) => distribution(group, shape)), layout };
  });

  draw("curves", (c) => {
    const metric = value("metric"), line = value("line");
    const traces = data.runs.map((run, k) => {
      const sorted = scaled(run, line, metric).sort((a, b) => a - b), name = plain(run.name);
      return {
        type: "scatter", mode: "lines", name, x: sorted, y: sorted.map((_, n) => (100 * (n + 1)) / sorted.length),
        line: { shape: "hv", color: colour(k), width: 2 },
        hovertemplate: `${name}: %{y:.0f} % within %{x:.3g}<extra></extra>`,
      };
    });
    const yaxis = axis(c, { title: { text: "touches (%)" }, range: [0, 101] });
    return { data: traces, layout: { showlegend: true, xaxis: logAxis(c, `${title()} of ${line}`), yaxis } };
  });

  function coverage(run, k) {
    const name = plain(run.name), hovertemplate = `${name}: %{y:.0f} % in the %{x} % set<extra></extra>`;
    const shared = { type: "scatter", name, legendgroup: name, hovertemplate };
    const x = Array.from({ length: 101 }, (_, n) => n);
    const levels = run.credible_level;
    const held = x.map((p) => (100 * levels.filter((level) => level <= p / 100).length) / levels.length);
    const percent = (shares) => shares.map((share) => 100 * share);
    const marker = { color: colour(k), size: 8, symbol: symbol(k) };
    return [
      { ...shared, mode: "lines", x, y: held, line: { color: colour(k), width: 2 } },
      { ...shared, mode: "markers", x: percent(run.levels), y: percent(run.coverage), marker, showlegend: false },
    ];
  }

  draw("coverage", (c) => {
    const right = { color: c.ink, width: 1, dash: "dash" }, ends = [0, 100];
    const shared = { type: "scatter", mode: "lines", showlegend: false, hoverinfo: "skip" };
    const line = { ...shared, x: ends, y: ends, line: right };
    const xaxis = axis(c, { title: { text: "probability of the set (%)" }, range: [0, 101] });
    const yaxis = axis(c, { title: { text: "true poses in it (%)" }, range: [0, 102] });
    return { data: [...data.runs.flatMap(coverage), line], layout: { showlegend: true, xaxis, yaxis } };
  });

  draw("entropy", (c) => {
    const metric = value("metric"), line = value("line");
    const traces = data.runs.map((run, k) => ({
      type: "scatter", mode: "markers", name: plain(run.name), x: run.entropy, y: scaled(run, line, metric),
      customdata: run.entropy.map((_, n) => n), marker: { color: colour(k), symbol: symbol(k), size: 6, opacity: 0.65 },
      hovertemplate: `${plain(run.name)}, touch %{customdata}: %{y:.3g}, entropy %{x:.2f}<extra></extra>`,
    }));
    const xaxis = axis(c, { title: { text: "entropy (nats)" }, rangemode: "tozero" });
    return { data: traces, layout: { showlegend: true, xaxis, yaxis: logAxis(c, `${title()} of ${line}`) } };
  });

  draw("times", (c) => {
    const names = data.runs.map((run) => plain(run.name));
    const traces = data.runs[0].times.map(([stage], n) => ({
      type: "bar", name: plain(stage), x: names, y: data.runs.map((run) => run.times[n][1]),
      marker: { color: colour(n) },
      hovertemplate: `%{x}: ${plain(stage)} %{y:.3g} ms<extra></extra>`,
    }));
    const yaxis = axis(c, { title: { text: "time (ms)" } }), xaxis = axis(c, { type: "category" });
    return { data: traces, layout: { barmode: "stack", showlegend: true, bargap: 0.5, xaxis, yaxis } };
  });

  onChange(["object", "metric", "scale", "shape"], () => render("errors"));
  onChange(["metric", "scale", "line"], () => ["curves", "entropy"].forEach(render));
})();
