"use strict";
// Shared by all pages: the data, the theme, and plots in its colours.
const page = (() => {
  const data = JSON.parse(document.getElementById("data").textContent);
  const plots = new Map(); // name -> function of the theme's colours that returns {data, layout}
  const NAMES = [
    "paper", "panel", "line", "ink", "soft", "accent", "truth", "steel", "gel", "housing", "grid", "bare", "second",
  ];
  const SERIES = ["#2b6cb0", "#dd6b20", "#2f9e62", "#8a63d2", "#c2417e", "#64748b", "#0f9aa8", "#a97d13"];

  // Escape text for plotly, because plotly interprets some HTML, and users choose the names.
  const plain = (text) => String(text).replace(/&/g, "&amp;").replace(/</g, "&lt;").replace(/>/g, "&gt;");

  function numbers(base64, Type) {
    const bytes = Uint8Array.from(atob(base64), (c) => c.charCodeAt(0));
    return new Type(bytes.buffer); // little-endian, as on all common machines
  }

  function colours() {
    const style = getComputedStyle(document.documentElement);
    return Object.fromEntries(NAMES.map((name) => [name, style.getPropertyValue(`--${name}`).trim()]));
  }

  const isTable = (value) => value !== null && typeof value === "object" && !Array.isArray(value);

  function merged(base, more) {
    for (const [key, value] of Object.entries(more)) {
      base[key] = isTable(value) && isTable(base[key]) ? merged(base[key], value) : value;
    }
    return base;
  }

  function axis(c, more) {
    const lines = { gridcolor: c.grid, linecolor: c.line, zerolinecolor: c.line };
    return merged({ ...lines, automargin: true, title: { standoff: 8 } }, more);
  }

  function layout(c, more) {
    const clear = "rgba(0,0,0,0)";
    const base = {
      paper_bgcolor: clear, plot_bgcolor: clear, font: { color: c.ink, size: 13, family: "system-ui, sans-serif" },
      margin: { l: 55, r: 15, t: 34, b: 45 }, colorway: SERIES, uirevision: "kept",
      hoverlabel: { bgcolor: c.panel, bordercolor: c.line, font: { color: c.ink } },
      legend: { orientation: "h", y: -0.2, yanchor: "top", x: 0, font: { size: 12 } },
      modebar: { bgcolor: clear, color: c.soft, activecolor: c.accent },
    };
    return merged(base, more);
  }

  // Only these buttons are shown. No button may send the data anywhere.
  const BUTTONS = {
    flat: [["toImage"], ["zoom2d", "pan2d", "resetScale2d"]],
    space: [["toImage"], ["zoom3d", "pan3d", "orbitRotation", "resetCameraDefault3d"]],
    round: [["toImage"]],
  };

  function render(name) {
    const c = colours();
    const made = plots.get(name)(c);
    const kind = made.layout.scene ? "space" : made.layout.polar ? "round" : "flat";
    const config = { displaylogo: false, responsive: true, modeBarButtons: BUTTONS[kind] };
    return Plotly.react(name, made.data, layout(c, made.layout), config);
  }

  // Draw a plot, now and whenever the colours change.
  function draw(name, make) {
    if (!document.getElementById(name)) return;
    plots.set(name, make);
    render(name);
  }

  function dark(is) {
    document.documentElement.dataset.theme = is ? "dark" : "light";
    for (const name of plots.keys()) render(name);
  }

  function pickable(element, chosen) {
    element.tabIndex = 0;
    element.addEventListener("click", chosen);
    element.addEventListener("keydown", (event) => {
      if (event.key !== "Enter" && event.key !== " ") return;
      event.preventDefault();
      chosen();
    });
  }

  const wanted = matchMedia("(prefers-color-scheme: dark)");
  document.documentElement.dataset.theme = wanted.matches ? "dark" : "light";
  wanted.addEventListener("change", () => dark(wanted.matches));
  const toggle = document.getElementById("theme");
  toggle.addEventListener("click", () => dark(document.documentElement.dataset.theme !== "dark"));

  return { data, plain, numbers, axis, draw, render, pickable, SERIES };
})();
