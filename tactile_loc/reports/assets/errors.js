"use strict";
// Logarithmic axes of errors, and choices that redraw plots.
const errors = (() => {
  const FLOOR = 1e-4; // of the mean of random poses; smaller errors are drawn here
  const SYMBOLS = ["circle", "square", "diamond", "cross", "x", "triangle-up", "star"];
  const POWERS = Array.from({ length: 13 }, (_, n) => n - 6);
  const ticks = (steps) => POWERS.flatMap((power) => steps.map((k) => +(k * 10 ** power).toPrecision(2)));
  const TICKS = ticks([1, 2, 5]), DENSE = ticks([1, 1.2, 1.5, 2, 3, 4, 5, 6, 8]); // for wide and narrow ranges

  function logAxis(c, title, more, tickvals = TICKS) {
    return page.axis(c, { type: "log", title: { text: title }, tickvals, ticktext: tickvals.map(String), ...more });
  }

  // The same axis for decimal logarithms of errors. A violin needs them, because it computes a density.
  function decadeAxis(c, title, range) {
    const marks = { tickvals: TICKS.map(Math.log10), ticktext: TICKS.map(String), zeroline: false };
    return page.axis(c, { title: { text: title }, range, ...marks });
  }

  function onChange(names, then) {
    for (const name of names) document.getElementById(name)?.addEventListener("change", then);
  }

  const value = (name) => document.getElementById(name).value;
  const colour = (number) => page.SERIES[number % page.SERIES.length];
  const symbol = (number) => SYMBOLS[Math.floor(number / page.SERIES.length) % SYMBOLS.length];

  return { FLOOR, TICKS, DENSE, logAxis, decadeAxis, onChange, value, colour, symbol };
})();
