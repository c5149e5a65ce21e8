/* What plots look like: axes and lines in the colours of the stylesheet, for uPlot. */
"use strict";
const chart = {
  COLOURS: 8, // that the stylesheet has: --line-0 and so on

  colour: (root, name) => getComputedStyle(root).getPropertyValue(name).trim(),

  axes(root) {
    const ink = (name) => chart.colour(root, name);
    const axis = { stroke: ink("--quiet"), grid: { stroke: ink("--line"), width: 1 }, ticks: { stroke: ink("--line") } };
    return [axis, { ...axis, size: 64 }];
  },

  /* The series of uPlot: the time, and a line for each label. */
  series: (root, labels) => [{ label: "Time" }, ...labels.map((label, at) => ({
    label,
    stroke: chart.colour(root, `--line-${at % chart.COLOURS}`),
    dash: at < chart.COLOURS ? [] : [6, 4],
    width: 1.5,
    spanGaps: true,
    points: { show: false },
    value: (_, number) => number === null || number === undefined ? "" : String(Number(number.toPrecision(7))),
  }))],
};
