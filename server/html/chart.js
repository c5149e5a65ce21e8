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

  /* Numbers that are all the same lie in the middle: uPlot's own range of zeros goes up to 100. */
  scales: {
    y: {
      range(_, least, most) {
        if (least === null) return [null, null];
        const room = Math.abs(least) / 10 || 1;
        return least === most ? [least - room, most + room] : uPlot.rangeNum(least, most, 0.1, true);
      },
    },
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
