"use strict";
// The page of an evaluation from several contacts.
(() => {
  const { data, plain, axis, draw, render } = page;
  const { logAxis, onChange, value, colour } = errors;
  const DASHES = ["solid", "dash", "dot", "dashdot"];

  function band(run, line, number, dash) {
    const { contacts, [value("scale")]: found } = run.lines[line];
    const name = plain(data.runs.length > 1 ? `${run.name}, ${line}` : line), shown = colour(number);
    const shared = { type: "scatter", x: contacts, legendgroup: name, hoverinfo: "skip" };
    const border = { ...shared, mode: "lines", line: { width: 0 }, showlegend: false };
    const line_ = { color: shown, width: 2, dash: DASHES[dash % DASHES.length] };
    return [
      { ...border, y: found.q25 },
      { ...border, y: found.q75, fill: "tonexty", fillcolor: `${shown}22` },
      {
        ...shared, y: found.median, mode: "lines+markers", name, line: line_, marker: { size: 7 }, hoverinfo: undefined,
        hovertemplate: `${name}, %{x} contacts: %{y:.3g}<extra></extra>`,
      },
    ];
  }

  draw("curves", (c) => {
    const asked = value("line"), unit = value("scale") === "metres" ? "mm" : "share of the mean ADD of random poses";
    const traces = data.runs.flatMap((run, k) =>
      Object.keys(run.lines).flatMap((line, n) => (asked === "all" || asked === line ? band(run, line, k, n) : [])));
    const xaxis = axis(c, { title: { text: "contacts" }, dtick: 1 });
    return { data: traces, layout: { showlegend: true, xaxis, yaxis: logAxis(c, `median ADD (${unit})`) } };
  });

  onChange(["line", "scale"], () => render("curves"));
})();
