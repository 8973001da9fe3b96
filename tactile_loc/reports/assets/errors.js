"use strict";
// Logarithmic axes of errors, and choices that redraw plots.
const errors = (() => {
  const POWERS = Array.from({ length: 13 }, (_, n) => n - 6);
  const ticks = (steps) => POWERS.flatMap((power) => steps.map((k) => +(k * 10 ** power).toPrecision(2)));
  const TICKS = ticks([1, 2, 5]), DENSE = ticks([1, 1.2, 1.5, 2, 3, 4, 5, 6, 8]); // for wide and narrow ranges

  function logAxis(c, title, more, tickvals = TICKS) {
    return page.axis(c, { type: "log", title: { text: title }, tickvals, ticktext: tickvals.map(String), ...more });
  }

  function onChange(names, then) {
    for (const name of names) document.getElementById(name)?.addEventListener("change", then);
  }

  const value = (name) => document.getElementById(name).value;
  const colour = (number) => page.SERIES[number % page.SERIES.length];

  return { TICKS, DENSE, logAxis, onChange, value, colour };
})();
