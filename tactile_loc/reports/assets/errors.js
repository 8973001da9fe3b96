"use strict";
// Axes of errors, which are logarithmic, and choices that draw plots anew.
const errors = (() => {
  const FLOOR = 1e-4; // errors below this share of a random pose's are drawn here
  const SYMBOLS = ["circle", "square", "diamond", "cross", "x", "triangle-up", "star"];
  const POWERS = Array.from({ length: 13 }, (_, n) => n - 6);
  const ticks = (steps) => POWERS.flatMap((power) => steps.map((k) => +(k * 10 ** power).toPrecision(2)));
  const TICKS = ticks([1, 2, 5]), DENSE = ticks([1, 1.2, 1.5, 2, 3, 4, 5, 6, 8]); // for wide and for narrow ranges

  function logAxis(c, title, more, tickvals = TICKS) {
    return page.axis(c, { type: "log", title: { text: title }, tickvals, ticktext: tickvals.map(String), ...more });
  }

  // The same where the values are decimal logarithms: a violin's density is that of what it is given.
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
