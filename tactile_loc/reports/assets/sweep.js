"use strict";
// The page of a sweep: one filter for the table and the plots.
(() => {
  const { data, plain, axis, draw, render, pickable } = page;
  const { TICKS, DENSE, logAxis, onChange, value, colour } = errors;
  const kinds = data.components; // the factors whose effect is drawn
  const LEAST_MM = 1e-6; // smaller errors are clipped before taking logarithms
  const texts = data.rows.map((row) => data.factors.map((factor) => row[factor]).join(" ").toLowerCase());
  let shown = data.rows;

  const column = () => `${value("line")}_median_mm`;
  const known = (row) => data.factors.filter((factor) => row[factor] !== null);
  const named = (row) => known(row).map((factor) => `${plain(factor)}: ${plain(row[factor])}`).join("<br>");
  const distinct = (rows, factor) => [...new Set(rows.map((row) => row[factor]))];

  // ---- error against time
  draw("scatter", (c) => {
    const asked = value("time"), time = asked === "line" ? data.line_times[value("line")] : asked;
    const by = value("colour"), error = column(), unit = time.endsWith("_s") ? "s" : "ms";
    const low = (name) => name.replace(/(_median)?_(mm|ms)$/, "_low_$2"), high = (name) => low(name).replace("_low_", "_high_");
    const reach = (rows, name, k) => ({ // the 95 % interval
      type: "data", symmetric: false, thickness: 1, width: 0, color: colour(k),
      array: rows.map((row) => Math.max(0, (row[high(name)] ?? row[name]) - row[name])),
      arrayminus: rows.map((row) => Math.max(0, row[name] - (row[low(name)] ?? row[name]))),
    });
    const traces = distinct(data.rows, by).map((one, k) => {
      const rows = shown.filter((row) => row[by] === one && row[error] !== null && row[time] !== null);
      return {
        type: "scatter", mode: "markers", name: plain(one ?? "–"), x: rows.map((row) => row[time]),
        y: rows.map((row) => row[error]), text: rows.map(named),
        error_x: reach(rows, time, k), error_y: reach(rows, error, k),
        marker: { color: colour(k), size: 9, opacity: 0.8, line: { color: c.paper, width: 1 } },
        hovertemplate: `%{text}<br><b>%{y:.3g} mm</b>, %{x:.3g} ${unit}<extra></extra>`,
      };
    });
    const xaxis = logAxis(c, document.getElementById("time").selectedOptions[0].textContent);
    const yaxis = logAxis(c, `median ADD of ${value("line")} (mm)`);
    return { data: traces, layout: { showlegend: true, xaxis, yaxis } };
  });

  // ---- the effect of each component
  // Rows that are equal in all other factors form a group. A group has logarithms of errors, by this factor's values.
  // Options of the factor's component count as part of the factor.
  function alike(factor) {
    const others = data.factors.filter((f) => f !== factor && !f.startsWith(`${factor}.`)), groups = new Map();
    for (const row of shown) {
      if (row[column()] === null) continue;
      const key = JSON.stringify(others.map((f) => row[f])), group = groups.get(key) ?? new Map();
      group.set(row[factor], [...(group.get(row[factor]) ?? []), Math.log(Math.max(row[column()], LEAST_MM))]);
      groups.set(key, group);
    }
    return [...groups.values()];
  }

  const mean = (values) => values.reduce((sum, v) => sum + v, 0) / values.length;

  function ratios(factor) {
    const values = distinct(shown, factor).filter((v) => v !== null), found = new Map(values.map((v) => [v, []]));
    for (const group of alike(factor)) {
      if (!values.every((v) => group.has(v))) continue; // one of them failed
      const logs = values.map((v) => mean(group.get(v))), middle = mean(logs);
      values.forEach((v, k) => found.get(v).push(Math.exp(logs[k] - middle)));
    }
    return found;
  }

  kinds.forEach((factor, number) => draw(`effect-${number}`, (c) => {
    const effect = ratios(factor);
    const traces = [...effect].map(([name, found], k) => ({
      type: "box", name: plain(name), y: found, boxpoints: "all", jitter: 0.5, pointpos: 0,
      marker: { color: colour(k), size: 4, opacity: 0.5 }, line: { width: 1.5 },
      hovertemplate: `${plain(name)}: %{y:.3g}<extra></extra>`,
    }));
    const line = { color: c.soft, width: 1, dash: "dash" };
    const seen = [...effect.values()].flat(), narrow = Math.max(...seen) < 8 * Math.min(...seen);
    const yaxis = logAxis(c, "error / mean", {}, narrow ? DENSE : TICKS);
    const as = { type: "line", xref: "paper", x0: 0, x1: 1, y0: 1, y1: 1, line };
    const xaxis = axis(c, { type: "category", title: { text: plain(factor) } });
    return { data: traces, layout: { showlegend: false, shapes: [as], xaxis, yaxis } };
  }));

  function all() {
    if (document.getElementById("scatter")) render("scatter");
    kinds.forEach((_, number) => render(`effect-${number}`));
  }

  // ---- the table
  const rows = [...document.querySelectorAll("#table tbody tr")];
  const headings = [...document.querySelectorAll("#table th")];

  function filter() {
    const wanted = value("filter").toLowerCase().split(/\s+/).filter(Boolean);
    const keep = texts.map((text) => wanted.every((word) => text.includes(word)));
    shown = data.rows.filter((_, number) => keep[number]);
    for (const row of rows) row.hidden = !keep[Number(row.dataset.row)];
    document.getElementById("count").textContent = `${shown.length} of ${data.rows.length} combinations`;
    all();
  }

  function content(row, place) {
    const cell = row.cells[place];
    return cell.dataset.value === undefined ? cell.textContent : Number(cell.dataset.value);
  }

  function compare(a, b) { // numbers come first
    if (typeof a === "number" && typeof b === "number") return a - b;
    if (typeof a === "string" && typeof b === "string") return a.localeCompare(b, undefined, { numeric: true });
    return typeof a === "number" ? -1 : 1;
  }

  function sortBy(heading, place) {
    const sign = heading.getAttribute("aria-sort") === "ascending" ? -1 : 1;
    for (const other of headings) other.removeAttribute("aria-sort");
    heading.setAttribute("aria-sort", sign > 0 ? "ascending" : "descending");
    rows.sort((a, b) => sign * compare(content(a, place), content(b, place)));
    document.querySelector("#table tbody").append(...rows);
  }

  headings.forEach((heading, place) => pickable(heading, () => sortBy(heading, place)));
  onChange(["line"], all);
  onChange(["time", "colour"], () => render("scatter"));
  document.getElementById("filter").addEventListener("input", filter);
})();
